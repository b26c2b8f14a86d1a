"""The frame of the solution: that of a camera, or of a target at one moment."""

from __future__ import annotations

from dataclasses import replace

from capture_rig.errors import InputError

from .fit import Fit
from .observations import State
from .problem import Problem
from .rigid import Array
from .view_graph import Key


def choose_reference(problem: Problem, reference: str | Key | None, root: str) -> str | Key:
    """A camera's name or (target, moment); InputError when ``reference`` names neither, or a target that moved."""
    if reference is None:
        return root
    if isinstance(reference, str):
        if reference in problem.cameras:
            return reference
        keys = [key for key in problem.keys if key[0] == reference]
        if len(keys) > 1:
            raise InputError(
                f"target '{reference}' cannot be the reference: it was seen at {len(keys)} moments",
                remedy="Say at which: (target, moment).",
            )
        reference = keys[0] if keys else (reference, 0)
    if reference not in problem.keys:
        raise InputError(
            f"the reference {reference} is neither a camera nor a target that was seen",
            remedy=f"Cameras: {', '.join(problem.cameras)}.",
        )
    return reference


def in_gauge(fit: Fit, reference: str | Key) -> Fit:
    """The same solution in the frame of the reference."""
    state, problem = fit.adjusted.state, fit.problem
    if isinstance(reference, str):
        row = list(problem.cameras).index(reference)
        R, origin = state.R_camera[row], state.centre[row]
    else:
        row = problem.keys.index(reference)
        if row not in fit.used.pose:
            raise InputError(
                f"the reference, target '{reference[0]}' at moment {reference[1]}, contradicts the rest",
                remedy="Take another reference, or take its pictures again.",
            )
        R, origin = state.R_pose[row].T, target_origin(problem, state, row)
    moved = State(
        state.R_camera @ R.T,
        (state.centre - origin) @ R.T,
        state.lens,
        R @ state.R_pose,
        (state.position - origin) @ R.T,
        state.scale,
    )
    return replace(fit, adjusted=replace(fit.adjusted, state=moved))


def target_origin(problem: Problem, state: State, row: int) -> Array:
    """(3,) where the origin of the target's own frame lies, for pose ``row``."""
    names = list(problem.shapes)
    name = problem.keys[row][0]
    return state.position[row] - state.scale[names.index(name)] * state.R_pose[row] @ problem.shapes[name].centroid
