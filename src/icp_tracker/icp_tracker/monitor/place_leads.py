"""How long other places of a limb have explained more: sequential change detection, place by place.

In every set each place of a limb has a margin over the tracked one, in rays. One set is not enough: chance margins of
ten rays occur, but they do not last. What is summed up is the margin beyond what chance gives, never below zero: the
cumulative sum test (Page, Continuous inspection schemes, Biometrika 41, 1954), which notices a change sooner than any
other test with as few false alarms. All places of a limb are followed at once, so that the first one to be looked at
has no advantage over a better one.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .limb_search import APART_M, LimbPlaces

FAR_M = 0.4  # a place so far from the tracked one, or farther, needs twice the evidence: tracks slip, they seldom leap
LEAD_SETS = 3  # sets in which a place must have led: one may be torn, two may share a chance
CLEAR_LEADS, CLEAR_SETS = 2.0, 2  # with so many times the lead that is needed, so many are enough


@dataclass(frozen=True, eq=False)
class PlaceLeads:
    """What the places of one limb, in the order of ``places``, have gathered.

    leads (k,) : rays times seconds by which each has explained more than the tracked place, and more than chance.
    sets (k,) : frame sets since each lead was last zero.
    """

    places: LimbPlaces
    leads: np.ndarray
    sets: np.ndarray

    @staticmethod
    def after(before: PlaceLeads | None, places: LimbPlaces, apart_s: float, chance_rays: float) -> PlaceLeads:
        """Return the leads one set, and so many seconds, later."""
        leads, sets = np.zeros(len(places.margins)), np.zeros(len(places.margins), np.int64)
        if before is not None:
            for k, earlier in enumerate(_earlier(before.places, places)):
                if earlier >= 0:
                    leads[k], sets[k] = before.leads[earlier], before.sets[earlier]
        leads = np.maximum(leads + (places.margins - chance_rays) * apart_s, 0.0)
        return PlaceLeads(places, leads, np.where(leads > 0.0, sets + 1, 0))

    def shares_of(self, needed: float) -> np.ndarray:
        """Return (k,) each place's lead over what it needs, ``needed`` for a place next to the tracked one; 0 for one
        that has not led for enough sets."""
        shares = self.leads / (needed * (1.0 + np.minimum(self.places.apart_m / FAR_M, 1.0)))
        enough = (self.sets >= LEAD_SETS) | ((self.sets >= CLEAR_SETS) & (shares >= CLEAR_LEADS))
        return np.asarray(np.where(enough, shares, 0.0))

    def without(self, number: int) -> PlaceLeads:
        """Return the same with the lead of one place gone."""
        leads, sets = self.leads.copy(), self.sets.copy()
        leads[number], sets[number] = 0.0, 0
        return PlaceLeads(self.places, leads, sets)


def _earlier(before: LimbPlaces, now: LimbPlaces) -> list[int]:
    """Return which place (k,) of the set before each one is: the one that it was refined from, else the nearest one
    within APART_M; -1 for a new one."""
    apart = np.linalg.norm(now.ends[:, None] - before.ends[None], axis=3).max(axis=2, initial=0.0)
    found = [int(origin) for origin in now.origins]
    for k, origin in enumerate(found):
        free = [m for m in range(len(before.margins)) if m not in found]
        if origin < 0 and free:
            nearest = min(free, key=lambda m: float(apart[k, m]))
            found[k] = nearest if apart[k, nearest] < APART_M else -1
    return found
