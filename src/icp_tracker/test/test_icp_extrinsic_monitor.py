"""A camera that moved from its calibration is found by the outlines of tracked bodies; sound ones are not blamed."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from capture_rig.rig import Rig
from capture_rig.rigid import rotation_matrix
from hull_server.hull_pipeline import HullPipeline
from hull_server.settings import HullSettings
from icp_tracker.extrinsic_monitor import CalibrationSettings, ContourResiduals, ExtrinsicMonitor
from icp_tracker.people.people_tracker import make_people_tracker
from icp_tracker.settings import IcpNodeSettings
from mocap_packets.frame_set import FrameSet
from mocap_packets.hull import ContourRays
from stick_figure.least_squares.contour_factor import RayMatch
from virtual_studio.motions.catalogue import walk
from virtual_studio.people import VolumetricBody, person_of
from virtual_studio.rendering.camera import ExactSilhouettes
from virtual_studio.rig import ring

SET_NS, RAYS, NOISE_M = 100_000_000, 200, 0.008
SECONDS, SLOW_SECONDS = 60, 200
"""Sets (ten a second) in which a large error shows, and a small one."""


def rig_of(cameras):
    return Rig(ring(5).cameras[:cameras], ring(5).volume)


def body_at(rig, place_world, seed, errors):
    """Rays of every camera at the outline of an upright cylinder, and how far from it they pass: noise, and what
    motions (rotation vector, translation; in the camera's frame) and growth of some cameras, by number, do to them."""
    rng, parts = np.random.default_rng(seed), []
    for number, camera in enumerate(rig.cameras):
        points = np.array(place_world) + rng.uniform((-0.2, -0.2, 0.1), (0.2, 0.2, 1.7), (RAYS, 3))
        directions = points - camera.centre_world
        directions /= np.linalg.norm(directions, axis=1, keepdims=True)
        normals = np.cross(directions, rng.normal(size=(RAYS, 3)))
        normals /= np.linalg.norm(normals, axis=1, keepdims=True)
        turn, push, growth = errors.get(number, ((0, 0, 0), (0, 0, 0), 0.0))
        in_camera = (points - camera.centre_world) @ camera.R_camera_world.T
        motion = np.cross(np.radians(turn), in_camera) + push
        moved = np.einsum("ni,ni->n", motion, normals @ camera.R_camera_world.T)
        distance = moved + growth * np.linalg.norm(in_camera, axis=1) + rng.normal(scale=NOISE_M, size=RAYS)
        parts.append((points, directions, normals, np.full(RAYS, number), distance))
    points, directions, normals, camera, distance = (np.concatenate(part) for part in zip(*parts, strict=True))
    rays = ContourRays(points, directions, normals, np.full(len(points), 0.1), np.full(len(points), 0.002))
    rays = replace(rays, camera=camera.astype(np.int32))
    match = RayMatch(np.zeros(len(points), np.int64), np.zeros(len(points)), distance, np.abs(distance))
    return ContourResiduals(np.tile(place_world, (15, 1)) + 0.01 * rng.normal(size=(15, 3)), rays, match)


def walking(frame):
    return np.cos(0.07 * frame), np.sin(0.11 * frame), 0.0


def watched(monitor, rig, errors, sets=SECONDS, first=0, where=walking):
    for frame in range(first, first + sets):
        if monitor.is_due(frame * SET_NS):
            monitor.update(frame * SET_NS, [(1, body_at(rig, where(frame), frame, errors))])
    return monitor.errors


@pytest.mark.parametrize(
    "turn_deg, push_m", [((0.5, 0, 0), (0, 0, 0)), ((0, -0.5, 0), (0, 0, 0)), ((0, 0, 0), (0.05, 0, 0))]
)
def test_camera_that_moved_is_named_with_the_shift_that_it_shows(turn_deg, push_m):
    rig = rig_of(6)
    errors = watched(ExtrinsicMonitor(rig), rig, {2: (turn_deg, push_m, 0.0)})
    assert list(errors.suspects) == ["cam03"]
    shown = body_at(rig, (0, 0, 0), 1, {2: (turn_deg, push_m, 0.0)}).match.distance[2 * RAYS : 3 * RAYS]
    expected_m = np.sqrt(np.mean(shown**2) - NOISE_M**2) / (1 - 1 / 6)
    assert errors.shift_m["cam03"] == pytest.approx(expected_m, rel=0.25)
    assert errors.suspects["cam03"].startswith("cam03: people") and "calibrate again" in errors.suspects["cam03"]


def test_sound_cameras_show_no_shift_however_the_surface_and_the_silhouettes_err():
    rig = rig_of(6)
    grown = {0: ((0, 0, 0), (0, 0, 0), 0.006), 3: ((0, 0, 0), (0, 0, 0), -0.006)}  # rad: about 20 mm
    errors = watched(ExtrinsicMonitor(rig), rig, grown, SLOW_SECONDS)
    assert errors.suspects == {} and max(errors.shift_m.values()) < 0.001


@pytest.mark.parametrize("reach_m", [0.0, 0.1])
def test_body_that_stays_in_one_place_tells_nothing(reach_m):
    """Its surface errs alike all the time."""
    rig, turned = rig_of(6), {0: ((0, 3.0, 0), (0, 0, 0), 0.0)}
    errors = watched(ExtrinsicMonitor(rig), rig, turned, where=lambda frame: reach_m * np.array(walking(frame)))
    assert errors.suspects == {} and errors.shift_m == {}


def test_camera_that_is_put_back_is_no_suspect_any_more():
    rig = rig_of(6)
    monitor = ExtrinsicMonitor(rig)
    assert list(watched(monitor, rig, {4: ((0, 1.0, 0), (0, 0, 0), 0.0)}).suspects) == ["cam05"]
    assert watched(monitor, rig, {}, 2 * SLOW_SECONDS, SECONDS).suspects == {}


def test_three_cameras_do_not_tell_which_of_them_moved():
    rig = rig_of(3)
    third = ((0, 0.5, 0), (0, 0, 0), 0.0), ((0, 0.3, 0), (0, 0, 0), 0.0)
    errors = watched(ExtrinsicMonitor(rig), rig, {0: third[0], 2: third[1]})
    assert list(errors.suspects) == ["cam01", "cam03"]
    (text,) = set(errors.suspects.values())
    assert text.startswith("cam01, cam03: people")


def test_two_cameras_and_a_monitor_that_is_off_say_nothing():
    assert not ExtrinsicMonitor(rig_of(2)).is_due(0)
    assert not ExtrinsicMonitor(rig_of(6), CalibrationSettings(enabled=False)).is_due(0)


def test_stamps_that_go_back_sets_without_anybody_and_wild_numbers_do_no_harm():
    rig = rig_of(6)
    monitor = ExtrinsicMonitor(rig)
    watched(monitor, rig, {}, first=1000)
    assert monitor.update(2000 * SET_NS, []).suspects == {}
    assert monitor.is_due(0)
    wild = body_at(rig, walking(0), 0, {})
    wild.match.distance[7] = np.inf
    assert watched(monitor, rig, {}, 5).suspects == {} and monitor.update(SET_NS * 5, [(1, wild)]).suspects == {}
    assert list(watched(monitor, rig, {2: ((0.5, 0, 0), (0, 0, 0), 0.0)}, first=6).suspects) == ["cam03"]
    monitor.reset()
    assert monitor.errors.shift_m == {}


@cache
def footage():
    """A person who walks before six cameras, ten sets a second: their exact silhouettes."""
    body, eyes = person_of(1.75), ExactSilhouettes(ring(5))
    person = VolumetricBody(body)
    return [eyes.render(person.place(pose)) for pose in walk(body, 7.0, 10.0).poses]


@pytest.mark.parametrize("moved", ["", "cam02"])
def test_tracked_person_tells_which_of_six_cameras_was_turned_by_half_a_degree(moved):
    rig, turn = ring(5), np.eye(4)
    turn[:3, :3] = rotation_matrix(np.radians([0.0, 0.5, 0.0]))
    rig = replace(
        rig,
        cameras=tuple(
            replace(camera, T_camera_world=turn @ camera.T_camera_world) if camera.name == moved else camera
            for camera in rig.cameras
        ),
    )
    hulls, tracker = HullPipeline(rig, HullSettings(backend="cpu")), make_people_tracker(IcpNodeSettings(), rig)
    for frame, masks in enumerate(footage()):
        tracker.step(hulls.run(FrameSet.of_instant(frame * SET_NS, masks)).products, {})
    assert list(tracker.extrinsic_errors.suspects) == ([moved] if moved else [])
    assert len(tracker.extrinsic_errors.shift_m) == len(rig.cameras)
