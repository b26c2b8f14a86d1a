"""Joints that a detector finds in images against those of the figure: the reprojection error.

A detection z of a joint X, in normalised coordinates of the undistorted image, has the residual

    r = z - (x / z, y / z),    (x, y, z) = R X + t

whose covariance is the detection's own plus that of the detectors' landmark about the joint, LANDMARK_SD_M at the
joint's depth. Detectors exchange sides, or find joints where there are none: the weights are Geman-McClure.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from capture_rig.kernel import kernel, njit
from capture_rig.session import WRIST_FRACTION
from capture_rig.small_matrices import robust_weight

from .. import kernels
from .normal_equations import CHAIN_COLUMNS

# Thresholds: docs/reference/points.md for the places; the gate is that of a normal distribution.
HIP_ASIDE_M = 0.025  # of the detectors' hips beside the joint's centre
LANDMARK_SD_M = 0.02  # of a detected joint, a place on the image of the skin, about the joint's centre
GATE_SIGMAS = 3.0  # standard deviations at which the weight of a residual has fallen to 1/4
MOST_NATS = 0.5 * GATE_SIGMAS**2  # largest log likelihood of one detection
NEAREST_M, UNSEEN = 0.1, 1e6  # joints at and behind the camera get a residual beyond every gate


def _landmarks() -> dict[str, tuple[int, int, float, float]]:
    """Return for each landmark the stick that carries it, the stick along which it lies, its place there from 0 to 1,
    and its offset to the left in the carrier's frame, m."""
    places = {"torso": (0, 0, 0.5, 0.0), "head": (1, 1, 1.0, 0.0), "neck": (0, 1, 0.0, 0.0)}
    for side, left in ((0, 1.0), (1, -1.0)):
        name = ("left", "right")[side]
        arm, thigh, forearm, calf = 2 + side, 4 + side, 6 + side, 8 + side
        places |= {
            f"{name}_shoulder": (0, arm, 0.0, 0.0),
            f"{name}_hip": (0, thigh, 0.0, 0.0),
            f"{name}_hip_of_image": (0, thigh, 0.0, left * HIP_ASIDE_M),
            f"{name}_elbow": (arm, arm, 1.0, 0.0),
            f"{name}_wrist": (forearm, forearm, WRIST_FRACTION, 0.0),
            f"{name}_hand": (forearm, forearm, 1.0, 0.0),
            f"{name}_knee": (thigh, thigh, 1.0, 0.0),
            f"{name}_foot": (calf, calf, 1.0, 0.0),
        }
    return places


LANDMARKS = _landmarks()
"""The places of the figure that detectors find, by name."""
LANDMARK_NAMES = tuple(LANDMARKS)
CARRIER, LINE = (np.array([place[k] for place in LANDMARKS.values()]) for k in range(2))
ALONG, LEFT = (np.array([place[k] for place in LANDMARKS.values()]) for k in range(2, 4))
ALL_STICKS = np.ones(10, np.bool_)


class Keypoints(NamedTuple):
    """Detections (n) of one instant.

    landmark (n,) : number in LANDMARK_NAMES. T_camera_world (n, 3, 4) : of the camera that saw it. ideal (n, 2) :
    its place, in normalised coordinates without distortion; covariance (n, 3) : xx, xy, yy of that. score (n,) : its
    weight, from 0 to 1. skeleton (n,), camera (n,) : the numbers of its skeleton, and of the camera in the rig.
    """

    landmark: np.ndarray
    T_camera_world: np.ndarray
    ideal: np.ndarray
    covariance: np.ndarray
    score: np.ndarray
    skeleton: np.ndarray
    camera: np.ndarray

    def chosen(self, rows: np.ndarray) -> Keypoints:
        """Return some detections, by number or mask."""
        return Keypoints(*(np.ascontiguousarray(column[rows]) for column in self))


NO_KEYPOINTS = Keypoints(
    np.empty(0, np.int64),
    np.empty((0, 3, 4)),
    np.empty((0, 2)),
    np.empty((0, 3)),
    np.empty(0),
    np.empty(0, np.int64),
    np.empty(0, np.int64),
)


