"""A body's sizes from contour rays that a known body made."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import refinement_rays as made

from icp_tracker.initialization.body_sizes import FOREARM, SIZES, THIGH, UPPER_ARM, prior_sizes
from icp_tracker.initialization.initial_pose import InitialPose
from icp_tracker.monitor.track_monitor import RecoverySettings
from icp_tracker.refinement import shape as shapes
from icp_tracker.refinement.body_refiner import BodyRefiner, RefinementSettings
from icp_tracker.tracker import IcpTracker, TrackerSettings
from mocap_packets.hull import HullProducts
from stick_figure.body import BEND_NUMBERS
from stick_figure.body_surface import BodySurface, build_of_girth
from stick_figure.kinematics import forward
from stick_figure.least_squares.extremities import ANGLES, COUNT, straight_extremities, turn_extremities
from stick_figure.least_squares.posed_model import BodyModel, PoseState, place
from stick_figure.pose import T_POSE_ANGLES, Pose

H = 1.75
SEEN = slice(0, len(SIZES) - 1)  # all but the ankles' height, which no ray of a foot fixed to the calf can tell
EXACT = RefinementSettings(
    keyframes=12, independent_rays=400.0, surface_sd_m=0.005, turn=0.05, least_change_m=0.002, pause_s=1.0
)


def wrong_start(rng):
    """A prior and a body drawn from it."""
    estimate = prior_sizes(H)
    prior = shapes.ShapePrior.of(estimate)
    truth = prior.mean + rng.normal(size=len(prior.mean)) * np.sqrt(np.diag(prior.covariance)) * 0.8
    return estimate, truth


def refined_by(estimate, truth, poses, settings, rng, sd_m=0.0, rounds=4, each=12):
    refiner, body = BodyRefiner(estimate, settings), shapes.body_of(truth)
    surface, given, stamp = BodySurface.of(body), [], 0
    sets = [(pose, made.tangent_rays(body, surface, pose, rng, each, sd_m)) for pose in poses]
    for _ in range(rounds):
        for pose, contour_rays in sets:
            stamp += 50_000_000
            given.append(refiner.step(stamp, pose, contour_rays))
    return refiner, given


def error(refiner, truth):
    return refiner.refined.sizes - truth[shapes.SIZE]


def test_sizes_converge_to_the_body_that_made_the_rays_when_all_joints_bend():
    rng = np.random.default_rng(3)
    estimate, truth = wrong_start(rng)
    refiner, _ = refined_by(estimate, truth, [made.moving_pose(rng) for _ in range(12)], EXACT, rng)
    before, after = np.abs(estimate.sizes - truth[shapes.SIZE])[SEEN], np.abs(error(refiner, truth))[SEEN]
    assert before.mean() > 0.008
    assert after.mean() < 0.6 * before.mean()  # build, turns of hands and feet and the back are told from the same rays
    assert after.max() < 0.025  # shoulders that may move leave the head and trunk less certain


def test_split_of_a_straight_arm_stays_with_the_prior_while_bent_elbows_tell_it():
    rng = np.random.default_rng(4)
    estimate = prior_sizes(H)
    straight = Pose.from_angles([0.0, 0.0, 1.1], np.eye(3), T_POSE_ANGLES)
    truth = shapes.ShapePrior.of(estimate).mean
    coarse = RefinementSettings(keyframes=12, turn=0.05, independent_rays=24.0)
    held, _ = refined_by(estimate, truth, [straight], coarse, rng)
    moved, _ = refined_by(estimate, truth, [made.moving_pose(rng) for _ in range(12)], coarse, rng)
    split = np.zeros(len(SIZES))
    split[UPPER_ARM], split[FOREARM] = 1.0, -1.0

    def sd(covariance):
        return np.sqrt(split @ covariance @ split)

    assert sd(held.refined.covariance) > 0.75 * sd(estimate.covariance)
    # a hand that may turn at the wrist says less about the elbow
    assert sd(moved.refined.covariance) < 0.65 * sd(estimate.covariance)


@pytest.mark.slow
def test_covariance_is_honest_over_bodies_drawn_from_the_prior():
    settings = RefinementSettings(keyframes=6, turn=0.05, surface_sd_m=0.006, independent_rays=100.0, explained=0.5)
    nees = []
    for seed in range(24):  # of eight, two that are far out decide
        rng = np.random.default_rng(100 + seed)
        estimate, truth = wrong_start(rng)
        poses = [made.moving_pose(rng) for _ in range(6)]
        refiner, _ = refined_by(estimate, truth, poses, settings, rng, sd_m=0.006, each=10)
        e, P = error(refiner, truth)[SEEN], refiner.refined.covariance[SEEN, SEEN]
        nees.append(e @ np.linalg.solve(P, e) / len(e))
    assert 0.4 < np.mean(nees) < 1.8


def test_no_size_leaves_the_prior_by_more_than_its_limit_when_rims_are_of_somebody_else():
    rng = np.random.default_rng(5)
    estimate = prior_sizes(H)
    truth = shapes.ShapePrior.of(estimate).mean
    truth[THIGH] += 9.0 * estimate.sd[THIGH]
    settings = RefinementSettings(keyframes=6, turn=0.05, explained=0.0, independent_rays=400.0)
    refiner, _ = refined_by(estimate, truth, [made.moving_pose(rng) for _ in range(6)], settings, rng)
    off = np.abs(refiner.refined.sizes - estimate.sizes) / estimate.sd
    assert off.max() <= shapes.FARTHEST_SD + 1e-9
    assert off[THIGH] > 1.0


def test_pose_whose_arm_the_flesh_does_not_explain_has_no_say():
    rng = np.random.default_rng(6)
    estimate = prior_sizes(H)
    truth = shapes.ShapePrior.of(estimate).mean
    body, pose = shapes.body_of(truth), made.moving_pose(rng)
    contour_rays = made.tangent_rays(body, BodySurface.of(body), pose, rng)
    angles = pose.angles()
    angles[3] += 1.5  # the left arm is fitted elsewhere
    refiner = BodyRefiner(estimate, RefinementSettings())
    refiner.step(1, Pose.from_angles(pose.position_world, pose.R_world_torso, angles), contour_rays)
    assert refiner.keyframes == 0
    np.testing.assert_allclose(refiner.refined.sizes, estimate.sizes, atol=1e-12)
    refiner.step(2, pose, contour_rays)
    assert refiner.keyframes == 1


def test_body_far_from_the_average_is_learnt_though_no_pose_explains_the_share_that_counts():
    """A tall, stout person who walked in is taken for average at first; after a moment the best poses count."""
    rng = np.random.default_rng(10)
    estimate = prior_sizes(H)
    truth = shapes.ShapePrior.of(estimate).mean
    truth[shapes.SIZE] *= 1.06
    truth[shapes.BUILD] = build_of_girth(1.4)
    settings = replace(EXACT, pause_s=0.0)
    poses = [made.moving_pose(rng) for _ in range(12)]
    hasty, _ = refined_by(estimate, truth, poses[:4], settings, rng, rounds=1)  # in less than a fifth of a second
    assert hasty.keyframes == 0
    refiner, _ = refined_by(estimate, truth, poses, settings, rng, rounds=10)
    before, after = np.abs(estimate.sizes - truth[shapes.SIZE])[SEEN], np.abs(error(refiner, truth))[SEEN]
    assert after.mean() < 0.2 * before.mean()


def test_body_is_given_only_when_it_changed_enough_and_not_again_before_the_pause():
    rng = np.random.default_rng(7)
    estimate, truth = wrong_start(rng)
    _, given = refined_by(estimate, truth, [made.moving_pose(rng) for _ in range(12)], EXACT, rng, rounds=6)
    at = np.flatnonzero([body is not None for body in given])
    assert 1 <= len(at) <= 4  # 3.6 s, at most one a second
    assert np.diff(at).min(initial=20) >= 20  # sets are 50 ms apart
    assert at[0] >= 20


@pytest.mark.parametrize("turn", [0.0, 0.3])
def test_gradient_is_that_of_the_rays_distances_from_capsules_placed_one_by_one(turn):
    rng, turns = np.random.default_rng(10), np.zeros((COUNT, ANGLES))
    turns[:, 0] = turn
    estimate, truth = wrong_start(rng)
    body, pose = shapes.body_of(truth), made.moving_pose(rng)
    contour_rays = made.tangent_rays(body, BodySurface.of(body), pose, rng, each=6)
    values = shapes.ShapePrior.of(estimate).mean
    model, n = shapes.ShapeArrays.of(values), shapes.POSE + len(values)
    H_, g = np.empty((n, n)), np.empty(n)
    wide = (1e3, 0.05, 0.06)  # all rays weigh the same, so that the cost is a plain sum of squares
    shapes.contour_system(contour_rays, turned(pose, shapes.figure_at(model, values), turns), turns, model, wide, H_, g)

    matches = matched(contour_rays, *capsules_at(values, pose, np.zeros(BEND_NUMBERS), turns))

    def cost(step):
        bend, more = step[24 : shapes.BENT], step[shapes.BENT : shapes.POSE].reshape(COUNT, ANGLES)
        moved = capsules_at(values + step[shapes.POSE :], pose.retract(step[:24]), bend, turns + more)
        return sum_of_squares(contour_rays, matches, *moved)

    about_second = range(shapes.BENT + 1, shapes.POSE, ANGLES)  # linear about straight alone
    for k in set(range(n)) - set(about_second if turn else ()):
        step = np.zeros(n)
        step[k] = 1e-6
        slope = (cost(step) - cost(-step)) / 2e-6
        assert -2.0 * g[k] == pytest.approx(slope, rel=2e-3, abs=1e-3 * np.abs(g).max())


def turned(pose, figure, turns):
    placed, ends = place(PoseState.of(pose), figure), straight_extremities(1.0)
    ends.turns[:] = turns
    turn_extremities(ends, placed)
    return placed


def capsules_at(values, pose, bend, turns):
    figure = BodyModel.of(shapes.body_of(values).bent(bend))
    placed = turned(pose, figure, turns)
    return placed.P, placed.Q, figure.surface.radii


def matched(contour_rays, P, Q, radii):
    """The capsule that is off least from each ray, and where along its axis."""
    found = []
    for row in contour_rays.rows.T:
        n, t, d, half = row[0:3], row[4:7], row[8:11], row[12]
        o = np.linalg.solve([n, t, d], row[[3, 7, 11]])  # the ray's middle, from its scalar products
        flat, off = np.array([n, t]), []
        for k in range(len(P)):
            s = flat @ (Q[k] - P[k])
            u = np.clip(-s @ (flat @ (P[k] - o)) / (s @ s + 1e-12), 0.0, 1.0)
            c = P[k] + u * (Q[k] - P[k]) - o
            beyond = max(abs(d @ c) - half - 0.05, 0.0)
            off.append(((-n @ c - radii[k] @ [1 - u, u]) ** 2 + (t @ c) ** 2 + beyond**2, k, u))
        found.append(min(off)[1:])
    return found


def sum_of_squares(contour_rays, matches, P, Q, radii):
    """Information times squared distance across, each ray against its place on a capsule."""
    total = 0.0
    for i, (k, u) in enumerate(matches):
        c = P[k] + u * (Q[k] - P[k])
        across = contour_rays.rows[3, i] - contour_rays.rows[:3, i] @ c - radii[k] @ [1 - u, u]
        total += contour_rays.information[i] * across**2
    return total


@pytest.mark.slow
@pytest.mark.parametrize("was_measured", [True, False])
def test_tracker_takes_over_better_sizes_of_a_measured_body_and_the_build_alone_of_a_given_one(was_measured):
    rng = np.random.default_rng(12)
    estimate, truth = wrong_start(rng)
    body, first = shapes.body_of(truth), made.moving_pose(rng)
    surface = BodySurface.of(body)
    found = InitialPose(first, estimate.body, "", estimate if was_measured else None)
    source = SimpleNamespace(find_pose=lambda seen: found)
    refinement = replace(EXACT, pause_s=0.1, explained=0.5)
    tracker = IcpTracker(source, TrackerSettings(refinement=refinement, recovery=RecoverySettings(search=False)))
    for k in range(40 if was_measured else 12):
        pose = first.retract(np.r_[np.zeros(6), np.full(18, 0.03 * abs(k % 20 - 10))])
        rays = made.rays_on(body, surface, pose, rng, each=8)
        tracker.step(HullProducts.of_points(k * 16_666_667, forward(body, pose), 0.02, contour_rays=rays))
    error = np.abs(tracker.body.lengths - body.lengths).mean()
    start = np.abs(estimate.body.lengths - body.lengths).mean()
    if was_measured:
        assert error < 0.8 * start
        assert tracker._refiner.keyframes > 3
    else:
        assert error == start
        assert tracker.body.build.any()
