"""Lost limbs and lost bodies: noticed, found again, never invented. Contour rays from an independent search for rays
that touch the body's surface; a person who stands, turns and walks as a whole, with noise on every ray."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import synthetic_people as synthetic
from poses import angles_with, pose_with
from refinement_rays import grazing_rays
from scipy.spatial.transform import Rotation

from capture_rig.visibility import CELL_M, UnseenCells
from icp_tracker.articulated_fit import ArticulatedSettings, make_data, minimise
from icp_tracker.initialization.initial_pose import KnownPose
from icp_tracker.monitor import pose_library
from icp_tracker.monitor.body_filter import CHECKS
from icp_tracker.monitor.evidence import LEFT_ARM, SLACK_M, evidence_of
from icp_tracker.monitor.limb_filter import CHANCE_SAMPLES, ELSEWHERE_M
from icp_tracker.monitor.limb_search import other_places, with_limb
from icp_tracker.monitor.track_monitor import RecoverySettings, TrackMonitor
from icp_tracker.tracker import IcpTracker, TrackerSettings
from mocap_packets.fit import DOUBTFUL, GOOD, LOST, PART_NAMES, PART_POINTS
from mocap_packets.hull import HullProducts, VoxelSamples
from stick_figure.body import Body
from stick_figure.kinematics import forward
from stick_figure.least_squares.contour_factor import match_rays
from stick_figure.least_squares.posed_model import BodyModel, PoseState, place
from stick_figure.pose import Pose

FPS = 60.0
LEFT_HAND, RIGHT_FOOT = 11, 14
NOISE_M = 0.004
STANCE = {
    "left_shoulder_x": -0.7,
    "right_shoulder_x": np.pi + 0.3,
    "left_shoulder_z": -0.5,
    "left_elbow": -1.0,
    "right_elbow": -0.4,
    "left_hip_x": 0.15,
    "right_hip_y": -0.5,
    "right_knee": 0.7,
}
FOLDED = {"left_shoulder_x": -1.4, "left_shoulder_z": 0.0, "left_shoulder_y": 0.0, "left_elbow": -2.4}


def posed(angles, otherwise=None):
    if otherwise is None:
        return pose_with(at=(0.0, 0.0, 1.2), **angles)
    return Pose.from_angles(*otherwise.arrays[:2], angles_with(otherwise.angles(), **angles))


@pytest.fixture(scope="module")
def person():
    """A body, its true pose, the rays that touch it and samples of its inside."""
    body = Body.from_stature(1.75)
    pose = posed(STANCE)
    return SimpleNamespace(
        body=body,
        pose=pose,
        rays=grazing_rays(body, pose, np.random.default_rng(8)),
        inside=synthetic.voxels(body, pose),
    )


def walked(person, k):
    """The person's motion as a whole at set k: rotation and shift."""
    return Rotation.from_rotvec([0.0, 0.0, 0.6 * k / FPS]).as_matrix(), np.array([0.5 * k / FPS, 0.0, 0.0])


def moved(pose, R, t):
    return replace(pose, position_world=R @ pose.position_world + t, R_world_torso=R @ pose.R_world_torso)


def seen(person, k, rng, R=None, t=None):
    """What the hull shows at set k: centerline (the inside's samples, thinned), voxels and rays."""
    if R is None:
        R, t = walked(person, k)
    rays = person.rays
    points = rays.points_world @ R.T + t + NOISE_M * rng.normal(size=(len(rays), 1)) * (rays.normals @ R.T)
    rays = replace(rays, points_world=points, directions=rays.directions @ R.T, normals=rays.normals @ R.T)
    inside = person.inside @ R.T + t
    voxels = VoxelSamples(inside, np.zeros(len(inside), bool))
    return HullProducts.of_points(stamp(k), inside[::9], 0.03, voxels, contour_rays=rays)


def tracker_of(person, settings=None):
    """A tracker that starts right."""
    return IcpTracker(KnownPose(person.pose, person.body), settings or TrackerSettings(acquire_inliers=0.0))


