"""The camera that lies: found by what it denies, left out, and taken back when it agrees again.

Every camera of the hull has a veto, so one that is covered, moved or frozen cuts the body for all. The watch hears all
silhouettes on a coarse grid a few times a second, adds up the evidence against each camera (a cumulative sum after
Page, "Continuous inspection schemes", Biometrika 1954: gross lies are found at once, small ones when they last) and
says whom the hull should leave out. A camera that is left out is heard on.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import numpy.typing as npt

from capture_rig import Rig

from ..settings import DissentSettings
from ..views import Masks, RigViews
from .dissent_evidence import Evidence, Hearing
from .dissent_record import Record, Testimony
from .dissent_verdict import Verdict, reason

ENOUGH_WITNESSES = 5  # each one less makes the hull of the others looser: twice as much must be allowed
FEWEST_WITNESSES = 3  # cameras that must remain: of two that contradict each other, either may be right
FLOODED, FLOODED_TIMES = 0.25, 4.0  # share of its view, and times the median, from which foreground is no silhouette
TOLD_BY_M2 = 0.04  # a camera agrees only by showing at least so much of the body: a hand or two
EARLY = 0.1  # share of the period by which a frame set may come early: stamps jitter
NS = 1e-9


class DissentWatch:
    """Watches over the cameras of one rig. Not for two threads at a time."""

    def __init__(self, rig: Rig, views: RigViews, settings: DissentSettings, min_seeing: int = 0) -> None:
        """Compute what depends on the calibration only; ``min_seeing`` is the hull's setting of that name."""
        self.settings, self.names, self._views = settings, views.names, views
        self._hearing = Hearing(rig, views, settings.voxel_size_m, min_seeing)
        self._fewest = max(FEWEST_WITNESSES, min_seeing)
        self._records = [Record() for _ in views.names]
        self._conflict, self._turn, self._hypothesis = 0.0, 0, 0
        self._last_ns: int | None = None
        self._verdict = replace(self._summary((), {}), judged=False)

    def judge(self, masks: Masks, stamp_ns: int) -> Verdict:
        """Hear one frame set's canvas masks (h, w) uint8, nonzero = foreground, if it is time to.

        A frame set that comes too soon after the last one heard, in which nobody is seen, or which has too few
        cameras to tell, changes nothing. Raises InputError for an unknown camera or a mask of the wrong size.
        """
        step_s = self._step_s(stamp_ns)
        if not self.settings.enabled or step_s <= 0.0:
            return replace(self._verdict, judged=False)
        self._last_ns = stamp_ns
        panel, others = self._seat(masks, step_s)
        evidence = self._hearing.hear(panel, others)
        if evidence is None or not self._weigh(evidence, step_s):
            return replace(self._verdict, judged=False)
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
                told.denied - max(lenience * settings.allowance, ratio * denied),
                record.lasting_misfit - max(lenience * settings.misfit_allowance, ratio * misfit),
                told.excess - settings.excess_limit,
            )
            record.charge(told, guilt / settings.saturation, step_s, settings.patience_s)
            return
        agrees = (
            told.denied <= max(lenience * settings.release, denied)
            and record.latest_misfit <= max(lenience * settings.misfit_allowance / 2, misfit)
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
            guilt = (told.denied - settings.allowance) / settings.saturation
            record = self._records[found.cameras[slot]]
            record.remember(told, self._gain(step_s))
            record.charge(told, guilt, step_s * len(panel) / 2, settings.patience_s)
        return True

    def _gain(self, step_s: float) -> float:
        """Of a running mean over the settings' memory."""
        return 1.0 - float(np.exp(-step_s / self.settings.memory_s))

    def _decide(self, present: list[int]) -> Verdict:
        """Take back who has agreed for long enough; leave out the guiltiest first, while enough remain."""
        records, settings = self._records, self.settings
        for record in records:
            if record.out and record.agreed_s >= settings.recover_s:
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

    def _summary(self, suspects: tuple[str, ...], reasons: Mapping[str, str]) -> Verdict:
        named = list(zip(self.names, self._records, strict=True))
        return Verdict(
            left_out=tuple(name for name, record in named if record.out),
            suspects=suspects,
            reasons=reasons,
            denied={name: record.denied for name, record in named},
            excess={name: record.excess for name, record in named},
            misfit={name: record.misfit for name, record in named},
            consistency={name: record.consistency for name, record in named},
            push_px={name: (float(record.push_px[0]), float(record.push_px[1])) for name, record in named},
            conflict=self._conflict,
            warning=self._warning(suspects),
            judged=True,
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
