"""Other places of a limb: which one takes over, and when. Margins are made up."""

import numpy as np
import pytest

from icp_tracker.monitor.limb_search import NO_POSES, LimbPlaces
from icp_tracker.monitor.place_leads import CLEAR_SETS, LEAD_SETS, PlaceLeads

DT, CHANCE, NEEDED = 1.0 / 60.0, 1.0, 0.1
NEAR, FAR = 0.2, 0.6  # m


def places(*rivals):
    """Other places of an arm, best first: margin (rays), how far off (m), and which of the known ones it is."""
    rivals = sorted(rivals, reverse=True)
    margins, apart, origins = np.array(rivals, float).reshape(-1, 3).T
    ends = np.zeros((len(margins), 2, 3))
    ends[:, :, 1] = apart[:, None]
    return LimbPlaces(NO_POSES, margins, ends, np.zeros((2, 3)), 30.0, origins.astype(int))


def after(*sets):
    """The leads after several sets, each a tuple of rivals."""
    leads = None
    for rivals in sets:
        leads = PlaceLeads.after(leads, places(*rivals), DT, CHANCE)
    return leads


def test_a_place_that_explains_more_is_ready_the_sooner_the_more_it_explains():
    ready = {}
    for margin in (2.0, 3.0, 8.0, 60.0):
        sets = 1
        while after(*[[(margin, NEAR, 0)]] * sets).shares_of(NEEDED)[0] < 1.0:
            sets += 1
        ready[margin] = sets
    assert ready[2.0] > ready[3.0] > ready[8.0] == LEAD_SETS > ready[60.0] == CLEAR_SETS


def test_margins_that_chance_gives_gather_nothing_and_a_lead_is_lost_again():
    assert after(*[[(CHANCE, NEAR, 0)]] * 100).leads[0] == 0.0
    turned = after(*[[(5.0, NEAR, 0)]] * 3, *[[(-30.0, NEAR, 0)]], *[[(5.0, NEAR, 0)]])
    assert turned.sets[0] == 1 and turned.leads[0] == pytest.approx(4.0 * DT)


def test_one_set_is_never_enough():
    assert after([(1000.0, NEAR, -1)]).shares_of(NEEDED)[0] == 0.0


def test_a_place_far_off_needs_twice_the_evidence():
    near, far = (after(*[[(8.0, apart, 0)]] * 4).shares_of(NEEDED)[0] for apart in (0.0, FAR))
    assert near == pytest.approx(2.0 * far)


def test_the_better_of_two_places_leads_though_the_other_was_found_before():
    """Seen with an arm behind the trunk: a place half a metre off led by three rays before the right one was found."""
    worse_alone = [[(3.0, FAR, 0)]] * 4
    both = [[(9.0, NEAR, -1), (3.0, FAR, 0)], *[[(9.0, NEAR, 0), (3.0, FAR, 1)]] * 3]
    shares = after(*worse_alone, *both).shares_of(NEEDED)
    assert shares[0] > 1.0 and shares[0] > 2.0 * shares[1]


def test_a_place_keeps_its_lead_when_it_is_found_anew_in_the_library():
    """The refined known place loses to one of the library that is the same: both are one place."""
    known = after(*[[(5.0, NEAR, 0)]] * 3)
    anew = PlaceLeads.after(known, places((6.0, NEAR + 0.05, -1), (2.0, FAR, -1)), DT, CHANCE)
    assert list(anew.sets) == [4, 1]
    assert anew.leads[0] > known.leads[0]


def test_a_place_that_was_tried_in_vain_starts_anew():
    leads = after(*[[(9.0, NEAR, 0), (5.0, FAR, 1)]] * 4)
    tried = leads.without(0)
    assert tried.leads[0] == 0.0 and tried.leads[1] == leads.leads[1] > 0.0