def follow(person, sets, wrong_at=None, wrong=None, settings=None):
    """Results and truths of a tracker that starts right and is given the pose ``wrong`` at a set."""
    tracker, rng, results, truths = tracker_of(person, settings), np.random.default_rng(3), [], []
    for k in range(sets):
        truth, prediction = moved(person.pose, *walked(person, k)), None
        if k == wrong_at:
            prediction = SimpleNamespace(stamp_ns=stamp(k), pose=wrong(truth), velocity=np.zeros(24))
        results.append(tracker.step(seen(person, k, rng), prediction))
        truths.append(forward(person.body, truth))
    return results, truths


def stamp(k):
    return 1_000_000_000 + round(k * 1e9 / FPS)


def worst_m(result, truth):
    return np.linalg.norm(result.reference_points_world - truth, axis=1).max()


def data_of(person):
    return data_in(seen(person, 0, np.random.default_rng(1), np.eye(3), np.zeros(3)))


def data_in(hull):
    return make_data(hull.centerline.points_world, 0.03, hull.voxels, ArticulatedSettings(), hull.contour_rays)


# --- the criterion ------------------------------------------------------------------------------------------------


def test_the_true_pose_explains_the_outlines_and_no_joint_is_beyond_its_range(person):
    evidence = evidence_of(BodyModel.of(person.body), person.pose, data_of(person))
    assert evidence.share > 0.95
    assert evidence.cost < 0.05 * len(evidence.costs)
    assert evidence.beyond < 1.0
    leg = pose_library.LimbPoses.of(person.pose, pose_library.LIMBS[2])
    through = with_limb(person.pose, pose_library.LIMBS[2], leg.R[0], 3.6)  # the calf in the thigh
    assert evidence_of(BodyModel.of(person.body), through, data_of(person)).beyond > 3.0


# --- where limbs can be -------------------------------------------------------------------------------------------


@pytest.mark.parametrize("limb", pose_library.LIMBS[:2], ids=lambda limb: PART_NAMES[limb.part])
def test_a_misplaced_arm_is_found_where_its_rays_are(person, limb):
    data = data_of(person)
    astray = with_limb(
        person.pose, limb, posed({"left_shoulder_x": -1.5, "right_shoulder_x": np.pi + 1.5}).R_joints[limb.ball], -0.1
    )
    places = other_places(BodyModel.of(person.body), astray, limb, data, pose_library.limb_poses(limb))
    assert places.margins[0] > 5.0 and places.apart_m[0] > ELSEWHERE_M
    assert (np.diff(places.margins) <= 0.0).all()
    found = with_limb(astray, limb, places.poses.R[0], places.poses.flexion[0])
    truth = forward(person.body, person.pose)
    off = np.linalg.norm(forward(person.body, found) - truth, axis=1)
    others = [p for p in range(15) if p not in PART_POINTS[limb.part]]
    assert off[others].max() < 1e-12
    assert off.max() < 0.12  # near enough for the fit, which does the rest:
    # where an arm is straight, elbow and wrist can bend in turn
    fitted = minimise(person.body, found, data, ArticulatedSettings())[0]
    assert np.linalg.norm(forward(person.body, fitted) - truth, axis=1).max() < 0.06


@pytest.mark.parametrize("limb", pose_library.LIMBS, ids=lambda limb: PART_NAMES[limb.part])
def test_a_limb_in_full_view_has_no_other_place(person, limb):
    places = other_places(BodyModel.of(person.body), person.pose, limb, data_of(person), pose_library.limb_poses(limb))
    assert places.samples > 1.8 * CHANCE_SAMPLES
    assert (places.margins < -1.5).all()


# --- one set after another, the fitted pose given -----------------------------------------------------------------


def assessed(person, poses, datas, monitor=None):
    """What a monitor says of the poses that were fitted to sets at 60 Hz."""
    monitor, settings = monitor or TrackMonitor(RecoverySettings()), ArticulatedSettings()
    return [
        monitor.assess(stamp(k), person.body, pose, data, settings)
        for k, (pose, data) in enumerate(zip(poses, datas, strict=True))
    ]


def without_rays_of(person, sticks):
    """The set without the rays that show some sticks."""
    data, figure = data_of(person), BodyModel.of(person.body)
    match = match_rays(data.contour_rays, place(PoseState.of(person.pose), figure), SLACK_M)
    kept = ~np.isin(figure.surface.stick[match.capsule], sticks)
    return data._replace(contour_rays=data.contour_rays.chosen(kept, data.contour_rays.information[kept]))


