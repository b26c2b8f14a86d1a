"""A camera that was bumped is told by its own picture; people, light and furniture that moved tell nothing of it.

The oracle is the virtual studio: it paints its room for a camera that stands where it was turned or pushed to.
"""

from dataclasses import replace
from functools import cache
from itertools import islice

import cv2
import numpy as np
import pytest
from camera_pictures import learned

from camera_client.alignment import PictureAlignment
from camera_client.background.model import BackgroundModel, Provenance, load_background, read_background
from camera_client.background.training_verdict import turn_findings
from camera_client.diagnostics import CameraState, Level, assess, frame_values
from camera_client.frame_processor import FrameProcessor, FrameResult
from camera_client.frame_source import Frame
from camera_client.movement import CameraMovedDetector, Movement, MovementState, carry_turn_over, turn_when_learned
from camera_client.settings import CameraClientSettings, CameraMovedSettings
from camera_client.sources.grab_loop import GrabState
from capture_rig.rig import load_rig
from capture_rig.video import Video
from virtual_studio.rendering.camera import Sensor
from virtual_studio.rig import ring, view_room

NOISE, PERIOD_NS = 3.0, 500_000_000
SENSOR = Sensor(NOISE, 0.01, 4)


def studio_camera(number=1):
    return ring(5).cameras[number]


def moved(camera, turn_deg=(0, 0, 0), push_m=(0, 0, 0)):
    """The camera where it stands after a turn about its own axes (x right, y down, z forward), or a push along them."""
    T = np.eye(4)
    T[:3, :3] = cv2.Rodrigues(np.radians(np.array(turn_deg, float)))[0]
    T[:3, 3] = push_m
    return replace(camera, T_camera_world=T @ camera.T_camera_world)


@cache
def light_of(number, turn_deg=(0, 0, 0), push_m=(0, 0, 0)):
    return view_room(moved(studio_camera(number), turn_deg, push_m)).grey


def picture(number=1, frame=0, light=1.0, **where):
    return SENSOR.expose(light_of(number, **where) * np.float32(light), number, frame)


@cache
def background(number=1, **where):
    return learned(picture(number, 1000 + frame, **where) for frame in range(12))


def with_person(image, share=0.5, seed=0):
    """Somebody in a pattern of their own stands before a share of the picture; a shadow falls on some of the rest."""
    rng = np.random.default_rng(seed)
    wide = round(share * image.shape[1])
    texture = cv2.resize(rng.uniform(70, 180, (40, 53)).astype(np.float32), image.shape[::-1])
    hidden = image.copy()
    hidden[:, :wide] = texture[:, :wide]
    hidden[340:, wide:] = (hidden[340:, wide:] * 0.6).astype(np.uint8)
    return hidden


def watched(watch, pictures, start=0):
    for number, image in enumerate(pictures, start):
        movement = watch.update(image, (number + 1) * PERIOD_NS)
    return movement


TURNS_DEG = [((0.3, 0, 0), 0.5), ((0, -1.0, 0), 0.5), ((0, 0, 2.0), 0.5), ((1.2, -1.5, 0.4), 0.4), ((-4, 3, -2), 0.2)]


@pytest.mark.parametrize(("turn_deg", "hidden"), TURNS_DEG)
def test_turn_of_the_camera_is_found_to_a_tenth_of_a_degree_with_somebody_in_the_picture(turn_deg, hidden):
    alignment = PictureAlignment(studio_camera(), background().mean, NOISE)
    found = alignment.align(with_person(picture(frame=1, light=0.8, turn_deg=turn_deg), hidden))
    assert np.degrees(found.turn_rad) == pytest.approx(turn_deg, abs=0.1)
    assert found.agreeing > found.agreeing_unmoved + 0.1


def test_camera_that_did_not_move_is_still_whatever_happens_before_it():
    watch = CameraMovedDetector(studio_camera(), background())
    for light, share in ((1.0, 0.0), (0.6, 0.3), (1.2, 0.5), (0.9, 0.1)):
        movement = watched(watch, [with_person(picture(frame=f, light=light), share, f) for f in range(4)])
        watch = CameraMovedDetector(studio_camera(), background())
        assert movement.state is MovementState.STILL
        assert np.degrees(np.linalg.norm(movement.turn_rad)) < 0.05


