"""Floor shadows told from feet by all cameras together.

A camera sends three kinds of foreground (``capture_rig.mask_levels``): sure; candidates, whose texture says that they
are shadow; and dark pixels, which are the person unless somebody knows better. Somebody may: a cast shadow lies on the
floor z = 0, so that all cameras which see a place of the floor see it equally dark. A leg stands above the floor: its
pixels fall on other floor places in every camera, bright ones or differently dark ones; and above that place on the
ray, all silhouettes agree on a body. So a dark pixel is taken for shadow when

1. another camera sees its floor place equally dark, and no more cameras contradict (bright floor, another darkness)
   than agree; who sees the person in front of it has no say;
2. its ray does not meet the hull of all silhouettes higher than ``min_height_m``: that would be a leg in front of it;
3. most dark or sure pixels around it are shadow by 1 and 2: a hull dies of one wrong pixel in one camera.

A candidate is background, unless more cameras contradict than agree and its ray does meet that hull: then it is body.
The planar homography between views of the floor is that of Khan and Shah (ECCV 2006), who
look for feet with it; here it looks for what is no foot.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

from capture_rig import Volume
from capture_rig.mask_levels import CANDIDATE_LEVELS, DARK_LEVELS, FOREGROUND, SHADOW_CANDIDATE

from ..settings import DoubtSettings
from ..views import Masks, RigViews
from .doubt_kernels import BLIND, STRIDE, Scene, Verdicts, degrees, judge, kinds, settle

LEAST_CENTRE_Z_M = 0.2  # a camera lower than this sees no floor worth judging

Mask = npt.NDArray[np.uint8]


@dataclass(frozen=True, eq=False)
class Resolved:
    """Masks without doubt, and how much of it there was.

    masks : (h, w) uint8 of each camera, 0 or 255; the very array that came in where it held nothing else.
    shadow_px, body_px : dark pixels that turned out to be shadow, and candidates that turned out to be body.
    """

    masks: dict[str, Mask]
    shadow_px: int
    body_px: int


class DoubtResolver:
    """Turns silhouettes with doubt into binary ones. Not for two threads at a time: it keeps scratch memory."""

    def __init__(self, views: RigViews, volume: Volume, settings: DoubtSettings) -> None:
        self._views, self._settings = views, settings
        self._blind = np.where(views.seen > 0, np.uint8(0), np.uint8(BLIND))
        self._levels = np.full_like(views.seen, BLIND)
        self._scene = _scene(views, volume)
        self._floor_px = np.empty((len(views.names), 3))

    def resolve(self, masks: Masks, seeing: int) -> Resolved:
        """Masks of one instant, of the levels of ``capture_rig.mask_levels``, to masks of 0 and 255.

        ``seeing``: how many cameras must see a voxel. The masks that come in are not written to. InputError for a
        camera that is not in the rig, and for a mask of the wrong size.
        """
        self._views.present(masks)
        doubtful = {
            name: cv2.boundingRect(where)
            for name, mask in sorted(masks.items())
            if cv2.countNonZero(where := _between(mask, CANDIDATE_LEVELS[0], DARK_LEVELS[-1]))
        }
        binary = {name: person(mask) if name in doubtful else mask for name, mask in masks.items()}
        if not doubtful or not self._settings.enabled:
            return Resolved(binary, 0, 0)
        self._stack(masks)
        shadow_px = body_px = 0
        for name, (x, y, width, height) in doubtful.items():
            shadow, body = self._judge(
                self._views.names.index(name), (x, y, x + width, y + height), seeing, binary[name]
            )
            shadow_px, body_px = shadow_px + shadow, body_px + body
        return Resolved(binary, shadow_px, body_px)

    def _stack(self, masks: Masks) -> None:
        """All masks in one array; pixels of absent cameras, and those that a camera does not see, are blind."""
        for index, name in enumerate(self._views.names):
            if name not in masks:
                self._levels[index] = BLIND
                continue
            width, height = self._views.sizes[index]
            own = self._levels[index, :height, :width]
            cv2.bitwise_or(masks[name], self._blind[index, :height, :width], dst=own)

    def _judge(self, camera: int, box: tuple[int, int, int, int], seeing: int, binary: Mask) -> tuple[int, int]:
        """Correct the camera's ``binary`` mask within the box (left, top, right, bottom): pixels removed, and added."""
        settings, scene = self._settings, self._scene
        if scene.centres[camera, 2] <= max(settings.min_height_m, LEAST_CENTRE_Z_M):
            return 0, 0
        left, top, right, bottom = box
        shape = -(-(bottom - top) // STRIDE), -(-(right - left) // STRIDE)
        verdicts = Verdicts(*np.zeros((len(Verdicts._fields), *shape), np.uint8))
        judge(
            scene,
            self._levels,
            camera,
            box,
            seeing,
            settings.tolerance,
            settings.min_height_m,
            settings.reach_m,
            self._floor_px,
            verdicts,
        )
        shadow_px, body_px = settle(scene.kind, self._levels[camera], box, verdicts, binary)
        return shadow_px, body_px


def _between(mask: Mask, low: int, high: int) -> Mask:
    """255 at pixels of these levels, ends included."""
    return np.asarray(cv2.inRange(mask, low, high), np.uint8)  # type: ignore[call-overload]


def person(mask: Mask) -> Mask:
    """The mask in 0 and 255: candidates are background, dark pixels the person."""
    return np.asarray(cv2.threshold(mask, SHADOW_CANDIDATE, FOREGROUND, cv2.THRESH_BINARY)[1], np.uint8)


def _scene(views: RigViews, volume: Volume) -> Scene:
    centres = np.stack([-np.linalg.solve(P[:, :3], P[:, 3]) for P in views.P])
    homogeneous = np.concatenate([centres, np.ones((len(centres), 1))], axis=1)
    floor = np.stack(
        [
            np.linalg.inv(P[:, [0, 1, 3]]) if abs(c[2]) > 1e-6 else np.full((3, 3), np.nan)
            for P, c in zip(views.P, centres, strict=True)
        ]
    )
    return Scene(
        P=np.ascontiguousarray(views.P),
        centres=centres,
        epipoles=np.einsum("jab,ib->jia", views.P, homogeneous),
        floor=floor,
        low=np.array(volume.low, float),
        high=np.array(volume.high, float),
        kind=kinds(),
        degree=degrees(),
    )