def test_a_right_pose_is_good_and_a_body_elsewhere_is_lost(person):
    data = data_of(person)
    beside = replace(person.pose, position_world=person.pose.position_world + np.array([0.6, 0.0, 0.0]))
    right, wrong = assessed(person, [person.pose, beside], [data, data])
    assert right.quality.state == GOOD and right.spread is None
    assert wrong.quality.state == LOST and "of the outlines" in wrong.quality.reason


def with_rays_beside(person, share):
    """The set with a share of the outlines up to 0.8 m beside the body: those of clothes, a bag, another body than
    ours."""
    rng, rays = np.random.default_rng(1), person.rays
    hull = seen(person, 0, rng, np.eye(3), np.zeros(3))
    moved = rng.uniform(0.1, 0.8, len(rays)) * (rng.random(len(rays)) < share)
    beside = rays.points_world + moved[:, None] * rays.normals
    return data_in(replace(hull, contour_rays=replace(rays, points_world=beside)))


@pytest.mark.parametrize(("share", "state"), [(0.5, DOUBTFUL), (0.37, GOOD)], ids=["no_learning", "learning"])
def test_a_body_that_explains_the_outlines_badly_as_a_whole_is_doubtful_in_every_part_though_it_is_usual(
    person, share, state
):
    """Torn silhouettes leave about as much: until it is half of them, sizes and places are learnt from the rest."""
    found = assessed(person, [person.pose] * 60, [with_rays_beside(person, share)] * 60)
    quality = found[-1].quality
    assert 1.0 - share - 0.06 < quality.explained < 1.0 - share + 0.06
    assert quality.state == state and quality.parts == (DOUBTFUL,) * 5 and "of the outlines" in quality.reason


def test_a_limb_that_no_ray_shows_is_doubtful_at_once_in_the_first_set(person):
    limb = pose_library.LIMBS[3]
    found = assessed(person, [person.pose] * 3, [without_rays_of(person, [limb.upper, limb.lower])] * 3)
    assert found[-1].quality.parts == (GOOD, GOOD, GOOD, GOOD, DOUBTFUL)
    assert "independent samples show it" in found[-1].quality.reason
    assert (np.linalg.eigvalsh(found[-1].spread[RIGHT_FOOT]) > 0.1**2).all()
    assert not found[-1].spread[[0, 7, 8, 9, 11, 12, 13]].any()


def test_the_ellipsoid_of_an_arm_that_went_astray_reaches_its_true_place(person):
    astray = posed(FOLDED, person.pose)
    found = assessed(person, [astray] * 8, [data_of(person)] * 8)
    doubted = [one for one in found if one.better is None and one.quality.parts[LEFT_ARM] == DOUBTFUL]
    hand = (forward(person.body, person.pose) - forward(person.body, astray))[LEFT_HAND]
    assert doubted and hand @ np.linalg.solve(doubted[-1].spread[LEFT_HAND], hand) < 7.8  # chi-square, 95 %
    moved_to = next(one for one in found if one.better is not None)
    assert moved_to.change == "left arm elsewhere"
    assert moved_to.moved == tuple(part == LEFT_ARM for part in range(5))
    assert (
        np.linalg.norm(forward(person.body, moved_to.better) - forward(person.body, person.pose), axis=1).max() < 0.06
    )


def test_an_arm_that_leaves_the_volume_is_doubtful_at_once_and_is_not_moved_to_what_is_left_over(person):
    """Its rays go within one set. What else the hull holds near the shoulder is no place for it."""
    whole, points = data_of(person), forward(person.body, person.pose)
    cells = np.zeros((80, 80, 50), bool)  # nothing is seen from the middle of the left forearm on
    cells[:, round((0.5 * (points[7, 1] + points[LEFT_HAND, 1]) + 2.0) / CELL_M) :] = True
    wall = UnseenCells(np.array([-2.0, -2.0, 0.0]), cells)
    gone = without_rays_of(person, [pose_library.LIMBS[0].upper, pose_library.LIMBS[0].lower])
    gone = gone._replace(unseen=wall)
    for found in assessed(person, [person.pose] * 20, [whole] * 10 + [gone] * 10)[10:]:
        assert found.quality.parts[LEFT_ARM] == DOUBTFUL
        assert found.better is None


