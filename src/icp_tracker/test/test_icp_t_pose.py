"""T-poses on hulls that are carved from exact silhouettes of people with volume: found, turned right, or refused."""

import re

import numpy as np
import pytest
from poses import angles_with
from t_pose_studio import DOWN, SET_NS, box, person, standing, studio

from capture_rig import load_session
from hull_server.hull_pipeline import HullPipeline
from hull_server.settings import HullSettings
from icp_tracker.acquisition.t_pose_measures import TPoseSettings, measure_t_pose
from icp_tracker.acquisition.t_pose_source import TPoseSource, find_t_pose, pose_of
from icp_tracker.acquisition.upright import PoseRejected
from icp_tracker.tracker import IcpTracker
from mocap_packets.frame_set import FrameSet
from mocap_packets.hull import HullProducts, VoxelSamples
from mocap_pipeline.session_footage import exact_silhouettes
from stick_figure.body import Body
from stick_figure.kinematics import forward
from virtual_studio.motions.timeline import both_sides

BODY = Body.from_stature(1.75)
LEVEL, HANGING = both_sides(), both_sides(shoulder_x=DOWN + 0.1)
SIX, THREE = (5, True), (3, False)  # cameras around, and one on the ceiling


def degrees_between(first, second):
    return np.degrees(np.arccos(np.clip(first @ second, -1, 1)))


def find_pose(rig, *people):
    room = studio(*rig)
    return find_t_pose(room.render(*people), TPoseSettings(), room.visibility)


def answer_to(voxels):
    """What is made of one set that shows these voxels."""
    cloud = VoxelSamples(voxels, np.ones(len(voxels), bool))
    return TPoseSource(TPoseSettings(hold_sets=1)).find_pose(HullProducts.of_points(0, np.empty((0, 3)), voxels=cloud))


# --- found -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("rig", [SIX, THREE])
def test_t_pose_of_anybody_anywhere_is_found_and_never_taken_back_to_front(rig):
    rng = np.random.default_rng(rig[0])
    for _ in range(4):
        body = Body.from_stature(rng.uniform(1.4, 2.0))
        angles = both_sides(
            shoulder_x=np.radians(rng.uniform(-15, 15)),
            shoulder_z=rng.uniform(-0.15, 0.1),
            elbow=-rng.uniform(0, 0.3),
            hip_x=rng.uniform(0, 0.15),
            knee=0.05,
        )
        pose = standing(body, angles, rng.uniform(-np.pi, np.pi), rng.uniform(-0.2, 0.2, 2))
        measured, reason = find_pose(rig, person(body, pose, rng.uniform(0.85, 1.25)))
        assert measured is not None, reason
        assert degrees_between(measured.body.forward_world, pose.R_world_torso[:2, 0]) < 12
        found = pose_of([measured], body)
        error = np.linalg.norm(forward(body, found) - forward(body, pose), axis=1)
        assert error[[0, 2, 3, 4, 5, 6]].max() < 0.07  # the trunk
        assert error.max() < 0.20


def test_floor_shadow_on_one_side_makes_the_heading_unsure_rather_than_wrong():
    rng, found = np.random.default_rng(0), 0
    for heading in np.arange(-3.0, 3.0, 1.0):
        seen = studio(*SIX).render(person(BODY, standing(BODY, LEVEL, heading)))
        slab = rng.uniform([-0.6, -0.4, 0.0], [0.0, 0.2, 0.08], (300, 3))
        slab[:, 2] = 0.02 * np.round(slab[:, 2] / 0.02)
        answer = answer_to(np.concatenate([seen.voxels.points_world, slab]))
        if answer.pose is None:
            assert "front and back look alike" in answer.reason
        else:
            found += 1
            forward_world = answer.pose.R_world_torso[:2, 0]
            assert degrees_between(forward_world, np.array([np.cos(heading), np.sin(heading)])) < 10
    assert found >= 3


def test_lowered_arms_are_found_where_they_are_asked_for_and_refused_elsewhere():
    lowered = studio(*SIX).render(person(BODY, standing(BODY, both_sides(shoulder_x=-np.pi / 4), 2.0)))
    level = studio(*SIX).render(person(BODY, standing(BODY, LEVEL, 2.0)))
    asked = TPoseSettings(arms="lowered")
    found, _ = find_t_pose(lowered, asked)
    assert degrees_between(found.body.forward_world, np.array([np.cos(2.0), np.sin(2.0)])) < 5
    assert np.degrees([arm.elevation for arm in found.arms]) == pytest.approx([-45, -45], abs=4)
    assert "not level: one slopes by -4" in find_t_pose(lowered, TPoseSettings())[1]
    assert "not lowered by 45 degrees" in find_t_pose(level, asked)[1]


