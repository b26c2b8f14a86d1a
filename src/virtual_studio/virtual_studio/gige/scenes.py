"""What a camera sees at an instant."""

from __future__ import annotations

from typing import Protocol

import numpy as np

from capture_rig.errors import InputError

from .pixels import Image


class CameraScene(Protocol):
    """The view of one camera."""

    @property
    def shape(self) -> tuple[int, ...]:
        """(H, W) of grey pictures, (H, W, 3) of coloured ones (BGR)."""

    def image(self, instant_ns: int) -> Image:
        """The picture at an instant (UTC, ns), uint8; nobody changes it afterwards. Must not take long."""


class PatternScene:
    """A test pattern that carries its own number and instant as black and white squares; stripes move below them.

    Pictures are numbered from 0 in the order in which they are taken.
    """

    SQUARE_PX = 4
    PER_ROW = 32
    ROWS = 3  # 32 bits of number, 64 of time

    def __init__(self, width: int = 640, height: int = 480, colour: bool = False) -> None:
        least = self.PER_ROW * self.SQUARE_PX
        if width < least or height < self.ROWS * self.SQUARE_PX:
            raise InputError(f"a pattern of {width} x {height} pixels", remedy=f"Give at least {least} x 12.")
        self._width, self._height, self._colour = width, height, colour
        y, x = np.mgrid[: height + 256, :width]
        self._stripes = ((x + y) % 256).astype(np.uint8)
        self.number = 0

    @property
    def shape(self) -> tuple[int, ...]:
        return (self._height, self._width, 3) if self._colour else (self._height, self._width)

    def image(self, instant_ns: int) -> Image:
        picture = self.picture(self.number, instant_ns)
        self.number += 1
        return picture

    def picture(self, number: int, instant_ns: int) -> Image:
        """The picture with this number, taken at this instant."""
        shift = number % 256
        picture = self._stripes[shift : shift + self._height].copy()
        bits = [(number % (1 << 32)) >> bit & 1 for bit in range(32)] + [instant_ns >> bit & 1 for bit in range(64)]
        squares = (255 * np.array(bits, np.uint8)).reshape(self.ROWS, self.PER_ROW)
        block = np.kron(squares, np.ones((self.SQUARE_PX, self.SQUARE_PX), np.uint8))
        if not self._colour:
            picture[: block.shape[0], : block.shape[1]] = block
            return picture
        coloured = np.stack([picture, np.roll(picture, 64, 1), 255 - picture], axis=2)
        coloured[: block.shape[0], : block.shape[1]] = block[..., None]
        return coloured

    @classmethod
    def read(cls, picture: Image) -> tuple[int, int]:
        """Number and instant (UTC, ns) in a picture of the pattern, in any format that keeps black from white."""
        grey = picture if picture.ndim == 2 else picture[..., 1]
        middle = cls.SQUARE_PX // 2
        squares = grey[middle :: cls.SQUARE_PX, middle :: cls.SQUARE_PX][: cls.ROWS, : cls.PER_ROW]
        bits = [int(value > 127) for value in squares.reshape(-1)]
        return sum(bit << i for i, bit in enumerate(bits[:32])), sum(bit << i for i, bit in enumerate(bits[32:]))
