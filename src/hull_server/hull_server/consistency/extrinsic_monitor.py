"""Does every camera still stand where its calibration says? Asked of the silhouettes, all the time.

Long before a camera that was bumped does so much harm that it is left out, the planes that touch the body tell that it
stands badly, and by how many degrees: within seconds when it is much, within minutes when it is little.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt
from numba import njit

from capture_rig import Rig

from ..settings import CalibrationSettings
from ..views import Masks, RigViews
from .epipolar_tangents import AXES, Array, EpipolarTangentFinder, Tangents

# --- Which camera does not stand where its calibration says, as the tangents of many frame sets tell.
#
# A difference between two cameras may be either's fault. With many cameras, and a person who moves, all differences of a
# camera that was turned by three angles fit these angles. So the angles of all cameras are found together, by least
# squares that lets go of outliers (shadows, hidden or missing parts), most cameras being expected to stand well. Then it
# is asked of each camera alone how much better the differences are explained if it, and no other, stands badly (model
# evidence: MacKay, "Bayesian interpolation", Neural Computation 1992), and better than by a silhouette that is too large
# or too small all around.

USUAL_RAD, WRONG_RAD = np.radians(0.12), np.radians(1.5)  # angles of calibrations that are sound, and that are not
USUAL_PX, LARGE_PX = 2.0, 10.0  # silhouettes are larger or smaller by so much; and by so much at worst
ALIKE_S = 0.5  # what is wrong with a silhouette lasts about so long: frame sets that follow sooner tell the same
LEAST_NOISE_PX, MOST_NOISE_PX = 0.5, 4.0
LETS_GO = 3.0  # standard deviations
GENTLE_ROUNDS, ROUNDS = 3, 8  # of reweighting: at first outliers are only played down, so that the rest can be found


@dataclass(frozen=True, eq=False)
class ExtrinsicError:
    """What is known of one camera: how it stands, seen from where its calibration says it stands.

    turn_rad (3,) : rotation vector in the camera's frame (x right, y down, z forward), radians, if it alone is wrong;
    a push aside shows as the turn that does the same to the pictures of the body. sd_rad : standard deviation of the
    size of the turn. gain : how much better that explains all differences than nothing does (twice the logarithm of the
    ratio of probabilities), and gain_growth : how much better a silhouette too large or too small does. fitting : share
    of the camera's differences that fit. count : how many there are.
    """

    turn_rad: Array
    sd_rad: float
    gain: float
    gain_growth: float
    fitting: float
    count: int

    @property
    def size_rad(self) -> float:
        return float(np.linalg.norm(self.turn_rad))


def estimate_extrinsic_errors(tangents: Sequence[Tangents], cameras: int, step_s: float) -> list[ExtrinsicError]:
    """How each of the ``cameras`` of a rig stands, by the tangents of frame sets that are ``step_s`` apart."""
    first, second, y, one, other = (np.concatenate(parts) for parts in list(zip(*tangents, strict=True))[:5])
    J = np.hstack([one, other])
    x, weight, noise_px = _fit(first, second, J, y, cameras, min(1.0, step_s / ALIKE_S))
    A, c = _normal_equations(first, second, J, y, weight, cameras)
    scale = min(1.0, step_s / ALIKE_S) / noise_px**2
    A, c = A * scale, c * scale
    nobody, _, _ = _evidence(A, c, _prior(cameras))
    standings = []
    for camera in range(cameras):
        turned, x, covariance = _evidence(A, c, _prior(cameras, wrong=camera))
        grown, _, _ = _evidence(A, c, _prior(cameras, large=camera))
        own = slice(AXES * camera, AXES * camera + 3)
        turn, mine = x[own], (first == camera) | (second == camera)
        along = turn / max(float(np.linalg.norm(turn)), 1e-12)
        fits = np.abs(_residuals(first[mine], second[mine], J[mine], y[mine], x)) < LETS_GO * noise_px
        standings.append(
            ExtrinsicError(
                turn_rad=turn,
                sd_rad=float(np.sqrt(along @ covariance[own, own] @ along)),
                gain=turned - nobody,
                gain_growth=grown - nobody,
                fitting=float(fits.mean()) if fits.size else 0.0,
                count=int(mine.sum()),
            )
        )
    return standings


def _fit(first, second, J, y, cameras, share):  # type: ignore[no-untyped-def]
    """All cameras' unknowns (4 n,), the weight of each difference, and their noise, pixels.

    A camera that stands badly is allowed to: its prior widens with what is found (Tipping, "Sparse Bayesian learning",
    JMLR 2001).
    """
    x, prior = np.zeros(AXES * cameras), _prior(cameras)
    weight, noise_px = np.ones(len(y)), LEAST_NOISE_PX
    for round_ in range(ROUNDS):
        residual = np.abs(_residuals(first, second, J, y, x))
        noise_px = float(np.clip(np.median(residual) / 0.6745, LEAST_NOISE_PX, MOST_NOISE_PX)) if len(y) else 1.0
        u = residual / (LETS_GO * noise_px)
        weight = 1 / (1 + u) ** 2 if round_ < GENTLE_ROUNDS else 1 / (1 + u * u) ** 2
        A, c = _normal_equations(first, second, J, y, weight, cameras)
        x = np.linalg.solve(A * share / noise_px**2 + np.diag(prior), c * share / noise_px**2)
        sizes = (x.reshape(cameras, AXES)[:, :3] ** 2).sum(1)
        prior.reshape(cameras, AXES)[:, :3] = (1 / (USUAL_RAD**2 + sizes))[:, None]
    return x, weight, noise_px


def _prior(cameras: int, wrong: int | None = None, large: int | None = None) -> Array:
    """(4 n,) precisions: sound calibrations and silhouettes, but for one camera's."""
    prior = np.tile([1 / USUAL_RAD**2] * 3 + [1 / USUAL_PX**2], cameras)
    if wrong is not None:
        prior[AXES * wrong : AXES * wrong + 3] = 1 / WRONG_RAD**2
    if large is not None:
        prior[AXES * large + 3] = 1 / LARGE_PX**2
    return prior


