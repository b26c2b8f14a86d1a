"""The pipeline on exact silhouettes of the virtual studio."""

from dataclasses import replace

import numpy as np
import pytest
from simulated_detections import coco_joints, detect, hidden, write_detections

from capture_rig.errors import InputError
from capture_rig.rig import Rig
from ekf_tracker.filter import PeopleFilter
from icp_tracker.initialization.initial_pose import KnownPose
from icp_tracker.people.people_tracker import PeopleTracker
from icp_tracker.tracker import IcpTracker
from mocap_packets.frame_set import FrameSet
from mocap_pipeline.configuration import Configuration
from mocap_pipeline.pipeline import MocapPipeline, TrackingStage
from mocap_pipeline.session_footage import load_detections
from stick_figure.body import Body
from stick_figure.kinematics import forward
from stick_figure.least_squares.posed_model import BodyModel, PoseState, place
from virtual_studio.motions.catalogue import MOTIONS, t_pose_only
from virtual_studio.motions.together import TOGETHER
from virtual_studio.people import VolumetricBody, people_of_sizes, together
from virtual_studio.rendering.camera import ExactSilhouettes
from virtual_studio.rig import ring

FRAME_NS, STANDING = 16_666_667, 12
BODY = Body.from_stature(1.75)


@pytest.fixture(scope="module")
def t_pose():
    """Rig, silhouettes {camera: mask} and true points (15, 3) of somebody in a T-pose."""
    rig, pose = ring(5), t_pose_only(BODY, 0.1, 60.0).poses[0]
    return rig, ExactSilhouettes(rig).render(VolumetricBody(BODY).place(pose)), forward(BODY, pose)


@pytest.fixture
def standing(t_pose):
    """A pipeline that has tracked the T-pose, and the stamp of the set after."""
    rig, masks, _ = t_pose
    pipeline = MocapPipeline(rig, Configuration.of({"hull_server.backend": "cpu"}))
    steps = [pipeline.step_masks(FRAME_NS * frame, masks) for frame in range(1, STANDING + 1)]
    assert steps[-1].state is not None
    return pipeline, steps[-1], (STANDING + 1) * FRAME_NS


def test_pipeline_finds_and_follows_a_person_in_a_t_pose(standing, t_pose):
    _, step, _ = standing
    errors = np.linalg.norm(step.state.points_world - t_pose[2], axis=1)
    assert errors.mean() < 0.04
    assert errors.max() < 0.12


def test_detections_of_a_folder_move_the_fit_and_are_refused_with_the_column_that_is_missing(
    standing, t_pose, tmp_path
):
    (rig, masks, points), (pipeline, _, stamp_ns) = t_pose, standing
    placed = place(PoseState.of(t_pose_only(BODY, 0.1, 60.0).poses[0]), BodyModel.of(BODY))
    joints, rng = coco_joints(points, 1.0), np.random.default_rng(1)
    for camera in rig.cameras:
        write_detections(tmp_path, {7: detect(joints, placed, camera, 0, rng)})
    (images,) = load_detections(tmp_path, rig).values()
    assert [image.camera for image in images] == list(rig.names)
    found = np.isfinite([image.values[0, :, 0] for image in images])
    assert (
        found[~np.array([hidden(joints, placed, camera) for camera in rig.cameras])].mean() > 0.95 and not found.all()
    )
    before = pipeline.step_masks(stamp_ns, masks).fit
    fit = pipeline.step_masks(stamp_ns + FRAME_NS, masks, detections=images).fit
    moved = np.linalg.norm(fit.reference_points_world - before.reference_points_world, axis=1)
    assert 1e-4 < moved.max() < 0.03 and np.trace(fit.covariance[11]) < np.trace(before.covariance[11])
    table = tmp_path / f"{rig.names[0]}.csv"
    table.write_text(table.read_text().replace("left_knee_cov_xy", "left_knee_cov"))
    with pytest.raises(InputError, match="left_knee_cov_xy"):
        load_detections(tmp_path, rig)
    with pytest.raises(InputError, match="no table"):
        load_detections(tmp_path / "empty", rig)


