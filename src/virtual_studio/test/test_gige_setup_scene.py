"""A set-up served live: its phases, how they are switched, and what the cameras' users are told."""

import time

import cv2
import numpy as np
import pytest
import yaml

from capture_rig.errors import InputError
from virtual_studio.boards import PosedBoard, on_floor, print_of
from virtual_studio.gige import Studio, StudioSettings, free_addresses
from virtual_studio.gige.command import request_from, write_rig_files
from virtual_studio.gige.rendered_scenes import PHASES, LiveScene, RenderedSet, SetupScene
from virtual_studio.gige.scenes import Playback
from virtual_studio.recording.footage import FLOOR_BOARD, HAND_BOARD
from virtual_studio.rig import ring

SECOND_NS = 1_000_000_000


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


def test_phase_begins_for_all_cameras_at_the_same_instant(scene):
    scene.show("floor")
    scene.playback.occupy(True)
    scene.show("person")
    before, after = time.time_ns() - SECOND_NS, time.time_ns() + SECOND_NS
    assert (scene.render(before)["cam01"] != scene.render(after)["cam01"]).any()


def test_phases_follow_each_other_and_begin_again(scene):
    scene.show("empty")
    assert [scene.show("next") for _ in PHASES] == [*PHASES[1:], "empty"]
    assert scene.views["cam01"].image(time.time_ns() + SECOND_NS) is scene.empty("cam01")
    with pytest.raises(InputError, match=r"no phase 'lunch'.*empty, intrinsics, floor, moving, person"):
        scene.show("lunch")


class NothingHappens(LiveScene):
    def render(self, instant_ns):
        return {}


def test_cameras_that_look_at_one_instant_see_the_same_moment():
    scene = NothingHappens(Playback(1, 60.0), {}, most_hz=20.0)
    scene._sets.append(RenderedSet(100, {}))
    assert scene.newest(200).instant_ns == 100
    scene._sets.append(RenderedSet(150, {}))  # it was rendered too late for the first camera that looked
    assert scene.newest(200).instant_ns == 100
    assert scene.newest(300).instant_ns == 150


@pytest.fixture(scope="module")
def studio():
    address = free_addresses(1)[0]
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


def test_studio_without_a_setup_has_no_phases():
    with (
        Studio(StudioSettings(pattern=True, cameras=1, address=free_addresses(1)[0])) as studio,
        pytest.raises(InputError, match="--scene setup"),
    ):
        studio.handle({"do": "show", "phase": "floor"})
