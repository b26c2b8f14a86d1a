"""Scenes of camera_movement.py: a camera of the studio that is moved while it films, and recorded silhouettes."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cache
from itertools import islice

import cv2
import numpy as np
from clips import Clip, canvas_masks
from scenes import STATURE_M, STUDIO_FPS, shared_sessions

from camera_client.background.model import BackgroundLearner, BackgroundModel
from camera_client.frame_processor import FrameProcessor, FrameResult
from camera_client.frame_source import Frame
from camera_client.settings import CameraClientSettings
from capture_rig import CameraModel
from sagoma_bringup.launch_arguments import start_settings
from stick_figure.body import Body
from virtual_studio.motions.catalogue import walk
from virtual_studio.people import Capsules, VolumetricBody
from virtual_studio.rendering.camera import Sensor, VirtualCamera
from virtual_studio.rendering.capsules import floor_shadow
from virtual_studio.rig import ring

SESSIONS = ("sessions/walk_ring5top", "sessions/charleston_ring5top", "sessions/zombie_he3", "real_4cam")
FPS = STUDIO_FPS
EVERY = 6  # frames of which one is rendered and looked at
SECONDS, BACKGROUND_FRAMES = 12.0, 20
AXES = {"pan": 1, "tilt": 0, "roll": 2}
PUSHES = {"sideways": 0, "upwards": 1}

Mask = np.ndarray


@dataclass(frozen=True)
class Displacement:
    """What befalls a camera: a turn about one of its own axes, degrees, or a push along one of them, metres."""

    name: str
    axis: int
    turn_deg: float = 0.0
    push_m: float = 0.0

    def matrix(self, sign: float) -> np.ndarray:
        """T_moved_camera (4, 4): what a point in the camera's frame is afterwards."""
        T = np.eye(4)
        T[:3, :3] = cv2.Rodrigues(sign * np.radians(self.turn_deg) * np.eye(3)[self.axis])[0]
        T[:3, 3] = sign * self.push_m * np.eye(3)[self.axis]
        return T

    def moved(self, camera: CameraModel, sign: float) -> CameraModel:
        """The camera where it really stands then."""
        return replace(camera, T_camera_world=self.matrix(sign) @ camera.T_camera_world)

    def homography(self, K: np.ndarray, sign: float) -> np.ndarray:
        """What a turn does to the undistorted picture."""
        return K @ self.matrix(sign)[:3, :3] @ np.linalg.inv(K)


def displacements(quick: bool) -> list[Displacement]:
    degrees = (1.0,) if quick else (0.5, 1.0, 2.0)
    turns = [
        Displacement(f"{name} {deg:g} degrees", axis, turn_deg=deg) for deg in degrees for name, axis in AXES.items()
    ]
    return turns + [Displacement(f"5 cm {name}", axis, push_m=0.05) for name, axis in PUSHES.items()]


class Studio:
    """The studio's rig, a walking person, and every camera's footage, rendered when it is asked for."""

    def __init__(self, cameras: int = 5) -> None:
        self.rig = ring(cameras)
        self.sensor = Sensor(3.0, 0.005, 1)
        body = Body.from_stature(STATURE_M)
        person = VolumetricBody(body)
        self.capsules: list[Capsules] = [person.place(pose) for pose in walk(body, SECONDS, FPS).poses[::EVERY]]
        self.shadows = [floor_shadow(capsules) for capsules in self.capsules]

    def film(self, camera: CameraModel, frame: int) -> tuple[Mask, Mask]:
        """Picture and exact silhouette (H, W) uint8 of a camera that stands where ``camera`` says."""
        light, mask = _eye(camera).render(self.capsules[frame], self.shadows[frame])
        return self.sensor.expose(light, self._number(camera), frame), mask

    def empty(self, camera: CameraModel) -> BackgroundModel:
        """The background learned from that place."""
        learner, number = BackgroundLearner(), self._number(camera)
        for frame in range(BACKGROUND_FRAMES):
            learner.add(self.sensor.expose(_eye(camera).empty_room(), number, 10_000 + frame))
        return learner.model("the studio")

    def processor(self, camera: CameraModel) -> FrameProcessor:
        """A camera client's chain, with the background of where the camera stands by its calibration."""
        processor = FrameProcessor(camera, CameraClientSettings(), self.rig.volume)
        processor.use_learned_background(_empty(self, camera))
        return processor

    def _number(self, camera: CameraModel) -> int:
        return self.rig.names.index(camera.name)


@cache
def _empty(studio: Studio, camera: CameraModel) -> BackgroundModel:
    return studio.empty(camera)


@cache
def _eye(camera: CameraModel) -> VirtualCamera:
    return VirtualCamera(camera)


def stamp_ns(frame: int) -> int:
    """Of one of the frames that are looked at."""
    return round(frame * EVERY / FPS * 1e9) + 1


def seen_by(processor: FrameProcessor, picture: Mask, frame: int) -> FrameResult:
    """What the chain makes of a picture."""
    return processor.run(Frame(picture, stamp_ns(frame), frame, "the studio's"))


def session_clips(only: str) -> Iterator[Clip]:
    """Our silhouettes of the sessions, and the exact ones where there are any; every EVERY-th frame."""
    for name, session in shared_sessions(SESSIONS, only):
        for kind, exact in (("from video", False), ("exact", True)):
            if not exact or session.masks:
                frames = islice(canvas_masks(session, exact), 0, None, EVERY)
                yield Clip.of(f"{name}, {kind}", session.rig, FPS / EVERY, frames, start=start_settings(session))
