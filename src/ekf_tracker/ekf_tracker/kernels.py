"""Prediction and correction of the articulated EKF (thesis Tables 5.5 and 5.7) on the manifold of poses.

The covariance belongs to an error vector of 48 slots: 24 of the pose's tangent (`stick_figure.pose`), 24
of its velocity. The pose itself stays a set of rotation matrices, so nothing needs normalising and no gimbal locks. The
kernels take a pose as its state arrays (t0, R0, RJ, hinges) of `stick_figure.kernels`; no fast-math and fixed orders of
summation, so equal inputs give equal bytes.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from capture_rig.kernel import njit
from capture_rig.small_matrices import inverse3, inverse_positive, symmetrise
from stick_figure import kernels
from stick_figure.joint_limits import (
    add_joint_limits,
    flipped_limb_fits_better,
    hyperextension,
    limit_rates,
    stop_at_straight,
)
from stick_figure.kinematics import rates_of_angles
from stick_figure.pose import HINGE_MARGIN_RAD, Pose

from .bias import add_measurement_bias
from .measurement import add_information, empty_linearised, linearise, moved, point_covariance

N = 24
# Thresholds: rounding from arithmetic; LINEAR_M judgement.
LINEAR_M = 1e-3
"""Largest distance of all points from their linearised places at which the update is not relinearised."""

Arrays = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]


class Estimate(NamedTuple):
    """Mean and covariance of the state.

    arrays : the pose as `stick_figure.pose.Pose.arrays` names it
    velocity : (24,) rates of the pose's tangent, m/s and rad/s
    covariance : (48, 48), pose before velocity
    """

    arrays: Arrays
    velocity: np.ndarray
    covariance: np.ndarray

    @property
    def pose(self) -> Pose:
        """The pose, with arrays of its own."""
        return Pose(*self.arrays)


class UpdateOptions(NamedTuple):
    """How an update is iterated: relinearisations at most, weight of a joint limit (1/rad^2), and how far (rad) an
    elbow or knee may pass straight before it is described the other way round."""

    max_iterations: int
    limit_weight: float = 0.0
    hinge_margin_rad: float = HINGE_MARGIN_RAD


@njit(cache=True, nogil=True)
def predict_estimate(estimate, transition, joint_sd_cap_rad):
    """Return the estimate one `Transition` later (thesis Table 5.5, from the a-posteriori state and covariance).

    No joint's pose is left with a standard deviation above the cap (rad): see :func:`cap_joints`. Elbows and knees that
    come straight stop there; that moves the mean alone, as joint limits do.
    """
    pose, velocity, P = estimate
    f_cross, f_velocity, q_pose, q_cross, q_velocity = transition
    out = np.empty_like(P)
    for i in range(N):
        for j in range(N):  # each sum in the order of its mirror image, so that the result is exactly symmetric
            cross = P[i, N + j] * f_cross[j] + f_cross[i] * P[N + i, j]
            out[i, j] = (P[i, j] + cross) + (f_cross[i] * f_cross[j]) * P[N + i, N + j]
            out[i, N + j] = (P[i, N + j] + f_cross[i] * P[N + i, N + j]) * f_velocity[j]
            out[N + i, j] = (P[N + i, j] + P[N + i, N + j] * f_cross[j]) * f_velocity[i]
            out[N + i, N + j] = (f_velocity[i] * f_velocity[j]) * P[N + i, N + j]
        out[i, i] += q_pose[i]
        out[i, N + i] += q_cross[i]
        out[N + i, i] += q_cross[i]
        out[N + i, N + i] += q_velocity[i]
    cap_joints(out, joint_sd_cap_rad)
    moved_pose = copied(pose)
    t0, R0, RJ, hinges = moved_pose
    before, moved_velocity = hinges.copy(), f_velocity * velocity
    kernels.retract(t0, R0, RJ, hinges, f_cross * velocity, 1.0)
    stop_at_straight(before, hinges, moved_velocity)
    return Estimate(moved_pose, moved_velocity, out)


@njit(cache=True, nogil=True)
def correct_estimate(sizes, prior, start, z, options):
    """Return the estimate after the visible points of z: iterated EKF update (thesis Table 5.7).

    Each iteration is one Gauss-Newton step on the sum of the points' and the prior's squared residuals (Bell &
    Cathey 1993). ``start`` : arrays of the pose of the first linearisation. Joint limits move the mean but are left out
    of the covariance, as they exclude places and measure none. Elbows and knees come out bent the right way. ValueError
    when the prior's covariance is not positive definite.
    """
    (prior_pose, velocity, P), pose = prior, copied(start)
    L, Y, V, offset = iterate_update(prior_pose, pose, P, sizes, z, options)
    P_vx = np.ascontiguousarray(P[N:, :N])
    moved_velocity = velocity + np.dot(P_vx, np.dot(Y, offset))  # the mean of v given x
    G = np.empty((2 * N, N))
    G[:N] = V
    G[N:] = np.dot(np.dot(P_vx, Y), V)
    posterior = joseph(P, G, L)
    _canonicalise_hinges(pose, moved_velocity, posterior, options.hinge_margin_rad, options.limit_weight > 0.0)
    if options.limit_weight > 0.0:
        limit_rates(moved_velocity)
    return Estimate(pose, moved_velocity, posterior)


@njit(cache=True)
def iterate_update(prior, pose, P, sizes, z, options):
    """Iterates the EKF's update (thesis Table 5.7) to the pose at which its own linearisation holds.

    ``pose`` is the first linearisation, and becomes the result. Joint limits that the last step passed are worth one
    more iteration.

    In information form, because the points' covariance is one small block each: with Y = P_pose^-1 and L = H' R^-1 H,
    the step from the prior is V (H' R^-1 (z - h) + L (x (-) prior)), V = (Y + L)^-1 the covariance of the pose. Returns
    L, Y, V (24, 24), L and V of the last linearisation, and x (-) prior (24,).
    """
    max_iterations, limit_weight, hinge_margin = options
    t0, R0, RJ, hinges = pose
    t0_prior, R0_prior, RJ_prior, hinges_prior = prior
    Y, weights = inverse_positive(np.ascontiguousarray(P[:N, :N])), _inverses(z)
    L, A, g, offset = np.empty((N, N)), np.zeros((N, N)), np.zeros(N), np.empty(N)
    at = empty_linearised()
    linearise(pose, sizes, at)
    iteration, violated = 0, add_joint_limits(RJ, hinges, hinge_margin, 0.0, A, g)
    while True:
        iteration += 1
        kernels.difference(t0, R0, RJ, hinges, t0_prior, R0_prior, RJ_prior, hinges_prior, offset)
        _normal_equations(at, weights, z, L, g)
        V = inverse_positive(Y + L)
        g -= np.dot(Y, offset)
        step = np.dot(V, g)
        if limit_weight > 0.0 and violated > 0:
            A[:] = Y + L
            add_joint_limits(RJ, hinges, hinge_margin, limit_weight, A, g)
            step = np.dot(inverse_positive(A), g)
        step *= kernels.scale_of_step(step)
        offset += step
        t0[:], R0[:], RJ[:], hinges[:] = t0_prior, R0_prior, RJ_prior, hinges_prior
        kernels.retract(t0, R0, RJ, hinges, offset, 1.0)
        linearisation_error = _linearise_and_compare(pose, sizes, z.visible, step, at)
        now_violated = add_joint_limits(RJ, hinges, hinge_margin, 0.0, A, g)
        limits_hold = limit_weight == 0.0 or now_violated <= violated
        if iteration > max_iterations or (
            limits_hold and (iteration == max_iterations or linearisation_error < LINEAR_M)
        ):
            return L, Y, V, offset
        violated = now_violated


@njit(cache=True)
def _normal_equations(at, weights, z, L, g):
    """L (24, 24) <- H' R^-1 H and g (24,) <- H' R^-1 (z - h) of the visible points."""
    L[:] = 0.0
    g[:] = 0.0
    for point in range(15):
        if z.visible[point]:
            add_information(at, point, weights[point], z.points_world[point] - at.h[point], L, g)
    for i in range(N):
        for j in range(i):
            L[i, j] = L[j, i]


@njit(cache=True)
def _linearise_and_compare(pose, sizes, visible, step, at):
    """at <- linearisation at the pose; returns the largest change (m, any axis) of a visible point's prediction."""
    expected = np.empty((15, 3))
    for point in range(15):
        expected[point, 0], expected[point, 1], expected[point, 2] = moved(at, point, step)
    linearise(pose, sizes, at)
    linearisation_error = 0.0
    for point in range(15):
        if visible[point]:
            for i in range(3):
                linearisation_error = max(linearisation_error, abs(expected[point, i] - at.h[point, i]))
    return linearisation_error


@njit(cache=True)
def _inverses(z):
    inverses = np.empty_like(z.covariance)
    for point in range(15):
        if z.visible[point]:
            inverse3(z.covariance[point], inverses[point])
    return inverses


@njit(cache=True)
def _canonicalise_hinges(pose, velocity, P, margin, only_if_better):
    """Describes limbs that passed straight the other way round, in place; with joint limits only if that is better."""
    _, _, RJ, hinges = pose
    RJ_turned, hinges_turned, velocity_turned = RJ.copy(), hinges.copy(), velocity.copy()
    turned = kernels.canonicalise_hinges(RJ_turned, hinges_turned, velocity_turned, margin)
    for h in range(4):
        if not turned >> h & 1:
            continue
        if only_if_better and not flipped_limb_fits_better(h, RJ, hyperextension(h, hinges, margin)):
            continue
        slot = kernels.HINGE_SLOT[h]
        RJ[1 + h], hinges[h], velocity[slot] = RJ_turned[1 + h], hinges_turned[h], velocity_turned[slot]
        negate(P, slot)
        negate(P, N + slot)


@njit(cache=True)
def joseph(P, G, L):
    """(I - K H) P (I - K H)' + K R K' for the gain K = G H' R^-1, with L = H' R^-1 H (24, 24) on the pose, P (48, 48).

    Joseph's form, because a sum of two squares stays symmetric and positive whatever the rounding of K;
    the thesis's (I - K H) P (Table 5.7) is right only for the exact gain and loses both over a few thousand sets.
    Here K H = [G L, 0] and K R K' = G L G'.
    """
    KH = np.dot(G, L)
    T = P - np.dot(KH, P[:N])  # (I - K H) P
    out = np.dot(G - T[:, :N], KH.T)
    out += T
    symmetrise(out)
    return out


@njit(cache=True)
def cap_joints(P, sd_cap):
    """Shrinks P (48, 48), in place, until no joint's pose has an sd above ``sd_cap`` (rad) in any slot.

    The twist of a straight limb is not observable, and without a bound its variance grows until the linearisation
    means nothing. Rows and columns are scaled alike (a congruence), so P stays positive definite.
    """
    for slot in range(6, N):
        if P[slot, slot] > sd_cap * sd_cap:
            shrink = sd_cap / math.sqrt(P[slot, slot])
            P[slot, :] *= shrink
            P[:, slot] *= shrink


@njit(cache=True)
def negate(P, slot):
    """Change the sign of one slot of the state, in place."""
    P[slot, :] *= -1.0
    P[:, slot] *= -1.0


@njit(cache=True)
def copied(pose):
    """State arrays of their own."""
    t0, R0, RJ, hinges = pose
    return t0.copy(), R0.copy(), RJ.copy(), hinges.copy()


@njit(cache=True, nogil=True)
def report(estimate, sizes, lasting, joints, least_information, angles):
    """Points (15, 3), their covariances (15, 3, 3), the state's covariance (48, 48), rates (18,) of the angles (18,).

    Both covariances include the measurements' bias: ``lasting``, ``joints`` and ``least_information`` of
    `bias.add_measurement_bias`.
    """
    pose, velocity, P = estimate
    at, points, state = empty_linearised(), np.empty((15, 3, 3)), P.copy()
    linearise(pose, sizes, at)
    for point in range(15):
        point_covariance(at, point, P, points[point])
    add_measurement_bias(at, pose, lasting, joints, least_information, points, state)
    _, _, _, hinges = pose
    return at.h, points, state, rates_of_angles(hinges, velocity, angles)
