"""One discrete Bayes filter for each limb: as tracked, at another place that the search found or did not, or unseen.

All evidence is counted in independent samples: cells of the limb's surface with rays that the limb's place explains and
the rest of the body does not; each is worth a nat. A limb in the wrong place explains a few by chance, a right one a
dozen, with three cameras as with eight. Evidence for another place is its samples beyond those of the tracked one; for
a place that the search did not find, the unexplained samples within reach, where the limb must show; against "unseen"
the samples of the tracked place. Chance lasts as long as the body holds still, so that sets close to each other in time
are one observation: log odds are forgotten exponentially (Raftery, Karny & Ettler, Online prediction under model
uncertainty via dynamic model averaging, Technometrics 52, 2010), by stamps, the same at any rate.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from ..articulated_fit import LONGEST_S
from .limb_search import LimbPlaces

# Thresholds: chosen with python bench/people.py --doubt on clothed figures before three cameras.
MEMORY_S = LONGEST_S  # time constant: a body moves by a limb's width in it; newer evidence is correlated
PLACE_LOG_PRIOR = -1.0  # of a place that the search found, against the tracked one: 1 to 3
UNFOUND_LOG_PRIOR = 2.5  # of a place that it did not find, as part of the limb hides before the body
SET_NATS = 4.0  # one set in 50 is torn, so none counts more than ln 50 for or against a place
CHANCE_SAMPLES = 5.0  # independent samples that a limb explains wherever it is
DOUBTFUL = 0.50  # probability of another place, or of none
ELSEWHERE_M = 0.25  # least distance of elbow or hand at another place: the track may then be 0.2 m wrong
UNSEEN_SD_M = 0.15  # of an unseen limb about its tracked place: half a forearm


@dataclass(frozen=True, eq=False)
class LimbBelief:
    """Log odds of one limb against its tracked place: of the other ``places`` (k,), of a place that the search did not
    find (``unfound``), and of a limb that nothing shows (``unseen``)."""

    places: LimbPlaces
    log_odds: np.ndarray
    unfound: float
    unseen: float

    @staticmethod
    def after(before: LimbBelief | None, places: LimbPlaces, dt_s: float, hidden: bool) -> LimbBelief:
        """Return the belief one set, ``dt_s`` later. ``hidden`` : the limb reaches out of the cameras' view, where it
        counts as unseen without delay."""
        gain = 1.0 - math.exp(-dt_s / MEMORY_S)
        seen = np.clip(places.margins + PLACE_LOG_PRIOR, -SET_NATS, SET_NATS)
        prior = _inherited(before, places.origins)
        prior = np.where(np.isnan(prior), np.minimum(seen, PLACE_LOG_PRIOR), prior)
        log_odds = prior + gain * (seen - prior)
        unfound = _of_one_set(places.unexplained - places.samples + UNFOUND_LOG_PRIOR)
        unseen = _of_one_set(CHANCE_SAMPLES - places.samples)
        if before is not None:
            unfound = before.unfound + gain * (unfound - before.unfound)
            unseen = unseen if hidden else before.unseen + gain * (unseen - before.unseen)
        return LimbBelief(places, log_odds, unfound, unseen)

    @cached_property
    def probabilities(self) -> np.ndarray:
        """(k + 2,) of the tracked place, the other places, unseen, given that the limb is not unfound; search,
        covariance and learning use these, as torn silhouettes leave much unexplained beside a limb that is right."""
        odds = np.exp(np.concatenate([[0.0], self.log_odds, [self.unseen]]))
        return np.asarray(odds / odds.sum())

    @cached_property
    def known_elsewhere(self) -> float:
        """Probability that elbow or hand is ELSEWHERE_M off, or unseen, given that the limb is not unfound."""
        p = self.probabilities
        return float(p[1:-1][self.places.apart_m > ELSEWHERE_M].sum() + p[-1])

    @cached_property
    def not_as_tracked(self) -> float:
        """Probability that elbow or hand is ELSEWHERE_M off, unfound, or unseen."""
        known = 1.0 + float(np.exp(self.log_odds).sum()) + math.exp(self.unseen)
        unfound = math.exp(self.unfound)
        return (unfound + known * self.known_elsewhere) / (unfound + known)

    @property
    def likeliest_place(self) -> int | None:
        """Number of the most probable place, if it is more probable than the tracked one and explains more than chance
        in the last set; else None."""
        explains = self.places.samples + self.places.margins + PLACE_LOG_PRIOR
        odds = np.where(explains > CHANCE_SAMPLES, self.log_odds, -np.inf)
        return int(odds.argmax()) if len(odds) and odds.max() > 0.0 else None

    @property
    def spread(self) -> np.ndarray:
        """Second moment (2, 3, 3) m^2 of elbow and hand about where they are tracked."""
        p, offsets = self.probabilities, self.places.ends - self.places.tracked
        moment = np.einsum("k,kpi,kpj->pij", p[1:-1], offsets, offsets)
        lower = self.places.tracked[1] - self.places.tracked[0]
        anywhere = np.array([UNSEEN_SD_M**2, 2.0 / 3.0 * float(lower @ lower)])
        return np.asarray(moment + p[-1] * anywhere[:, None, None] * np.eye(3))

    def without(self, number: int) -> LimbBelief:
        """Return the belief with one place refuted: the whole set does not agree."""
        log_odds = self.log_odds.copy()
        log_odds[number] = PLACE_LOG_PRIOR
        return replace(self, log_odds=log_odds)


def _of_one_set(nats: float) -> float:
    """Clip one set's evidence to SET_NATS."""
    return min(max(nats, -SET_NATS), SET_NATS)


def _inherited(before: LimbBelief | None, origins: np.ndarray) -> np.ndarray:
    """Return the log odds (k,) of each place before this set; NaN of new ones."""
    known = np.append(np.empty(0) if before is None else before.log_odds, np.nan)
    return np.asarray(known[np.where(origins < len(known), origins, -1)])
