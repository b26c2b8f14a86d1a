"""Detects cameras whose silhouettes contradict all others, excludes them from carving, and reinstates them.

Every camera can veto a voxel, so one that is covered, moved or frozen cuts the body for all. A few times a second all
silhouettes are compared on a coarse grid (:mod:`.silhouette_residuals`). Residuals beyond an allowance are summed up
for each camera (CUSUM: Page, "Continuous inspection schemes", Biometrika 1954): large faults are found at once, small
ones when they last. An excluded camera is still compared.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from capture_rig import Rig
from capture_rig.stamps import StampThrottle
from capture_rig.visibility import CELL_M

from ..settings import PERSON_LITRES, CameraFaultSettings
from ..views import Masks, RigViews
from . import EARLY
from .occluders import OccluderMap
from .silhouette_residuals import CameraResiduals, ResidualEstimator, Residuals

# Thresholds: chosen with python bench/camera_faults.py (figures of sound cameras); three voters: of two that
# contradict each other either may be right.
PERIOD_S = 0.1  # between comparisons
ENOUGH_VOTERS = 5  # each camera less makes the hull of the others looser, and doubles the allowance
FEWEST_VOTERS = 3  # cameras that must remain: of two that contradict each other, either may be right

# allowances, as shares: 0 to 1
VETO_ALLOWANCE = 0.025  # of the body, as the others show it
EXCESS_ALLOWANCE = 0.15  # of a camera's view, and of all foreground, that no other camera, or no hull, confirms
NEXT_WORST = 1.5  # a faulty camera's residual is at least this many times that of the next worst

# how fast
SATURATION = 0.1  # residual beyond the allowance at which the sum grows by one second a second
DETECTION_S = 3 * PERIOD_S  # sum at which a camera is faulty: three comparisons, where the fault is large


@dataclass(frozen=True)
class CameraFaults:
    """The cameras that contradict the others. Shares are 0 to 1, running means over some seconds.

    updated : whether this frame set was compared; if not, everything else is as before.
    left_out : cameras to carve without. suspects : cameras that would be left out if enough others remained.
    reasons : a message with the remedy for each of both.
    means : residuals of each camera; see :class:`.silhouette_residuals.CameraResiduals`.
    warning : set when the remaining cameras contradict each other and none can be blamed; empty otherwise.
    """

    left_out: tuple[str, ...] = ()
    suspects: tuple[str, ...] = ()
    reasons: Mapping[str, str] = field(default_factory=dict)
    means: Mapping[str, CameraResiduals] = field(default_factory=dict)
    warning: str = ""
    updated: bool = False


class CameraFaultDetector:
    """Detects the faulty cameras of one rig. One thread at a time."""

    def __init__(self, rig: Rig, views: RigViews, settings: CameraFaultSettings, min_seeing: int = 0) -> None:
        """``min_seeing`` is the hull's setting of that name."""
        self.settings, self.names, self._views = settings, views.names, views
        self._estimator = ResidualEstimator(rig, views, CELL_M, min_seeing)
        self.occluders = OccluderMap(views, self._estimator)
        self._throttle = StampThrottle(PERIOD_S, early_share=EARLY)
        self._fewest = max(FEWEST_VOTERS, min_seeing)
        self._records = [_CameraRecord() for _ in views.names]
        self._conflict = 0.0
        self._faults = CameraFaults(means=dict.fromkeys(views.names, CameraResiduals()))

    def update(self, masks: Masks, stamp_ns: int) -> CameraFaults:
        """Compare one frame set's canvas masks (h, w) uint8, nonzero = foreground, once a period.

        A frame set without a person, or with too few cameras, changes nothing. Raises InputError for an unknown camera
        or a mask of the wrong size.
        """
        step_s = self._throttle.step_s(stamp_ns) if self.settings.enabled else 0.0
        self._faults = replace(self._faults, updated=False)
        if step_s <= 0.0:
            return self._faults
        present = self._views.present(masks).tolist()
        for camera in present:
            self._estimator.set_mask(camera, masks[self.names[camera]])
        # blank and excluded cameras are compared, but cannot veto
        voters = tuple(c for c in present if self._estimator.shows(c) and not self._records[c].left_out)
        residuals = self._estimator.estimate(voters, tuple(c for c in present if c not in voters))
        if residuals is None:
            return self._faults
        self.occluders.learn(residuals, step_s)
        shows_body = residuals.body_litres >= PERSON_LITRES
        if not shows_body.any():  # there is no body to compare by
            return self._faults
        for slot in np.flatnonzero(shows_body):
            self._test_camera(residuals, int(slot), step_s)
        self._conflict += self._gain(step_s) * (residuals.unexplained - self._conflict)
        self._faults = self._decide(present)
        return self._faults

    def _test_camera(self, residuals: Residuals, slot: int, step_s: float) -> None:
        """Compare one camera's residuals with the allowances, and with the next worst camera's."""
        record, mine = self._records[residuals.cameras[slot]], residuals.own[slot]
        others = (one for other, one in enumerate(residuals.own[: residuals.voters]) if other != slot)
        next_veto = max((one.veto_fraction for one in others), default=0.0)
        lenience = 2.0 ** max(ENOUGH_VOTERS - residuals.voters, 0)
        record.mean = record.mean.moved(mine, self._gain(step_s))
        if not record.left_out:
            ratio = NEXT_WORST + lenience - 1.0
            fault = max(
                mine.veto_fraction - max(lenience * VETO_ALLOWANCE, ratio * next_veto), mine.excess - EXCESS_ALLOWANCE
            )
            record.add_fault(mine, fault / SATURATION, step_s)
            return
        agrees = mine.veto_fraction <= max(lenience * VETO_ALLOWANCE, next_veto) and mine.excess <= EXCESS_ALLOWANCE / 2
        if not agrees or mine.coverage > 0.0:  # disagreement counts twice, an empty silhouette not at all
            record.agreed_s = max(record.agreed_s + (step_s if agrees else -2 * step_s), 0.0)

    def _decide(self, present: list[int]) -> CameraFaults:
        """Reinstate cameras that agreed long enough; exclude faulty ones, the worst first, while enough remain."""
        records = self._records
        for record in records:
            if record.left_out and record.agreed_s >= self.settings.reinstate_s:
                record.left_out, record.cusum_s, record.faulty_count = False, 0.0, 0
        used = [camera for camera in present if not records[camera].left_out]
        faulty = [camera for camera in used if records[camera].cusum_s >= DETECTION_S]
        sound = len(used) - len(faulty)
        reasons = {
            name: why for name, why in self._faults.reasons.items() if records[self._views.number[name]].left_out
        }
        means = {camera: records[camera].faulty_mean for camera in faulty}
        for camera in sorted(faulty, key=lambda c: means[c].veto_fraction + means[c].excess, reverse=True):
            name = self.names[camera]
            reasons[name] = _reason(name, means[camera], sound)
            if len(used) > self._fewest:
                used.remove(camera)
                records[camera].left_out, records[camera].agreed_s = True, 0.0
        suspects, warning = tuple(self.names[camera] for camera in faulty if camera in used), ""
        left_out = tuple(name for name, record in zip(self.names, records, strict=True) if record.left_out)
        if not suspects and self._conflict > EXCESS_ALLOWANCE:
            names = ", ".join(name for name in self.names if name not in left_out)
            warning = (
                f"{names} contradict each other: {self._conflict:.0%} of what they show fits no common hull, and it "
                "cannot be told which of them is wrong. Is somebody outside the volume, is a background old, or were "
                "cameras moved since they were calibrated (the tracker says so once it follows somebody)?"
            )
        by_name = {name: record.mean for name, record in zip(self.names, records, strict=True)}
        return CameraFaults(left_out, suspects, reasons, by_name, warning, updated=True)

    def _gain(self, step_s: float) -> float:
        """Return the weight of a new value in a running mean, which is as long as a camera must agree."""
        return 1.0 - float(np.exp(-step_s / self.settings.reinstate_s))


