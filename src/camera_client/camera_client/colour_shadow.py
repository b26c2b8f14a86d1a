"""Shadows in colour images: darker than the background by one factor in all channels (Horprasert et al. 1999)."""

from __future__ import annotations

import cv2
import numpy as np

from .background_model import BackgroundModel
from .frame_source import Image, Mask
from .regions import Box
from .settings import ColourShadowSettings

_THREE = np.ones((3, 3), np.uint8)


class ColourShadow:
    """Tells which foreground pixels only show the background in shadow.

    With x the pixel, mu and s its background's mean and sigma, the brightness factor is the a that minimises
    sum ((x - a mu) / s)^2 over the channels, and the chromaticity distance is the root of that minimum (Horprasert,
    Harwood and Davis 1999, eq. 4-6). Where the background is nearly black, every dark colour passes this test, so
    that dark clothes would be lost: no shadow is looked for there.

    The test runs at half resolution, on means of 2 x 2 pixels: Bayer sensors and 4:2:0 video hold no finer colour.
    A pixel within distance k of a shadow keeps every channel within k s of a mu, so that two images of limits rule
    out nearly all pixels before the exact test.
    """

    alignment_px = 2

    def __init__(self, background: BackgroundModel, sigma_floor: float, settings: ColourShadowSettings) -> None:
        mean, sigma = halve(background.mean), np.maximum(halve(background.sigma), np.float32(sigma_floor))
        self._settings = settings
        self._inverse_sigma = 1 / sigma
        self._mean_sigmas = mean * self._inverse_sigma
        slack = settings.chromaticity * sigma
        bright = mean.mean(axis=2, keepdims=True) >= settings.min_brightness
        lo = np.where(bright, np.clip(np.floor(settings.darkest * mean - slack), 0, 255), 255)
        hi = np.where(bright, np.clip(np.ceil(settings.lightest * mean + slack), 0, 255), 0)
        self._lo, self._hi = lo.astype(np.uint8), hi.astype(np.uint8)

    def shadow(self, image: Image, mask: Mask, box: Box | None = None) -> Mask:
        """255 where ``image`` (H, W, 3) fits the shadowed background, else 0; looks only where ``mask`` is.

        ``mask`` covers ``box`` of the image, or all of it; the box begins at even pixels.
        """
        box = box or Box.whole(image.shape)
        small = halve(image[box.slices])
        rows, columns = (slice(s.start // 2, -(-s.stop // 2)) for s in box.slices)
        found = cv2.inRange(small, self._lo[rows, columns], self._hi[rows, columns])
        row, column = np.nonzero(cv2.bitwise_and(found, halve(mask)))
        fits = self._fits(small[row, column], row + rows.start, column + columns.start)
        found[:] = 0
        found[row[fits], column[fits]] = 255
        found = cv2.morphologyEx(found, cv2.MORPH_OPEN, _THREE)  # the person's rim is a blend that can look like shadow
        full = cv2.resize(found, None, fx=2, fy=2, interpolation=cv2.INTER_NEAREST)
        return np.ascontiguousarray(full[: mask.shape[0], : mask.shape[1]])

    def _fits(self, x: np.ndarray, row: np.ndarray, column: np.ndarray) -> np.ndarray:
        """Which pixels x (n, 3), at ``row`` and ``column`` (n,) of the half-size image, are a darkened background."""
        s, mu = self._settings, self._mean_sigmas[row, column]
        x_sigmas = x * self._inverse_sigma[row, column]
        power = np.einsum("ij,ij->i", mu, mu)
        factor = np.einsum("ij,ij->i", x_sigmas, mu) / np.maximum(power, 1e-9)
        departure = x_sigmas - factor[:, None] * mu
        distance2 = np.einsum("ij,ij->i", departure, departure)
        return (factor >= s.darkest) & (factor <= s.lightest) & (distance2 <= s.chromaticity**2)


def halve(image: np.ndarray) -> np.ndarray:
    """The image at half its size (rounded up), each pixel the mean of the four it covers; odd sides are continued."""
    down, right = image.shape[0] % 2, image.shape[1] % 2
    if down or right:
        image = cv2.copyMakeBorder(image, 0, down, 0, right, cv2.BORDER_REPLICATE)
    return cv2.resize(image, (image.shape[1] // 2, image.shape[0] // 2), interpolation=cv2.INTER_AREA)
