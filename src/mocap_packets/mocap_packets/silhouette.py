"""What a camera client hands to the hull server: the silhouette of one image."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from capture_rig.mask_levels import BACKGROUND, FOREGROUND, SHADOW_CANDIDATE

Mask = npt.NDArray[np.uint8]


@dataclass(frozen=True, eq=False)
class Silhouette:
    """What a camera sees of the person. Only ``mask``, camera and stamp travel on, as a PNG of few levels.

    mask : (h, w) uint8 on the padded undistorted canvas: 255 person, 0 not, 47 uncertain, up to 127 most likely a
        shadow, between them person or shadow (see `capture_rig.mask_levels`).
    image_mask : (H, W) in the camera's own pixels, of 255, 0 and 127 only.
    foreground_fraction, candidate_fraction : the shares of the image that are 255 and 127 there.
    flags : may hold "empty" or "full": such a mask is what was seen, and probably not a person.
    camera, stamp_ns : whose image it was, and when it was captured, where that is known.
    """

    mask: Mask
    image_mask: Mask
    foreground_fraction: float
    flags: tuple[str, ...]
    candidate_fraction: float = 0.0
    camera: str = ""
    stamp_ns: int | None = None

    @property
    def person(self) -> Mask:
        """The binary mask, 0 or 255: candidates are taken for shadow."""
        return np.where(self.mask > SHADOW_CANDIDATE, np.uint8(FOREGROUND), np.uint8(BACKGROUND))
