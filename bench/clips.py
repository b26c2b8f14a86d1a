"""Clips to drill a tracker with: canvas silhouettes and true points, from the virtual studio or a session folder."""

from __future__ import annotations

import zlib
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from capture_rig.errors import InputError
from capture_rig.rig import Rig
from capture_rig.session import footage_stamp_ns, load_session
from mocap_packets.hull import HullProducts
from sagoma_tools.evaluation.chain import Chain, Configuration, Masks
from sagoma_tools.evaluation.in_process import EPOCH_NS, exact_silhouettes, silhouettes
from sagoma_tools.evaluation.live_run import start_settings
from stick_figure.body import Body
from stick_figure.kinematics import forward
from virtual_studio.motions.catalogue import MOTIONS
from virtual_studio.people import VolumetricBody
from virtual_studio.rendering.camera import ExactSilhouettes
from virtual_studio.rig import ring

STUDIO_FPS, STATURE_M = 60.0, 1.75

Packed = dict[str, tuple[bytes, tuple[int, ...]]]
"""Masks of one frame, compressed: a clip in memory is a thousandth of its pixels."""


@dataclass(frozen=True, eq=False)
class Clip:
    """One capture. truth (F, 15, 3) m, NaN where unknown; start: settings of the first pose."""

    name: str
    rig: Rig
    fps: float
    truth: np.ndarray
    start: dict[str, Any]
    packed: list[Packed]

    def __len__(self) -> int:
        return len(self.packed)

    def stamp_ns(self, frame: int) -> int:
        """Capture stamp of a frame."""
        return footage_stamp_ns(EPOCH_NS, frame, self.fps)

    def masks(self, frame: int) -> Masks:
        """Canvas masks of a frame."""
        return {
            name: np.frombuffer(zlib.decompress(data), np.uint8).reshape(shape)
            for name, (data, shape) in self.packed[frame].items()
        }

    def chain(self, settings: dict[str, Any]) -> Chain:
        """A fresh hull, tracker and filter for this clip."""
        return Chain(self.rig, Configuration.of({"hull_server.backend": "cpu", **self.start, **settings}))

    def carved(self, settings: dict[str, Any]) -> list[HullProducts]:
        """The hull of every frame, undisturbed."""
        chain = self.chain(settings)
        return [chain.carve(self.stamp_ns(frame), self.masks(frame)) for frame in range(len(self))]


def studio_clip(motion: str, seconds: float, cameras: int = 6, body: Body | None = None, build: float = 1.0) -> Clip:
    """A named motion of the virtual studio, exact silhouettes of a ring of cameras and one on the ceiling."""
    rig, body = ring(cameras - 1), body or Body.from_stature(STATURE_M)
    person, eyes = VolumetricBody(body, build), ExactSilhouettes(rig)
    poses = MOTIONS[motion](body, seconds, STUDIO_FPS, build).poses
    truth = np.array([forward(body, pose) for pose in poses])
    packed = [_packed(eyes.render(person.place(pose))) for pose in poses]
    return Clip(f"{motion}_{cameras}", rig, STUDIO_FPS, truth, {}, packed)


def session_clip(folder: Path, exact: bool) -> Clip:
    """A session folder with a reference, its exact silhouettes or those of its footage."""
    session = load_session(folder)
    if session.truth is None:
        raise InputError("has no truth.csv or reference*.csv", where=str(folder), remedy="Give a session with a truth.")
    start = start_settings(session, "auto")
    camera = Configuration.of({}).camera
    packed = _pack_all(exact_silhouettes(session) if exact else silhouettes(session, camera))
    truth = np.full((len(packed), 15, 3), np.nan)
    known = session.truth.frames < len(packed)
    truth[session.truth.frames[known]] = session.truth.stick_figure_points()[known]
    return Clip(session.folder.name, session.rig, session.fps, truth, start, packed)


def _pack_all(masks: Iterable[Masks]) -> list[Packed]:
    return [_packed(each) for each in masks]


def _packed(masks: Masks) -> Packed:
    return {name: (zlib.compress(np.ascontiguousarray(mask), 1), mask.shape) for name, mask in masks.items()}
