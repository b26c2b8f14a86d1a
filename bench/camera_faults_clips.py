"""Clips of silhouettes for bench/camera_faults.py, and the faults of cameras that change them."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from camera_client.settings import CameraClientSettings
from capture_rig import Rig
from capture_rig.session import load_session
from sagoma_tools.evaluation.in_process import exact_silhouettes, silhouettes
from stick_figure.body import Body
from virtual_studio.motions.catalogue import walk
from virtual_studio.people import VolumetricBody
from virtual_studio.rendering.camera import VirtualCamera
from virtual_studio.rig import ring

FPS = 60.0
SHARED = Path(os.environ.get("SAGOMA_SHARED_DATA", Path(__file__).resolve().parents[2] / "shared" / "data"))
SESSIONS = ("walk_ring5top", "charleston_ring5top", "zombie_he3")
STUDIOS = {"studio, 5 + ceiling": ring(5), "studio, 7 + ceiling": ring(7), "studio, 3": ring(3, ceiling=False)}
STATURE_M, WALK_S = 1.75, 5.0

Mask = np.ndarray
Lie = Callable[[Mask, np.random.Generator], Callable[[Mask], Mask]]


@dataclass(frozen=True, eq=False)
class Clip:
    """Canvas masks of every camera, frame after frame, packed eight pixels a byte."""

    name: str
    rig: Rig
    packed: list[dict[str, tuple[tuple[int, ...], np.ndarray]]]

    @classmethod
    def of(cls, name: str, rig: Rig, frames: Iterable[Mapping[str, Mask]]) -> Clip:
        return cls(name, rig, [{n: (m.shape, np.packbits(m > 0)) for n, m in masks.items()} for masks in frames])

    def mask(self, frame: int, camera: str) -> Mask:
        """Frames count on backwards from the clip's end, and forwards again from its start."""
        last = len(self.packed) - 1
        frame = frame % (2 * last)
        shape, bits = self.packed[min(frame, 2 * last - frame)][camera]
        return np.unpackbits(bits, count=shape[0] * shape[1]).reshape(shape) * np.uint8(255)


def clips(quick: bool, only: str = "") -> Iterator[Clip]:
    """The walking body of the virtual studio, and the rendered sessions where they are; those named like ``only``."""
    for name, rig in list(STUDIOS.items())[: 1 if quick else None]:
        if only in name:
            yield Clip.of(name, rig, _studio(rig, 3.0 if quick else WALK_S))
    for name in () if quick else SESSIONS:
        if not (SHARED / "sessions" / name).is_dir():
            print(f"{name} is not in {SHARED / 'sessions'}: left out")
            continue
        session = load_session(SHARED / "sessions" / name)
        if only in (exact := f"{name}, exact"):
            yield Clip.of(exact, session.rig, exact_silhouettes(session))
        if only in (ours := f"{name}, from video"):
            yield Clip.of(ours, session.rig, silhouettes(session, CameraClientSettings()))


def _studio(rig: Rig, seconds: float) -> Iterator[dict[str, Mask]]:
    eyes = {camera.name: (VirtualCamera(camera), camera.undistorted_view()) for camera in rig.cameras}
    body = Body.from_stature(STATURE_M)
    for pose in walk(body, seconds, FPS).poses:
        capsules = VolumetricBody(body).place(pose)
        yield {name: view.undistort_mask(eye.render(capsules, None)[1]) for name, (eye, view) in eyes.items()}


def lies(K: np.ndarray) -> dict[str, Lie]:
    """Each lie by name: from the last honest mask (and chance) to what becomes of every mask after it."""
    return {
        "blank": lambda last, rng: np.zeros_like,
        "lower half cut": lambda last, rng: lambda mask: _cut(mask, lower=True),
        "upper half cut": lambda last, rng: lambda mask: _cut(mask, lower=False),
        "turned 2 degrees": lambda last, rng: _turn(K, rng, 2.0),
        "turned 1 degree": lambda last, rng: _turn(K, rng, 1.0),
        "frozen": lambda last, rng: lambda mask: last,
        "all foreground": lambda last, rng: lambda mask: np.full_like(mask, 255),
        "mirrored": lambda last, rng: lambda mask: np.ascontiguousarray(mask[:, ::-1]),
    }


def _cut(mask: Mask, lower: bool) -> Mask:
    rows = np.flatnonzero(mask.any(1))
    half = slice((rows[0] + rows[-1]) // 2, None) if lower else slice((rows[0] + rows[-1]) // 2)
    cut = mask.copy()
    cut[half] = 0
    return cut


def _turn(K: np.ndarray, rng: np.random.Generator, degrees: float) -> Callable[[Mask], Mask]:
    """The picture after the camera has turned about a random axis: pixels move by K R K^-1."""
    axis = rng.normal(size=3)
    R = cv2.Rodrigues(np.radians(degrees) * axis / np.linalg.norm(axis))[0]
    H = K @ R @ np.linalg.inv(K)
    return lambda mask: cv2.warpPerspective(mask, H, mask.shape[::-1], flags=cv2.INTER_NEAREST)