# --- refused ---------------------------------------------------------------------------------------------------------

REFUSED = {
    "arms hanging": (HANGING, "arms not stretched sideways"),
    "hands on the hips": (both_sides(shoulder_x=DOWN + 0.7, elbow=-1.7, shoulder_y=0.3), "arms not stretched sideways"),
    "one arm up": (angles_with(LEVEL, left_shoulder_x=1.5), "only one is"),
    "one arm hanging": (angles_with(LEVEL, left_shoulder_x=DOWN + 0.1), "only one is"),
    "both arms up": (both_sides(shoulder_x=1.4), "hands beside the head"),
    "arms lowered": (both_sides(shoulder_x=-np.pi / 4), "arms not level: one slopes by -4"),
    "arms ahead": (both_sides(shoulder_z=-0.9), "arms not straight sideways"),
    "sitting": (both_sides(hip_y=-1.5, knee=1.5), "sitting, or knees bent"),
    "in stride": (angles_with(LEVEL, left_hip_y=-0.4, right_hip_y=0.3), "one is 0.4"),
    "legs wide apart": (both_sides(hip_x=0.5), "legs too far apart"),
}


@pytest.mark.parametrize("rig", [SIX, THREE])
@pytest.mark.parametrize("name", REFUSED)
def test_other_pose_is_refused_with_its_own_reason(rig, name):
    angles, reason = REFUSED[name]
    measured, said = find_pose(rig, person(BODY, standing(BODY, angles, 0.3 if rig == SIX else 2.0)))
    assert measured is None and reason in said


@pytest.mark.parametrize(
    ("shape", "reason"),
    [
        (person(BODY, standing(BODY, both_sides(elbow=-1.2), 0.3)), "arm"),
        (person(BODY, standing(BODY, both_sides(elbow=-1.2, shoulder_y=np.pi / 2), 0.3)), "arm"),
        (person(BODY, standing(BODY, both_sides(hip_y=-0.7), 0.3, lean=0.7)), "not upright: the head is 0.4"),
        (box((-0.3, -0.4, 0.0), (0.3, 0.4, 1.4)), "no single head"),
        (box((-0.2, -0.8, 0.0), (0.2, 0.8, 1.5)), "no single head"),
    ],
    ids=["elbows ahead", "elbows up", "bending forward", "cart", "wide cart"],
)
def test_bent_people_and_carts_are_refused(shape, reason):
    measured, said = find_pose(SIX, shape)
    assert measured is None and reason in said


def test_nobody_and_scraps_are_refused():
    whole = studio(*SIX).render(person(BODY, standing(BODY, LEVEL))).voxels.points_world
    for voxels, reason in (
        (None, "no hull"),
        (whole[:0], "no hull"),
        (whole[:50], "too small: 50 voxels"),
        (0.5 * whole, "too small: 0.8"),
        (2.0 * whole, "too large: 3."),
    ):
        with pytest.raises(PoseRejected, match=reason):
            measure_t_pose(voxels)


# --- several bodies --------------------------------------------------------------------------------------------------


def test_body_in_the_t_pose_is_found_among_others_whatever_its_number():
    for place in (0.55, -0.55):
        pose = standing(BODY, LEVEL, 0.0, (place, 0.0))
        measured, reason = find_pose(SIX, person(BODY, pose), person(BODY, standing(BODY, HANGING, 1.0, (-place, 0.0))))
        assert measured is not None, reason
        assert np.linalg.norm(measured.body.centre_world - [place, 0.0]) < 0.05


@pytest.mark.parametrize(
    ("angles", "said"),
    [
        (LEVEL, r"2 bodies in a T-pose.*"),
        (HANGING, r"body \d: arms not stretched sideways; body \d: arms not stretched sideways"),
    ],
    ids=["both in a T-pose", "neither"],
)
def test_several_bodies_are_refused_where_not_one_alone_is_in_the_t_pose(angles, said):
    people = [person(BODY, standing(BODY, angles, 0.2, (x, 0.0))) for x in (0.6, -0.6)]
    assert re.fullmatch(said, find_pose(SIX, *people)[1])


@pytest.mark.parametrize("rig", [SIX, THREE])
def test_people_who_touch_are_refused(rig):
    behind = person(BODY, standing(BODY, LEVEL)), person(BODY, standing(BODY, HANGING, 0.0, (-0.24, 0.0)))
    beside = [person(BODY, standing(BODY, HANGING, 0.0, (0.0, y))) for y in (0.22, -0.22)]
    for people in (behind, beside):
        assert "more than one body" in find_pose(rig, *people)[1]


