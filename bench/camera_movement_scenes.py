"""Scenes of bench/camera_movement.py: a camera of the studio that is moved while it films, and recorded silhouettes."""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

import cv2
import numpy as np

from camera_client.background.model import BackgroundLearner, BackgroundModel
from camera_client.camera_chain import CameraChain, FrameResult
from camera_client.frame_source import Frame
from camera_client.settings import CameraClientSettings
from capture_rig import CameraModel, Rig
from capture_rig.session import Session, load_session
from sagoma_tools.evaluation.in_process import exact_silhouettes, silhouettes
from stick_figure.body import Body
from virtual_studio.motions.catalogue import walk
from virtual_studio.people import Capsules, VolumetricBody
from virtual_studio.rendering.camera import Sensor, VirtualCamera
from virtual_studio.rendering.capsules import floor_shadow
from virtual_studio.rig import ring

SHARED = Path(os.environ.get("SAGOMA_SHARED_DATA", Path(__file__).resolve().parents[2] / "shared" / "data"))
SESSIONS = ("sessions/walk_ring5top", "sessions/charleston_ring5top", "sessions/zombie_he3", "real_4cam")
FPS = 60.0
EVERY = 6  # frames of which one is rendered and looked at
STATURE_M, SECONDS, BACKGROUND_FRAMES = 1.75, 9.0, 20
AXES = {"pan": 1, "tilt": 0, "roll": 2}
PUSHES = {"sideways": 0, "upwards": 1}

Mask = np.ndarray
Masks = dict[str, Mask]


@dataclass(frozen=True)
class Bump:
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


def bumps(quick: bool) -> list[Bump]:
    degrees = (1.0,) if quick else (0.5, 1.0, 2.0)
    turns = [Bump(f"{name} {deg:g} degrees", axis, turn_deg=deg) for deg in degrees for name, axis in AXES.items()]
    return turns + [Bump(f"5 cm {name}", axis, push_m=0.05) for name, axis in PUSHES.items()]


class Studio:
    """The studio's rig, a walking person, and every camera's footage, rendered when it is asked for."""

    def __init__(self, cameras: int = 5) -> None:
        self.rig = ring(cameras)
        self.sensor = Sensor(3.0, 0.005, 1)
        body = Body.from_stature(STATURE_M)
        person = VolumetricBody(body)
        self.capsules: list[Capsules] = [person.place(pose) for pose in walk(body, SECONDS, FPS).poses[60::EVERY]]
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

    def chain(self, camera: CameraModel) -> CameraChain:
        """A camera client's chain, with the background of where the camera stands by its calibration."""
        chain = CameraChain(camera, CameraClientSettings(), self.rig.volume)
        chain.use_learned_background(_empty(self, camera))
        return chain

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


def seen_by(chain: CameraChain, picture: Mask, frame: int) -> FrameResult:
    """What the chain makes of a picture."""
    return chain.run(Frame(picture, stamp_ns(frame), frame, "the studio's"))


@dataclass(frozen=True, eq=False)
class Clip:
    """Canvas masks (levels of capture_rig.mask_levels) of every camera, packed: what is the person, and what may be."""

    name: str
    rig: Rig
    packed: list[dict[str, tuple[tuple[int, ...], np.ndarray, np.ndarray]]]

    @classmethod
    def of(cls, name: str, rig: Rig, frames: Iterable[Mapping[str, Mask]]) -> Clip:
        kept = [masks for frame, masks in enumerate(frames) if frame % EVERY == 0]
        return cls(
            name,
            rig,
            [{n: (m.shape, np.packbits(m == 255), np.packbits(m > 0)) for n, m in masks.items()} for masks in kept],
        )

    def masks(self, frame: int) -> Masks:
        """Frames count on backwards from the clip's end, and forwards again from its start."""
        last = len(self.packed) - 1
        frame = frame % (2 * last)
        return {name: _unpacked(*bits) for name, bits in self.packed[min(frame, 2 * last - frame)].items()}


def _unpacked(shape: tuple[int, ...], person: np.ndarray, any_: np.ndarray) -> Mask:
    count = shape[0] * shape[1]
    levels = np.unpackbits(any_, count=count) * np.uint8(85) + np.unpackbits(person, count=count) * np.uint8(170)
    return levels.reshape(shape)


def sessions(only: str) -> Iterator[tuple[str, Session]]:
    """Those that are there, and have ``only`` in their name."""
    for name in SESSIONS:
        if only not in name:
            continue
        if (SHARED / name).is_dir():
            yield Path(name).name, load_session(SHARED / name)
        else:
            print(f"{name} is not in {SHARED}: left out")


def session_clips(only: str) -> Iterator[Clip]:
    """Our silhouettes of the sessions, and the exact ones where there are any."""
    for name, session in sessions(only):
        yield Clip.of(f"{name}, from video", session.rig, silhouettes(session, CameraClientSettings()))
        if session.masks:
            yield Clip.of(f"{name}, exact", session.rig, exact_silhouettes(session))
