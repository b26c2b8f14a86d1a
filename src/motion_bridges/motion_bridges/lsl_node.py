"""Lab Streaming Layer: one stream of points and joint angles, to be recorded beside EEG, EMG or force plates."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from typing import Any

from capture_rig.errors import InputError
from capture_rig.settings import setting
from capture_rig.stamps import NS_PER_S
from motion_export.motion import T_POSE_STICKS
from sagoma_ros.process import run_node
from stick_figure.skeleton import POINT_NAMES

from .isb_node import ContinuousAngles
from .person_node import Instant, PersonNode, PersonSettings

MACHINE, NETWORK = "machine", "network"


@dataclass(frozen=True)
class LslSettings(PersonSettings):
    """Parameters of the node lsl_bridge."""

    scope: str = setting(
        MACHINE,
        "who finds the stream: programs on this machine; or whom LSL's own settings say",
        choices=(MACHINE, NETWORK),
    )


class LslBridge(PersonNode):
    """Offers a stream of type MoCap: 15 points in metres, then the angles of the ISB in degrees.

    Its time stamps are the instants of exposure by LSL's clock.
    """

    Name, Settings = "lsl_bridge", LslSettings

    def configure(self) -> None:
        """Load the library, offer the stream."""
        super().configure()
        try:  # an optional requirement
            import pylsl
        except (ImportError, RuntimeError):  # RuntimeError: no liblsl for it
            remedy = "Install it: pip install 'pylsl>=1.18' into the environment of this node."
            raise InputError("pylsl is not installed", where="lsl_bridge", remedy=remedy) from None
        self._lsl, self._angles = pylsl, ContinuousAngles()
        if self.settings.scope == MACHINE:
            pylsl.set_config_content("[multicast]\nResolveScope = machine\n")
        self._outlet = pylsl.StreamOutlet(self._description(list(self._angles.update(T_POSE_STICKS))))
        self._closing.append(lambda: delattr(self, "_outlet"))  # takes the stream back

    def send(self, instant: Instant) -> None:
        """Send an instant."""
        angles = self._angles.update(instant.R_world_sticks)
        age_s = (self.get_clock().now().nanoseconds - instant.stamp_ns) / NS_PER_S
        sample = [*instant.points_world.ravel().tolist(), *angles.values()]
        self._outlet.push_sample(sample, self._lsl.local_clock() - age_s)

    def _description(self, angles: list[str]) -> Any:
        """Return the stream's description, as XDF has it for motion capture."""
        points = [(f"{name}_{axis}", f"Position{axis.upper()}", "meters") for name in POINT_NAMES for axis in "xyz"]
        channels = [*points, *((name, "Angle", "degrees") for name in angles)]
        name = f"sagoma {self.resolve_topic_name(self.settings.person)}"
        stream = self._lsl.StreamInfo(name, "MoCap", len(channels), channel_format="float32", source_id=name)
        labels, types, units = zip(*channels, strict=True)
        stream.set_channel_labels(labels)
        stream.set_channel_types(types)
        stream.set_channel_units(units)
        return stream


def main(args: list[str] | None = None) -> None:
    """Entry point of the executable ``lsl_bridge``."""
    sys.exit(run_node(LslBridge, args))


if __name__ == "__main__":
    main()
