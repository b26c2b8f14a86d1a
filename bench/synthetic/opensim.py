"""The stick figure as an OpenSim model, and its inverse kinematics solver (``pip install opensim``)."""

from __future__ import annotations

from itertools import count

import numpy as np
import opensim as osim

from stick_figure.body import Body
from stick_figure.skeleton import PARENT

from .clips import FPS, Clip
from .solvers import POINT_ENDS, Solver, along_stick, local_ends

ACCURACY = 1e-4
ZERO = (0.0, 0.0, 0.0)
PIN_ABOUT_Y = (-np.pi / 2, 0.0, 0.0)
"""A pin turns about its z axis: turned frames make that the knee's y."""


def inverse_kinematics(clip: Clip, points: list[np.ndarray]) -> Solver:
    """OpenSim's InverseKinematicsSolver on 15 labelled points. It wants all frames (15, 3) m beforehand, as a table."""
    return _Follower(clip.body, points)


class _Follower:
    """OpenSim's solver and all that it points at: it keeps nothing alive itself."""

    def __init__(self, body: Body, points: list[np.ndarray]) -> None:
        osim.Logger.setLevelString("Error")
        self._model, self._weights = _model(body), osim.SetMarkerWeights()
        for i in range(15):
            self._weights.cloneAndAppend(osim.MarkerWeight(f"p{i}", 1.0))
        self._state = self._model.initSystem()
        self._markers = osim.MarkersReference(_table(points), self._weights)
        self._coordinates = osim.SimTKArrayCoordinateReference()
        self._solver = osim.InverseKinematicsSolver(self._model, self._markers, self._coordinates, float("inf"))
        self._solver.setAccuracy(ACCURACY)
        self._state.setTime(0.0)
        self._solver.assemble(self._state)
        self._placed = [self._model.getMarkerSet().get(i) for i in range(15)]
        self._frames = count()

    def __call__(self, _: np.ndarray) -> np.ndarray:
        """The next frame's points (15, 3), m."""
        self._state.setTime(next(self._frames) / FPS)
        self._solver.track(self._state)
        self._model.realizePosition(self._state)
        return np.array([[marker.getLocationInGround(self._state)[k] for k in range(3)] for marker in self._placed])


def _model(body: Body) -> osim.Model:
    model, parts = osim.Model(), []
    for stick in range(10):
        parts.append(osim.Body(f"stick{stick}", 1.0, _vector(ZERO), osim.Inertia(0.1, 0.1, 0.1)))
        model.addBody(parts[-1])
    origins = body.stick_origins_torso
    model.addJoint(osim.FreeJoint("torso", model.getGround(), *_here(ZERO), parts[0], *_here(ZERO)))
    model.addJoint(osim.UniversalJoint("neck", parts[0], *_here(origins[1]), parts[1], *_here(ZERO)))
    for stick in (2, 3, 4, 5):
        model.addJoint(osim.BallJoint(f"ball{stick}", parts[0], *_here(origins[stick]), parts[stick], *_here(ZERO)))
    for stick in (6, 7, 8, 9):
        parent, turned = int(PARENT[stick]), ZERO if stick < 8 else PIN_ABOUT_Y
        at = along_stick(parent, body.lengths[parent])
        model.addJoint(
            osim.PinJoint(
                f"pin{stick}", parts[parent], _vector(at), _vector(turned), parts[stick], _vector(ZERO), _vector(turned)
            )
        )
    for i, (stick, end) in enumerate(POINT_ENDS):
        model.addMarker(osim.Marker(f"p{i}", parts[stick], _vector(local_ends(body, stick)[end])))
    model.finalizeConnections()
    return model


def _here(at: np.ndarray | tuple[float, float, float]) -> tuple[osim.Vec3, osim.Vec3]:
    return _vector(at), _vector(ZERO)


def _vector(v: np.ndarray | tuple[float, float, float]) -> osim.Vec3:
    return osim.Vec3(float(v[0]), float(v[1]), float(v[2]))


def _table(points: list[np.ndarray]) -> osim.TimeSeriesTableVec3:
    table, labels = osim.TimeSeriesTableVec3(), osim.StdVectorString()
    for i in range(15):
        labels.append(f"p{i}")
    table.setColumnLabels(labels)
    for frame, z in enumerate(points):
        row = osim.RowVectorVec3(15)
        for i in range(15):
            row[i] = _vector(z[i])
        table.appendRow(frame / FPS, row)
    return table
