"""What a body of uncertain sizes adds to the covariance of its fitted points.

A fit puts the figure's surface where the body's is; how far along a stick a joint lies from there is the figure's
sizes alone. So a size that is wrong by d moves its own point by d along its own stick. The sticks beyond it are not
moved: their surfaces are where the rays show them. Left and right of one size err together; each point's covariance is
its own.
"""

from __future__ import annotations

import numpy as np

from stick_figure.kinematics import stick_frames
from stick_figure.pose import Pose
from stick_figure.skeleton import POINT_STICK

from .acquisition.body_sizes import CALF, FOREARM, HEAD_, HIP, RISE, SHOULDER, SIZES, THIGH, TORSO_, UPPER_ARM

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
