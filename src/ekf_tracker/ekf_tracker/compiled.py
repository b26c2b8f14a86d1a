"""The filter's two steps, compiled: plain arrays in, plain arrays out.

Slots as in `slots`: 24 of the pose's tangent, then 24 of its velocity. No fast-math and fixed orders of summation, so
equal inputs give equal bytes. A pose is its state arrays (t0, R0, RJ, hinges) of `stick_figure.kernels`.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from stick_figure import kernels

from .algebra import inverse3, inverse_spd, symmetrise
from .joint_limits import add_joint_limits, beyond_straight, turned_is_better
from .linearised import add_information, empty_linearised, linearise, moved

N = 24
STEP_LIMIT = 0.5
"""rad and m: a longer Gauss-Newton step is outside the region where the linearisation holds."""
LINEAR_M = 1e-3
"""When every point is this close to where the linearisation said, linearising again is not worth it."""


@njit(cache=True)
def advance(pose, velocity, P, reach, kept, q_pose, q_cross, q_velocity, sd_cap):
    """Pose, velocity and covariance (48, 48) one transition later (thesis Table 5.5).

    F = [[I, reach], [0, kept]] and Q = [[q_pose, q_cross], [q_cross, q_velocity]], each block diagonal (24,).
    """
    out = np.empty_like(P)
    for i in range(N):
        for j in range(N):  # each sum in an order that its mirror image shares, so that the result is exactly symmetric
            cross = P[i, N + j] * reach[j] + reach[i] * P[N + i, j]
            out[i, j] = (P[i, j] + cross) + (reach[i] * reach[j]) * P[N + i, N + j]
            out[i, N + j] = (P[i, N + j] + reach[i] * P[N + i, N + j]) * kept[j]
            out[N + i, j] = (P[N + i, j] + P[N + i, N + j] * reach[j]) * kept[i]
            out[N + i, N + j] = (kept[i] * kept[j]) * P[N + i, N + j]
        out[i, i] += q_pose[i]
        out[i, N + i] += q_cross[i]
        out[N + i, i] += q_cross[i]
        out[N + i, N + i] += q_velocity[i]
    cap_joints(out, sd_cap)
    ahead = copied(pose)
    t0, R0, RJ, hinges = ahead
    kernels.retract(t0, R0, RJ, hinges, reach * velocity, 1.0)
    return ahead, kept * velocity, out


@njit(cache=True)
def copied(pose):
    """State arrays of their own."""
    t0, R0, RJ, hinges = pose
    return t0.copy(), R0.copy(), RJ.copy(), hinges.copy()


@njit(cache=True)
def cap_joints(P, sd_cap):
    """Shrinks P (48, 48), in place, until no joint's pose has an sd above ``sd_cap`` (rad) about any axis.

    The twist of a straight limb is not observable, and without a bound its variance grows until the linearisation
    means nothing. The joint's error is shrunk along the uncertain axis only (a congruence, so P stays positive
    definite), and what is known about the other axes is kept.
    """
    cap = sd_cap * sd_cap
    for ball in range(5):
        slots = kernels.SLOT_OF_JOINT_AXIS[ball]
        axes = 2 if slots[2] < 0 else 3
        total = 0.0
        for k in range(axes):
            total += P[slots[k], slots[k]]
        if total > cap:
            _cap_ball(P, slots[:axes], cap)
    for slot in kernels.HINGE_SLOT:
        if P[slot, slot] > cap:
            shrink = math.sqrt(cap / P[slot, slot])
            P[slot, :] *= shrink
            P[:, slot] *= shrink


@njit(cache=True)
def _cap_ball(P, slots, cap):
    n = len(slots)
    block = np.empty((n, n))
    for a in range(n):
        for b in range(n):
            block[a, b] = P[slots[a], slots[b]]
    variances, axes = np.linalg.eigh(block)
    if variances[-1] <= cap:
        return
    shrink = np.zeros((n, n))
    for k in range(n):
        factor = math.sqrt(cap / max(variances[k], cap))
        for a in range(n):
            for b in range(n):
                shrink[a, b] += factor * (axes[a, k] * axes[b, k])
    _turn_rows(P, slots, shrink)
    _turn_rows(P.T, slots, shrink)
    for a in range(n):
        for b in range(a):
            P[slots[b], slots[a]] = P[slots[a], slots[b]]


@njit(cache=True)
def _turn_rows(P, slots, shrink):
    before = np.empty(len(slots))
    for c in range(P.shape[1]):
        for a in range(len(slots)):
            before[a] = P[slots[a], c]
        for a in range(len(slots)):
            P[slots[a], c] = (shrink[a] * before).sum()


@njit(cache=True)
def correct(prior, start, velocity, P, lengths, origins, z, R, chosen, limit_weight, iterations, hinge_margin):
    """Pose, velocity and covariance after the chosen points (15,) bool of z (15, 3), R (15, 3, 3) (thesis Table 5.7).

    ``start`` is the pose of the first linearisation. Elbows and knees come out bent the right way. ValueError when P
    (48, 48) has lost its positive definiteness.
    """
    pose = copied(start)
    L, Y, V, gone = most_probable(
        prior, pose, lengths, origins, P, z, R, chosen, limit_weight, iterations, hinge_margin
    )
    P_vx = np.ascontiguousarray(P[N:, :N])
    moved_velocity = velocity + np.dot(P_vx, np.dot(Y, gone))  # the mean of v given x
    G = np.empty((2 * N, N))
    G[:N] = V
    G[N:] = np.dot(np.dot(P_vx, Y), V)
    posterior = joseph(P, G, L)
    _bend_the_right_way(pose, moved_velocity, posterior, hinge_margin, limit_weight > 0.0)
    return pose, moved_velocity, posterior


@njit(cache=True)
def _bend_the_right_way(pose, velocity, P, margin, only_if_better):
    """Describes limbs that passed straight the other way round, in place; with joint limits only if that is better."""
    _, _, RJ, hinges = pose
    RJ_turned, hinges_turned, velocity_turned = RJ.copy(), hinges.copy(), velocity.copy()
    turned = kernels.canonicalise_hinges(RJ_turned, hinges_turned, velocity_turned, margin)
    for h in range(4):
        if not turned >> h & 1:
            continue
        if only_if_better and not turned_is_better(h, RJ, beyond_straight(h, hinges, margin)):
            continue
        slot = kernels.HINGE_SLOT[h]
        RJ[1 + h], hinges[h], velocity[slot] = RJ_turned[1 + h], hinges_turned[h], velocity_turned[slot]
        _negate(P, slot)
        _negate(P, N + slot)


@njit(cache=True)
def _negate(P, slot):
    P[slot, :] *= -1.0
    P[:, slot] *= -1.0


@njit(cache=True)
def most_probable(prior, pose, lengths, origins, P, z, R, chosen, limit_weight, iterations, hinge_margin):
    """Iterates the EKF's update (thesis Table 5.7) to the pose at which its own linearisation holds.

    ``pose`` is the first linearisation, and becomes the result. ``limit_weight`` of the joint limits in 1/rad^2; limits
    that the last step passed are worth one more iteration.

    In information form, because the points' covariance is one small block each: with Y = P_pose^-1 and L = H' R^-1 H,
    the step from the prior is V (H' R^-1 (z - h) + L (x (-) prior)), V = (Y + L)^-1 the covariance of the pose. Returns
    L, Y, V (24, 24), L and V of the last linearisation, and x (-) prior (24,).
    """
    t0, R0, RJ, hinges = pose
    t0_prior, R0_prior, RJ_prior, hinges_prior = prior
    Y, weights, at = inverse_spd(np.ascontiguousarray(P[:N, :N])), _inverses(R, chosen), empty_linearised()
    L, A, g, gone = np.empty((N, N)), np.zeros((N, N)), np.zeros(N), np.empty(N)
    linearise(pose, lengths, origins, at)
    number, beyond = 0, add_joint_limits(RJ, hinges, hinge_margin, 0.0, A, g)
    while True:
        number += 1
        kernels.difference(t0, R0, RJ, hinges, t0_prior, R0_prior, RJ_prior, hinges_prior, gone)
        _normal_equations(at, weights, z, chosen, L, g)
        V = inverse_spd(Y + L)
        g -= np.dot(Y, gone)
        step = np.dot(V, g)
        if limit_weight > 0.0 and beyond > 0:
            A[:] = Y + L
            add_joint_limits(RJ, hinges, hinge_margin, limit_weight, A, g)
            step = np.dot(inverse_spd(A), g)
        step *= min(1.0, STEP_LIMIT / max(np.abs(step).max(), STEP_LIMIT))
        gone += step
        t0[:], R0[:], RJ[:], hinges[:] = t0_prior, R0_prior, RJ_prior, hinges_prior
        kernels.retract(t0, R0, RJ, hinges, gone, 1.0)
        surprise = _linearise_and_compare(pose, lengths, origins, chosen, step, at)
        passed = add_joint_limits(RJ, hinges, hinge_margin, 0.0, A, g)
        limits_hold = limit_weight == 0.0 or passed <= beyond
        if number > iterations or (limits_hold and (number == iterations or surprise < LINEAR_M)):
            return L, Y, V, gone
        beyond = passed


@njit(cache=True)
def _inverses(R, chosen):
    inverses = np.empty_like(R)
    for point in range(15):
        if chosen[point]:
            inverse3(R[point], inverses[point])
    return inverses


@njit(cache=True)
def _normal_equations(at, weights, z, chosen, L, g):
    """L (24, 24) <- H' R^-1 H and g (24,) <- H' R^-1 (z - h) of the chosen points."""
    L[:] = 0.0
    g[:] = 0.0
    for point in range(15):
        if chosen[point]:
            add_information(at, point, weights[point], z[point] - at.h[point], L, g)
    for i in range(N):
        for j in range(i):
            L[i, j] = L[j, i]


@njit(cache=True)
def _linearise_and_compare(pose, lengths, origins, chosen, step, at):
    """at <- linearisation at the pose; returns how far (m, any axis) the chosen points are from where it had them."""
    expected = np.empty((15, 3))
    for point in range(15):
        expected[point, 0], expected[point, 1], expected[point, 2] = moved(at, point, step)
    linearise(pose, lengths, origins, at)
    surprise = 0.0
    for point in range(15):
        if chosen[point]:
            for i in range(3):
                surprise = max(surprise, abs(expected[point, i] - at.h[point, i]))
    return surprise


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