@njit(cache=True)
def add_keypoints(keypoints, posed, scale, H, g):
    """Add every detection's residual to upper H and g, ``scale`` times its information."""
    point, D, J = np.empty(3), np.empty((2, 3)), np.empty((3, CHAIN_COLUMNS))
    slots, E = np.empty(CHAIN_COLUMNS, np.int64), np.empty((2, CHAIN_COLUMNS))
    for i in range(keypoints.score.shape[0]):
        p, q, a, b, c = _residual(keypoints, i, posed, point, D)
        w = robust_weight(scale * keypoints.score[i], _mahalanobis(p, q, a, b, c) / GATE_SIGMAS**2)
        n = kernels.point_jacobian(CARRIER[keypoints.landmark[i]], point, posed.t0, posed.A, posed.axes, J, slots)
        for m in range(n):
            for row in range(2):
                E[row, m] = D[row, 0] * J[0, m] + D[row, 1] * J[1, m] + D[row, 2] * J[2, m]
        for m in range(n):
            x, y = w * (a * E[0, m] + b * E[1, m]), w * (b * E[0, m] + c * E[1, m])
            g[slots[m]] += x * p + y * q
            for other in range(m, n):
                row, column = min(slots[m], slots[other]), max(slots[m], slots[other])
                H[row, column] += x * E[0, other] + y * E[1, other]


@njit(cache=True, nogil=True)
def keypoint_support(keypoints, posed, sticks):
    """Return the log-likelihood ratio (nats) of the pose and of chance for the detections of joints on some ``sticks``
    (10,) bool."""
    point, D, support = np.empty(3), np.empty((2, 3)), 0.0
    for i in range(keypoints.score.shape[0]):
        if sticks[CARRIER[keypoints.landmark[i]]]:
            p, q, a, b, c = _residual(keypoints, i, posed, point, D)
            support += keypoints.score[i] * MOST_NATS / (1.0 + _mahalanobis(p, q, a, b, c) / GATE_SIGMAS**2)
    return support


@njit(cache=True, nogil=True)
def offsets_m(keypoints, posed):
    """Return the offsets (n, 2), m, of the detections from the joints, across their cameras' axes at the joints' depth;
    huge at and behind the camera."""
    point, D, offsets = np.empty(3), np.empty((2, 3)), np.empty((keypoints.score.shape[0], 2))
    for i in range(offsets.shape[0]):
        p, q, _, _, _ = _residual(keypoints, i, posed, point, D)
        depth = max(_depth(keypoints.T_camera_world[i], point), NEAREST_M)
        offsets[i, 0], offsets[i, 1] = p * depth, q * depth
    return offsets


@kernel
def _residual(keypoints, i, posed, point, D):
    """point (3,) <- the joint in the world; D (2, 3) <- the derivative of its view.

    Returns the residual and the numbers a, b, c of its information [[a, b], [b, c]]; at and behind the camera the
    residual is UNSEEN.
    """
    k, T = keypoints.landmark[i], keypoints.T_camera_world[i]
    j, u = LINE[k], ALONG[k]
    for r in range(3):
        along = posed.A[j, r] + u * (posed.B[j, r] - posed.A[j, r])
        point[r] = along + LEFT[k] * posed.G[CARRIER[k], r, 1]
    z = _depth(T, point)
    if z < NEAREST_M:
        D[:] = 0.0
        return UNSEEN, UNSEEN, 1.0, 0.0, 1.0
    x = (T[0, 0] * point[0] + T[0, 1] * point[1] + T[0, 2] * point[2] + T[0, 3]) / z
    y = (T[1, 0] * point[0] + T[1, 1] * point[1] + T[1, 2] * point[2] + T[1, 3]) / z
    for r in range(3):
        D[0, r], D[1, r] = (T[0, r] - x * T[2, r]) / z, (T[1, r] - y * T[2, r]) / z
    about = (LANDMARK_SD_M / z) ** 2
    xx, xy, yy = keypoints.covariance[i, 0] + about, keypoints.covariance[i, 1], keypoints.covariance[i, 2] + about
    determinant = xx * yy - xy * xy
    p, q = keypoints.ideal[i, 0] - x, keypoints.ideal[i, 1] - y
    return p, q, yy / determinant, -xy / determinant, xx / determinant


@kernel
def _depth(T, point):
    return T[2, 0] * point[0] + T[2, 1] * point[1] + T[2, 2] * point[2] + T[2, 3]


@kernel
def _mahalanobis(p, q, a, b, c):
    return a * p * p + 2.0 * b * p * q + c * q * q
