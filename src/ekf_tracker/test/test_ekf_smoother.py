"""The backward pass: better than the filter on noisy points, gaps filled with a covariance that holds."""

import numpy as np
import pytest
from ekf_person import ALL, IDEAL, NONE, Person, ellipsoid_distances, isotropic, stamp
from scipy.stats import chi2

from ekf_tracker.filter import ArticulatedEkf
from ekf_tracker.smoother import Set, smooth
from mocap_packets.fit import ReferencePoints
from mocap_packets.state import NoState
from stick_figure.skeleton import POINT_NAMES

NOISE, SETTLED = 0.01, 20
ARM = [POINT_NAMES.index("left_elbow"), POINT_NAMES.index("left_hand")]


def take(body, seed, frames=120, visible=lambda k: ALL, spread=lambda k: isotropic(NOISE)):
    """Sets of a moving person with noisy points of these covariances, and the true points."""
    rng, person, sets, truth = np.random.default_rng(seed), Person(body, seed), [], []
    for k in range(frames):
        truth.append(person.points(k / 60))
        measured = truth[-1] + np.einsum("pij,pj->pi", np.sqrt(spread(k)), rng.standard_normal((15, 3)))
        sets.append(Set(stamp(k), ReferencePoints(measured, spread(k), visible(k)), body))
    return sets, np.array(truth)


def filtered(sets):
    ekf = ArticulatedEkf(sets[0].body, IDEAL)
    return [ekf.step(one.stamp_ns, *one.points) for one in sets]


def errors(states, truth):
    return np.array([state.points_world for state in states]) - truth


def jitter(states):
    return np.linalg.norm(np.diff([state.points_world for state in states], 3, axis=0), axis=-1).mean()


def test_smoothed_points_are_nearer_to_the_truth_and_quieter_than_the_filters(body):
    before, after, quiet, inside = [], [], [], []
    for seed in range(2):
        sets, truth = take(body, seed)
        forwards, both = filtered(sets), smooth(sets, IDEAL)
        before.append(np.linalg.norm(errors(forwards, truth)[SETTLED:], axis=-1).mean())
        after.append(np.linalg.norm(errors(both, truth)[SETTLED:], axis=-1).mean())
        quiet.append(jitter(both) / jitter(forwards))
        covariance = np.array([state.point_covariance for state in both])
        inside.append(ellipsoid_distances(errors(both, truth), covariance) < chi2.ppf(0.95, 3))
    assert np.mean(after) < 0.8 * np.mean(before)
    assert np.mean(quiet) < 0.3
    assert 0.88 < np.mean(inside) < 0.99


@pytest.mark.parametrize("hidden", [range(60, 66), range(60, 75)])
def test_gaps_are_filled_from_both_sides_with_a_covariance_that_holds(body, hidden):
    sets, truth = take(body, 3, visible=lambda k: NONE if k in hidden else ALL)
    gap = slice(hidden.start, hidden.stop)
    forwards, both = filtered(sets), smooth(sets, IDEAL)
    before, after = (np.linalg.norm(errors(s, truth)[gap], axis=-1).mean() for s in (forwards, both))
    assert after < 0.5 * before
    covariance = np.array([state.point_covariance for state in both])
    assert (ellipsoid_distances(errors(both, truth), covariance)[gap] < chi2.ppf(0.95, 3)).mean() > 0.85
    traces = np.trace(covariance, axis1=2, axis2=3).mean(axis=1)
    middle = (hidden.start + hidden.stop) // 2
    assert traces[middle] > 2.0 * traces[hidden.start - 5] and traces[middle] > traces[hidden.start]


def test_a_doubtful_arm_is_known_from_the_sets_around_it(body):
    """Its points come with 20 cm for a while: the arm stays where both sides say, and is surer there than the fit."""
    doubtful = range(60, 68)

    def spread(k):
        R = isotropic(NOISE)
        if k in doubtful:
            R[ARM] = isotropic(0.2)[ARM]
        return R

    sets, truth = take(body, 5, spread=spread)
    forwards, both = filtered(sets), smooth(sets, IDEAL)
    gap = slice(doubtful.start, doubtful.stop)
    before, after = (np.linalg.norm(errors(s, truth)[gap][:, ARM], axis=-1).mean() for s in (forwards, both))
    assert after < 0.7 * before
    assert np.sqrt(np.trace(both[64].point_covariance[ARM[1]])) < 0.15


def test_the_last_state_is_the_filters_and_sets_without_a_body_stay_without(body):
    sets, _ = take(body, 1, frames=40)
    empty = [Set(stamp(k - 3), one.points, None) for k, one in enumerate(sets[:3])]
    both = smooth([*empty, *sets], IDEAL)
    assert [isinstance(state, NoState) for state in both[:4]] == [True, True, True, False]
    np.testing.assert_array_equal(both[-1].points_world, filtered(sets)[-1].points_world)
