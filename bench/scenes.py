"""What the benches play: sessions of the test data, the studio's person before a rig, and clips of canvas silhouettes.

Test data is looked for in ../shared/data, or where SAGOMA_SHARED_DATA points; what is absent is left out, and said so.
"""

from __future__ import annotations

import os
import zlib
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from camera_client.settings import CameraClientSettings
from capture_rig import Rig
from capture_rig.errors import InputError
from capture_rig.session import Session, Truth, footage_stamp_ns, load_session
from mocap_packets.hull import HullProducts
from mocap_pipeline.configuration import Configuration
from mocap_pipeline.pipeline import Masks, MocapPipeline
from mocap_pipeline.session_footage import EPOCH_NS, exact_silhouettes, silhouettes
from sagoma_bringup.first_pose import start_settings
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


def session_with_truth(folder: Path) -> Session:
    """A session folder that has a reference. Raises InputError."""
    session = load_session(folder)
    if session.truth is None:
        raise InputError("has no truth.csv or reference*.csv", where=str(folder), remedy="Give a session with a truth.")
    return session


def canvas_masks(session: Session, exact: bool) -> Iterator[Masks]:
    """Silhouettes of a session, frame by frame: exact, or as the camera client segments the footage."""
    return exact_silhouettes(session) if exact else silhouettes(session, CameraClientSettings())


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


@dataclass(frozen=True, eq=False)
class Clip:
    """Canvas masks of every camera, frame after frame, compressed: a clip in memory is a hundredth of its pixels.

    truth : (F, 15, 3) m, NaN where unknown; others : those of further persons. start : settings of the first pose.
    """

    name: str
    rig: Rig
    fps: float
    packed: list[dict[str, tuple[bytes, tuple[int, ...]]]]
    truth: np.ndarray = field(default_factory=lambda: np.empty((0, 15, 3)))
    start: Mapping[str, Any] = field(default_factory=dict)
    others: tuple[np.ndarray, ...] = ()

    @classmethod
    def of(cls, name: str, rig: Rig, fps: float, frames: Iterable[Masks], **more: Any) -> Clip:
        """From masks."""
        packed = [{n: (zlib.compress(np.ascontiguousarray(m), 1), m.shape) for n, m in f.items()} for f in frames]
        return cls(name, rig, fps, packed, **more)

    def __len__(self) -> int:
        return len(self.packed)

    def stamp_ns(self, frame: int) -> int:
        """Capture stamp of a frame."""
        return footage_stamp_ns(EPOCH_NS, frame, self.fps)

    def mask(self, frame: int, camera: str) -> np.ndarray:
        """One mask. Frames count on backwards from the clip's end, and forwards again from its start."""
        last = len(self) - 1
        frame %= max(2 * last, 1)
        data, shape = self.packed[min(frame, 2 * last - frame)][camera]
        return np.frombuffer(zlib.decompress(data), np.uint8).reshape(shape)

    def masks(self, frame: int) -> Masks:
        """Every camera's."""
        return {camera: self.mask(frame, camera) for camera in self.rig.names}

    @property
    def start_from_t_pose(self) -> Mapping[str, Any]:
        """The same start for servers of any age: older ones know no start from any pose."""
        source = "icp_tracker.initial_pose.source"
        return {**self.start, source: "t_pose"} if self.start.get(source) == "auto" else self.start

    def pipeline(self, settings: Mapping[str, Any]) -> MocapPipeline:
        """A fresh hull, tracker and filter for this clip."""
        return MocapPipeline(self.rig, Configuration.of({"hull_server.backend": "cpu", **self.start, **settings}))

    def carved(self, settings: Mapping[str, Any]) -> list[HullProducts]:
        """The hull of every frame, undisturbed."""
        pipeline = self.pipeline(settings)
        return [pipeline.carve(self.stamp_ns(frame), self.masks(frame)) for frame in range(len(self))]


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


def session_clip(folder: Path, exact: bool) -> Clip:
    """A session folder with a reference."""
    session = session_with_truth(folder)
    assert session.truth is not None
    clip = Clip.of(folder.name, session.rig, session.fps, canvas_masks(session, exact))
    truth, *others = (truth_of_frames(known, len(clip)) for known in session.truths)
    return Clip(clip.name, clip.rig, clip.fps, clip.packed, truth, start_settings(session, "auto"), tuple(others))


def inside_volume(rig: Rig, truth: np.ndarray) -> np.ndarray:
    """Tell in which frames (F,) all known points (F, 15, 3) m lie inside the capture volume, above or on the floor."""
    low, high = rig.volume.low + MARGIN_M, rig.volume.high - MARGIN_M
    outside = (truth < np.array([*low[:2], -1.0])) | (truth > high)
    return np.isfinite(truth).any(axis=(1, 2)) & ~outside.any(axis=(1, 2))


def truth_of_frames(truth: Truth, frames: int) -> np.ndarray:
    """Return (F, 15, 3) m of the first so many frames, NaN where unknown."""
    points = np.full((frames, 15, 3), np.nan)
    known = truth.frames < frames
    points[truth.frames[known]] = truth.stick_figure_points()[known]
    return points
