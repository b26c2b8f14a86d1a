"""Disturbs decoded clips as rooms and cameras do after a background was learned.

In the order of the light's way: things that stand elsewhere, lamps, the camera that was touched, the sensor's noise,
the codec that stored the picture.
"""

from __future__ import annotations

import zlib
from dataclasses import dataclass, replace

import cv2
import numpy as np
from room_clips import Frames, RoomClip
from room_rivals import through_codec

MAINS_HZ = 100.03
"""Lamps flicker at twice the mains' 50 Hz, which is never exact: the beat with the frame rate drifts."""
SWITCH_S = 0.5
"""After a sudden change so long is not scored: "survived within half a second"."""
ABSORB_S = 4.0
"""Things moved are scored after so long."""
THING_PX = (36, 110), (44, 140)
"""Least and greatest width and height of things: bags, chairs, boards at 3 to 5 m."""
CLEAR_PX = 15
"""So far things stay from where the person ever is in the picture."""
THING_LEVELS = 12.0
"""Things differ by so much from the room, or nobody could see them."""
NOISE_SAMPLES = 1 << 23


@dataclass(frozen=True)
class Disturbance:
    """How a take differs from the room as it was learned.

    brightness : share by which the light changes over the clip, evenly, or where ``sudden`` at once in its middle.
    flicker : peak of the lamps' relative ripple. shift_px : every camera's picture is moved by so much, each in its own
    direction. things : a camera, alternately put into the picture and taken out of it. noise : standard deviation, grey
    levels, added to background and take. codec, quality : what both were stored with, as
    ``room_rivals.through_codec`` names them; needs the other interpreter.
    """

    brightness: float = 0.0
    sudden: bool = False
    flicker: float = 0.0
    shift_px: float = 0.0
    things: int = 0
    noise: float = 0.0
    codec: str = ""
    quality: int = 0

    def __str__(self) -> str:
        parts = [f"{'sudden' if self.sudden else 'slow'} {self.brightness:+.0%}"] if self.brightness else []
        parts += [f"flicker {self.flicker:.1%}"] if self.flicker else []
        parts += [f"moved {self.shift_px:g} px"] if self.shift_px else []
        parts += [f"{self.things} things"] if self.things else []
        parts += [f"noise {self.noise:g}"] if self.noise else []
        parts += [f"{self.codec} {self.quality}"] if self.codec else []
        return ", ".join(parts) or "as it is"

    def apply(self, clip: RoomClip, python: str = "") -> RoomClip:
        """Return the clip as it would have been; ``python``: an interpreter that encodes."""
        if self == Disturbance():
            return clip
        if self.things:
            clip = clip.there_and_back()
        empty, take, truth = {}, {}, {}
        gains = self._gains(clip)
        for camera in clip.rig.names:
            rng = np.random.default_rng([zlib.crc32(f"{clip.name} {camera}".encode()), 7])
            pair = clip.empty[camera], clip.take[camera]
            placed = place_things(pair[0], clip.truth[camera], self.things, rng)
            angle = rng.uniform(0, 2 * np.pi)
            offset = self.shift_px * np.array([np.cos(angle), np.sin(angle)])
            empty[camera] = self._expose(pair[0], placed[1::2], np.ones(len(pair[0])), np.zeros(2), rng)
            take[camera] = self._expose(pair[1], placed[::2], gains, offset, rng)
            truth[camera] = clip.truth[camera]
            if self.shift_px:
                truth[camera] = np.array([255 * (moved(mask, offset) > 127) for mask in truth[camera]], np.uint8)
        if self.codec:
            empty, take = (through_codec(part, self.codec, self.quality, clip.fps, python) for part in (empty, take))
        return replace(clip, empty=empty, take=take, truth=truth, doubtful_s=self._doubtful_s(clip))

    def _gains(self, clip: RoomClip) -> np.ndarray:
        """(F,) the light of every frame over that of the background."""
        n = clip.frames
        change = (np.arange(n) >= n // 2) if self.sudden else np.linspace(0, 1, n)
        ripple = np.sin(2 * np.pi * MAINS_HZ * np.arange(n) / clip.fps)
        return np.asarray((1 + self.brightness * change) * (1 + self.flicker * ripple))

    def _doubtful_s(self, clip: RoomClip) -> tuple[float, float]:
        if self.things:
            return 0.0, ABSORB_S
        middle = clip.frames // 2 / clip.fps
        return (middle, middle + SWITCH_S) if self.sudden else clip.doubtful_s

    def _expose(
        self, frames: Frames, things: list[Thing], gains: np.ndarray, offset: np.ndarray, rng: np.random.Generator
    ) -> Frames:
        """Frames of a room with these things in it, under this light, through a camera moved by ``offset`` px."""
        if not (things or self.noise or offset.any() or (gains != 1).any()):
            return frames
        normal = rng.standard_normal(NOISE_SAMPLES, dtype=np.float32) if self.noise else np.empty(0, np.float32)
        exposed = np.empty(frames.shape, np.uint8)
        for k, gain in zip(range(len(frames)), gains, strict=False):
            picture = frames[k].astype(np.float32)
            for thing in things:
                thing.paint(picture)
            picture *= np.float32(gain)
            if offset.any():
                picture = moved(picture, offset)
            if self.noise:
                start = int(rng.integers(NOISE_SAMPLES - picture.size))
                picture += np.float32(self.noise) * normal[start : start + picture.size].reshape(picture.shape)
            exposed[k] = np.rint(picture).clip(0, 255)
        return exposed


def moved(picture: np.ndarray, offset: np.ndarray) -> np.ndarray:
    """Return a picture moved by ``offset`` (x, y) px, sharp; beyond its border it is mirrored."""
    matrix = np.array([[1, 0, offset[0]], [0, 1, offset[1]]], float)
    size = picture.shape[1], picture.shape[0]
    return cv2.warpAffine(picture, matrix, size, flags=cv2.INTER_LANCZOS4, borderMode=cv2.BORDER_REFLECT_101)


# --- things in the room


@dataclass(frozen=True, eq=False)
class Thing:
    """A thing in one camera's picture: where, its own light (h, w[, 3]), how much it covers, what its shadow leaves."""

    top: int
    left: int
    light: np.ndarray
    cover: np.ndarray
    shadow: np.ndarray

    def paint(self, picture: np.ndarray) -> None:
        """Put the thing in front of a picture (H, W[, 3]) float32, in place; the sensor's noise stays as it was."""
        h, w = self.cover.shape[:2]
        part = picture[self.top : self.top + h, self.left : self.left + w]
        noise = part - cv2.blur(part, (3, 3))
        part *= self.shadow
        part += self.cover * (self.light + noise - part)


def place_things(empty: Frames, truth: Frames, count: int, rng: np.random.Generator) -> list[Thing]:
    """Find places for things where the person is never in the picture; fewer where there is no room for them."""
    if not count:
        return []
    taken = np.max(truth, axis=0)
    taken = cv2.dilate(taken, np.ones((2 * CLEAR_PX + 1,) * 2, np.uint8))
    room, things = empty[0].astype(np.float32), []
    height, width = taken.shape
    for _ in range(400):
        (least_w, most_w), (least_h, most_h) = THING_PX
        w, h = int(rng.integers(least_w, most_w)), int(rng.integers(least_h, most_h))
        left, top = int(rng.integers(0, width - w)), int(rng.integers(0, height - h))
        if taken[top : top + h, left : left + w].any():
            continue
        things.append(_thing(room[top : top + h, left : left + w], top, left, rng))
        taken[top : top + h, left : left + w] = 255
        if len(things) == count:
            break
    return things


def _thing(behind: np.ndarray, top: int, left: int, rng: np.random.Generator) -> Thing:
    """A rounded, shaded, faintly patterned body with a soft shadow on its ground."""
    h, w = behind.shape[:2]
    around = behind.mean()
    level = rng.uniform(30, 210)
    while abs(level - around) < THING_LEVELS:
        level = rng.uniform(30, 210)
    outline, inset, foot = np.zeros((h, w), np.float32), max(w // 8, 3), max(h // 6, 4)
    cv2.rectangle(outline, (inset, 2), (w - 1 - inset, h - 1 - foot), 1.0, cv2.FILLED)
    if rng.random() < 0.5:  # a chair: legs, and air between them
        cv2.rectangle(outline, (2 * inset, int(0.6 * h)), (w - 1 - 2 * inset, h - 1 - foot), 0.0, cv2.FILLED)
    cover = cv2.GaussianBlur(outline, (0, 0), 0.8)  # the lens
    shadow = np.zeros((h, w), np.float32)
    cv2.ellipse(shadow, (w // 2, h - 1 - foot), (max(w // 2 - 3, 3), max(foot - 2, 2)), 0, 0, 360, 1.0, cv2.FILLED)
    shadow = 1 - 0.35 * cv2.GaussianBlur(shadow, (0, 0), 2.5)
    pattern = cv2.resize(rng.standard_normal((max(h // 12, 2), max(w // 12, 2))), (w, h), interpolation=cv2.INTER_CUBIC)
    light = level * (1 + 0.15 * np.linspace(-1, 1, w))[None, :] + 5 * pattern
    if behind.ndim == 3:
        cover, shadow = cover[..., None], shadow[..., None]
        light = light[..., None] * rng.uniform(0.7, 1.3, 3)
    return Thing(top, left, light.astype(np.float32), cover, shadow)
