"""``sagoma calibrate extrinsics`` from pictures to files, outer corners, and what it says of input it cannot use."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
import yaml
from calibration_room import (
    corner_pixels,
    on_floor,
    outer_pixels,
    picture,
    three_cameras,
    write_intrinsics,
    write_pictures,
)
from footage_clips import write_clip

from capture_rig.rig import load_rig, save_rig
from rig_calibration.boards.board import Checkerboard
from sagoma_tools.calibration.rig_detections import read_corners
from sagoma_tools.cli import main

BOARD = Checkerboard(7, 4, (0.12, 0.12))
BOARD_TEXT = "checkerboard 7x4 120mm"
REDO, BAD_INPUT = 1, 2
TURN = 0.4


@pytest.fixture(scope="module")
def cameras():
    return three_cameras()


@pytest.fixture(scope="module")
def floor_pictures(cameras):
    return {name: picture(camera, BOARD, on_floor(BOARD, TURN)) for name, camera in cameras.items()}


@pytest.fixture()
def room(tmp_path, cameras, floor_pictures):
    """A folder with intrinsics/ and floor/."""
    write_intrinsics(tmp_path / "intrinsics", cameras)
    write_pictures(tmp_path / "floor", {name: [image] for name, image in floor_pictures.items()})
    return tmp_path


def calibrate(room, *more, floor=True, board=BOARD_TEXT):
    pictures = ["--floor", room / "floor"] if floor else []
    given = ["--intrinsics", room / "intrinsics", "--board", board, "--output", room / "rig.yaml"]
    return main(["calibrate", "extrinsics", *map(str, [*pictures, *given, *more])])


def complaint(capsys, room, *more, floor=True):
    """What it says when it cannot use the input."""
    assert calibrate(room, *more, floor=floor) == BAD_INPUT
    return capsys.readouterr().err


def place_errors_mm(path, cameras):
    """In the frame of the floor board, whose rows were turned by TURN from the room's x."""
    c, s = np.cos(TURN), np.sin(TURN)
    R_floor_room = np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])
    return {
        camera.name: 1e3 * float(np.linalg.norm(camera.centre_world - R_floor_room @ cameras[camera.name].centre_world))
        for camera in load_rig(path).cameras
    }


def test_floor_pictures_give_rig_report_and_pictures_and_the_same_bytes_twice(room, cameras, capsys):
    assert calibrate(room) == 0
    printed = capsys.readouterr().out
    once = (room / "rig.yaml").read_bytes()
    assert max(place_errors_mm(room / "rig.yaml", cameras).values()) < 10.0
    report = yaml.safe_load((room / "rig.report.yaml").read_text())
    assert report["cameras"]["cam01"]["height_m"] == pytest.approx(1.6, abs=0.01)
    assert "the lens of cam01 is 1.6" in printed and "Measure with a tape" in printed
    overlay = cv2.imread(str(room / "rig_cam02.png"))
    x, y = corner_pixels(cameras["cam02"], BOARD, on_floor(BOARD, TURN))[5]
    around = overlay[int(y) - 6 : int(y) + 8, int(x) - 6 : int(x) + 8].reshape(-1, 3)
    blue, green, red = around.astype(int).T
    assert ((blue > 200) & (green > 200) & (red < 100)).sum() > 8, "a circle around a corner that was found"
    assert cv2.imread(str(room / "rig.png")).shape[1] > 1000
    assert calibrate(room) == 0
    assert (room / "rig.yaml").read_bytes() == once


@pytest.mark.slow
def test_lenses_may_come_from_a_rig_file(room, cameras):
    assert calibrate(room) == 0
    rig = load_rig(room / "rig.yaml")
    moved = replace(rig, cameras=tuple(replace(c, T_camera_world=np.eye(4)) for c in rig.cameras))
    save_rig(moved, room / "old.yaml")
    once = (room / "rig.yaml").read_bytes()
    assert calibrate(room, "--intrinsics", room / "old.yaml") == 0  # the last one counts
    assert (room / "rig.yaml").read_bytes() == once


def test_wrong_size_that_a_tape_reveals_is_redo(room, cameras, capsys):
    apart = np.linalg.norm(cameras["cam01"].centre_world - cameras["cam02"].centre_world)
    assert calibrate(room, "--check", "cam01", "cam02", f"{apart / 1.05:.3f}") == REDO
    printed = " ".join(capsys.readouterr().out.split())
    assert "verdict: REDO" in printed and "+5." in printed and "measure the print" in printed


