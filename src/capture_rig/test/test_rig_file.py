"""The rig file: exact round trip, and an error that names file, key, value and remedy for everything wrong."""

import copy
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from capture_rig.errors import InputError
from capture_rig.rig import MAX_CAMERAS, load_rig, save_rig
from capture_rig.session import load_session

CAMERA = {
    "image_width": 640,
    "image_height": 480,
    "camera_matrix": [[469.2772007972855, 0.0, 316.4], [0.0, 468.38, 243.9], [0.0, 0.0, 1.0]],
    "distortion_model": "plumb_bob",
    "distortion": [-0.18, 0.08, 0.0003, -0.0005, 0.0],
    "R_camera_world": [[0.0, -1.0, 0.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]],
    "t_camera_world": [0.1, 1.0, 3.0],
}


DATA = Path(__file__).parent / "data"


def test_rig_that_version_0_1_saved_is_read() -> None:
    rig = load_rig(DATA / "rig_0_1.yaml")
    assert rig.names == ("cam01", "cam02") and rig.volume.high.tolist() == [2.0, 2.5, 2.4]
    assert [camera.distortion_model for camera in rig.cameras] == ["plumb_bob", "rational_polynomial"]
    pixels = [camera.project([0.3, -0.2, 1.0]) for camera in rig.cameras]
    assert np.allclose(pixels, [[393.297519789, 517.702976885], [366.796923012, 592.275796753]], atol=1e-6)
    assert np.allclose(rig.cameras[0].centre_world, [1.067900912, 2.839139993, -0.893796253], atol=1e-8)


def document(**changes: Any) -> dict[str, Any]:
    """Two good cameras; ``changes`` replace keys of cam02."""
    return {"cameras": {"cam02": {**copy.deepcopy(CAMERA), **changes}, "cam01": copy.deepcopy(CAMERA)}}


def write(tmp_path: Path, content: dict[str, Any] | str) -> Path:
    path = tmp_path / "rig.yaml"
    path.write_text(content if isinstance(content, str) else yaml.safe_dump(content))
    return path


def refusal(tmp_path: Path, content: dict[str, Any] | str) -> str:
    with pytest.raises(InputError) as caught:
        load_rig(write(tmp_path, content))
    text = str(caught.value)
    assert str(tmp_path / "rig.yaml") in text
    assert caught.value.remedy
    return text


def test_rig_has_its_cameras_in_name_order_with_every_number_of_their_entries(tmp_path: Path) -> None:
    rig = load_rig(write(tmp_path, document(image_width=800)))
    assert rig.names == ("cam01", "cam02")
    assert [camera.width for camera in rig.cameras] == [640, 800] and rig.camera("cam02").width == 800
    camera = rig.camera("cam01")
    assert camera.K.tolist() == CAMERA["camera_matrix"] and camera.D.tolist() == CAMERA["distortion"]
    assert camera.R_camera_world.tolist() == CAMERA["R_camera_world"]
    assert camera.t_camera_world.tolist() == CAMERA["t_camera_world"]
    assert camera.T_camera_world[3].tolist() == [0, 0, 0, 1]


def test_saved_rig_reads_back_to_the_same_numbers_and_bytes(tmp_path: Path) -> None:
    rotation, _ = np.linalg.qr(np.random.default_rng(2).normal(size=(3, 3)))
    rotation *= np.sign(np.linalg.det(rotation))
    rational = document(
        R_camera_world=rotation.tolist(),
        t_camera_world=(np.random.default_rng(3).normal(size=3) / 3).tolist(),
        line_time_s=3.1e-5,
        distortion_model="rational_polynomial",
        distortion=[1e-5, 0.1, 1 / 3, 0, 0, 7.0, 2e-17, -4.0],
    )
    rational["volume"] = {"low": [-1 / 3, -2, 0], "high": [1, 2, 2.2]}
    first = load_rig(write(tmp_path, rational))
    save_rig(first, tmp_path / "again.yaml")
    second = load_rig(tmp_path / "again.yaml")
    save_rig(second, tmp_path / "third.yaml")
    assert (tmp_path / "again.yaml").read_bytes() == (tmp_path / "third.yaml").read_bytes()
    assert first.names == second.names and [camera.line_time_s for camera in first.cameras] == [0.0, 3.1e-5]
    assert np.array_equal(first.volume.low, second.volume.low)
    assert np.array_equal(first.volume.high, second.volume.high)
    for a, b in zip(first.cameras, second.cameras, strict=True):
        assert (a.name, a.width, a.height, a.distortion_model) == (b.name, b.width, b.height, b.distortion_model)
        assert a.line_time_s == b.line_time_s
        for name in ("K", "D", "T_camera_world"):
            assert np.array_equal(getattr(a, name), getattr(b, name))


