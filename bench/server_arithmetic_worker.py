"""Times the server's stages of one tree, a block of frame sets at a time.

    PYTHONPATH=TREE/src/... python bench/server_arithmetic_worker.py CLIP

CLIP is a pickled :class:`Work`. Reads numbers of sets from standard input, one a line; after each answers with one line
of JSON: for every set {stage: ms of processor time}, the 15 filtered points (metres) or null, and a digest of all that
travelled between the stages. Started by bench/server_arithmetic.py alone: it imports nothing of the bench, so that it
times any tree whose MocapPipeline has the same methods.
"""

from __future__ import annotations

import hashlib
import json
import os
import pickle
import sys
import time
import types
import zlib
from collections.abc import Callable, Iterator
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any, NamedTuple

for _pool in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS"):
    os.environ.setdefault(_pool, "1")

import cv2  # noqa: E402
import numpy as np  # noqa: E402

from capture_rig.session import load_session  # noqa: E402
from hull_server import hull_pipeline  # noqa: E402
from mocap_packets.fit import FIRST_PERSON  # noqa: E402
from mocap_packets.frame_set import FrameSet  # noqa: E402
from mocap_pipeline.configuration import Configuration  # noqa: E402
from mocap_pipeline.pipeline import MocapPipeline  # noqa: E402

cv2.setNumThreads(1)

PARTS_OF_HULL = {"_faults": "camera faults", "_extrinsics": "extrinsic monitor", "_support": "support report"}
"""What of the hull pipeline is timed on its own, too: attribute -> stage."""


class Work(NamedTuple):
    """A session's folder, settings, the stamp of each set, and its compressed masks by camera."""

    session: str
    settings: dict[str, Any]
    stamps_ns: list[int]
    masks: list[dict[str, tuple[bytes, tuple[int, ...]]]]


def main() -> None:
    """Answer until standard input ends."""
    work = Work(*pickle.loads(Path(sys.argv[1]).read_bytes()))
    sets = run(work)
    for line in sys.stdin:
        block = [next(sets) for _ in range(int(line))]
        print(json.dumps(block), flush=True)


def run(work: Work) -> Iterator[dict[str, Any]]:
    """Process one set after another."""
    # the pipeline's own stage watch reads processor time
    hull_pipeline.time = types.SimpleNamespace(perf_counter=time.thread_time)  # type: ignore[attr-defined]
    pipeline = MocapPipeline(load_session(Path(work.session)).rig, Configuration.of(work.settings))
    parts: dict[str, float] = {}
    for attribute, stage in PARTS_OF_HULL.items():
        if (part := getattr(pipeline.hull, attribute, None)) is not None:
            part.update = timed(part.update, stage, parts)
    for stamp_ns, packed in zip(work.stamps_ns, work.masks, strict=True):
        masks = {
            n: np.frombuffer(zlib.decompress(data), np.uint8).reshape(shape) for n, (data, shape) in packed.items()
        }
        parts.clear()
        laps = [time.thread_time()]
        result = pipeline.hull.run(FrameSet.of_instant(stamp_ns, masks, ()))
        laps.append(time.thread_time())
        products = result.products
        laps.append(time.thread_time())
        fits = pipeline.body.fit(products)
        laps.append(time.thread_time())
        answer, fit = pipeline.body.filter(fits)[FIRST_PERSON], fits[0]
        laps.append(time.thread_time())
        hull, sent, icp, ekf = (1e3 * float(lap) for lap in np.diff(laps))
        stages = {f"hull: {name}": ms for name, ms in result.stage_ms.items()} | parts
        stages |= {"hull": hull, "as sent": sent, "icp": icp, "ekf": ekf, "sum": hull + sent + icp + ekf}
        points = getattr(answer, "points_world", None)
        packets = (products, fit.reference_points_world, fit.covariance, points)
        yield {"ms": stages, "points": None if points is None else points.tolist(), "digest": digest(packets)}


def timed(work: Callable[..., Any], stage: str, ms: dict[str, float]) -> Callable[..., Any]:
    """The same, noting its processor time."""

    def timed_work(*arguments: Any) -> Any:
        begin = time.thread_time()
        result = work(*arguments)
        ms[stage] = 1e3 * (time.thread_time() - begin)
        return result

    return timed_work


def digest(packets: tuple[Any, ...]) -> str:
    """Of all arrays in packets and tuples of them."""
    found = hashlib.sha256()

    def put(item: Any) -> None:
        if isinstance(item, np.ndarray):
            found.update(np.ascontiguousarray(item).tobytes())
        elif is_dataclass(item):
            for one in fields(item):
                put(getattr(item, one.name))

    for packet in packets:
        put(packet)
    return found.hexdigest()[:16]


if __name__ == "__main__":
    main()
