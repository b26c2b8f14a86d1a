"""What an uncertain body adds to the covariance of its fitted points: lengths, and limbs that the rig does not show.

A fit puts the figure's surface where the body's is; how far along a stick a joint lies from there is the figure's
sizes alone. So a size that is wrong by d moves its own point by d along its own stick. The sticks beyond it are moved
only where the rig does not show them, a foot outside the pictures: else their surfaces are where the rays show them.
Left and right of one size err together; each point's covariance is its own.
"""

from __future__ import annotations

import numpy as np

from capture_rig.visibility import RigVisibility
from stick_figure.kinematics import stick_frames
from stick_figure.pose import Pose
from stick_figure.skeleton import POINT_STICK

from .acquisition.body_sizes import CALF, FOREARM, HEAD_, HIP, RISE, SHOULDER, SIZES, THIGH, TORSO_, UPPER_ARM
from .articulated_fit import UNSEEN_SD

# point: sizes that place it in the frame of its stick, each as (coordinate axis, size, share of the size's error); the
# torso's centre is half its length from either end
_PLACED_BY = (
    ((2, TORSO_, 0.5),),
    ((2, HEAD_, 1.0),),
    ((2, TORSO_, 0.5),),
    *(((1, SHOULDER, 1.0), (2, RISE, 1.0)),) * 2,
    *(((1, HIP, 1.0), (2, TORSO_, 0.5)),) * 2,
    *(((1, UPPER_ARM, 1.0),),) * 2,
    *(((2, THIGH, 1.0),),) * 2,
    *(((1, FOREARM, 1.0),),) * 2,
    *(((2, CALF, 1.0),),) * 2,
)


CHAINS: tuple[tuple[tuple[int, ...], tuple[int, ...]], ...] = (
    ((2, 1), (HEAD_,)),
    ((3, 7, 11), (UPPER_ARM, FOREARM)),
    ((4, 8, 12), (UPPER_ARM, FOREARM)),
    ((5, 9, 13), (THIGH, CALF)),
    ((6, 10, 14), (THIGH, CALF)),
)
"""Reference points from the trunk outwards, and the sizes of the sticks between them."""


def _shares() -> np.ndarray:
    """Return (15, 3, SIZES): variance of a point along its stick's axes per variance of each size."""
    shares = np.zeros((len(_PLACED_BY), 3, len(SIZES)))
    for point, placed_by in enumerate(_PLACED_BY):
        for axis, size, share in placed_by:
            shares[point, axis, size] = share**2
    return shares


_SHARES = _shares()


def covariance_of_sizes(pose: Pose, size_sd_m: np.ndarray) -> np.ndarray:
    """Return (15, 3, 3) m^2, world frame, of the points of a pose when the sizes (10,) have these deviations, m."""
    variances = _SHARES @ size_sd_m**2
    frames = stick_frames(pose)[POINT_STICK]
    return np.asarray((frames * variances[:, None, :]) @ frames.transpose(0, 2, 1))


def widen_hidden(
    covariance: np.ndarray,
    points_world: np.ndarray,
    supported: np.ndarray,
    size_sd_m: np.ndarray | None,
    visibility: RigVisibility | None,
) -> np.ndarray:
    """Return the covariance (15, 3, 3) m^2 of points (15, 3) m, larger where the rig does not show them.

    Added are the lengths of the hidden sticks before a point's own, which is in :func:`covariance_of_sizes`.
    supported (15,) bool : points whose sticks data bear on; of the others the direction is not known either.
    size_sd_m (10,) : of the body's sizes; None for a body whose sizes were given.
    """
    hidden = None if visibility is None else visibility.unseen_cells.at(points_world)
    if hidden is None or not hidden.any():
        return covariance
    wide = covariance.copy()
    for points, sizes in CHAINS:
        before = np.zeros((3, 3))
        for near, far, size in zip(points[:-1], points[1:], sizes, strict=True):
            if not hidden[far]:
                before[:] = 0.0
                continue
            stick = points_world[far] - points_world[near]
            length = float(np.linalg.norm(stick))
            along = stick / max(length, 1e-9)
            if not supported[far]:
                before += (UNSEEN_SD * length) ** 2 * (np.eye(3) - np.outer(along, along))
            wide[far] += before
            if size_sd_m is not None:
                before += size_sd_m[size] ** 2 * np.outer(along, along)
    return wide
