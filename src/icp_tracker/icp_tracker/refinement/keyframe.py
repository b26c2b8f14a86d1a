"""One kept pose with its rims, and what it says about the body's shape whatever the pose was exactly."""

from __future__ import annotations

import numpy as np

from stick_figure import kernels
from stick_figure.pose import Pose

from ..articulated_solver import PriorSettings
from ..figure_arrays import State
from ..gauss_newton import Rims
from ..normal_equations import TANGENT, mirror_upper
from ..soft_constraints import add_joint_limits, add_neck_rest
from .rim_system import rim_system
from .settings import RefinementSettings
from .shape import UNKNOWNS, ShapeModel

LARGEST_STEP = 0.3  # m, rad


class Keyframe:
    """Pose and shape share the rims: the pose is eliminated, and follows when the shape changes.

    ``information`` (UNKNOWNS, UNKNOWNS) and ``target`` (UNKNOWNS,) are its part of normal equations for the shape's
    values themselves: (sum of information) values = sum of target. Zero until the first :meth:`look`, and while the
    flesh explains too few of its rays.
    """

    def __init__(self, pose: Pose, rims: Rims, settings: RefinementSettings, prior: PriorSettings) -> None:
        self.pose, self.rims = pose, _worth(rims, settings)
        self.explained = 0.0
        self._settings, self._prior = settings, prior
        self._values: np.ndarray | None = None
        self._through = np.empty((TANGENT, UNKNOWNS + 1))
        self._forget()

    def _forget(self) -> None:
        self.information, self.target = np.zeros((UNKNOWNS, UNKNOWNS)), np.zeros(UNKNOWNS)

    def look(self, model: ShapeModel, values: np.ndarray) -> None:
        """Move the pose to where it suits a shape's ``values`` (UNKNOWNS,), and linearise there."""
        state, n = State.of(self.pose), TANGENT + UNKNOWNS
        if self._values is not None:  # the pose follows the shape, by the last linearisation
            step = self._through @ np.concatenate([self._values - values, [1.0]])
            kernels.retract(*state, step, min(1.0, LARGEST_STEP / max(float(np.abs(step).max()), LARGEST_STEP)))
            self.pose = state.pose()
        H, g = np.empty((n, n)), np.empty(n)
        robust = (self._settings.gate_m, self._settings.slack_m, self._settings.explained_m)
        self.explained = float(rim_system(self.rims, *state, *model.at(values), model.derivatives, robust, H, g))
        pose, shape = slice(0, TANGENT), slice(TANGENT, n)
        own, pull = self._with_prior(state, H, g)
        self._through, self._values = np.linalg.solve(own, np.column_stack([H[pose, shape], pull])), values
        if self.explained < self._settings.explained:
            self._forget()
            return
        # the pose is eliminated: Schur complement
        self.information = H[shape, shape] - H[shape, pose] @ self._through[:, :-1]
        self.target = g[shape] - H[shape, pose] @ self._through[:, -1] + self.information @ values

    def _with_prior(self, state: State, H: np.ndarray, g: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The pose's normal equations with what holds it where rims do not: scatter, the neck's rest, limits."""
        own, pull = np.zeros((TANGENT, TANGENT)), g[:TANGENT].copy()
        if self._prior.neck_sd > 0.0:
            add_neck_rest(state.RJ[0], self._prior.neck_pitch, self._prior.neck_sd**-2, own, pull)
        if self._prior.limit_sd > 0.0:
            add_joint_limits(state.RJ, state.hinges, self._prior.limit_sd**-2, own, pull)
        mirror_upper(own)
        return own + H[:TANGENT, :TANGENT] + np.diag(self._prior.information()), pull

    def differs(self, pose: Pose, turn: float) -> bool:
        """Whether some joint (not the torso) is turned by more than ``turn`` (rad) against this pose."""
        return bool(np.abs(pose.minus(self.pose)[6:]).max() > turn)


def _worth(rims: Rims, settings: RefinementSettings) -> Rims:
    """At most so many rays, evenly spread, together worth the independent ones."""
    count = len(rims.information)
    rows = np.arange(count) if count <= settings.rays else np.arange(settings.rays) * count // settings.rays
    information = np.full(len(rows), settings.independent_rays / settings.flesh_sd_m**2 / max(len(rows), 1))
    points, directions, normals, tangents = (np.ascontiguousarray(part[:, rows]) for part in rims[:4])
    half_lengths = np.ascontiguousarray(rims.half_lengths[rows])
    return Rims(points, directions, normals, tangents, half_lengths, information)