class _CameraRecord:
    """State of one camera.

    cusum_s : sum of its faults, in seconds of a large one. agreed_s : seconds of agreement since it was left out.
    mean : running mean. faulty_mean : mean since the sum was last zero.
    """

    def __init__(self) -> None:
        self.left_out = False
        self.cusum_s, self.agreed_s = 0.0, 0.0
        self.mean = CameraResiduals()
        self.faulty_mean, self.faulty_count = CameraResiduals(), 0

    def add_fault(self, residuals: CameraResiduals, fault: float, step_s: float) -> None:
        """Add ``fault``, limited to -1 ... 1, to the sum, which stays between 0 and DETECTION_S."""
        self.cusum_s = min(max(self.cusum_s + min(max(fault, -1.0), 1.0) * step_s, 0.0), DETECTION_S)
        self.faulty_count = self.faulty_count + 1 if self.cusum_s > 0.0 else 0
        if self.faulty_count:
            self.faulty_mean = self.faulty_mean.moved(residuals, 1.0 / self.faulty_count)


def _reason(name: str, mean: CameraResiduals, sound: int) -> str:
    """Return a camera's fault and remedy in words; ``sound`` is the number of cameras that are not faulty."""
    return (
        f"{name} contradicts the other {sound}: it vetoes {mean.veto_fraction:.0%} of the body that they agree on, and "
        f"{mean.excess:.0%} of its view is foreground that they do not confirm; is its lens covered or something in "
        "front of it, is its background old, has the light changed, was it moved, or are its images frozen?"
    )
