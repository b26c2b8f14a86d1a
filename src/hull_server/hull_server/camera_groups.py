"""Shadow resolution of some cameras of a rig, so that several processes, on several machines, share the work.

Whether a dark pixel is the person or floor in shadow takes all cameras' silhouettes to say, and from some ten cameras
on it is most of the hull server's work, as every camera is compared with every other. But each camera's pixels are
decided on their own. So every process of a group takes all silhouettes and resolves those of its cameras; what it hands
on are levels again (``capture_rig.mask_levels``), of which a hull server that resolves no shadows itself makes the same
hull, bit for bit: pixels found to be shadow become candidates of the same attenuation, which count as background, and
candidates found to be the person become attenuated pixels, which count as the person. What else looks at levels asks
only whether a pixel is sure.
"""

from __future__ import annotations

from collections.abc import Collection

import numpy as np

from capture_rig import Rig
from capture_rig.kernel import kernel
from capture_rig.mask_levels import (
    ATTENUATED_LEVELS,
    CANDIDATE_LEVELS,
    SHADOW_CANDIDATE,
    STEPS_OF_CANDIDATE,
    candidate_level,
)
from mocap_packets.frame_set import FrameSet

from .consistency.camera_fault_detector import CameraFaultDetector
from .floor_shadows import ShadowResolver
from .level_stack import Mask
from .settings import HullSettings
from .views import RigViews, min_seeing
from .words import HIGH_BITS


def _levels_found() -> np.ndarray:
    """Return the level (2, 256) of every level that is found to be background, and of one found to be the person."""
    found = np.tile(np.arange(256, dtype=np.uint8), (2, 1))
    for step, level in enumerate(ATTENUATED_LEVELS):
        found[0, level] = candidate_level(step)
    for (step, _), level in zip(STEPS_OF_CANDIDATE, CANDIDATE_LEVELS, strict=True):
        found[1, level] = ATTENUATED_LEVELS[step]
    return found


LEVELS_FOUND = _levels_found()


class GroupResolver:
    """Resolves the shadows in the silhouettes of some cameras. One thread at a time."""

    def __init__(self, rig: Rig, settings: HullSettings, cameras: Collection[str]) -> None:
        """``settings`` must be the hull server's: both decide alike which cameras are believed."""
        views = RigViews.from_rig(rig)
        self.cameras, self._min_seeing = tuple(sorted(cameras)), settings.min_seeing
        self._faults = CameraFaultDetector(rig, views, settings.camera_fault, settings.min_seeing)
        self._shadows = ShadowResolver(views, rig.volume, settings.shadow)

    def run(self, frame_set: FrameSet[Mask]) -> dict[str, Mask]:
        """Return the group's silhouettes (h, w) uint8 of one frame set, resolved, as levels.

        Cameras that are left out because they contradict the others are handed on as they came. InputError for a mask
        of the wrong size.
        """
        frames = frame_set.frames
        left_out = self._faults.update(frames, frame_set.stamp_ns).left_out
        used = {name: mask for name, mask in frames.items() if name not in left_out}
        mine = [name for name in self.cameras if name in frames]
        binary = self._shadows.resolve(used, min_seeing(len(used), self._min_seeing), mine)
        return {name: resolved_levels(frames[name], binary[name]) if name in used else frames[name] for name in mine}


def resolved_levels(levels: Mask, binary: Mask) -> Mask:
    """Return levels whose pixels above SHADOW_CANDIDATE are those of the binary mask; both (h, w)."""
    if binary is levels:
        return levels
    resolved = levels.copy()
    _recolour(binary.view(np.uint64), resolved.view(np.uint64), binary, resolved, LEVELS_FOUND)
    return resolved


@kernel
def _recolour(binary_words, level_words, binary, levels, found):  # type: ignore[no-untyped-def]
    """Replace the levels that say otherwise than the mask; the words are the same pixels, eight to a word."""
    for v in range(binary.shape[0]):
        for word in range(binary_words.shape[1]):
            if (binary_words[v, word] ^ level_words[v, word]) & HIGH_BITS != 0:
                for u in range(8 * word, 8 * word + 8):
                    is_person = binary[v, u] > SHADOW_CANDIDATE
                    if is_person != (levels[v, u] > SHADOW_CANDIDATE):
                        levels[v, u] = found[np.int64(is_person), levels[v, u]]
