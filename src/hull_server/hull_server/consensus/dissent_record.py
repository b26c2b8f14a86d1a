"""What is held against one camera, and what to tell the user about it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .dissent_misfit import Misfit


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
    denied, excess, misfit, push_px, consistency : running means. accused : means over the hearings since the guilt last
    was zero.
    """

    def __init__(self) -> None:
        self.out = False
        self.guilt_s, self.agreed_s, self.still_s = 0.0, 0.0, 0.0
        self.denied, self.excess, self.misfit, self.push_px = 0.0, 0.0, 0.0, np.zeros(2)
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
        self._misfits, self.latest_push_px = (self._misfits[1], misfit.share), misfit.push_px
        self.misfit += gain * (misfit.share - self.misfit)
        self.push_px = self.push_px + gain * (np.array(misfit.push_px) - self.push_px)

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