def test_pipeline_goes_on_with_a_camera_missing(standing, t_pose):
    pipeline, _, stamp_ns = standing
    masks = {name: mask for name, mask in t_pose[1].items() if name != "cam03"}
    step = pipeline.step_masks(stamp_ns, masks, ("cam03",))
    assert np.linalg.norm(step.state.points_world - t_pose[2], axis=1).mean() < 0.04


@pytest.mark.slow
def test_a_runner_before_untriggered_cameras_is_where_the_rays_times_say():
    hz, fine_hz, sets = 30.0, 480.0, 18
    six, configuration = ring(5), Configuration.of({"hull_server.backend": "cpu"})
    rolling = tuple(replace(camera, line_time_s=15e-3 / camera.height) for camera in six.cameras)
    rig, person = Rig(rolling, six.volume), VolumetricBody(BODY)
    later_s = {name: 0.5 / hz * (number % 2) for number, name in enumerate(rig.names)}
    poses = MOTIONS["run"](BODY, 3.4, fine_hz).poses
    eyes, hull = ExactSilhouettes(rig), MocapPipeline(rig, configuration).hull

    def pose_at(time_s):
        return poses[round(fine_hz * time_s)]

    def follower():
        known = KnownPose(pose_at(2.6 + 0.25 / hz), BODY)
        tracker = PeopleTracker(lambda: IcpTracker(known, configuration.icp))
        return TrackingStage(tracker, PeopleFilter(configuration.ekf))

    errors_m, stages = {"timed": [], "as if in step": []}, [follower(), follower()]
    for k in range(sets):
        masks = eyes.expose(lambda time_s: person.place(pose_at(time_s)), 2.6 + k / hz, later_s)
        stamps_ns = {name: round((k / hz + later_s[name]) * 1e9) for name in rig.names}
        products = hull.run(FrameSet.of_stamps(stamps_ns, masks)).products
        rays = products.contour_rays
        truth = forward(BODY, pose_at(2.6 + products.stamp_ns * 1e-9))
        untimed = replace(products, contour_rays=replace(rays, time_s=np.zeros(len(rays))))
        for stage, seen, errors in zip(stages, (products, untimed), errors_m.values(), strict=True):
            errors.append(np.linalg.norm(stage.step(seen).state.points_world - truth, axis=1))
    timed, untimed = (np.mean(errors[sets // 3 :]) for errors in errors_m.values())
    assert timed < 0.0115 and timed < 0.8 * untimed


@pytest.mark.slow
def test_two_who_pass_shake_hands_hug_and_part_are_followed_without_being_exchanged():
    fps, rig, persons = 30.0, ring(5), people_of_sizes(2)
    motions, eyes = TOGETHER["meeting"].motions(persons, fps), ExactSilhouettes(rig)
    pipeline = MocapPipeline(rig, Configuration.of({"hull_server.backend": "cpu"}))
    errors: dict[int, list[np.ndarray]] = {1: [], 2: []}  # mm from each of the two, by the tracker's number
    for frame, poses in enumerate(zip(*(motion.poses for motion in motions), strict=True)):
        masks = eyes.render(together(*(person.place(pose) for person, pose in zip(persons, poses, strict=True))))
        true = [forward(person.body, pose) for person, pose in zip(persons, poses, strict=True)]
        for person in pipeline.step_masks(round((frame + 1) * 1e9 / fps), masks).people:
            if person.state is not None:
                off = [np.linalg.norm(person.state.points_world - points, axis=1).mean() for points in true]
                errors[person.person].append(1e3 * np.array(off))
    for rows in errors.values():
        from_each = np.array(rows)
        assert len(from_each) > 0.95 * len(motions[0].poses)
        assert len(set(from_each.argmin(axis=1))) == 1  # always the same one
        assert from_each.min(axis=1).mean() < 25.0
    assert {int(np.argmin(rows[0])) for rows in errors.values()} == {0, 1}
