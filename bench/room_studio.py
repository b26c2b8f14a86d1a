"""Clips of the virtual studio for bench/rooms.py: a person in clothes of any kind, grey or in colour, casting shadows.

The person walks in the ring of cameras; masks are exact. Sensors have a noise of two grey levels and lamps a ripple of
half a percent, in the empty room, too.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from room_clips import EMPTY_STRIDE, STRIDE, RoomClip
from scenes import STATURE_M, STUDIO_FPS

from stick_figure.body import Body
from stick_figure.pose import Pose
from virtual_studio.motions.catalogue import MOTIONS
from virtual_studio.outfits import OUTFITS
from virtual_studio.people import Capsules, VolumetricBody
from virtual_studio.recording.session import BACKGROUND_S, FIRST_BACKGROUND_FRAME
from virtual_studio.rendering.camera import Sensor, VirtualCamera
from virtual_studio.rendering.capsules import floor_shadow
from virtual_studio.rig import ring

SIDE_CAMERAS = 4
SENSOR = Sensor(noise=2.0, flicker=0.005, seed=13)


@dataclass(frozen=True)
class Look:
    """How a studio clip looks: colour or grey, one of the studio's outfits, strength of the floor's shadows 0..1."""

    colour: bool = False
    outfit: str = "middle"
    shadow: float = 0.5

    def __str__(self) -> str:
        return f"studio_{'colour' if self.colour else 'mono'}_{self.outfit}_shadow{self.shadow:g}"


LOOKS = tuple(
    Look(colour, outfit, shadow)
    for colour in (False, True)
    for outfit, shadow in (
        ("middle", 0.5),
        ("dark", 0.5),
        ("light", 0.5),
        ("room", 0.5),
        ("middle", 0.0),
        ("middle", 1.0),
    )
)
"""The first of each kind is the one that is disturbed further."""


class Studio:
    """The studio's rig and its person, looked at in one way."""

    def __init__(self, look: Look) -> None:
        self.look, self.rig = look, ring(SIDE_CAMERAS)
        self.cameras = {camera.name: VirtualCamera(camera) for camera in self.rig.cameras}
        self._person = VolumetricBody(Body.from_stature(STATURE_M))

    def empty(self, camera: str) -> np.ndarray:
        """Return the light of the empty room, (H, W[, 3])."""
        eye = self.cameras[camera]
        return eye.empty_room_colour() if self.look.colour else eye.empty_room()

    def shadow(self, pose: Pose) -> tuple[Capsules, np.ndarray]:
        """Return the person in a pose, and the shadow on the floor, the same for every camera."""
        capsules = self._person.place(pose)
        return capsules, floor_shadow(capsules, self.look.shadow)

    def seen(self, camera: str, capsules: Capsules, shadow: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return light and exact mask of the person in the room."""
        eye, outfit = self.cameras[camera], OUTFITS[self.look.outfit]
        if self.look.colour:
            return eye.render_colour(capsules, outfit.albedo_bgr(capsules), shadow)
        return eye.render(outfit.dress(capsules), shadow)

    def empty_frames(self, camera: str, frames: int) -> np.ndarray:
        """Return pictures of the empty room, to learn from."""
        light, number = self.empty(camera), self.rig.names.index(camera)
        return np.array([SENSOR.expose(light, number, FIRST_BACKGROUND_FRAME + k) for k in range(frames)])


def studio_clip(look: Look, seconds: float) -> RoomClip:
    """Film the person walking for so long, from the T-pose on."""
    studio, fps = Studio(look), STUDIO_FPS / STRIDE
    poses = MOTIONS["walk"](Body.from_stature(STATURE_M), seconds, fps).poses
    names = studio.rig.names
    films: dict[str, list[Any]] = {name: [] for name in names}
    masks: dict[str, list[Any]] = {name: [] for name in names}
    for frame, pose in enumerate(poses):
        capsules, shadow = studio.shadow(pose)
        for number, name in enumerate(names):
            light, mask = studio.seen(name, capsules, shadow)
            films[name].append(SENSOR.expose(light, number, frame))
            masks[name].append(mask)
    empty = {name: studio.empty_frames(name, round(BACKGROUND_S * STUDIO_FPS / EMPTY_STRIDE)) for name in names}
    take, truth = ({name: np.array(frames) for name, frames in part.items()} for part in (films, masks))
    return RoomClip(str(look), studio.rig, fps, empty, take, truth)
