"""A known body starts from anything near a T-pose, and from nothing else."""

import numpy as np
import pytest
from t_pose_studio import DOWN, SET_NS, both_sides, person, standing, studio, with_angles

from icp_tracker.acquisition.body_sizes import LimbGirths
from icp_tracker.acquisition.initial_pose import KnownPose
from icp_tracker.acquisition.known_body_source import SETS, KnownBodySource
from icp_tracker.acquisition.pose_source import AnyPoseSource, InitialPoseSettings, make_pose_source
from icp_tracker.acquisition.t_pose_measures import TPoseSettings
from icp_tracker.acquisition.t_pose_source import TPoseSource
from stick_figure.body import Body
from stick_figure.body_file import save_body
from stick_figure.kinematics import forward

BODY = Body.from_stature(1.75)
THREE, SIX = (3, False), (5, True)


def start(rig, body, *people, known=BODY):
    """The answer to the same people in as many sets as a start needs."""
    room = studio(*rig)
    source = KnownBodySource(TPoseSettings(), known, room.visibility)
    return [source.find_pose(room.render(*people, apart_ns=SET_NS)) for _ in range(SETS)]


@pytest.mark.parametrize(("rig", "limit_mm"), [(SIX, 25), (THREE, 60)])
def test_known_body_is_found_near_a_t_pose_whatever_its_heading(rig, limit_mm):
    rng = np.random.default_rng(5)
    for _ in range(6):
        u = rng.uniform
        bend = u(0, 0.5)  # a slight squat
        angles = with_angles(
            both_sides(),
            left_shoulder_x=u(-0.75, 0.75),
            right_shoulder_x=np.pi - u(-0.75, 0.75),
            left_elbow=-u(0, 0.4),
            left_shoulder_z=u(-0.3, 0.2),
            left_hip_x=u(0, 0.25),
            right_hip_x=-u(0, 0.25),
            left_hip_y=-bend / 2,
            right_hip_y=-bend / 2,
            left_knee=bend,
            right_knee=bend,
        )
        truth = standing(BODY, angles, u(-np.pi, np.pi), u(-0.2, 0.2, 2))
        answers = start(rig, BODY, person(BODY, truth))
        assert [answer.reason for answer in answers] == [
            "the known body seen (1 of 3)",
            "the known body seen (2 of 3)",
            "",
        ]
        found = answers[-1]
        assert found.body is BODY
        error_mm = 1e3 * np.linalg.norm(forward(BODY, found.pose) - forward(BODY, truth), axis=1)
        assert error_mm.mean() < limit_mm
        assert found.pose.R_world_torso[:, 0] @ truth.R_world_torso[:, 0] > 0.95


@pytest.mark.parametrize(
    ("angles", "reason"),
    [
        (both_sides(shoulder_x=DOWN + 0.1), "too far from a T-pose"),
        (both_sides(shoulder_x=1.4), "too far from a T-pose"),
        (both_sides(shoulder_z=-1.4), "too far from a T-pose"),
        (both_sides(hip_y=-1.5, knee=1.5), "does not fit: it is 1.75 m tall, and this one 1.3"),
    ],
)
def test_pose_far_from_a_t_pose_is_refused(angles, reason):
    assert reason in start(SIX, BODY, person(BODY, standing(BODY, angles, 0.8)))[-1].reason


def test_body_of_another_stature_is_refused():
    answer = start(SIX, BODY, person(BODY, standing(BODY, both_sides(), 0.8)), known=Body.from_stature(1.5))[-1]
    assert answer.pose is None and "does not fit" in answer.reason


def test_two_who_could_be_the_known_body_are_refused():
    people = [person(BODY, standing(BODY, both_sides(), 0.2, (x, 0.0))) for x in (0.6, -0.6)]
    assert "2 bodies could be the known one" in start(SIX, BODY, *people)[-1].reason


def test_body_file_chooses_the_start_that_needs_no_t_pose(tmp_path):
    save_body(BODY, tmp_path / "body.yaml", thickness={"thigh": 1.2})
    source = make_pose_source(
        InitialPoseSettings(source="t_pose"), str(tmp_path / "body.yaml"), studio(*SIX).visibility
    )
    assert isinstance(source, KnownBodySource)
    assert isinstance(make_pose_source(InitialPoseSettings(source="t_pose")), TPoseSource)
    assert isinstance(make_pose_source(InitialPoseSettings()), AnyPoseSource)
    room = studio(*SIX)
    people = person(BODY, standing(BODY, both_sides(shoulder_x=-0.5), 0.8))
    found = [source.find_pose(room.render(people, apart_ns=SET_NS)) for _ in range(SETS)][-1]
    assert found.girths == LimbGirths(thigh=1.2, measured=("thigh",))
    assert np.allclose(found.body.lengths, BODY.lengths)
    assert not KnownPose(found.pose, found.body).needs_voxels and source.needs_voxels
