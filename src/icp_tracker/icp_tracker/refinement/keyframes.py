"""Keyframes: the poses that a body's sizes are refined from, with their normal equations of its shape.

Pose and shape share a keyframe's rays. So the pose is eliminated from its normal equations (Schur complement) and
updated when the shape changes; the reduced equations are linear in the shape alone, and those of all keyframes add up.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from capture_rig.kernel import njit
from capture_rig.small_matrices import solve_positive, solve_positive_columns
from stick_figure import kernels
from stick_figure.body import BEND_NUMBERS
from stick_figure.joint_limits import LIMIT_SD_RAD, NECK_SD, add_joint_limits, add_neck_rest
from stick_figure.least_squares.contour_factor import SLACK_M, bent_figure
from stick_figure.least_squares.extremities import ANGLES, COUNT, LARGEST_TURN, straight_extremities, turn_extremities
from stick_figure.least_squares.normal_equations import TANGENT, mirror_upper
from stick_figure.least_squares.posed_model import PoseState, place

from .shape import BENT, POSE, UNKNOWNS, contour_system, figure_at

# Thresholds: chosen with rendered bodies of our mesh; measured by python bench/people.py.
GATE_M, EXPLAINED_M = 0.04, 0.06  # see `contour_system`
FIRST_JOINT_SLOT = 6


class Keyframes(NamedTuple):
    """Room for K poses: t0 (K, 3), R0 (K, 3, 3), RJ (K, 5, 3, 3), hinges (K, 4) as of :class:`PoseState`.

    information (K, U, U), target (K, U) : each one's part of the normal equations of the shape's values: (sum of
    information) values = sum of target; zero while the surface explains too few of its rays.
    bend (K, 7) of the trunk and turns (K, 4, 2) of hands and feet are each keyframe's own, like its pose.
    values (K, U) : where it was linearised. through (K, POSE, U + 1) : back-substitution of the pose from there.
    """

    t0: np.ndarray
    R0: np.ndarray
    RJ: np.ndarray
    hinges: np.ndarray
    bend: np.ndarray
    turns: np.ndarray
    information: np.ndarray
    target: np.ndarray
    values: np.ndarray
    through: np.ndarray

    @classmethod
    def of(cls, count: int) -> Keyframes:
        """Make room for ``count`` keyframes."""
        pose = (3,), (3, 3), (5, 3, 3), (4,), (BEND_NUMBERS,), (COUNT, ANGLES)
        equations = (UNKNOWNS, UNKNOWNS), (UNKNOWNS,), (UNKNOWNS,), (POSE, UNKNOWNS + 1)
        return cls(*(np.empty((count, *shape)) for shape in (*pose, *equations)))


@njit(cache=True, nogil=True)
def write_keyframe(kept, k, pose, bend, values):
    """Write a pose (t0, R0, RJ, hinges) and bend to place k, not linearised yet; ``values`` : the shape's."""
    kept.t0[k], kept.R0[k], kept.RJ[k], kept.hinges[k] = pose
    kept.bend[k] = bend
    kept.turns[k] = 0.0
    kept.values[k] = values
    kept.through[k] = 0.0


@njit(cache=True, nogil=True)
def linearise_keyframe(kept, k, rays, model, values, prior, least):
    """Update a keyframe's pose for the shape's ``values``, and linearise there.

    ``prior`` (POSE,) : information of its pose, bend (about rest) and turns (about straight). ``least`` : share of the
    rays that must be explained for it to count; returns the explained share.
    """
    state, n, unknowns = PoseState(kept.t0[k], kept.R0[k], kept.RJ[k], kept.hinges[k]), POSE + UNKNOWNS, UNKNOWNS
    bend, ends = kept.bend[k], straight_extremities(1.0)
    _update_pose(kept.through[k], kept.values[k] - values, state, bend, kept.turns[k])
    ends.turns[:] = kept.turns[k]
    H, g = np.empty((n, n)), np.empty(n)
    posed = place(state, bent_figure(figure_at(model, values), model.bends, bend))
    turn_extremities(ends, posed)
    explained = contour_system(rays, posed, ends.turns, model, (GATE_M, SLACK_M, EXPLAINED_M), H, g)
    own, L, through = H[:POSE, :POSE].copy(), np.empty((POSE, POSE)), kept.through[k]
    through[:, :unknowns], through[:, unknowns] = H[:POSE, POSE:], g[:POSE]
    _add_limits(state, own[:TANGENT, :TANGENT], through[:TANGENT, unknowns])
    for i in range(POSE):
        own[i, i] += prior[i]
    through[TANGENT:BENT, unknowns] -= prior[TANGENT:BENT] * bend
    through[BENT:, unknowns] -= prior[BENT:] * ends.turns.ravel()
    solve_positive_columns(own, L, through)
    kept.values[k] = values
    information, target = kept.information[k], kept.target[k]
    information[:], target[:] = 0.0, 0.0
    if explained >= least:
        for i in range(unknowns):
            eliminated = np.zeros(unknowns + 1)
            for m in range(POSE):
                for j in range(unknowns + 1):  # of neighbours in memory alone, so that it is vectorised
                    eliminated[j] += H[POSE + i, m] * through[m, j]
            target[i] = g[POSE + i]
            for j in range(unknowns):
                information[i, j] = H[POSE + i, POSE + j] - eliminated[j]
                target[i] += information[i, j] * values[j]
            target[i] -= eliminated[unknowns]
    return explained


@njit(cache=True)
def _update_pose(through, change, state, bend, turns):
    """Update pose, bend and turns by back-substitution for a ``change`` (U,) of the shape's values."""
    step = through[:, -1] + (through[:, :-1] * change).sum(axis=1)
    scale = kernels.scale_of_step(step[:BENT])
    kernels.retract(state.t0, state.R0, state.RJ, state.hinges, step[:TANGENT], scale)
    bend += scale * step[TANGENT:BENT]
    turned = turns + scale * step[BENT:].reshape(COUNT, ANGLES)
    turns[:] = np.minimum(np.maximum(turned, -LARGEST_TURN), LARGEST_TURN)


@njit(cache=True)
def _add_limits(state, own, pull):
    """Add the neck's rest and the joints' limits to the pose's equations."""
    known = np.zeros((TANGENT, TANGENT))
    add_neck_rest(state.RJ[0], NECK_SD**-2, known, pull)
    add_joint_limits(state.RJ, state.hinges, np.inf, LIMIT_SD_RAD**-2, known, pull)
    mirror_upper(known)
    own += known


@njit(cache=True, nogil=True)
def differs_from_all(kept, count, pose, turn):
    """Return whether a pose differs from every keyframe by more than ``turn`` rad at some joint (not the torso)."""
    (t0, R0, RJ, hinges), tangent = pose, np.empty(TANGENT)
    for k in range(count - 1, -1, -1):  # the latest ones resemble it most
        kernels.difference(t0, R0, RJ, hinges, kept.t0[k], kept.R0[k], kept.RJ[k], kept.hinges[k], tangent)
        if not np.abs(tangent[FIRST_JOINT_SLOT:]).max() > turn:
            return False
    return True


@njit(cache=True, nogil=True)
def solve_shape(kept, count, information, target):
    """Return the shape's values (U,) from the keyframes and the prior's ``information`` (U, U) and ``target`` (U,)."""
    H, g, L, values = information.copy(), target.copy(), np.empty_like(information), np.empty_like(target)
    for k in range(count):
        H += kept.information[k]
        g += kept.target[k]
    solve_positive(H, g, L, values)
    return values
