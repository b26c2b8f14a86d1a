"""Footage of bench/rooms.py: what every camera sees of an empty room and of a person in it, exact masks.

Clips are sessions of the test data, or the virtual studio's: a person who walks in a ring of cameras in clothes of any
kind, grey or in colour, casting shadows; its sensors have a noise of two grey levels and its lamps a ripple of half a
percent, in the empty room, too. They are decoded once into a folder of .npy files, which the processes of the bench map
into memory.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
from scenes import STATURE_M, STUDIO_FPS

from camera_client.sources.footage_reader import MONO_TOLERANCE
from capture_rig import Rig
from capture_rig.rig import load_rig, save_rig
from capture_rig.session import Session
from capture_rig.video import Video
from stick_figure.body import Body
from stick_figure.pose import Pose
from virtual_studio.motions.catalogue import MOTIONS
from virtual_studio.people import OUTFITS, Capsules, VolumetricBody
from virtual_studio.recording.session import BACKGROUND_S, FIRST_BACKGROUND_FRAME
from virtual_studio.rendering.camera import Sensor, VirtualCamera
from virtual_studio.rendering.capsules import floor_shadow
from virtual_studio.rig import ring

STRIDE, EMPTY_STRIDE = 4, 2
"""Of 60 frames a second every fourth one is played, as 15 Hz cameras would give them; of the empty room every second
one, so that 45 are left to learn from."""
SCORED_EVERY = 2
"""Of the frames played, so many to one that is scored."""
EPOCH_NS = 1_000_000_000_000_000_000
PERSON_PX = 400
"""Frames with fewer of the person's pixels in the picture count for what they show falsely alone."""

SIDE_CAMERAS = 4
SENSOR = Sensor(noise=2.0, flicker=0.005, seed=13)

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


# --- the studio's


@dataclass(frozen=True)
class Look:
    """How a studio clip looks: colour or grey, one of the studio's outfits, strength of the floor's shadows 0..1."""

    colour: bool = False
    outfit: str = "middle"
    shadow: float = 0.5

    def __str__(self) -> str:
        return f"studio_{'colour' if self.colour else 'mono'}_{self.outfit}_shadow{self.shadow:g}"


LOOKS = tuple(
    Look(colour, outfit, shadow)
    for colour in (False, True)
    for outfit, shadow in (
        ("middle", 0.5),
        ("dark", 0.5),
        ("light", 0.5),
        ("room", 0.5),
        ("middle", 0.0),
        ("middle", 1.0),
    )
)
"""The first of each kind is the one that is disturbed further."""


class Studio:
    """The studio's rig, or another one, and its person, looked at in one way."""

    def __init__(self, look: Look, rig: Rig | None = None) -> None:
        self.look, self.rig = look, rig or ring(SIDE_CAMERAS)
        self.cameras = {camera.name: VirtualCamera(camera) for camera in self.rig.cameras}
        self._person = VolumetricBody(Body.from_stature(STATURE_M))

    def empty(self, camera: str) -> np.ndarray:
        """Return the light of the empty room, (H, W[, 3])."""
        eye = self.cameras[camera]
        return eye.empty_room_colour() if self.look.colour else eye.empty_room()

    def shadow(self, pose: Pose) -> tuple[Capsules, np.ndarray]:
        """Return the person in a pose, and the shadow on the floor, the same for every camera."""
        capsules = self._person.place(pose)
        return capsules, floor_shadow(capsules, self.look.shadow)

    def seen(self, camera: str, capsules: Capsules, shadow: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return light and exact mask of the person in the room."""
        eye, outfit = self.cameras[camera], OUTFITS[self.look.outfit]
        if self.look.colour:
            return eye.render_colour(capsules, outfit.albedo_bgr(capsules), shadow)
        return eye.render(outfit.dress(capsules), shadow)

    def empty_frames(self, camera: str, frames: int) -> np.ndarray:
        """Return pictures of the empty room, to learn from."""
        light, number = self.empty(camera), self.rig.names.index(camera)
        return np.array([SENSOR.expose(light, number, FIRST_BACKGROUND_FRAME + k) for k in range(frames)])


def studio_clip(look: Look, seconds: float, rig: Rig | None = None) -> RoomClip:
    """Film the person walking for so long, from the T-pose on, with the studio's rig or another one."""
    studio, fps = Studio(look, rig), STUDIO_FPS / STRIDE
    poses = MOTIONS["walk"](Body.from_stature(STATURE_M), seconds, fps).poses
    names = studio.rig.names
    films: dict[str, list[Any]] = {name: [] for name in names}
    masks: dict[str, list[Any]] = {name: [] for name in names}
    for frame, pose in enumerate(poses):
        capsules, shadow = studio.shadow(pose)
        for number, name in enumerate(names):
            light, mask = studio.seen(name, capsules, shadow)
            films[name].append(SENSOR.expose(light, number, frame))
            masks[name].append(mask)
    empty = {name: studio.empty_frames(name, round(BACKGROUND_S * STUDIO_FPS / EMPTY_STRIDE)) for name in names}
    take, truth = ({name: np.array(frames) for name, frames in part.items()} for part in (films, masks))
    return RoomClip(str(look), studio.rig, fps, empty, take, truth)
