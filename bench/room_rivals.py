"""Background subtractors of the field and codecs that run in another interpreter, and the record of what they reached.

The interpreter, in a virtual environment of its own, so that the project's stays as it is:

    apt-get install libopencv-dev           # pybgs is built against it
    python3 -m venv RIVALS && RIVALS/bin/pip install opencv-contrib-python-headless pybgs av

GSOC is of OpenCV's contributed modules; SuBSENSE, PAWCS and ViBe of pybgs (BGSLibrary); av encodes and decodes. Of
relatives the table has the better one: GSOC before LSBP and CNT, SuBSENSE before LOBSTER, and PAWCS instead of it on
colour. What rivals reach does not change with our code, but takes them the better part of an hour: their figures, and
those of MOG2 and KNN, are kept in room_rivals.json, each with a checksum of the frames that it was measured on.
"""

from __future__ import annotations

import json
import subprocess
import tempfile
import zlib
from pathlib import Path
from typing import Any

import numpy as np
from room_clips import RoomClip
from room_methods import CV2_RIVALS, CanvasTruth, Score, tidy

MONO_METHODS, COLOUR_METHODS = ("GSOC", "SuBSENSE", "ViBe"), ("GSOC", "PAWCS", "ViBe")
METHODS = ("GSOC", "SuBSENSE", "PAWCS", "ViBe")
WORKER = Path(__file__).with_name("room_rivals_worker.py")
RECORD = Path(__file__).with_name("room_rivals.json")


def methods_for(clip: RoomClip) -> tuple[str, ...]:
    """The rivals that a clip's row shows."""
    return COLOUR_METHODS if clip.take[clip.rig.names[0]].ndim == 4 else MONO_METHODS


def checksum(clip: RoomClip) -> int:
    """A number of the frames that rivals see."""
    total = 0
    for part in (clip.empty, clip.take, clip.truth):
        for camera in clip.scored_cameras:
            total = zlib.crc32(np.ascontiguousarray(part[camera][:: max(len(part[camera]) // 8, 1)]), total)
    return total


def recorded(row: str, clip: RoomClip) -> dict[str, dict[str, float]]:
    """Figures of a row by method, as far as they were measured on these very frames."""
    found = _record().get(row, {})
    methods = found.get("methods", {}) if found.get("checksum") == checksum(clip) else {}
    return {name: methods[name] for name in (*CV2_RIVALS, *methods_for(clip)) if name in methods}


def record(row: str, number: int, methods: dict[str, Any]) -> None:
    """Keep a row's figures by method, beside those measured on the same frames (of this checksum) before."""
    kept = _record()
    before = kept.get(row, {})
    known = before["methods"] if before.get("checksum") == number else {}
    kept[row] = {"checksum": number, "methods": known | methods}
    lines = (f"{json.dumps(name)}: {json.dumps(kept[name])}" for name in sorted(kept))
    RECORD.write_text("{\n" + ",\n".join(lines) + "\n}\n")


def _record() -> dict[str, Any]:
    return json.loads(RECORD.read_text()) if RECORD.is_file() else {}


def measure_rivals(clip: RoomClip, truth: CanvasTruth, python: str) -> dict[str, Score]:
    """Run the rivals of the other interpreter over a clip, as they come: they learn on and on."""
    with tempfile.TemporaryDirectory(prefix="sagoma_rivals_") as temporary:
        folder = Path(temporary)
        for camera in clip.scored_cameras:
            np.save(folder / f"empty_{camera}.npy", clip.empty[camera])
            np.save(folder / f"take_{camera}.npy", clip.take[camera])
        cameras, scored = list(clip.scored_cameras), clip.scored
        scores = {method: Score() for method in methods_for(clip)}
        _work(python, folder, {"work": "subtract", "cameras": cameras, "scored": scored, "methods": list(scores)})
        for method, score in scores.items():
            for camera in cameras:
                for frame, mask in zip(scored, np.load(folder / f"{method}_{camera}.npy"), strict=True):
                    score.add(truth.views[camera].undistort_mask(tidy(mask)), truth.of(camera, frame))
    return scores


def through_codec(clips: dict[str, np.ndarray], codec: str, quality: int, fps: float, python: str) -> dict:
    """Return footage by name as it comes back from a codec of this quality."""
    with tempfile.TemporaryDirectory(prefix="sagoma_codec_") as temporary:
        folder = Path(temporary)
        for name, frames in clips.items():
            np.save(folder / f"{name}.npy", frames)
        files = [f"{name}.npy" for name in clips]
        _work(python, folder, {"work": "encode", "files": files, "codec": codec, "quality": quality, "fps": fps})
        return {name: np.load(folder / f"{name}.npy") for name in clips}


def _work(python: str, folder: Path, job: dict[str, Any]) -> None:
    (folder / "job.json").write_text(json.dumps(job))
    done = subprocess.run([python, str(WORKER), str(folder)], capture_output=True, text=True)
    if done.returncode:
        raise RuntimeError(f"{python} {WORKER.name}: {done.stderr[-2000:]}")