def test_chair_that_was_moved_is_no_movement_of_the_camera():
    chair = picture(frame=3)
    here, there = (slice(200, 400), slice(120, 240)), (slice(200, 400), slice(400, 520))
    chair[here], chair[there] = chair[there].copy(), chair[here].copy()
    movement = watched(CameraMovedDetector(studio_camera(), background()), [chair] * 4)
    assert movement.state is MovementState.STILL and np.degrees(np.linalg.norm(movement.turn_rad)) < 0.02


def test_bumped_camera_is_named_in_the_third_look_with_pixels_degrees_and_remedy_until_it_is_put_back():
    watch, camera = CameraMovedDetector(studio_camera(), background()), studio_camera()
    assert watched(watch, [picture(frame=f) for f in range(3)]).describe("cam03") == ""
    bumped = [picture(frame=f, turn_deg=(0, 1.0, 0.5)) for f in range(3)]
    assert watched(watch, bumped[:1], 3).state is MovementState.STILL  # one bad picture is no movement
    movement = watched(watch, bumped[1:], 4)
    assert movement.state is MovementState.MOVED
    assert movement.shift_px == pytest.approx(camera.K[0, 0] * np.tan(np.radians(1.0)), rel=0.1)
    assert movement.turned_deg == pytest.approx(0.5, abs=0.05)
    text = movement.describe("cam03")
    assert text.startswith("cam03 was moved: its picture is shifted by ") and "(1.0 degrees), turned by 0.5" in text
    assert "put it back, or calibrate it" in text
    assert watched(watch, [picture(frame=f) for f in range(4)], 6).state is MovementState.STILL


@pytest.mark.parametrize("push_m", [(0.05, 0, 0), (0, 0.05, 0)])
def test_camera_that_was_pushed_by_five_centimetres_is_named(push_m):
    watch = CameraMovedDetector(studio_camera(), background())
    movement = watched(watch, [with_person(picture(frame=f, push_m=push_m), 0.2, f) for f in range(4)])
    assert movement.state is MovementState.MOVED
    assert 0.2 < np.degrees(np.linalg.norm(movement.turn_rad)) < 1.0  # 0.05 m at 3 m to 8 m


def test_plain_walls_tell_nothing_and_nobody_is_named():
    camera, wall = studio_camera(), np.full((480, 640), 128, np.float32)
    model = BackgroundModel(wall, np.full_like(wall, 2.0), Provenance("a wall", 50, 2.0))
    watch = CameraMovedDetector(camera, model)
    rng = np.random.default_rng(0)
    movement = watched(watch, [np.clip(wall + rng.normal(0, 2, wall.shape), 0, 255).astype(np.uint8)] * 4)
    assert movement.state is MovementState.UNKNOWN and movement.values() == {"camera_moved": "cannot tell"}
    assert movement.describe("cam01") == ""


def test_picture_of_another_place_is_told_after_three_seconds_and_not_as_a_turn():
    watch = CameraMovedDetector(studio_camera(), background())
    elsewhere = [picture(frame=f, turn_deg=(0, 60.0, 0)) for f in range(8)]
    assert watched(watch, elsewhere[:3]).state is MovementState.UNKNOWN
    movement = watched(watch, elsewhere, 3)
    assert movement.state is MovementState.LOST and "shows something else" in movement.describe("cam01")


def test_looks_are_half_a_second_apart_and_go_on_when_stamps_go_back():
    watch, image = CameraMovedDetector(studio_camera(), background()), picture(frame=1)
    for stamp_ms in (0, 100, 400, 500, 900, 1000):
        movement = watch.update(image, stamp_ms * 1_000_000)
    assert movement.state is MovementState.STILL  # at 0, 500 and 1000 ms
    bumped = picture(frame=2, turn_deg=(0, 1.0, 0))
    for stamp_ms in (0, 500):
        movement = watch.update(bumped, stamp_ms * 1_000_000)
    assert movement.state is MovementState.MOVED


def test_limit_of_zero_switches_the_watch_off():
    watch = CameraMovedDetector(studio_camera(), background(), CameraMovedSettings(limit_deg=0.0))
    assert watched(watch, [picture(frame=f, turn_deg=(0, 2.0, 0)) for f in range(4)]).state is MovementState.UNKNOWN


