"""Avatars in Unity, Unreal, VTuber programs: Virtual Motion Capture protocol (https://protocol.vmc.info), over OSC."""

from __future__ import annotations

import socket
import sys
from dataclasses import dataclass
from typing import Any

import numpy as np
from pythonosc.osc_bundle import OscBundle
from pythonosc.osc_bundle_builder import IMMEDIATELY, OscBundleBuilder
from pythonosc.osc_message_builder import OscMessageBuilder
from pythonosc.udp_client import UDPClient
from scipy.spatial.transform import Rotation

from capture_rig.errors import InputError
from capture_rig.settings import setting
from capture_rig.stamps import NS_PER_S
from motion_export.joint_tree import JOINTS, local_transforms
from motion_export.motion import rotated
from sagoma_ros.process import run_node

from .person_node import Instant, PersonNode, PersonSettings

UNITY_AXES = np.diag([-1.0, 1.0, 1.0])
"""From animation axes (y up, z forward, x to the left) to Unity's, which are left-handed: x to the right."""
BONES = {
    "Hips": "Hips",
    "Spine": "Spine",
    "Neck": "Neck",
    "LeftArm": "LeftUpperArm",
    "LeftForeArm": "LeftLowerArm",
    "RightArm": "RightUpperArm",
    "RightForeArm": "RightLowerArm",
    "LeftUpLeg": "LeftUpperLeg",
    "LeftLeg": "LeftLowerLeg",
    "RightUpLeg": "RightUpperLeg",
    "RightLeg": "RightLowerLeg",
}
"""Joints of `motion_export.joint_tree` and the names of Unity's HumanBodyBones; hands, feet and head keep the avatar's
own rest."""
RIGID = ("Chest", "UpperChest", "LeftShoulder", "RightShoulder")
"""Bones that some avatars have between those above: they stay in the place and axes of the bone that carries them."""
TRANSFORM = tuple[list[float], list[float]]
AT_REST: TRANSFORM = ([0.0, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0])
VMC_PORT = 39539
"""The usual one of programs that draw an avatar ("Marionette")."""


def vmc_bones(instant: Instant) -> dict[str, TRANSFORM]:
    """Return place (m) and quaternion (x y z w) of every bone in the bone that carries it, in Unity's axes.

    "root" stands on the floor below the hips and does not turn, for receivers that use the root's place alone.
    """
    places, R = local_transforms(instant.points_world[None], instant.R_world_sticks[None])
    places, quaternions = places[0] @ UNITY_AXES, Rotation.from_matrix(rotated(R[0], UNITY_AXES)).as_quat()
    x, height, z = places[0].tolist()
    places[0] = 0.0, height, 0.0
    moved = {
        BONES[j.name]: (places[k].tolist(), quaternions[k].tolist()) for k, j in enumerate(JOINTS) if j.name in BONES
    }
    return {"root": ([x, 0.0, z], AT_REST[1]), **moved, **dict.fromkeys(RIGID, AT_REST)}


def vmc_bundle(bones: dict[str, TRANSFORM], time_s: float) -> OscBundle:
    """Return one OSC bundle with the bones, the sender's time, and the word that they are valid."""
    bundle = OscBundleBuilder(IMMEDIATELY)
    said: list[tuple[str, list[Any]]] = [("/VMC/Ext/OK", [1]), ("/VMC/Ext/T", [time_s])]
    for name, (place, quaternion) in bones.items():
        address = "/VMC/Ext/Root/Pos" if name == "root" else "/VMC/Ext/Bone/Pos"
        said.append((address, [name, *place, *quaternion]))
    for address, values in said:
        message = OscMessageBuilder(address)
        for value in values:
            message.add_arg(value)
        bundle.add_content(message.build())
    return bundle.build()


@dataclass(frozen=True)
class VmcSettings(PersonSettings):
    """Parameters of the node vmc_bridge."""

    host: str = setting("127.0.0.1", "machine that draws the avatar")
    port: int = setting(VMC_PORT, "UDP port on which it listens", low=1, high=65535)


class VmcBridge(PersonNode):
    """Sends every frame set as one bundle of OSC over UDP, in the Virtual Motion Capture protocol."""

    Name, Settings = "vmc_bridge", VmcSettings

    def configure(self) -> None:
        """Open the socket."""
        super().configure()
        self._first_ns = 0
        host, port = self.settings.host, self.settings.port
        try:
            self._client = UDPClient(host, port)
        except (socket.gaierror, UnicodeError):
            raise InputError(
                f"there is no machine '{host}'", where="host", remedy="Give a name or an address."
            ) from None
        self._closing.append(self._client.close)

    def send(self, instant: Instant) -> None:
        """Send an instant."""
        self._first_ns = self._first_ns or instant.stamp_ns
        self._client.send(vmc_bundle(vmc_bones(instant), (instant.stamp_ns - self._first_ns) / NS_PER_S))


def main(args: list[str] | None = None) -> None:
    """Entry point of the executable ``vmc_bridge``."""
    sys.exit(run_node(VmcBridge, args))


if __name__ == "__main__":
    main()