def test_a_body_that_was_lost_is_believed_when_other_poses_have_been_tried(person):
    monitor, data = TrackMonitor(RecoverySettings()), data_of(person)
    before = assessed(person, [person.pose] * 3, [data] * 3, monitor)
    monitor.mark_lost()
    after = assessed(person, [person.pose] * 20, [data] * 20, monitor)
    assert all(one.better is None for one in before + after)
    assert {one.quality.state for one in before} == {GOOD}
    doubted = [one.quality.parts == (DOUBTFUL,) * 5 for one in after]
    assert doubted == [True] * (CHECKS - 1) + [False] * (21 - CHECKS)
    assert "other poses are being tried" in after[0].quality.reason


# --- set after set ------------------------------------------------------------------------------------------------


def test_a_good_track_is_left_alone(person):
    results, truths = follow(person, 60)
    assert {result.state for result in results} == {"tracking"}
    assert not any(result.recovered for result in results)
    assert max(worst_m(r, t) for r, t in zip(results, truths, strict=True)) < 0.06


@pytest.mark.parametrize(
    "wrong",
    [
        lambda pose: posed(FOLDED, pose),
        lambda pose: pose_library.exchanged(Body.from_stature(1.75), pose, pose_library.WITH_SIDES),
        pose_library.turned_around,
        lambda pose: pose_library.exchanged(Body.from_stature(1.75), pose, pose_library.WITH_ARMS),
        lambda pose: replace(pose, position_world=pose.position_world + np.array([0.0, 0.4, 0.0])),
    ],
    ids=["arm folded", "sides exchanged", "about face", "arms exchanged", "0.4 m beside"],
)
def test_a_wrong_pose_is_replaced_within_a_second(person, wrong):
    results, truths = follow(person, 55, wrong_at=5, wrong=wrong)
    assert max(worst_m(r, t) for r, t in zip(results[-3:], truths[-3:], strict=True)) < 0.06
    assert results[-1].state == "tracking"


def test_without_the_search_a_body_turned_round_stays_so(person):
    settings = TrackerSettings(acquire_inliers=0.0, recovery=RecoverySettings(search=False))
    results, truths = follow(person, 65, wrong_at=5, wrong=pose_library.turned_around, settings=settings)
    assert worst_m(results[-1], truths[-1]) > 0.2


def test_who_left_is_lost_and_found_again_elsewhere(person):
    tracker, rng = tracker_of(person), np.random.default_rng(2)
    tracker.step(seen(person, 0, rng))
    empty = tracker.step(HullProducts.of_points(stamp(1), np.empty((0, 3))))
    assert empty.state == LOST and empty.reason.startswith("nobody in the volume") and not empty.visible.any()
    assert set(empty.quality.parts) == {LOST} and empty.reference_points.doubtful.all()
    R, t = Rotation.from_rotvec([0.0, 0.0, 2.2]).as_matrix(), np.array([-1.1, 0.7, 0.0])
    truth, found = forward(person.body, moved(person.pose, R, t)), []
    for k in range(60, 120):
        result = tracker.step(seen(person, k, rng, R, t))
        found.append(worst_m(result, truth) < 0.06)
        assert result.state != LOST or not result.visible.any()
    assert all(found[30:])  # half a second, also where the first guess has front and back the wrong way round
    assert result.state == "tracking"


def test_a_stale_prediction_does_not_undo_a_recovery(person):
    """The filter takes some sets to follow; until then its state, arm still folded, must not be the start again."""
    tracker, rng, found = tracker_of(person), np.random.default_rng(4), None
    for k in range(60):
        truth = moved(person.pose, *walked(person, k))
        pose = posed(FOLDED, truth) if found is None or k < found + 6 else truth
        prediction = SimpleNamespace(stamp_ns=stamp(k), pose=pose, velocity=np.zeros(24))
        result = tracker.step(seen(person, k, rng), prediction if k else None)
        good = k > 0 and worst_m(result, forward(person.body, truth)) < 0.06
        assert good or found is None
        found = k if good and found is None else found
    assert found is not None and found < 40
