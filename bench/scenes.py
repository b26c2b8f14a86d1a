"""What the benches play: sessions of the test data, and clips of the studio's people before a rig.

Test data is looked for in ../shared/data, or where SAGOMA_SHARED_DATA points; what is absent is left out, and said so.
"""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from clips import Clip

from capture_rig import Rig
from capture_rig.session import Session, load_session
from mocap_pipeline.pipeline import Masks
from stick_figure.body import Body
from stick_figure.kinematics import forward
from stick_figure.pose import Pose
from virtual_studio.motions.catalogue import MOTIONS, Motion
from virtual_studio.motions.together import TOGETHER
from virtual_studio.people import VolumetricBody, together
from virtual_studio.rendering.camera import ExactSilhouettes
from virtual_studio.rig import ring

SHARED = Path(os.environ.get("SAGOMA_SHARED_DATA", Path(__file__).resolve().parents[2] / "shared" / "data"))
STATURE_M, STUDIO_FPS = 1.75, 60.0
MARGIN_M = 0.05
"""How far inside the volume all points must lie for a frame to count: flesh reaches farther than joints."""


def shared_sessions(names: Iterable[str] = (), only: str = "") -> Iterator[tuple[str, Session]]:
    """Sessions of the test data by name: those of ``names`` (paths in it; all rendered ones) with ``only`` in them."""
    rendered = SHARED / "sessions"
    folders = [SHARED / name for name in names] or (sorted(rendered.iterdir()) if rendered.is_dir() else [])
    if not folders:
        print(f"{rendered} is not there: no rendered sessions (SAGOMA_SHARED_DATA names the folder of the test data)")
    for folder in folders:
        if only in folder.name and not folder.is_dir():
            print(f"{folder} is not there: left out")
        elif only in folder.name:
            yield folder.name, load_session(folder)


def studio_masks(rig: Rig, body: Body, poses: Iterable[Pose], build: float = 1.0) -> Iterator[Masks]:
    """Exact canvas silhouettes of the studio's person in these poses."""
    person, cameras = VolumetricBody(body, build), ExactSilhouettes(rig)
    return (cameras.render(person.place(pose)) for pose in poses)


def motion_masks(rig: Rig, person: VolumetricBody, motion: Motion) -> Iterator[Masks]:
    """Exact canvas silhouettes of the studio's person in motion, with what it carries; things in the room hide both."""
    cameras, things = ExactSilhouettes(rig), motion.things
    for frame, pose in enumerate(motion.poses):
        placed = person.place(pose)
        yield cameras.render(things.foreground(placed, frame), things.room(frame)) if things else cameras.render(placed)


def together_clip(scene: str, persons: Sequence[VolumetricBody], cameras: int = 6, fps: float = STUDIO_FPS) -> Clip:
    """Several of the studio's persons in a named scene, exact silhouettes of a ring of cameras and one on the ceiling.

    Roles that nobody is given for are left out.
    """
    whole = TOGETHER[scene]
    rig, motions = ring(cameras - 1), replace(whole, roles=whole.roles[: len(persons)]).motions(persons, fps)
    eyes, instants = ExactSilhouettes(rig), zip(*(motion.poses for motion in motions), strict=True)
    frames = (eyes.render(together(*map(VolumetricBody.place, persons, poses))) for poses in instants)
    truth, *others = (
        np.array([forward(person.body, pose) for pose in motion.poses])
        for person, motion in zip(persons, motions, strict=True)
    )
    return Clip.of(f"{scene}_{cameras}", rig, fps, frames, truth=truth, others=tuple(others))


def studio_clip(motion: str, seconds: float, cameras: int = 6, body: Body | None = None, build: float = 1.0) -> Clip:
    """A named motion of the virtual studio, exact silhouettes of a ring of cameras and one on the ceiling."""
    rig, body = ring(cameras - 1), body or Body.from_stature(STATURE_M)
    played = MOTIONS[motion](body, seconds, STUDIO_FPS, build)
    truth = np.array([forward(body, pose) for pose in played.poses])
    masks = motion_masks(rig, VolumetricBody(body, build), played)
    return Clip.of(f"{motion}_{cameras}", rig, STUDIO_FPS, masks, truth=truth)


def inside_volume(rig: Rig, truth: np.ndarray) -> np.ndarray:
    """Tell in which frames (F,) all known points (F, 15, 3) m lie inside the capture volume, above or on the floor."""
    low, high = rig.volume.low + MARGIN_M, rig.volume.high - MARGIN_M
    outside = (truth < np.array([*low[:2], -1.0])) | (truth > high)
    return np.isfinite(truth).any(axis=(1, 2)) & ~outside.any(axis=(1, 2))
