"""The state of the solver between its steps."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..boards.sighting import Sighting
from .adjustment import Adjusted, Prior, fixed_camera
from .initial_poses import InitialPoses, numbered_right
from .normal_equations import Bools, Free
from .observations import Ints, Layout, Observations, State, lens_of, observe
from .outliers import ODD_ONE, LeftOut
from .problem import Problem
from .projection import residuals_px
from .rigid import Array, inverse
from .target_shape import LINE
from .view import View

NO_POSE = "its corners are too few to tell where the target was, or fit no pose of it"


@dataclass(frozen=True, eq=False)
class Fit:
    """The state of the solver: all sightings, which of them still take part (``rows``), and the adjusted state.

    ``seen`` holds the observations of all sightings; ``free_scales`` (k,) which targets' sizes are unknown;
    ``emphasis`` (s,) by what the weights of each sighting's corners are multiplied; ``displacement`` (s,), m, how far
    (sd) the target may have been elsewhere for each sighting; ``prior`` of the lenses, where these are refined.
    """

    problem: Problem
    all_sightings: tuple[Sighting, ...]
    seen: Observations
    rows: Ints
    adjusted: Adjusted
    root: int
    free_scales: Bools
    left_out: tuple[LeftOut, ...]
    scale_of: dict[str, tuple[float, float]]
    emphasis: Array
    displacement: Array
    prior: Prior | None = None

    @property
    def sightings(self) -> tuple[Sighting, ...]:
        """Those that take part."""
        return tuple(self.all_sightings[row] for row in self.rows)

    @property
    def used(self) -> Observations:
        return self.seen.only(self.rows).weighted(self.emphasis[self.rows, None])

    @property
    def layout(self) -> Layout:
        return Layout(len(self.problem.cameras), len(self.problem.shapes), self.prior is not None)

    @property
    def reasons(self) -> dict[str, str]:
        """By camera, the commonest reason why sightings of it were left out."""
        by_camera: dict[str, list[str]] = {}
        for out in self.left_out:
            by_camera.setdefault(out.sighting.camera, []).append(out.reason)
        return {name: max(sorted(set(reasons)), key=reasons.count) for name, reasons in by_camera.items()}

    def free(self, layout: Layout) -> Free:
        """What moves while the root camera holds the frame."""
        free = fixed_camera(layout, len(self.adjusted.state.position), self.root, self.free_scales, self._free_lenses())
        return Free(free.shared, np.isin(np.arange(len(free.poses)), self.seen.pose[self.rows]))

    def _free_lenses(self) -> Bools | None:
        if self.prior is None:
            return None
        return np.array([np.diag(self.problem.lens_covariance[name]) > 0 for name in self.problem.cameras])


def start_fit(problem: Problem, views: Sequence[View], initial: InitialPoses) -> Fit:
    """The first state; sightings whose target has no pose yet, or lies behind their camera, are left out."""
    keys, names = problem.keys, list(problem.cameras)
    sightings = tuple(numbered_right(view, turn) for view, turn in zip(views, initial.turns, strict=True))
    seen = observe(sightings, names, keys, problem.shapes)
    state = _first_state(problem, initial)
    placed = np.array([key in initial.T_root_target for key in keys])[seen.pose]
    in_front = (np.isfinite(residuals_px(state, seen)).all(axis=2) | (seen.weight == 0)).all(axis=1)
    keep = placed & in_front
    on_a_line = np.array([view.shape.dimension == LINE for view in views], bool)  # one view of a wand is no mishap
    left_out = tuple(
        LeftOut(sightings[i], ODD_ONE if placed[i] else NO_POSE) for i in np.flatnonzero(~keep & (placed | ~on_a_line))
    )
    nothing = np.zeros(len(problem.shapes), bool)
    return Fit(
        problem,
        sightings,
        seen,
        np.flatnonzero(keep),
        Adjusted(state, 1.0, 0),
        names.index(initial.root),
        nothing,
        left_out,
        {},
        np.ones(len(sightings)),
        np.zeros(len(sightings)),
    )


def lens_covariances(fit: Fit) -> dict[int, Array]:
    """By row of the camera, the covariance of its lens where that is known and the lens was not refined."""
    if fit.prior is not None:
        return {}
    known = fit.problem.lens_covariance
    return {row: known[name] for row, name in enumerate(fit.problem.cameras) if name in known}


def _first_state(problem: Problem, initial: InitialPoses) -> State:
    T_root_camera = inverse(np.array([initial.T_camera_root[name] for name in problem.cameras]))
    T = np.array([initial.T_root_target.get(key, np.eye(4)) for key in problem.keys])
    return State(
        np.swapaxes(T_root_camera[:, :3, :3], 1, 2),
        T_root_camera[:, :3, 3],
        np.array([lens_of(camera) for camera in problem.cameras.values()]),
        T[:, :3, :3],
        T[:, :3, 3],
        np.ones(len(problem.shapes)),
    )
