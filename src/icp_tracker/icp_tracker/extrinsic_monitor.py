"""Monitors each camera's extrinsic calibration by the contour rays of tracked bodies.

A contour ray touches the body, so its residual distance from the fitted surface is zero on average, whatever the pose,
the clothes and the clutter behind. If it is not, in one camera, and varies with the body's place, that camera has moved
from its calibration: a small motion of the camera moves every ray by a known amount, and six numbers explain all of
them. They are solved for by least squares, weighted as in the fit, together with a uniform growth of the silhouette;
twice, from the odd and from the even seconds. The scalar product of the two solutions' shifts of the rays has no bias
from noise (cross-validation: Stone, "Cross-validatory choice", JRSS B 1974). Errors of the surface leave 1 to 6 mm, a
camera that was turned by a degree 10 mm and more.

Unlike the epipolar tangents of whole silhouettes (Sinha, Pollefeys and McMillan 2004) this works with cut silhouettes
and with several persons.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from capture_rig.rig import Rig
from capture_rig.settings import setting
from capture_rig.small_matrices import robust_weight
from capture_rig.stamps import NS_PER_S
from mocap_packets.hull import ContourRays
from stick_figure.least_squares.contour_factor import SURFACE_GATE_M, RayMatch
from stick_figure.least_squares.effective_information import SURFACE_SD_M

from .refinement.bend_estimator import RAYS_OF_A_DATUM

Array = npt.NDArray[np.float64]

# Thresholds: chosen with recordings of rendered people of four makers, two real rooms, and cameras turned by 0.5 and 1
# degree, pushed by 5 cm (bench/camera_faults.py --moved).
PERIOD_S, LONGEST_S = 0.1, 0.5  # between measured sets; largest interval that one set counts for
MEMORY_S = 20.0  # time constant of the sums
BLOCK_S = 1.0  # errors of two blocks are independent
LEAST_S = 1.5  # of measurements before a camera is judged
SETTLING_S = 2.0  # of measurements after which noise may reach the limit: the limit is doubled then
MOTION_M = 0.03  # least movement of a body between measured sets: errors of one that holds still repeat
SPREAD_M = 0.25  # least root mean square of the places: in one place the surface errs alike in both halves
ENOUGH_CAMERAS = 5  # of fewer it is not known which one has moved, as the fit yields to each by its share
NEXT_WORST, NEXT_OF_FEW = 0.6, 0.4  # of the largest shift: largest shifts that one camera's error causes in others
MISSING = 1.5  # times the limit while a camera is left out: the bodies' sizes may be learnt with its errors
FEWEST_CAMERAS, FEWEST_RAYS = 3, 10  # of a set
CAMERA_SD = np.repeat([np.radians(1.0), 0.1, 0.003], [3, 3, 1])  # prior: rotation rad, translation m, growth rad
CAMERA = 6  # numbers of a camera's motion; the growth of its silhouettes follows


@dataclass(frozen=True)
class CalibrationSettings:
    """When a camera is reported to have moved from its calibration."""

    enabled: bool = setting(True, "compare the tracked bodies' outlines with the calibration all the time")
    limit_m: float = setting(
        0.005, "a camera is reported that shows bodies farther than this beside the others", unit="m", low=0.001
    )


@dataclass(frozen=True, eq=False)
class ExtrinsicErrors:
    """Shift (m, root mean square over its rays) of the bodies in each camera against the others; and for each camera
    that has moved a message with the remedy."""

    shift_m: Mapping[str, float] = field(default_factory=dict)
    suspects: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class ContourResiduals:
    """A fitted body: reference points (15, 3), m, its contour rays (n) and their match; world frame."""

    points_world: Array
    rays: ContourRays
    match: RayMatch


class ExtrinsicMonitor:
    """Monitors the calibration of one rig. The same sets give the same results."""

    def __init__(self, rig: Rig, settings: CalibrationSettings | None = None) -> None:
        self._rig, self._settings = rig, settings or CalibrationSettings()
        self.reset()

    def reset(self) -> None:
        """Forget all measurements."""
        self.errors = ExtrinsicErrors()
        self._halves = [[_Sums() for _ in self._rig.cameras] for _ in range(2)]
        self._places = np.zeros(4)  # count of measured places, sums of x, of y and of their squares
        self._last: dict[int, Array] = {}  # each person's points when last measured
        self._last_ns: int | None = None

    def is_due(self, stamp_ns: int) -> bool:
        """Whether a set of this stamp is to be measured."""
        if not self._settings.enabled or len(self._rig.cameras) < FEWEST_CAMERAS:
            return False
        return self._last_ns is None or not 0 <= stamp_ns - self._last_ns < PERIOD_S * NS_PER_S

    def update(self, stamp_ns: int, bodies: Iterable[tuple[int, ContourResiduals]]) -> ExtrinsicErrors:
        """Add the fitted bodies of one frame set, by person; return the cameras' errors."""
        passed_s = PERIOD_S if self._last_ns is None else (stamp_ns - self._last_ns) / NS_PER_S
        moved = [(person, body) for person, body in bodies if self._has_moved(person, body)]
        self._last_ns = stamp_ns
        if moved:
            block = int(stamp_ns // (BLOCK_S * NS_PER_S)) % 2
            step_s = min(max(passed_s, PERIOD_S), LONGEST_S)
            for half, cameras in enumerate(self._halves):
                for number, sums in enumerate(cameras):
                    sums.decay(step_s)
                    if half == block:
                        sums.add(self._equations(number, [body for _, body in moved]), step_s)
            places = np.array([body.points_world[0, :2] for _, body in moved])
            self._places = self._places * np.exp(-step_s / MEMORY_S)
            self._places += [len(places), *places.sum(axis=0), (places**2).sum()]
            self._last |= {person: body.points_world for person, body in moved}
            count, x, y, squares = self._places
            spread_m2 = squares / count - (x * x + y * y) / count**2
            self.errors = self._estimate() if spread_m2 > SPREAD_M**2 else ExtrinsicErrors()
        return self.errors

    def _has_moved(self, person: int, body: ContourResiduals) -> bool:
        last = self._last.get(person)
        return last is None or float(np.linalg.norm(body.points_world - last, axis=1).mean()) > MOTION_M

    def _equations(self, number: int, bodies: list[ContourResiduals]) -> tuple[Array, Array, Array]:
        """Return the distances (k,) m of one camera's rays outside the surface; their derivatives (k, 7) by a motion of
        the camera (rotation vector and translation, in its frame) and by growth, rad; and weights (k,)."""
        camera, parts = self._rig.cameras[number], []
        for body in bodies:
            own = body.rays.camera == number
            points = (body.rays.points_world[own] - camera.centre_world) @ camera.R_camera_world.T
            normals = body.rays.normals[own] @ camera.R_camera_world.T
            depths = np.linalg.norm(points, axis=1)
            by_motion = np.column_stack([np.cross(points, normals), normals, depths])
            weights = robust_weight.py_func(1.0, (body.match.separation[own] / SURFACE_GATE_M) ** 2)
            parts.append((body.match.distance[own], by_motion, weights))
        y, J, w = (np.concatenate(part) for part in zip(*parts, strict=True))
        return y, J, w

    def _estimate(self) -> ExtrinsicErrors:
        """Return the shifts that both halves agree on, and the suspected cameras."""
        names, shift_m, limits_m = self._rig.names, dict[str, float](), dict[str, float]()
        drawn = 1.0 - 1.0 / len(names)  # share of a shift that remains, as the fit yields to every camera by its share
        for camera, odd, even in zip(names, *self._halves, strict=True):
            seconds = odd.seconds + even.seconds
            if min(odd.seconds, even.seconds) >= 0.25 * LEAST_S and seconds >= LEAST_S:
                M = (odd.of_rays + even.of_rays) / max(odd.rays + even.rays, 1.0)
                shift_m[camera] = float(np.sqrt(max(odd.motion() @ M @ even.motion(), 0.0))) / drawn
                limits_m[camera] = self._settings.limit_m * (1.0 + SETTLING_S / seconds)
        if len(shift_m) < len(names):
            limits_m = {camera: MISSING * limit_m for camera, limit_m in limits_m.items()}
        worst = max(shift_m, key=shift_m.__getitem__, default="")
        if not worst or shift_m[worst] <= limits_m[worst]:
            return ExtrinsicErrors(shift_m)
        if len(names) < ENOUGH_CAMERAS:
            alike = [camera for camera in shift_m if shift_m[camera] >= NEXT_OF_FEW * shift_m[worst]]
            return ExtrinsicErrors(shift_m, dict.fromkeys(alike, _moved_text(", ".join(alike), shift_m[worst])))
        moved = [c for c in shift_m if shift_m[c] > limits_m[c] and shift_m[c] >= NEXT_WORST * shift_m[worst]]
        return ExtrinsicErrors(shift_m, {camera: _moved_text(camera, shift_m[camera]) for camera in moved})


def _moved_text(cameras: str, shift_m: float) -> str:
    return (
        f"{cameras}: people {1e3 * shift_m:.0f} mm beside where other cameras show them. Moved since the calibration? "
        "Put it back, or calibrate again"
    )


class _Sums:
    """The normal equations of one camera: A (7, 7) and b (7,); of_rays (6, 6), sum of J^T J over its rays by a motion;
    the numbers of rays and seconds."""

    def __init__(self) -> None:
        self.A, self.b, self.of_rays = np.zeros((CAMERA + 1,) * 2), np.zeros(CAMERA + 1), np.zeros((CAMERA,) * 2)
        self.rays = self.seconds = 0.0

    def decay(self, step_s: float) -> None:
        kept = float(np.exp(-step_s / MEMORY_S))
        self.A, self.b, self.of_rays = kept * self.A, kept * self.b, kept * self.of_rays
        self.rays, self.seconds = kept * self.rays, kept * self.seconds

    def add(self, equations: tuple[Array, Array, Array], step_s: float) -> None:
        y, J, w = equations
        if len(y) < FEWEST_RAYS or not (np.isfinite(y).all() and np.isfinite(J).all()):
            return
        # sets of one block are correlated: together they count as one set
        information = step_s / BLOCK_S / (RAYS_OF_A_DATUM * SURFACE_SD_M**2)
        self.A = self.A + information * (J * w[:, None]).T @ J
        self.b = self.b + information * (J * w[:, None]).T @ y
        self.of_rays = self.of_rays + J[:, :CAMERA].T @ J[:, :CAMERA]
        self.rays, self.seconds = self.rays + len(y), self.seconds + step_s

    def motion(self) -> Array:
        """Return the camera's most probable motion (6,)."""
        solved = np.linalg.solve(self.A + np.diag(CAMERA_SD**-2), self.b)
        return np.asarray(solved[:CAMERA], np.float64)
