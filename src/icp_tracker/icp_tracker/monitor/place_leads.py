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

from capture_rig.kernel import njit

from .limb_search import APART_M, LimbPlaces, farther_apart

FAR_M = 0.4  # a place so far from the tracked one, or farther, needs twice the evidence: tracks slip, they seldom leap
LEAD_SETS = 3  # sets in which a place must have led: one may be torn, two may share a chance
CLEAR_LEADS, CLEAR_SETS = 2.0, 2  # with so many times the lead that is needed, so many are enough
NO_ENDS, NO_LEADS, NO_SETS = np.empty((0, 2, 3)), np.empty(0), np.empty(0, np.int64)


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
        """Return the leads one set, and so many seconds, later: a place goes on from that of the set before that it was
        refined from, else from the nearest one within APART_M."""
        ends, leads, sets, origins = NO_ENDS, NO_LEADS, NO_SETS, np.full_like(places.origins, -1)
        if before is not None:
            ends, leads, sets, origins = before.places.ends, before.leads, before.sets, places.origins
        earned = (places.margins - chance_rays) * apart_s
        leads, sets = _gathered(ends, leads, sets, places.ends, origins, earned)
        return PlaceLeads(places, leads, sets)

    def shares_of(self, needed: float) -> np.ndarray:
        """Return (k,) each place's lead over what it needs, ``needed`` for a place next to the tracked one; 0 for one
        that has not led for enough sets."""
        return np.asarray(_shares(self.leads, self.sets, self.places.apart_m, needed))

    def without(self, number: int) -> PlaceLeads:
        """Return the same with the lead of one place gone."""
        leads, sets = self.leads.copy(), self.sets.copy()
        leads[number], sets[number] = 0.0, 0
        return PlaceLeads(self.places, leads, sets)


@njit(cache=True)
def _gathered(ends_before, leads_before, sets_before, ends, origins, earned):
    """Return leads (k,) and sets (k,) of the places now, by those of the set before and what was ``earned`` (k,)."""
    leads, sets, earlier = np.empty(earned.shape[0]), np.empty(earned.shape[0], np.int64), origins.copy()
    for k in range(earned.shape[0]):
        if origins[k] < 0:
            earlier[k] = _nearest(ends[k], ends_before, earlier)
        lead, count = (leads_before[earlier[k]], sets_before[earlier[k]]) if earlier[k] >= 0 else (0.0, 0)
        leads[k] = max(lead + earned[k], 0.0)
        sets[k] = count + 1 if leads[k] > 0.0 else 0
    return leads, sets


@njit(cache=True)
def _nearest(ends, ends_before, taken):
    """Return which place of the set before is the nearest one within APART_M that is not ``taken``; -1 for none."""
    best, nearest = APART_M, -1
    for m in range(ends_before.shape[0]):
        apart = farther_apart(ends, ends_before[m])
        if apart < best and not (taken == m).any():
            best, nearest = apart, m
    return nearest


@njit(cache=True)
def _shares(leads, sets, apart_m, needed):
    """Return each lead (k,) over what its place needs, 0 for one of too few sets."""
    shares = leads / (needed * (1.0 + np.minimum(apart_m / FAR_M, 1.0)))
    for k in range(shares.shape[0]):
        if not (sets[k] >= LEAD_SETS or (sets[k] >= CLEAR_SETS and shares[k] >= CLEAR_LEADS)):
            shares[k] = 0.0
    return shares
