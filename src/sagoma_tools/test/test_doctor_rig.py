"""The doctor on rigs: good ones, and ones that somebody spoilt."""

import json
import os
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml

from capture_rig.rig import Rig, Volume, load_rig, save_rig
from sagoma_tools.cli import main
from sagoma_tools.doctor.rig import RigView, check_place
from virtual_studio.rig import ring

GOOD = ring(3, False)


def with_camera(rig, name, **changes):
    cameras = tuple(replace(camera, **changes) if camera.name == name else camera for camera in rig.cameras)
    return Rig(cameras, rig.volume)


def moved(camera, centre_world):
    T = camera.T_camera_world.copy()
    T[:3, 3] = -T[:3, :3] @ np.asarray(centre_world, float)
    return T


def K_of(camera, **entries):
    K = camera.K.copy()
    for entry, value in entries.items():
        K[{"fx": (0, 0), "fy": (1, 1), "cx": (0, 2)}[entry]] = value
    return K


@pytest.fixture
def examined(tmp_path, capsys):
    """Writes a rig, examines it, and returns the exit status and the findings above OK by subject."""

    def examine(rig, *options):
        save_rig(rig, tmp_path / "rig.yaml")
        capsys.readouterr()
        status = main(["doctor", "--no-machine", "--json", "--rig", str(tmp_path / "rig.yaml"), *map(str, options)])
        found = {}
        for said in json.loads(capsys.readouterr().out)["findings"]:
            if said["severity"] != "ok":
                assert said["severity"] == "note" or said["remedy"]
                found.setdefault(said["subject"], []).append((said["severity"], said["code"], said["what"]))
        return status, found

    return examine


C1 = GOOD.cameras[0]
WIDE, FOLDING = K_of(C1, fx=418.0, fy=418.0), np.array([-0.4, 0.15, 0.0, 0.0, -0.03])
FISHEYE = {"K": K_of(C1, fx=640 / np.pi, fy=640 / np.pi), "distortion_model": "equidistant", "D": np.zeros(4)}


def test_pictures_larger_than_the_volume_are_told_and_their_parts_written(examined, tmp_path):
    low, high = GOOD.volume.low, GOOD.volume.high
    slim = Rig(GOOD.cameras, Volume(low * [0.3, 0.3, 1.0], high * [0.3, 0.3, 1.0]))
    _, found = examined(slim, "--regions", tmp_path / "parts.yaml")
    text = next(what for _, code, what in found["rig"] if code == "regions.smaller")
    # three pictures of 640 x 480 bytes in packets of 9000, 70 % of a Gigabit: 0.7 * 125e6 / (3 * 309.9e3)
    assert "carries all cameras at 94 Hz" in text
    parts = load_rig(tmp_path / "parts.yaml")
    for whole, part in zip(GOOD.cameras, parts.cameras, strict=True):
        assert part.width < 0.8 * whole.width and f"width {part.width}, height {part.height}" in text
        points = slim.volume.low + np.random.default_rng(0).random((500, 3)) * (slim.volume.high - slim.volume.low)
        moved_px = whole.project(points) - part.project(points)  # as the offset, in whole pixels
        np.testing.assert_allclose(moved_px, np.rint(moved_px[0]) + np.zeros((500, 1)), atol=1e-6)


@pytest.mark.parametrize(
    "changes, severity, code, value",
    [
        ({"T_camera_world": moved(C1, [3.0, 1.0, -0.4])}, "error", "place.below_floor", "0.40 m"),
        ({"T_camera_world": moved(C1, [3.0, 1.0, 7.0])}, "warning", "place.high", "7.00 m"),
        ({"K": K_of(C1, cx=520.0)}, "warning", "lens.off_centre", "(520, "),
        ({"K": K_of(C1, fy=490.0)}, "warning", "lens.unequal_focal", "490 px"),
        ({"K": K_of(C1, fx=120.0, fy=120.0)}, "warning", "lens.field_of_view", "degrees"),
        ({"D": np.array([-0.9, 0.0, 0.0, 0.0, 0.0])}, "warning", "lens.unused", "% of the image is not used"),
        ({"K": WIDE, "D": FOLDING}, "note", "lens.unused", "holds up to 54 degrees: the outer "),
        (FISHEYE, "note", "lens.unused", "the undistorted picture ends at 76 degrees"),
        ({"T_camera_world": np.diag([-1.0, 1.0, -1.0, 1.0]) @ C1.T_camera_world}, "error", "view.empty", ""),
    ],
)
def test_spoilt_camera_is_named_with_what_is_wrong(examined, changes, severity, code, value):
    status, found = examined(with_camera(GOOD, "cam01", **changes))
    assert status >= {"note": 0, "warning": 1, "error": 2}[severity]
    assert any((kind, its) == (severity, code) and value in what for kind, its, what in found["camera cam01"])
    assert not any(subject.startswith("camera") for subject in set(found) - {"camera cam01"})


def test_cameras_that_stand_badly_are_named_and_those_that_stand_well_are_not(examined):
    status, found = examined(GOOD)
    assert (status, {*found}, {severity for severity, _, _ in found["rig"]}) == (0, {"rig"}, {"note"})
    _, found = examined(Rig(GOOD.cameras[:2], GOOD.volume))
    assert "cameras.too_few" in [code for _, code, _ in found["rig"]]
    status, found = examined(with_camera(GOOD, "cam02", T_camera_world=C1.T_camera_world))
    assert status == 2 and ("error", "cameras.same_place") in [each[:2] for each in found["rig"]]
    # a point reflection of the camera's place in the volume's middle, looking back
    T, opposite = np.eye(4), np.diag([-1.0, 1.0, -1.0]) @ C1.R_camera_world
    T[:3, :3], T[:3, 3] = opposite, -opposite @ (np.array([0.0, 0.0, 2.0]) - C1.centre_world)
    _, found = examined(with_camera(GOOD, "cam03", T_camera_world=T))
    assert any(code == "cameras.opposite" and "180 degrees" in what for _, code, what in found["rig"])


def test_shares_of_the_volume_agree_with_counting_by_hand():
    view = RigView.of(GOOD, Path("rig.yaml"))
    foot, head = np.array([0.5, -0.5, 0.1]), np.array([0.5, -0.5, 1.7])
    for camera, sees in zip(GOOD.cameras, view.sees, strict=True):
        inside = [0 <= u < camera.width and 0 <= v < camera.height for u, v in camera.project([foot, head])]
        assert all(inside) and sees.mean() > 0.9
    assert (view.sees.sum(axis=0) >= 2).all() and not view.sees.all()
    # 3.25 m from (0, 0, 0.95), where a pixel of 468 px focal length is 6.9 mm
    *_, seen = check_place(view, C1)
    assert "3.2 m from the volume's centre, 6.9 mm a pixel" in seen.what


def test_report_is_read_with_verdict_findings_and_age(examined, tmp_path):
    path, findings = tmp_path / "rig.report.yaml", [{"grade": "redo", "what": "no tilt", "remedy": "tilt the board"}]
    path.write_text(yaml.safe_dump({"verdict": "redo", "findings": findings}))
    os.utime(path, (time.time() - 400 * 86400,) * 2)
    status, found = examined(GOOD)
    text = {code: what for _, code, what in found["rig"]}
    assert status == 2 and "no tilt (tilt the board)" in text["calibration.redo"] and "400 days" in text["age.old"]
    path.write_text("[1, 2")
    assert "rig_report.unusable" in [code for _, code, _ in examined(GOOD)[1]["rig"]]
