"""Hull products of clips, kept in files, so that trackers can be compared on them without carving anew."""

from __future__ import annotations

import pickle
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from scenes import Clip

from capture_rig import Rig
from mocap_packets.hull import Centerline, ContourRays, HullProducts, VoxelSamples

KINDS = {"centerline": Centerline, "voxels": VoxelSamples, "contour_rays": ContourRays}


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
