"""A shadow resolver's node: takes all cameras' silhouettes, hands on those of its cameras with the shadows resolved.

Several of them, each with some cameras, take the hull server's largest part off it (docs/hosts.md):

    ros2 run hull_server shadow_resolver --ros-args -r __node:=resolver_1 -p rig_file:=RIG -p cameras:="[cam01, cam02]"
    ros2 run hull_server hull_server --ros-args -p rig_file:=RIG -p resolved:=true
"""

from __future__ import annotations

from functools import partial

from sensor_msgs.msg import CompressedImage

from capture_rig import InputError
from sagoma_ros import mask_png
from sagoma_ros.health import OK
from sagoma_ros.images import absence_message, silhouette_message
from sagoma_ros.process import run_node
from sagoma_ros.qos import SILHOUETTE_PUBLISHER

from .camera_groups import GroupResolver
from .hull_node import ClosedSet, HullNode
from .settings import ResolverSettings
from .silhouette_input_ros import RESOLVED, SilhouetteInput


class ResolverNode(HullNode):
    """Silhouettes of all cameras in; CAM/silhouette/resolved/compressed of its cameras out, one each per set.

    It collects frame sets as the hull server does, and refuses cameras by the same rules; it thins nothing out.
    """

    Settings = ResolverSettings

    def __init__(self, **options: object) -> None:
        super().__init__("shadow_resolver", **options)
        self._resolver: GroupResolver | None = None

    def configure(self) -> None:
        """Load the rig, compute the calibration's tables, subscribe."""
        settings: ResolverSettings = self.settings
        rig = self._load_rig()
        chosen = settings.cameras or list(rig.names)
        if unknown := sorted(set(chosen) - set(rig.names)):
            raise InputError(
                f"the rig has no camera {', '.join(unknown)}",
                where=f"parameter cameras of {self.get_name()}",
                remedy=f"Known cameras: {', '.join(rig.names)}.",
            )
        self._resolver = GroupResolver(rig, settings, chosen)
        mask_png.warm_up()
        self._resolved = {
            camera: self.create_publisher(CompressedImage, f"{camera}/{RESOLVED}/compressed", SILHOUETTE_PUBLISHER)
            for camera in self._resolver.cameras
        }
        self._closing += [partial(self.destroy_publisher, publisher) for publisher in self._resolved.values()]
        self.silhouettes = SilhouetteInput(self, self._canvases, self._overload, self._take)

    def cleanup(self) -> None:
        """Release subscriptions and publishers."""
        super().cleanup()
        self._resolver = None

    def _begin(self, closed: ClosedSet) -> None:
        """Resolve one frame set and publish it, on a thread of its own."""
        assert self._resolver is not None
        frame_set = closed.frame_set
        for camera, levels in self._resolver.run(frame_set).items():
            message = silhouette_message(levels, frame_set.stamps_ns[camera], f"{camera}_optical")
            self._resolved[camera].publish(message)
        if self.settings.reliable:
            for camera in set(frame_set.missing) & self._resolved.keys():
                self._resolved[camera].publish(absence_message(frame_set.stamp_ns))
        self.health.count("sets_resolved")
        if self.silhouettes is None or not self.silhouettes.refused:
            self.health.status(OK, f"resolving {', '.join(self._resolver.cameras)}")


def main(args: list[str] | None = None) -> int:
    """Entry point of the executable."""
    return run_node(ResolverNode, args)


if __name__ == "__main__":
    raise SystemExit(main())