def test_rotation_rounded_in_the_file_becomes_the_nearest_rotation(tmp_path: Path) -> None:
    angle = 0.7
    exact = np.array([[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1]])
    R = load_rig(write(tmp_path, document(R_camera_world=exact.round(5).tolist()))).camera("cam02").R_camera_world
    assert np.abs(R @ R.T - np.eye(3)).max() < 1e-14
    assert np.abs(R - exact).max() < 1e-5


def test_four_distortion_coefficients_mean_k3_is_zero(tmp_path: Path) -> None:
    rig = load_rig(write(tmp_path, document(distortion=[-0.1, 0.2, 0.3, 0.4])))
    assert rig.camera("cam02").D.tolist() == [-0.1, 0.2, 0.3, 0.4, 0]


def test_default_volume_stands_on_the_floor_where_the_optical_axes_meet(tmp_path: Path) -> None:
    ring = {}
    for index, azimuth in enumerate(np.radians([10, 100, 220])):
        centre = np.array([1.0 + 3 * np.cos(azimuth), 2.0 + 3 * np.sin(azimuth), 1.1])
        forward = np.array([1.0, 2.0, 1.1]) - centre
        forward /= np.linalg.norm(forward)
        right = np.cross(forward, [0, 0, 1])
        R = np.stack([right, np.cross(forward, right), forward])
        ring[f"cam{index}"] = {**CAMERA, "R_camera_world": R.tolist(), "t_camera_world": (-R @ centre).tolist()}
    volume = load_rig(write(tmp_path, {"cameras": ring})).volume
    assert (volume.low + volume.high)[:2] / 2 == pytest.approx([1, 2])
    assert volume.low[2] <= 0 and volume.high[2] >= 2.2


@pytest.mark.parametrize(
    "parts",
    [("sessions", "walk_ring5top"), ("sessions", "charleston_ring5top"), ("sessions", "zombie_he3"), ("real_4cam",)],
)
def test_default_volume_contains_the_truth_of(parts: tuple[str, ...], shared_data: Callable[..., Path]) -> None:
    session = load_session(shared_data(*parts))
    assert session.truth is not None
    points = session.truth.points_world.reshape(-1, 3)
    assert (np.nanmin(points, axis=0) > session.rig.volume.low).all()
    assert (np.nanmax(points, axis=0) < session.rig.volume.high).all()


def test_unknown_camera_name_lists_the_known_ones(tmp_path: Path) -> None:
    rig = load_rig(write(tmp_path, document()))
    with pytest.raises(InputError, match=r"no camera 'cam09'.*cam01, cam02"):
        rig.camera("cam09")


@pytest.mark.parametrize("content", ["", "units: metres\n", "cameras: {}\n", "cameras: 3\n"])
def test_rig_without_cameras_is_refused(tmp_path: Path, content: str) -> None:
    assert "'cameras' is missing or empty" in refusal(tmp_path, content)
    assert "cameras.cam01: is not a mapping" in refusal(tmp_path, "cameras: {cam01: 3}\n")


@pytest.mark.parametrize("key", CAMERA)
def test_missing_key_is_named_with_its_camera(tmp_path: Path, key: str) -> None:
    content = document()
    del content["cameras"]["cam02"][key]
    text = refusal(tmp_path, content)
    assert f"cameras.cam02: key '{key}' is missing" in text


NOT_FINITE = "finite numbers"
NO_ROTATION = "R_camera_world is not a rotation"


