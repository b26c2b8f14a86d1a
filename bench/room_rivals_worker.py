"""Runs background subtractors and codecs that the project does not depend on, in an interpreter that has them.

    PYTHON bench/room_rivals_worker.py FOLDER

FOLDER/job.json names the work; frames and masks are .npy files beside it. Started by bench/room_rivals.py alone, whose
docstring says how to make the interpreter; it needs numpy, and what the job asks for: opencv-contrib, pybgs or av.
"""

from __future__ import annotations

import io
import json
import os
import sys
from fractions import Fraction
from pathlib import Path

import numpy as np

MEDIUM = {"h264": ("libx264", "yuv420p"), "mpeg4": ("mpeg4", "yuv420p"), "mjpeg": ("mjpeg", "yuvj420p")}
CONTAINER = "matroska"


def subtractor(name: str):
    """Returns image -> mask of a rival, as its authors parametrised it, which goes on to learn."""
    import cv2

    cv2.setNumThreads(1)
    if name in ("GSOC", "LSBP", "CNT"):
        of_contrib = getattr(cv2.bgsegm, f"createBackgroundSubtractor{name}")()
        return of_contrib.apply
    import pybgs

    of_library = getattr(pybgs, name)()
    if name == "ViBe":  # written for colour alone
        return lambda image: of_library.apply(image if image.ndim == 3 else np.repeat(image[..., None], 3, axis=2))
    return of_library.apply


def subtract(folder: Path, job: dict) -> None:
    """Writes METHOD_CAMERA.npy: the masks (F, H, W) of the frames that are scored."""
    scored = set(job["scored"])
    for camera in job["cameras"]:
        empty, take = np.load(folder / f"empty_{camera}.npy"), np.load(folder / f"take_{camera}.npy")
        for method in job["methods"]:
            apply = subtractor(method)
            for image in empty:
                apply(image)
            masks = [apply(image) for image in take]
            kept = [np.asarray(mask, np.uint8).reshape(take.shape[1:3]) for k, mask in enumerate(masks) if k in scored]
            np.save(folder / f"{method}_{camera}.npy", np.array(kept))


def encode(folder: Path, job: dict) -> None:
    """Replaces every .npy of frames (F, H, W[, 3]) by what is left of it after a codec of this quality."""
    for name in job["files"]:
        frames = np.load(folder / name)
        np.save(folder / name, through_codec(frames, job["codec"], job["quality"], job["fps"]))


def through_codec(frames: np.ndarray, codec: str, quality: int, fps: float) -> np.ndarray:
    """Returns frames encoded and decoded; quality is the rate factor of H.264, the quantiser of the others."""
    import av

    kind, pixels = MEDIUM[codec]
    file = io.BytesIO()
    with av.open(file, "w", format=CONTAINER) as container:
        options = {"crf": str(quality)} if codec == "h264" else {"qmin": str(quality), "qmax": str(quality)}
        stream = container.add_stream(kind, rate=Fraction(fps).limit_denominator(1000), options=options)
        stream.height, stream.width, stream.pix_fmt = *frames.shape[1:3], pixels
        stream.thread_count = 1
        for image in frames:
            picture = image if image.ndim == 3 else np.repeat(image[..., None], 3, axis=2)
            for packet in stream.encode(av.VideoFrame.from_ndarray(np.ascontiguousarray(picture), format="bgr24")):
                container.mux(packet)
        for packet in stream.encode():
            container.mux(packet)
    print(codec, quality, f"{8e-6 * file.tell() * fps / len(frames):.2f} Mbit/s")
    file.seek(0)
    with av.open(file, "r") as container:
        decoded = [frame.to_ndarray(format="bgr24") for frame in container.decode(video=0)]
    back = np.array(decoded)
    return back if frames.ndim == 4 else np.ascontiguousarray(back[..., 1])


def main() -> None:
    folder = Path(sys.argv[1]).resolve()
    job = json.loads((folder / "job.json").read_text())
    (folder / "config").mkdir(exist_ok=True)
    os.chdir(folder)  # pybgs writes its parameters below the working directory
    {"subtract": subtract, "encode": encode}[job["work"]](folder, job)


if __name__ == "__main__":
    main()