def _evidence(A: Array, c: Array, prior: Array) -> tuple[float, Array, Array]:
    """Twice the logarithm of the probability of the differences (but for what is the same for every prior), the most
    probable unknowns, and their covariance."""
    precision = A + np.diag(prior)
    covariance = np.asarray(np.linalg.inv(precision), np.float64)
    x = covariance @ c
    return float(c @ x - np.linalg.slogdet(precision)[1] + np.log(prior).sum()), x, covariance


@njit(cache=True, nogil=True)
def _normal_equations(first, second, J, y, weight, cameras):  # type: ignore[no-untyped-def]
    """The sums J^T W J (4 n, 4 n) and J^T W y (4 n,); each row of J (m, 8) belongs to two cameras."""
    A, c, place = np.zeros((AXES * cameras, AXES * cameras)), np.zeros(AXES * cameras), np.empty(2 * AXES, np.int64)
    for row in range(y.size):
        for k in range(AXES):
            place[k], place[AXES + k] = AXES * first[row] + k, AXES * second[row] + k
        for k in range(2 * AXES):
            c[place[k]] += weight[row] * J[row, k] * y[row]
            for m in range(2 * AXES):
                A[place[k], place[m]] += weight[row] * J[row, k] * J[row, m]
    return A, c


@njit(cache=True, nogil=True)
def _residuals(first, second, J, y, x):  # type: ignore[no-untyped-def]
    """(m,) differences that the unknowns x leave."""
    left: npt.NDArray[np.float64] = y.copy()
    for row in range(y.size):
        for k in range(AXES):
            left[row] -= J[row, k] * x[AXES * first[row] + k] + J[row, AXES + k] * x[AXES * second[row] + k]
    return left


SLOW_EVERY = 10  # of so many looks one is remembered for long
SLOW_LOOKS = 60
ASKED_EVERY = 3  # looks
FEWEST_CAMERAS = 3
FEWEST = 12  # differences of a camera; fewer tell nothing
SIGMAS = 3.0
SYSTEMATIC_RAD = np.radians(0.08)  # of every angle: lenses, and silhouettes that err in one direction for long
CONFIRMED = 4  # times in a row before a camera is named; once is enough ...
NEWS_RAD = np.radians(0.5)  # when the body's outline has moved by less, its silhouettes err as they did before
GROSS = 4.0  # ... when it is off by so many times what is allowed
ENOUGH_CAMERAS = 5  # each one less makes it harder to tell whose fault a difference is: twice as much is allowed
FITTING = 0.5  # share of the camera's differences that its turn must explain
CLEARER = 3.0  # its evidence is above that of every other explanation by so much
EARLY = 0.1  # share of the period by which a frame set may come early: stamps jitter
NS = 1e-9


@dataclass(frozen=True, eq=False)
class ExtrinsicErrors:
    """How well the cameras stand. Angles in radians, by camera; of cameras that were measured only.

    rotation_error_rad : by how much each camera is turned from where its calibration says it stands, if it alone is; sd_rad : the
    standard deviation of that; roll_rad : the part about its optical axis. suspects : cameras that certainly stand
    badly, and why, in words a user can act on.
    """

    rotation_error_rad: Mapping[str, float] = field(default_factory=dict)
    sd_rad: Mapping[str, float] = field(default_factory=dict)
    roll_rad: Mapping[str, float] = field(default_factory=dict)
    suspects: Mapping[str, str] = field(default_factory=dict)