@pytest.mark.parametrize(
    ("key", "value", "says"),
    [
        ("camera_matrix", [[0.0, 0, 320], [0, 470, 240], [0, 0, 1]], "fx, fy > 0 pixels"),
        ("camera_matrix", [[470, 2.5, 320], [0, 470, 240], [0, 0, 1]], "fx, fy > 0 pixels"),  # OpenCV has no skew
        ("camera_matrix", [[470, 0, -1e9], [0, 470, 240], [0, 0, 1]], "has its principal point at ["),
        ("camera_matrix", [[float("nan"), 0, 320], [0, 470, 240], [0, 0, 1]], NOT_FINITE),
        ("distortion", [0.1, float("inf"), 0, 0, 0], NOT_FINITE),
        ("distortion", [0.1] * 8, "is not 5 finite numbers"),
        ("distortion_model", "rational_polynomial", "is not 8 finite numbers"),
        ("distortion_model", "fisheye", "= 'fisheye' is not known"),
        ("R_camera_world", [[1, 0.01, 0], [0, 1, 0], [0, 0, 1]], NO_ROTATION),
        ("R_camera_world", [[1, 0, 0], [0, 1, 0], [0, 0, -1]], "by 2"),
        ("t_camera_world", [0, float("nan"), 0], NOT_FINITE),
        ("t_camera_world", ["left", 0, 1], NOT_FINITE),
        *(("line_time_s", value, f"= {value!r} is not a number from 0") for value in (-1e-5, 0.015, "fast", True)),
        *(
            ("image_height", size, f"= {size!r} is not a whole number from 1 to 20000")
            for size in (0, 640.5, "640", True, 60000)
        ),
    ],
)
def test_wrong_value_of_a_camera_is_refused_with_camera_and_key(
    tmp_path: Path, key: str, value: object, says: str
) -> None:
    text = refusal(tmp_path, document(**{key: value}))
    named = "distortion" if says == "is not 8 finite numbers" else key
    assert f"cameras.cam02: {named} " in text and says in text


@pytest.mark.parametrize("focal", [1e-12, 8.0, 1e5, 1e300])
def test_focal_length_of_no_lens_is_refused_with_its_range_in_pixels(tmp_path: Path, focal: float) -> None:
    text = refusal(tmp_path, document(camera_matrix=[[470, 0, 320], [0, focal, 240], [0, 0, 1]]))
    assert f"cameras.cam02: camera_matrix has focal lengths of 470 and {focal:g} pixels in an image 640 wide" in text
    assert "in pixels, 32 to 64000, not millimetres" in text


def test_translation_in_millimetres_is_refused_with_the_unit_as_the_likely_cause(tmp_path: Path) -> None:
    text = refusal(tmp_path, document(t_camera_world=[100.0, 1000.0, 3000.0]))
    assert "cameras.cam02: t_camera_world = [100.0, 1000.0, 3000.0] is more than 100 m from the origin" in text
    assert "millimetres are likely here" in text
    volume = {"low": [-2500, -2500, 0], "high": [2500, 2500, 2400]}
    assert "volume: low = " in (text := refusal(tmp_path, {**document(), "volume": volume})) and "millimetres" in text


def test_more_cameras_than_a_set_can_hold_are_refused(tmp_path: Path) -> None:
    cameras = {f"cam{number:03d}": CAMERA for number in range(MAX_CAMERAS + 1)}
    assert "cameras: there are 64 cameras. At most 63" in refusal(tmp_path, {"cameras": cameras})


@pytest.mark.parametrize(
    ("volume", "problem"),
    [
        ({"low": [0, 0, 0], "high": [1, 1, 0]}, "is not above low"),
        ({"low": [0, 0, 0], "high": [1, 1, 1], "unit": "m"}, "is not a volume"),
        ([0, 0, 0, 1, 1, 1], "is not a volume"),
        ({"low": [0, 0], "high": [1, 1, 1]}, "low = [0, 0] is not 3 finite numbers"),
    ],
)
def test_volume_that_is_no_box_is_refused(tmp_path: Path, volume: object, problem: str) -> None:
    text = refusal(tmp_path, {**document(), "volume": volume})
    assert "rig.yaml: volume: " in text
    assert problem in text