# --- held ------------------------------------------------------------------------------------------------------------


def moved(seen, stamp_ns, shift):
    voxels = VoxelSamples(seen.voxels.points_world + shift, seen.voxels.surface)
    return HullProducts.of_points(stamp_ns, seen.centerline.points_world + shift, voxels=voxels)


@pytest.fixture(scope="module")
def t_pose():
    return studio(*SIX).render(person(BODY, standing(BODY, LEVEL, 0.7)))


def test_t_pose_must_be_held(t_pose):
    source = TPoseSource(TPoseSettings(hold_sets=3))
    nobody = HullProducts.of_points(0, np.empty((0, 3)))
    sets = [moved(t_pose, k * SET_NS, 0.0) if seen else nobody for k, seen in enumerate([1, 1, 0, 1, 1, 1])]
    answers = [source.find_pose(seen) for seen in sets]
    assert [answer.reason for answer in answers] == [
        "T-pose seen, hold it (1 of 3)",
        "T-pose seen, hold it (2 of 3)",
        "no hull",
        "T-pose seen, hold it (1 of 3)",
        "T-pose seen, hold it (2 of 3)",
        "",
    ]
    assert answers[-1].pose is not None and answers[-1].estimate is not None


def test_known_body_keeps_its_sizes_in_a_t_pose(t_pose):
    source = TPoseSource(TPoseSettings(hold_sets=1), known=BODY)
    found = source.find_pose(t_pose)
    assert found.body is BODY and found.estimate is None
    error_m = np.linalg.norm(forward(BODY, found.pose) - forward(BODY, standing(BODY, LEVEL, 0.7)), axis=1)
    assert error_m.mean() < 0.05


def test_walking_with_arms_stretched_out_is_refused_until_it_ends(t_pose):
    source = TPoseSource(TPoseSettings())
    at = [np.array([0.8 * min(k, 11) / 60, 0.0, 0.0]) for k in range(20)]  # 0.8 m/s, and stops
    answers = [source.find_pose(moved(t_pose, k * SET_NS, shift)) for k, shift in enumerate(at)]
    assert all(answer.pose is None for answer in answers[:12])
    assert answers[11].reason == "stand still: moving at 0.8 m/s"
    found = next(answer for answer in answers if answer.pose is not None)
    middle = t_pose.voxels.points_world[:, :2].mean(axis=0) + at[-1][:2]
    assert np.linalg.norm(found.pose.position_world[:2] - middle) < 0.06


def test_somebody_else_starts_holding_anew(t_pose):
    source = TPoseSource(TPoseSettings(hold_sets=2))
    assert source.find_pose(moved(t_pose, 0, 0.0)).pose is None
    assert "1 of 2" in source.find_pose(moved(t_pose, SET_NS, np.array([0.5, 0.0, 0.0]))).reason


def test_person_without_feet_cannot_tell_front_from_back(t_pose):
    answer = answer_to(t_pose.voxels.points_world[t_pose.voxels.points_world[:, 2] > 0.12])
    assert answer.pose is None and "front and back look alike" in answer.reason


# --- rendered sessions with exact silhouettes -------------------------------------------------------------------------

HELD_SETS = 6  # of the T-pose with which every session begins


@pytest.mark.parametrize("name", ["walk_ring5top", "zombie_he3"])
def test_t_pose_of_a_rendered_person_is_found_and_fitted(shared_data, name):
    session = load_session(shared_data("sessions", name))
    truth = session.truth.stick_figure_points()
    tracker = IcpTracker(TPoseSource(TPoseSettings()))
    pipeline, masks = HullPipeline(session.rig, HullSettings(backend="cpu")), exact_silhouettes(session)
    stamps_ns = [1 + round(frame * 1e9 / session.fps) for frame in range(HELD_SETS)]
    sets = [FrameSet.of_instant(stamp_ns, next(masks)) for stamp_ns in stamps_ns]
    results = [tracker.step(pipeline.run(one).products) for one in sets]
    assert [r.state for r in results] == ["acquiring"] * 4 + ["tracking"] * 2
    found, expected = results[-1].reference_points_world, truth[HELD_SETS - 1]
    error_mm = 1e3 * np.linalg.norm(found - expected, axis=1)
    assert error_mm.mean() < 50
    assert error_mm.max() < 100  # left is left: the heading is not turned round
    across = [(points[3] - points[4])[:2] / np.linalg.norm((points[3] - points[4])[:2]) for points in (found, expected)]
    assert np.degrees(np.arccos(across[0] @ across[1])) < 8
