"""What simulated cameras see: the pattern, a session's footage, the rendered room, a set-up served live."""

import time

import cv2
import numpy as np
import pytest
import yaml
from footage_clips import write_clip
from gige_client import eventually

from capture_rig.errors import InputError
from capture_rig.rig import save_rig
from capture_rig.session import load_session
from stick_figure.body import Body
from virtual_studio.boards import PosedBoard, on_floor, print_of
from virtual_studio.gige import Studio, StudioSettings, free_address
from virtual_studio.gige.__main__ import request_from, write_rig_files
from virtual_studio.gige.rendered_scenes import PHASES, RoomScene, SetupScene
from virtual_studio.gige.scenes import PatternScene, load_session_scene
from virtual_studio.motions.catalogue import MOTIONS
from virtual_studio.people import VolumetricBody
from virtual_studio.recording.footage import FLOOR_BOARD, HAND_BOARD
from virtual_studio.rendering.camera import WHITE, VirtualCamera
from virtual_studio.rendering.capsules import floor_shadow
from virtual_studio.rig import ring

SECOND_NS = 1_000_000_000
NOW_NS = 1_800_000_000 * SECOND_NS
FPS, FRAMES = 25.0, 12


@pytest.mark.parametrize("colour", [False, True])
def test_pattern_tells_its_number_and_instant_even_when_dimmed(colour):
    scene = PatternScene(colour=colour)
    for expected in range(3):
        picture = scene.image(NOW_NS + expected)
        assert picture.shape == scene.shape
        assert PatternScene.read(picture) == (expected, NOW_NS + expected)
        assert PatternScene.read((picture * 0.6).astype(np.uint8)) == (expected, NOW_NS + expected)