def test_background_learned_anew_after_a_bump_remembers_the_turn_until_the_camera_is_calibrated(tmp_path):
    camera, turn_deg = studio_camera(), (0.0, 1.0, 0.0)
    first = carry_turn_over(background(), None, camera)
    assert turn_findings(first.provenance) == ()
    again = carry_turn_over(background(turn_deg=turn_deg), first, camera)
    assert np.degrees(turn_when_learned(again.provenance, camera)) == pytest.approx(turn_deg, abs=0.05)
    (finding,) = turn_findings(again.provenance)
    assert "turned by 1.0 degrees" in finding.what and finding.remedy == "calibrate it again"
    third = carry_turn_over(background(turn_deg=turn_deg), again, camera)  # and once more, without touching the camera
    third.save(tmp_path / "background.npz")
    about = load_background(tmp_path / "background.npz").provenance
    assert np.degrees(turn_when_learned(about, camera)) == pytest.approx(turn_deg, abs=0.05)
    watch = CameraMovedDetector(camera, third, since_rad=turn_when_learned(about, camera))
    assert watched(watch, [picture(frame=f, turn_deg=turn_deg) for f in range(4)]).state is MovementState.MOVED
    assert turn_when_learned(about, moved(camera, turn_deg)) == pytest.approx(np.zeros(3))  # calibrated where it stands


def test_chain_names_the_bumped_camera_while_its_silhouette_floods_and_after_it_learned_the_background_again():
    processor, turn_deg = FrameProcessor(studio_camera(), CameraClientSettings(), ring(5).volume), (0, 2.0, 0)
    processor.use_learned_background(background())

    def shown(looks, **where):
        for k in looks:
            result = processor.run(Frame(picture(frame=k, **where), (k + 1) * PERIOD_NS, k, "a test"))
        return result

    honest = shown(range(3)).silhouette.foreground_fraction
    result = shown(range(3, 6), turn_deg=turn_deg)
    assert result.silhouette.foreground_fraction > honest + 0.005
    assert result.movement.state is MovementState.MOVED
    processor.use_learned_background(background(turn_deg=turn_deg))
    result = shown(range(6, 10), turn_deg=turn_deg)
    assert result.silhouette.foreground_fraction < 0.01
    assert result.movement.state is MovementState.MOVED and result.movement.swing_deg == pytest.approx(2.0, abs=0.05)


def test_diagnostics_tell_of_the_movement_as_an_error_with_figures():
    camera = studio_camera()
    movement = Movement(MovementState.MOVED, np.array([0.02, 0, 0]), 5.0, 0.6)
    result = FrameResult(camera, (), movement=movement)
    told = assess(CameraState(GrabState.RUNNING, result=result))
    assert told == (Level.ERROR, movement.describe(camera.name))
    values = frame_values(Frame(picture(), 1, 1, "a test"), result)
    assert values["camera_shift_px"] == 5.0 and values["camera_turn_deg"] == 0.0
    assert values["camera_moved"] == "was moved"


def test_real_footage_is_still_and_named_when_it_is_turned_by_a_degree(shared_data):
    folder = shared_data("real_4cam")
    camera = load_rig(folder / "rig.yaml").camera("cam03")
    shape = (camera.height, camera.width, 3)
    model = read_background(folder / "cam03_background.png", shape)
    with Video(folder / "cam03.mp4") as video:
        frames = list(islice(video, 0, 61, 15))
    movement = watched(CameraMovedDetector(camera, model), frames)
    assert movement.state is MovementState.STILL and np.degrees(np.linalg.norm(movement.turn_rad)) < 0.02
    R = cv2.Rodrigues(np.radians([0.6, 0.7, -0.4]))[0]
    H = camera.K @ R @ np.linalg.inv(camera.K)
    warped = [cv2.warpPerspective(f, H, f.shape[1::-1], borderMode=cv2.BORDER_REPLICATE) for f in frames]
    movement = watched(CameraMovedDetector(camera, model), warped)
    assert movement.state is MovementState.MOVED
    assert np.degrees(movement.turn_rad) == pytest.approx([0.6, 0.7, -0.4], abs=0.1)
