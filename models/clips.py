"""Clips of canvas silhouettes with what is true of them, and their hulls kept in files: what tables are learnt from.

Benches play and track the same clips (bench/scenes.py makes more of them).
"""

from __future__ import annotations

import pickle
import zlib
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from camera_client.settings import CameraClientSettings
from capture_rig import Rig
from capture_rig.errors import InputError
from capture_rig.session import Session, Truth, footage_stamp_ns, load_session
from mocap_packets.hull import Centerline, ContourRays, HullProducts, VoxelSamples
from mocap_pipeline.configuration import Configuration
from mocap_pipeline.pipeline import Masks, MocapPipeline
from mocap_pipeline.session_footage import EPOCH_NS, exact_silhouettes, silhouettes
from sagoma_bringup.launch_arguments import start_settings

KINDS = {"centerline": Centerline, "voxels": VoxelSamples, "contour_rays": ContourRays}


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


@dataclass(frozen=True, eq=False)
class Recorded:
    """The hull of every frame of a clip, with what is true of it.

    truths : of every person (F, 15, 3) m, NaN where unknown. start : settings of the first pose.
    """

    name: str
    rig: Rig
    fps: float
    products: list[HullProducts]
    truths: tuple[np.ndarray, ...]
    start: Mapping[str, Any] = field(default_factory=dict)

    @classmethod
    def of(cls, clip: Clip) -> Recorded:
        """Carves a clip."""
        return cls(clip.name, clip.rig, clip.fps, clip.carved({}), (clip.truth, *clip.others), clip.start)

    def save(self, path: Path) -> None:
        """Writes it as plain tables, which outlive changes of the classes."""
        rows = [
            {"stamp_ns": p.stamp_ns, **{kind: getattr(p, kind).to_table() for kind in KINDS}} for p in self.products
        ]
        document = {"name": self.name, "fps": self.fps, "rig": self.rig, "start": dict(self.start), "rows": rows}
        document |= {"truth" if k == 0 else f"truth_{k + 1}": truth for k, truth in enumerate(self.truths)}
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(pickle.dumps(document))


def load(path: Path) -> Recorded:
    """Reads what `Recorded.save` wrote; columns that were not recorded then are zero."""
    document = pickle.loads(path.read_bytes())
    products = [
        HullProducts(row["stamp_ns"], *(_table(kind, row[name]) for name, kind in KINDS.items()))
        for row in document["rows"]
    ]
    names = ["truth", *sorted(key for key in document if key.startswith("truth_"))]
    truths = tuple(document[name] for name in names)
    return Recorded(path.stem, document["rig"], document["fps"], products, truths, document["start"])


def _table(kind: Any, rows: np.ndarray) -> Any:
    table = np.zeros(len(rows), kind.LAYOUT)
    for name in kind.LAYOUT.names:
        if name in (rows.dtype.names or ()):
            table[name] = rows[name]
    return kind.from_table(table)


def session_with_truth(folder: Path) -> Session:
    """A session folder that has a reference. Raises InputError."""
    session = load_session(folder)
    if session.truth is None:
        raise InputError("has no truth.csv or reference*.csv", where=str(folder), remedy="Give a session with a truth.")
    return session


def canvas_masks(session: Session, exact: bool) -> Iterator[Masks]:
    """Silhouettes of a session, frame by frame: exact, or as the camera client segments the footage."""
    return exact_silhouettes(session) if exact else silhouettes(session, CameraClientSettings())


def session_clip(folder: Path, exact: bool) -> Clip:
    """A session folder with a reference."""
    session = session_with_truth(folder)
    assert session.truth is not None
    clip = Clip.of(folder.name, session.rig, session.fps, canvas_masks(session, exact))
    truth, *others = (truth_of_frames(known, len(clip)) for known in session.truths)
    return Clip(clip.name, clip.rig, clip.fps, clip.packed, truth, start_settings(session, "auto"), tuple(others))


def truth_of_frames(truth: Truth, frames: int) -> np.ndarray:
    """Return (F, 15, 3) m of the first so many frames, NaN where unknown."""
    points = np.full((frames, 15, 3), np.nan)
    known = truth.frames < frames
    points[truth.frames[known]] = truth.stick_figure_points()[known]
    return points