@pytest.fixture
def session(tmp_path):
    """Two cameras whose frames tell their number by their grey level; cam02 is in colour."""
    save_rig(ring(2, ceiling=False), tmp_path / "rig.yaml")
    greys = [np.full((480, 640), 20 + 10 * i, np.uint8) for i in range(FRAMES)]
    for name, images in (("cam01", greys), ("cam02", [cv2.merge([grey // 2, grey, grey]) for grey in greys])):
        write_clip(tmp_path / f"{name}.mkv", images, FPS, "FFV1")
        cv2.imwrite(str(tmp_path / f"{name}_background.png"), np.full((480, 640), 7, np.uint8))
    return load_session(tmp_path)


def test_session_s_cameras_see_the_same_frame_at_one_instant_in_grey_and_in_colour(session):
    scene = load_session_scene(session)
    epoch_ns = scene.playback.play(NOW_NS)
    for frame in (0, 5, FRAMES - 1, FRAMES + 2):
        instant = epoch_ns + round((frame + 0.1) * SECOND_NS / FPS)
        expected = 20 + 10 * (frame % FRAMES)
        assert scene.views["cam01"].image(instant)[3, 3] == expected
        assert scene.views["cam02"].image(instant)[3, 3] == pytest.approx([expected / 2, expected, expected], abs=1)
    assert scene.views["cam01"].shape == (480, 640)
    assert scene.views["cam02"].shape == scene.views["cam02"].background[0].shape == (480, 640, 3)


def test_empty_room_is_seen_while_nobody_is_there(session):
    scene = load_session_scene(session)
    assert scene.can_be_empty
    for occupied, least, most in ((False, 7, 7), (True, 20, 255)):
        scene.playback.occupied = occupied
        assert least <= scene.views["cam01"].image(NOW_NS).max() <= most
    (session.folder / "cam02_background.png").unlink()
    assert not load_session_scene(load_session(session.folder)).can_be_empty


def test_frames_that_do_not_fit_into_memory_are_left_out_for_every_camera_alike(session):
    colour_frame_mb = 480 * 640 * 3 / 1e6
    scene = load_session_scene(session, memory_mb=2 * 4.1 * colour_frame_mb / 0.75)
    assert scene.playback.frames == 4 and f"only the first 4 of {FRAMES} frames" in scene.notes[0]
    assert {len(view.frames) for view in scene.views.values()} == {4}
    with pytest.raises(InputError, match=r"one frame has 0\.9 MB.*--memory"):
        load_session_scene(session, memory_mb=1.0)


@pytest.fixture
def room():
    scene = RoomScene(ring(1, ceiling=False), seconds=2.0, most_hz=1000.0)
    scene.start()
    yield scene
    scene.close()


def test_room_shows_the_body_with_its_shadow_through_each_camera_s_lens(room):
    room.playback.hold()
    body = Body.from_stature(1.75)
    capsules = VolumetricBody(body).place(MOTIONS["tour"](body, 0.1, 60.0).poses[0])
    for model in ring(1, ceiling=False).cameras:
        camera = VirtualCamera(model)
        light, mask = camera.render(capsules, floor_shadow(capsules))
        expected = np.rint(light * WHITE).astype(np.uint8)
        # what was rendered before the person stood still is seen first
        eventually(lambda name=model.name, e=expected: np.array_equal(room.views[name].image(time.time_ns()), e))
        np.testing.assert_allclose(room.empty(model.name), camera.empty_room() * WHITE, atol=0.51)
        shaded = (expected.astype(int) < room.empty(model.name).astype(int) - 3) & (mask == 0)
        assert shaded.sum() > 500  # the shadow on the floor
    room.playback.occupied = False
    np.testing.assert_array_equal(room.views["cam01"].image(time.time_ns()), room.empty("cam01"))


def test_renderer_follows_the_cameras_which_see_one_moment_at_one_instant(room):
    seen = []

    def look():
        instant = time.time_ns()
        one, other = (room.views["cam01"].image(instant) for _ in range(2))
        assert one is other
        if not any(one is earlier for earlier in seen):
            seen.append(one)
        return len(seen) >= 4

    eventually(look)


# --- a set-up served live ---------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def scene():
    return SetupScene(ring(2, ceiling=False), seconds=2.0)  # not started: rendered when asked


def shown(scene, phase, seconds=1.0):
    """What the cameras see so long after a switch."""
    scene.show(phase)
    return scene.render(time.time_ns() + round(seconds * SECOND_NS))


def test_floor_board_lies_where_the_truth_says_in_every_picture(scene):
    printed = print_of(FLOOR_BOARD)
    corners_world = PosedBoard(printed, on_floor(printed)[None]).corners_world
    for name, picture in shown(scene, "floor").items():
        truth = ring(2, ceiling=False).camera(name).project(corners_world)
        stop = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_MAX_ITER, 50, 1e-4)
        found = cv2.cornerSubPix(picture, truth.astype(np.float32).reshape(-1, 1, 2), (2, 2), (-1, -1), stop)
        assert np.abs(found.reshape(-1, 2) - truth).max() < 0.4


def test_each_camera_is_shown_a_board_of_its_own_in_the_phase_of_intrinsics(scene):
    looks = [shown(scene, "intrinsics", seconds) for seconds in (1.25, 2.3, 3.3, 4.3)]
    size = HAND_BOARD.columns, HAND_BOARD.rows
    for name in scene.views:
        assert sum(cv2.findChessboardCornersSB(look[name], size)[0] for look in looks) >= 2


def test_phases_follow_each_other_and_begin_again(scene):
    scene.show("empty")
    assert [scene.show("next") for _ in PHASES] == [*PHASES[1:], "empty"]
    assert scene.views["cam01"].image(time.time_ns() + SECOND_NS) is scene.empty("cam01")
    with pytest.raises(InputError, match=r"no phase 'lunch'.*empty, intrinsics, floor, moving, person"):
        scene.show("lunch")


@pytest.fixture(scope="module")
def studio():
    address = free_address()
    with Studio(StudioSettings(scene="setup", cameras=1, address=address)) as studio:
        yield studio


def test_studio_switches_phases_on_request(studio):
    assert studio.handle({"do": "status"})["shows"] == "empty"
    assert studio.handle(request_from(["show", "floor"])) == {"shows": "floor"}
    assert studio.handle({"do": "status"})["shows"] == "floor"
    assert studio.handle(request_from(["show", "next"])) == {"shows": "moving"}
    studio.handle(request_from(["room", "empty"]))
    assert studio.handle({"do": "status"})["shows"] == "empty"
    studio.handle(request_from(["play", "once"]))
    assert studio.handle({"do": "status"})["shows"] == "person"


def test_files_of_a_setup_tell_nobody_the_calibration(studio, tmp_path):
    write_rig_files(studio, tmp_path)
    assert not (tmp_path / "rig.yaml").exists() and (tmp_path / "truth_rig.yaml").exists()
    assert (tmp_path / "board.yaml").exists() and (tmp_path / "floor_board.yaml").exists()
    (parameters,) = yaml.safe_load((tmp_path / "cameras" / "cam01.yaml").read_text()).values()
    assert "rig_file" not in parameters["ros__parameters"]