class ExtrinsicMonitor:
    """Watches over the calibration of one rig. Not for two threads at a time. The same sets give the same results."""

    def __init__(self, rig: Rig, views: RigViews, settings: CalibrationSettings | None = None) -> None:
        """Compute what depends on the calibration only."""
        self.settings, self.names = settings or CalibrationSettings(), views.names
        self._finder = EpipolarTangentFinder(rig, views)
        self._recent: deque[Tangents] = deque(maxlen=max(round(self.settings.memory_s / self.settings.period_s), 1))
        self._lasting: deque[Tangents] = deque(maxlen=SLOW_LOOKS)
        self._looks, self._last_ns = 0, -1
        self._known: list[ExtrinsicError] = []  # by the lasting evidence
        self._in_a_row = [0] * len(views.names)
        self.calibration = ExtrinsicErrors()

    def update(self, masks: Masks, stamp_ns: int) -> ExtrinsicErrors:
        """Take one frame set's canvas masks (h, w) uint8, levels of ``capture_rig.mask_levels``, if it is time to.

        Sets in which nobody is seen change nothing.
        """
        if not self.settings.enabled or len(self.names) < FEWEST_CAMERAS or not self._is_time(stamp_ns):
            return self.calibration
        tangents = self._finder.find(masks)
        if tangents.first.size and self._is_news(tangents):
            self._recent.append(tangents)
            if self._looks % SLOW_EVERY == 0:
                self._lasting.append(tangents)
                self._known = estimate_extrinsic_errors(
                    self._lasting, len(self.names), SLOW_EVERY * self.settings.period_s
                )
            self._looks += 1
            if self._looks % ASKED_EVERY == 0:
                self.calibration = self._ask()
        return self.calibration

    def _is_time(self, stamp_ns: int) -> bool:
        if 0 <= self._last_ns <= stamp_ns < self._last_ns + (1 - EARLY) * self.settings.period_s / NS:
            return False
        self._last_ns = stamp_ns
        return True

    def _is_news(self, tangents: Tangents) -> bool:
        """Whether the body has moved since the last set that was taken: one that stands still tells the same again."""
        if not self._recent:
            return True
        moved_rad = np.abs(tangents.angles - self._recent[-1].angles)
        known = np.isfinite(moved_rad)
        return not known.any() or float(np.median(moved_rad[known])) > NEWS_RAD

    def _ask(self) -> ExtrinsicErrors:
        """Weigh the recent and the lasting evidence of every camera."""
        recent = estimate_extrinsic_errors(self._recent, len(self.names), self.settings.period_s)
        present = sum(standing.count >= FEWEST for standing in recent)
        lenience = 2.0 ** max(ENOUGH_CAMERAS - present, 0)
        allowed_rad = np.radians(self.settings.limit_deg) * lenience
        standings: dict[str, ExtrinsicError] = {}
        suspects: dict[str, str] = {}
        for camera, name in enumerate(self.names):
            if max(recent[camera].count, self._known[camera].count) < FEWEST:
                continue
            excess_rad, standings[name] = self._worst(recent, camera, allowed_rad, CLEARER * lenience)
            self._in_a_row[camera] = self._in_a_row[camera] + 1 if excess_rad > allowed_rad else 0
            if self._in_a_row[camera] >= CONFIRMED or excess_rad > GROSS * allowed_rad:
                suspects[name] = self._reason(name, standings[name])
        return ExtrinsicErrors(
            rotation_error_rad={name: standing.size_rad for name, standing in standings.items()},
            sd_rad={name: standing.sd_rad for name, standing in standings.items()},
            roll_rad={name: float(standing.turn_rad[2]) for name, standing in standings.items()},
            suspects=suspects,
        )

    def _worst(
        self, recent: list[ExtrinsicError], camera: int, allowed_rad: float, clearer: float
    ) -> tuple[float, ExtrinsicError]:
        """By how much a camera certainly stands badly, and how; how it stands as far as known, when it does not."""
        now, known = recent[camera], self._known[camera]
        excess_rad, excess_known_rad = _excess_rad(recent, camera, clearer), _excess_rad(self._known, camera, clearer)
        if excess_rad > allowed_rad:
            return excess_rad, now
        stands_well_now = now.size_rad + 2 * now.sd_rad < allowed_rad
        if excess_known_rad > allowed_rad and not stands_well_now:
            return excess_known_rad, known
        return 0.0, min((now, known), key=lambda standing: standing.sd_rad)

    def _reason(self, name: str, standing: ExtrinsicError) -> str:
        aside, about = np.degrees(np.hypot(*standing.turn_rad[:2])), np.degrees(abs(standing.turn_rad[2]))
        size = np.degrees(standing.size_rad)
        return (
            f"{name} stands {size:.1f} degrees from where its calibration says ({aside:.1f} aside, {about:.1f} "
            f"about its axis), as the other {len(self.names) - 1} show: was it moved? Put it back, or calibrate it "
            "again"
        )


def _excess_rad(standings: list[ExtrinsicError], camera: int, clearer: float) -> float:
    """By how much the camera certainly stands badly; 0 unless no other explanation is nearly as good."""
    mine = standings[camera]
    rivals = [mine.gain_growth, *(s.gain for other, s in enumerate(standings) if other != camera)]
    if mine.count < FEWEST or mine.fitting < FITTING or mine.gain - max(rivals) < clearer:
        return 0.0
    return mine.size_rad - SIGMAS * float(np.hypot(mine.sd_rad, SYSTEMATIC_RAD))
