"""The built-in person's motion, the studio's rigs, and scenes of several persons."""

from functools import cache

import numpy as np
import pytest

from capture_rig.errors import InputError
from capture_rig.session import load_session
from stick_figure.body import Body
from stick_figure.kinematics import forward
from stick_figure.skeleton import T_POSE_ANGLES
from virtual_studio.motions.catalogue import HARD_CASES, MOTIONS, T_POSE_S, t_pose_only, tour
from virtual_studio.motions.together import OUTSIDE_M, TOGETHER
from virtual_studio.people import OUTFITS, VolumetricBody, people_of_sizes, person_of
from virtual_studio.recording.session import write_scene
from virtual_studio.rig import VOLUME, azimuths, ring

BODY = Body.from_stature(1.75)


@cache
def whole_tour():
    return tour(BODY, seconds=21.0, fps=60)


def test_angles_of_the_poses_are_the_stated_ones():
    previous = None
    for pose, angles in zip(whole_tour().poses, whole_tour().angles, strict=True):
        previous = pose.angles(previous)
        np.testing.assert_allclose(previous, angles, atol=1e-9)


def test_motion_starts_with_one_second_of_exact_t_pose_and_a_t_pose_alone_never_moves():
    frames = round(T_POSE_S * 60)
    np.testing.assert_array_equal(whole_tour().angles[:frames], np.tile(T_POSE_ANGLES, (frames, 1)))
    positions = np.array([pose.position_world for pose in whole_tour().poses[:frames]])
    np.testing.assert_array_equal(positions, np.tile(positions[0], (frames, 1)))
    assert np.abs(whole_tour().angles[frames + 60] - T_POSE_ANGLES).max() > 1.0
    alone = t_pose_only(BODY, 2.0, 30)
    assert len(alone.poses) == 60 and np.ptp(alone.angles, axis=0).max() == 0.0


@pytest.mark.parametrize("motion", [tour, HARD_CASES["leave_and_return"]], ids=["tour", "leave and return"])
def test_truth_at_a_time_does_not_depend_on_the_frame_rate(motion):
    slow, fast = motion(BODY, 6.0, 20), motion(BODY, 6.0, 60)
    for a, b in zip(slow.poses, fast.poses[::3], strict=True):
        np.testing.assert_allclose(forward(BODY, a), forward(BODY, b), atol=1e-6)


@pytest.mark.parametrize(("seconds", "fps"), [(0.0, 60), (-1.0, 60), (2.0, 0.0), (0.001, 60)])
def test_impossible_times_are_refused(seconds, fps):
    for make in MOTIONS.values():
        with pytest.raises(InputError):
            make(BODY, seconds, fps)


@pytest.mark.parametrize("n", range(2, 13))
def test_ring_has_no_two_cameras_that_face_each_other(n):
    angles = azimuths(n)
    apart = np.abs((angles[:, None] - angles[None] + np.pi) % (2 * np.pi) - np.pi)
    facing = np.pi - apart
    assert facing.min() > np.radians(0.2 * 180 / n)
    assert apart[~np.eye(n, dtype=bool)].min() > np.radians(0.5 * 360 / n)


def test_ring_stands_where_it_should_and_looks_at_the_centre():
    rig = ring(5)
    assert rig.names == ("cam01", "cam02", "cam03", "cam04", "cam05", "cam06")
    for camera in rig.cameras:
        assert (camera.width, camera.height) == (640, 480)
        np.testing.assert_allclose(camera.R_camera_world @ camera.R_camera_world.T, np.eye(3), atol=1e-12)
        assert np.linalg.det(camera.R_camera_world) == pytest.approx(1.0)
        centre = camera.project(np.array([0.0, 0.0, 0.95]))
        assert np.abs(centre - [319.5, 239.5]).max() < 15
    for camera in rig.cameras[:5]:
        assert 1.2 <= camera.centre_world[2] <= 2.3
        assert np.linalg.norm(camera.centre_world - [0, 0, 0.95]) == pytest.approx(3.2, abs=0.2)
        assert (camera.R_camera_world @ np.array([0, 0, -1.0]))[1] > 0.9  # down in the world is down in the image
    assert rig.cameras[5].centre_world[2] > 3.0
    with pytest.raises(InputError, match="0 cameras"):
        ring(0)


# --- several persons --------------------------------------------------------------------------------------------------

PAIR = people_of_sizes(2)
RIGHT_HAND = 12


def places(motion):
    """(F, 2) the torso's place on the floor."""
    return np.array([pose.position_world[:2] for pose in motion.poses])


@pytest.fixture(scope="module")
def coming_later():
    """The motions of the two, 5 frames a second."""
    return TOGETHER["coming_later"].motions(PAIR, 5.0)


def test_second_person_comes_into_the_volume_leaves_it_and_comes_back(coming_later):
    staying, coming = map(places, coming_later)
    inside = (np.abs(coming) < VOLUME.high[:2]).all(axis=1)
    assert np.flatnonzero(np.diff(inside.astype(int))).size == 3  # in, out and in again
    assert coming[0, 0] == pytest.approx(OUTSIDE_M)
    assert np.linalg.norm(staying - staying[0], axis=1).max() < 0.4


@pytest.mark.slow
def test_persons_of_the_crowd_keep_out_of_each_others_way():
    motions = TOGETHER["crowd"].motions(people_of_sizes(4), 2.0)
    four = np.array([places(motion) for motion in motions])
    apart = np.linalg.norm(four[:, None] - four[None], axis=-1)[np.triu_indices(4, 1)]
    assert apart.min() > 0.5


@pytest.mark.slow
def test_session_of_a_scene_has_a_truth_and_a_body_for_each_person(tmp_path, coming_later):
    folder = write_scene(tmp_path / "scene", ring(1), "coming_later", PAIR, [OUTFITS["middle"]], fps=1.0)
    session = load_session(folder)
    assert [truth.source.name for truth in session.truths] == ["truth.csv", "truth_2.csv"]
    assert (folder / "body_2.yaml").is_file()
    for person, truth, motion in zip(PAIR, session.truths, coming_later, strict=True):
        np.testing.assert_allclose(truth.points_world[2], forward(person.body, motion.poses[10]), atol=1e-3)


@pytest.mark.slow
@pytest.mark.parametrize("persons", [PAIR, (VolumetricBody(person_of(1.9)), VolumetricBody(person_of(1.55)))])
def test_two_who_meet_pass_each_other_shake_hands_hug_and_part(persons):
    motions = TOGETHER["meeting"].motions(persons, 10.0)
    apart = np.linalg.norm(places(motions[0]) - places(motions[1]), axis=1)
    both = zip(persons, motions, strict=True)
    one, other = ([forward(p.body, pose)[RIGHT_HAND] for pose in motion.poses] for p, motion in both)
    shaking = np.linalg.norm(np.subtract(one, other), axis=1)
    assert 0.4 < apart[15:40].min() < 0.8  # they pass each other
    assert (shaking < 0.2).sum() >= 10  # and shake hands for a second
    assert 0.2 < apart[70:120].min() < 0.5  # the hug
    assert apart[-10:].min() > 0.9  # and part
