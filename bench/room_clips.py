"""Holds the footage of bench/rooms.py: what every camera sees of an empty room and of a person in it, exact masks.

Clips are decoded once into a folder of .npy files, which the processes of the bench map into memory.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from itertools import islice
from pathlib import Path

import numpy as np

from camera_client.sources.footage_reader import MONO_TOLERANCE
from capture_rig import Rig
from capture_rig.rig import load_rig, save_rig
from capture_rig.session import Session
from capture_rig.video import Video

STRIDE, EMPTY_STRIDE = 4, 2
"""Of 60 frames a second every fourth one is played, as 15 Hz cameras would give them; of the empty room every second
one, so that 45 are left to learn from."""
SCORED_EVERY = 2
"""Of the frames played, so many to one that is scored."""
EPOCH_NS = 1_000_000_000_000_000_000
PERSON_PX = 400
"""Frames with fewer of the person's pixels in the picture count for what they show falsely alone."""

Frames = np.ndarray
"""(F, H, W) or (F, H, W, 3) uint8."""


@dataclass(frozen=True, eq=False)
class RoomClip:
    """What the cameras of a rig see, frame after frame, all in step.

    empty, take, truth : by camera, (F, H, W[, 3]) uint8: the empty room, the footage, and the person's exact masks in
    it (0 or 255). doubtful_s : start and end of what is not scored, while a method may still find its way.
    """

    name: str
    rig: Rig
    fps: float
    empty: Mapping[str, Frames]
    take: Mapping[str, Frames]
    truth: Mapping[str, Frames]
    doubtful_s: tuple[float, float] = (0.0, 0.0)

    @property
    def frames(self) -> int:
        return min(len(frames) for frames in self.take.values())

    @property
    def scored_cameras(self) -> tuple[str, ...]:
        """Two of them: the last one (in most rigs the one above), and one in the middle."""
        names = self.rig.names
        return tuple(dict.fromkeys((names[-1], names[(len(names) - 1) // 2])))

    @property
    def scored(self) -> list[int]:
        """The numbers of the frames that are scored."""
        begin, end = self.doubtful_s
        wanted = range(SCORED_EVERY // 2, self.frames, SCORED_EVERY)
        return [frame for frame in wanted if not begin <= frame / self.fps < end]

    def stamp_ns(self, frame: int) -> int:
        """Capture stamp of a frame."""
        return EPOCH_NS + round(frame / self.fps * 1e9)

    def images(self, frame: int) -> dict[str, np.ndarray]:
        """Every camera's picture of one instant."""
        return {name: self.take[name][frame] for name in self.rig.names}

    def there_and_back(self) -> RoomClip:
        """The same clip played forwards, then backwards: twice as long, and nothing leaps."""

        def doubled(frames: Frames) -> Frames:
            return np.concatenate([frames, frames[::-1]])

        take, truth = ({name: doubled(f) for name, f in part.items()} for part in (self.take, self.truth))
        return replace(self, take=take, truth=truth)

    def save(self, folder: Path) -> None:
        """Write the clip into a folder of its own, to be opened by :func:`open_clip`."""
        folder.mkdir(parents=True)
        save_rig(self.rig, folder / "rig.yaml")
        for part in PARTS:
            for camera, frames in getattr(self, part).items():
                np.save(folder / f"{part}_{camera}.npy", frames)
        (folder / "fps.txt").write_text(f"{self.fps!r}\n")


PARTS = ("empty", "take", "truth")


def open_clip(folder: Path) -> RoomClip:
    """Open a saved clip; its pictures are mapped, not read."""
    rig = load_rig(folder / "rig.yaml")
    empty, take, truth = (
        {camera: np.load(folder / f"{part}_{camera}.npy", mmap_mode="r") for camera in rig.names} for part in PARTS
    )
    return RoomClip(folder.name, rig, float((folder / "fps.txt").read_text()), empty, take, truth)


def of_session(name: str, session: Session, seconds: float) -> RoomClip:
    """Thinned out to STRIDE, the first ``seconds`` of a session with exact masks."""
    frames, cameras = round(seconds * session.fps), session.rig.names
    empty = {camera: _decoded(session.backgrounds[camera], frames, EMPTY_STRIDE) for camera in cameras}
    take = {camera: _decoded(session.videos[camera], frames, STRIDE) for camera in cameras}
    masks = {camera: _decoded(session.masks[camera], frames, STRIDE) for camera in cameras}
    truth = {camera: np.where(mask > 127, 255, 0).astype(np.uint8) for camera, mask in masks.items()}
    return RoomClip(name, session.rig, session.fps / STRIDE, empty, take, truth)


def _decoded(path: Path, frames: int, stride: int) -> Frames:
    """One in ``stride`` of so many frames; (F, H, W) where the footage is grey."""
    with Video(path) as video:
        images = np.array(list(islice(video, 0, frames, stride)))
    spread = images[0].astype(int).max(axis=2) - images[0].min(axis=2)
    return np.ascontiguousarray(images[..., 0]) if spread.max() <= MONO_TOLERANCE else images