def test_camera_without_a_board_is_named_and_may_be_left_out_or_its_corners_clicked(room, capsys):
    cv2.imwrite(str(room / "floor" / "cam03.png"), np.full((480, 640), 90, np.uint8))
    said = complaint(capsys, room, "--click")
    assert "corners are wanted of cam03" in said and "cam03_click.png" in said and "--corners" in said
    assert cv2.imread(str(room / "cam03_click.png")).shape == (1200, 1600, 3)
    assert list(yaml.safe_load((room / "rig.corners.yaml").read_text())) == ["cam03"]
    (room / "corners.yaml").write_text("cam03: [[10, 10], [90, 12], [95, 60], [12, 66]]\n")  # of something else
    assert "cam03" in complaint(capsys, room, "--corners", room / "corners.yaml")
    said = complaint(capsys, room)
    assert "no board was found for cam03" in said and "--corners" in said and "--without cam03" in said
    assert calibrate(room, "--without", "cam03") == 0
    assert load_rig(room / "rig.yaml").names == ("cam01", "cam02")


def test_lenses_that_are_missing_or_of_another_camera_or_image_size_are_refused(room, capsys):
    lens = room / "intrinsics" / "cam02.yaml"
    image = cv2.imread(str(room / "floor" / "cam02.png"))
    cv2.imwrite(str(room / "floor" / "cam02.png"), cv2.resize(image, (1280, 960), interpolation=cv2.INTER_CUBIC))
    assert "cam02: its images are 1280 x 960 pixels, its intrinsics are for 640 x 480" in complaint(capsys, room)
    lens.write_bytes((room / "intrinsics" / "cam01.yaml").read_bytes())
    assert "camera_name = 'cam01' is not this camera, 'cam02'" in complaint(capsys, room)
    lens.unlink()
    said = complaint(capsys, room)
    assert "camera 'cam02'" in said and "sagoma calibrate intrinsics" in said


def test_films_of_a_carried_board_at_different_rates_are_refused_with_the_rates(room, floor_pictures, capsys):
    (room / "films").mkdir()
    for name, fps in (("cam01", 25.0), ("cam02", 50.0)):
        write_clip(room / "films" / f"{name}.avi", [floor_pictures[name]] * 4, fps, "XVID")
    said = complaint(capsys, room, "--moving", room / "films", floor=False)
    assert "different frame rates (cam01 25, cam02 50 fps): frame k of each is not of the same instant" in said
    assert "ffmpeg -i IN -r RATE" in said


def test_measured_points_on_the_floor_serve_instead_of_a_board(room, cameras, capsys):
    points = {"A": [-0.8, -0.5], "B": [0.8, -0.5], "C": [0.8, 0.6], "D": [-0.8, 0.6], "E": [0.0, 0.0, 0.4]}
    world = np.array([[*xy, 0.0][:3] for xy in points.values()])
    rng = np.random.default_rng(4)
    seen = {}
    for name, camera in cameras.items():
        clicked = camera.project(world) + 0.3 * rng.standard_normal((5, 2))
        seen[name] = dict(zip(points, clicked.round(1).tolist(), strict=True))
    path = room / "points.yaml"
    path.write_text(yaml.safe_dump({"points": points, "cameras": seen}))
    assert calibrate(room, "--floor-points", path, floor=False) == 0, capsys.readouterr()
    for camera in load_rig(room / "rig.yaml").cameras:
        assert np.linalg.norm(camera.centre_world - cameras[camera.name].centre_world) < 0.03


def hidden(image, camera):
    """The picture with a box standing across the board."""
    corners = corner_pixels(camera, BOARD, on_floor(BOARD, TURN)).reshape(4, 7, 2)
    across = corners[[0, 1, 2, 3], [1, 2, 3, 4]]
    low, high = (across.min(axis=0) - 9).astype(int), (across.max(axis=0) + 9).astype(int)
    return cv2.rectangle(image.copy(), low.tolist(), high.tolist(), 140, cv2.FILLED)


def test_outer_corners_from_a_file_serve_where_the_board_is_not_found(room, cameras, floor_pictures, capsys):
    cv2.imwrite(str(room / "floor" / "cam03.png"), hidden(floor_pictures["cam03"], cameras["cam03"]))
    assert "cam03" in complaint(capsys, room)
    rough = outer_pixels(cameras["cam03"], BOARD, on_floor(BOARD, TURN), 7)
    rough += [[3.0, -2.0], [-2.0, 2.0], [2.0, 3.0], [-3.0, -1.0]]
    path = room / "corners.yaml"
    path.write_text(yaml.safe_dump({"cam07": rough.tolist()}))
    assert "there is no camera 'cam07'" in complaint(capsys, room, "--corners", path)
    path.write_text(yaml.safe_dump({"cam03": rough.tolist()}))
    assert calibrate(room, "--corners", path) == 0
    assert place_errors_mm(room / "rig.yaml", cameras)["cam03"] < 25.0


def test_corners_file_gives_corners_with_or_without_a_frame(tmp_path):
    corners, path = [[1.0, 2.0], [9.0, 2.0], [9.0, 7.0], [1.0, 7.0]], tmp_path / "corners.yaml"
    path.write_text(f"cam01: {corners}\ncam02: {{corners: {corners}, frame: 7}}\n")
    read = {name: (one.frame, one.pixels.tolist()) for name, one in read_corners(path).items()}
    assert read == {"cam01": (None, corners), "cam02": (7, corners)}
