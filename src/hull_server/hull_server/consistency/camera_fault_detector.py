"""The camera that lies: found by what it denies, left out, and taken back when it agrees again.

Every camera of the hull has a veto, so one that is covered, moved or frozen cuts the body for all. The watch hears all
silhouettes on a coarse grid a few times a second, adds up the evidence against each camera (a cumulative sum after
Page, "Continuous inspection schemes", Biometrika 1954: gross lies are found at once, small ones when they last) and
says whom the hull should leave out. A camera that is left out is heard on.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np
import numpy.typing as npt

from capture_rig import Rig

from ..settings import CameraFaultSettings
from ..views import Masks, RigViews
from .silhouette_residuals import Evidence, Hearing, Misfit

# --- What is held against one camera, and what to tell the user about it.


@dataclass(frozen=True)
class Testimony:
    """What one hearing found about one camera: the shares of :class:`~.dissent_evidence.Evidence`."""

    denied: float = 0.0
    excess: float = 0.0
    coverage: float = 0.0
    covered: float = 1.0

    @property
    def consistency(self) -> float:
        """1 where a silhouette and the hull of the others, reprojected, agree: nothing uncovered, nothing denied."""
        return self.covered * (1.0 - self.denied)


class Record:
    """One camera's account.

    guilt_s : evidence against it, as seconds of a gross lie; agreed_s : how long it has agreed since it was left out.
    denied, excess, misfit, silhouette_offset_px, consistency : running means. accused : means over the hearings since the guilt last
    was zero.
    """

    def __init__(self) -> None:
        self.out = False
        self.guilt_s, self.agreed_s, self.still_s = 0.0, 0.0, 0.0
        self.denied, self.excess, self.misfit, self.silhouette_offset_px = 0.0, 0.0, 0.0, np.zeros(2)
        self.consistency = 1.0
        self.accused = Testimony()
        self.latest_push_px = (0.0, 0.0)
        self._misfits = (0.0, 0.0)
        self._hearings, self._fingerprint = 0, 0

    @property
    def latest_misfit(self) -> float:
        return self._misfits[1]

    @property
    def lasting_misfit(self) -> float:
        """What the last two measurements agree on: when one camera lies, others seem to for a moment."""
        return min(self._misfits)

    @property
    def weight(self) -> float:
        """For ordering the guilty."""
        return self.accused.denied + self.accused.excess + self.lasting_misfit

    def look(self, fingerprint: int, step_s: float) -> None:
        """Note whether the silhouette has changed."""
        self.still_s = self.still_s + step_s if fingerprint == self._fingerprint else 0.0
        self._fingerprint = fingerprint

    def measure(self, misfit: Misfit, gain: float) -> None:
        """Take a new measurement of how far the silhouette lies beside the hull."""
        self._misfits, self.latest_push_px = (self._misfits[1], misfit.share), misfit.silhouette_offset_px
        self.misfit += gain * (misfit.share - self.misfit)
        self.silhouette_offset_px = self.silhouette_offset_px + gain * (
            np.array(misfit.silhouette_offset_px) - self.silhouette_offset_px
        )

    def forget_misfit(self) -> None:
        """The hull that it was measured by was wrong."""
        self._misfits = (0.0, 0.0)

    def remember(self, testimony: Testimony, gain: float) -> None:
        """Follow the running means, by ``gain`` of the way."""
        self.denied += gain * (testimony.denied - self.denied)
        self.excess += gain * (testimony.excess - self.excess)
        self.consistency += gain * (testimony.consistency - self.consistency)

    def charge(self, testimony: Testimony, guilt: float, step_s: float, patience_s: float) -> None:
        """Add ``guilt`` (1 is a gross lie, below 0 speaks for the camera); the sum stays between 0 and the patience."""
        self.guilt_s = min(max(self.guilt_s + min(max(guilt, -1.0), 1.0) * step_s, 0.0), patience_s)
        if self.guilt_s == 0.0:
            self._hearings = 0
            return
        self._hearings += 1
        mean, share = self.accused, 1.0 / self._hearings
        self.accused = Testimony(
            mean.denied + share * (testimony.denied - mean.denied),
            mean.excess + share * (testimony.excess - mean.excess),
            mean.coverage + share * (testimony.coverage - mean.coverage),
        )

    def acquit(self, agrees: bool, step_s: float) -> None:
        """Count agreement; disagreement takes back twice as much."""
        self.agreed_s = max(self.agreed_s + (step_s if agrees else -2 * step_s), 0.0)

    def leave_out(self) -> None:
        self.out, self.agreed_s = True, 0.0

    def take_back(self) -> None:
        self.out, self.guilt_s, self._hearings = False, 0.0, 0


# --- Whom the hull should believe, and what to tell the user about the others.

STILL_S = 0.25  # a silhouette that does not change for so long, while the others do, is frozen


@dataclass(frozen=True)
class CameraFaults:
    """Whom to believe. Shares are 0 to 1, running means over the last seconds.

    judged : whether this frame set told anything; if not, everything else is as it was.
    left_out : cameras whose masks the hull should do without. suspects : cameras that would be left out if enough
    others remained. reasons : why, of both, in words a user can act on.
    denied : share of the body, as the others show it, that each camera denies: how far it is from fitting the rig.
    excess : share of each camera's view that is foreground of which the others know nothing.
    misfit : share of each silhouette that would lie inside the hull of the others if it were pushed to where it fits
    best, and silhouette_offset_px : by how many pixels, to the right and down: (0, 0) where the rig's calibration holds.
    consistency : how well each silhouette and the hull of the others, reprojected, agree: 1 when nothing that it shows
    is uncovered, and nothing that they agree on is denied.
    conflict : share of the foreground of all who are believed that their common hull leaves unexplained.
    warning : that they contradict each other when nobody is to blame; empty otherwise.
    """

    left_out: tuple[str, ...] = ()
    suspects: tuple[str, ...] = ()
    reasons: Mapping[str, str] = field(default_factory=dict)
    denied: Mapping[str, float] = field(default_factory=dict)
    excess: Mapping[str, float] = field(default_factory=dict)
    misfit: Mapping[str, float] = field(default_factory=dict)
    silhouette_offset_px: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    consistency: Mapping[str, float] = field(default_factory=dict)
    conflict: float = 0.0
    warning: str = ""
    updated: bool = False


def reason(name: str, record: Record, rest: list[Record], settings: CameraFaultSettings, focal_px: float) -> str:
    """Why a camera is not believed, in words a user can act on. ``rest`` are the cameras that are believed."""
    seen, others = record.accused, f"the other {len(rest)}"
    if seen.excess > settings.excess_limit:
        return (
            f"{name}: {seen.excess:.0%} of its view is foreground that {others} know nothing of: has the light "
            "changed, is its background old, or does something stand before it?"
        )
    if seen.coverage == 0.0:
        return (
            f"{name}: its silhouette is empty where {others} see somebody: is its lens covered, or its exposure wrong?"
        )
    denies = f"{name} denies {seen.denied:.0%} of the body that {others} agree on"
    if record.still_s >= STILL_S and rest and sum(r.still_s == 0.0 for r in rest) > len(rest) / 2:
        return f"{denies}, and its silhouette has not changed for {record.still_s:.1f} s: are its images frozen?"
    if record.lasting_misfit > settings.offset_allowance:
        silhouette_offset_px = float(np.hypot(*record.latest_push_px))
        turned_deg = np.degrees(np.arctan2(silhouette_offset_px, focal_px))
        return (
            f"{denies}, and its silhouette fits better when it is pushed by {silhouette_offset_px:.0f} pixels ({turned_deg:.1f} "
            "degrees): was it moved or turned? Then calibrate it again."
        )
    return f"{denies}: is something before it, or is its background old?"


ENOUGH_WITNESSES = 5  # each one less makes the hull of the others looser: twice as much must be allowed
FEWEST_WITNESSES = 3  # cameras that must remain: of two that contradict each other, either may be right
FLOODED, FLOODED_TIMES = 0.25, 4.0  # share of its view, and times the median, from which foreground is no silhouette
TOLD_BY_M2 = 0.04  # a camera agrees only by showing at least so much of the body: a hand or two
EARLY = 0.1  # share of the period by which a frame set may come early: stamps jitter
NS = 1e-9


class CameraFaultDetector:
    """Watches over the cameras of one rig. Not for two threads at a time."""

    def __init__(self, rig: Rig, views: RigViews, settings: CameraFaultSettings, min_seeing: int = 0) -> None:
        """Compute what depends on the calibration only; ``min_seeing`` is the hull's setting of that name."""
        self.settings, self.names, self._views = settings, views.names, views
        self._hearing = Hearing(rig, views, settings.voxel_size_m, min_seeing)
        self._fewest = max(FEWEST_WITNESSES, min_seeing)
        self._records = [Record() for _ in views.names]
        self._conflict, self._turn, self._hypothesis = 0.0, 0, 0
        self._last_ns: int | None = None
        self._verdict = replace(self._summary((), {}), updated=False)

    def update(self, masks: Masks, stamp_ns: int) -> CameraFaults:
        """Hear one frame set's canvas masks (h, w) uint8, nonzero = foreground, if it is time to.

        A frame set that comes too soon after the last one heard, in which nobody is seen, or which has too few
        cameras to tell, changes nothing. Raises InputError for an unknown camera or a mask of the wrong size.
        """
        step_s = self._step_s(stamp_ns)
        if not self.settings.enabled or step_s <= 0.0:
            return replace(self._verdict, updated=False)
        self._last_ns = stamp_ns
        panel, others = self._seat(masks, step_s)
        evidence = self._hearing.hear(panel, others)
        if evidence is None or not self._weigh(evidence, step_s):
            return replace(self._verdict, updated=False)
        self._verdict = self._decide([camera for camera, name in enumerate(self.names) if name in masks])
        return self._verdict

    def _step_s(self, stamp_ns: int) -> float:
        """Time that a hearing now stands for; 0 when it is too early. After a pause, or when stamps go back, one
        period."""
        period_s = self.settings.period_s
        if self._last_ns is None or stamp_ns < self._last_ns:
            return period_s
        elapsed_s = (stamp_ns - self._last_ns) * NS
        return min(elapsed_s, 2 * period_s) if elapsed_s >= (1 - EARLY) * period_s else 0.0

    def _seat(self, masks: Masks, step_s: float) -> tuple[tuple[int, ...], tuple[int, ...]]:
        """Label all masks; who is on the panel, and who is only heard: those left out and those flooded."""
        present = self._views.present(masks).tolist()
        for camera in present:
            self._records[camera].look(self._hearing.open(camera, masks[self.names[camera]]), step_s)
        coverage = {camera: self._hearing.coverage(camera) for camera in present}
        limit = max(FLOODED, FLOODED_TIMES * float(np.median(list(coverage.values()) or [0.0])))
        panel = tuple(c for c in present if coverage[c] <= limit and not self._records[c].out)
        return panel, tuple(c for c in present if c not in panel)

    def _weigh(self, evidence: Evidence, step_s: float) -> bool:
        """Add up the evidence; False when there is no body to tell by."""
        bodies = evidence.body_litres >= self.settings.min_body_litres
        self._measure_next(evidence, bodies, step_s)
        for slot in np.flatnonzero(bodies):
            self._charge(evidence, int(slot), step_s)
        if bodies.any():
            self._conflict += self._gain(step_s) * (evidence.unexplained - self._conflict)
        torn = evidence.showing >= self._fewest and evidence.conflict.min() > self.settings.conflict_limit
        return bool(torn and self._try_two(evidence, step_s)) or bool(bodies.any())

    def _measure_next(self, evidence: Evidence, bodies: npt.NDArray[np.bool_], step_s: float) -> None:
        """Measure the misfit of one camera, another at every hearing."""
        if len(evidence.cameras) == 0:
            return
        self._turn = (self._turn + 1) % len(evidence.cameras)
        if bodies[self._turn] and evidence.explained_m2[self._turn] >= TOLD_BY_M2:
            record = self._records[evidence.cameras[self._turn]]
            record.measure(self._hearing.misfit(evidence, self._turn), self._gain(step_s * len(evidence.cameras)))

    def _charge(self, evidence: Evidence, slot: int, step_s: float) -> None:
        """One camera: by how much is it worse than it may be, and than the next worst?"""
        settings, record, told = self.settings, self._records[evidence.cameras[slot]], _testimony(evidence, slot)
        rivals = [other for other in range(evidence.panel) if other != slot]
        denied = float(evidence.denied[rivals].max(initial=0.0))
        misfit = max((self._records[evidence.cameras[other]].latest_misfit for other in rivals), default=0.0)
        lenience = 2.0 ** max(ENOUGH_WITNESSES - evidence.panel, 0)
        record.remember(told, self._gain(step_s))
        if not record.out:
            ratio = settings.ratio + lenience - 1.0
            guilt = max(
                told.denied - max(lenience * settings.veto_allowance, ratio * denied),
                record.lasting_misfit - max(lenience * settings.offset_allowance, ratio * misfit),
                told.excess - settings.excess_limit,
            )
            record.charge(told, guilt / settings.saturation, step_s, settings.patience_s)
            return
        agrees = (
            told.denied <= max(lenience * settings.reinstate_allowance, denied)
            and record.latest_misfit <= max(lenience * settings.offset_allowance / 2, misfit)
            and told.excess <= settings.excess_limit / 2
        )
        if not agrees or evidence.explained_m2[slot] >= TOLD_BY_M2:
            record.acquit(agrees, step_s)

    def _try_two(self, evidence: Evidence, step_s: float) -> bool:
        """No single camera explains the conflict: is one of the panel, another at every hearing, one of two liars?"""
        panel, settings = evidence.cameras[: evidence.panel], self.settings
        if len(panel) - 2 < self._fewest:
            return False
        self._hypothesis = (self._hypothesis + 1) % len(panel)
        first = panel[self._hypothesis]
        remaining = tuple(camera for camera in panel if camera != first)
        found = self._hearing.hear(remaining, (first, *evidence.cameras[evidence.panel :]))
        if found is None:
            return False
        second = int(np.argmax(found.denied[: found.panel]))
        solved = found.body_litres[second] >= settings.min_body_litres and found.denied[second] >= settings.saturation
        if not solved or found.conflict[second] > settings.conflict_limit / 2:
            return False
        for slot in (second, found.panel):  # a hearing comes to each pair twice in a round of the panel
            told = _testimony(found, slot)
            guilt = (told.denied - settings.veto_allowance) / settings.saturation
            record = self._records[found.cameras[slot]]
            record.remember(told, self._gain(step_s))
            record.charge(told, guilt, step_s * len(panel) / 2, settings.patience_s)
        return True

    def _gain(self, step_s: float) -> float:
        """Of a running mean over the settings' memory."""
        return 1.0 - float(np.exp(-step_s / self.settings.memory_s))

    def _decide(self, present: list[int]) -> CameraFaults:
        """Take back who has agreed for long enough; leave out the guiltiest first, while enough remain."""
        records, settings = self._records, self.settings
        for record in records:
            if record.out and record.agreed_s >= settings.reinstate_s:
                record.take_back()
        believed = [camera for camera in present if not records[camera].out]
        guilty = [camera for camera in believed if records[camera].guilt_s >= settings.patience_s]
        honest = [records[camera] for camera in believed if camera not in guilty]
        reasons = {name: why for name, why in self._verdict.reasons.items() if records[self.names.index(name)].out}
        for camera in sorted(guilty, key=lambda c: records[c].weight, reverse=True):
            name = self.names[camera]
            reasons[name] = reason(name, records[camera], honest, settings, float(self._hearing.focal_px[camera]))
            if len(believed) > self._fewest:
                believed.remove(camera)
                records[camera].leave_out()
                for other in believed:  # measured by a hull that this camera had cut
                    records[other].forget_misfit()
        suspects = tuple(self.names[camera] for camera in guilty if camera in believed)
        return self._summary(suspects, reasons)

    def _summary(self, suspects: tuple[str, ...], reasons: Mapping[str, str]) -> CameraFaults:
        named = list(zip(self.names, self._records, strict=True))
        return CameraFaults(
            left_out=tuple(name for name, record in named if record.out),
            suspects=suspects,
            reasons=reasons,
            denied={name: record.denied for name, record in named},
            excess={name: record.excess for name, record in named},
            misfit={name: record.misfit for name, record in named},
            consistency={name: record.consistency for name, record in named},
            silhouette_offset_px={
                name: (float(record.silhouette_offset_px[0]), float(record.silhouette_offset_px[1]))
                for name, record in named
            },
            conflict=self._conflict,
            warning=self._warning(suspects),
            updated=True,
        )

    def _warning(self, suspects: tuple[str, ...]) -> str:
        """When it is clear that somebody lies, and not who."""
        if suspects or self._conflict <= self.settings.warning_limit:
            return ""
        believed = [name for name, record in zip(self.names, self._records, strict=True) if not record.out]
        return (
            f"{', '.join(believed)} contradict each other: {self._conflict:.0%} of what they show fits no common "
            "hull, and it cannot be told who is wrong. Or is somebody outside the volume?"
        )


def _testimony(evidence: Evidence, slot: int) -> Testimony:
    shares = (evidence.denied, evidence.excess, evidence.coverage, evidence.covered)
    return Testimony(*(float(share[slot]) for share in shares))
