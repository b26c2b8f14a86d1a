"""A room of four fisheyes of 180 degrees, calibrated by films of boards; a person walks in it, and the truth scores."""

import json
import shutil
from dataclasses import replace

import numpy as np
import pytest
from command_line import calibrated, run

from capture_rig.camera import CameraModel
from capture_rig.rig import Rig, load_rig, save_rig
from virtual_studio.recording.footage import FootagePlan, read_truth_floor, write_setup
from virtual_studio.rig import ring

SIZE, ACROSS_RAD = (1280, 1024), np.pi
D = np.array([-0.02, 0.01, -0.004, 0.0006])  # of a lens that departs from the equidistant projection by a per cent


def fisheye(camera: CameraModel) -> CameraModel:
    K, focal = camera.K.copy(), SIZE[0] / ACROSS_RAD
    K[0, 0], K[1, 1] = focal, 1.001 * focal
    return replace(camera, K=K, distortion_model="equidistant", D=D)


@pytest.mark.slow
def test_fisheye_room_is_calibrated_by_boards_and_a_person_tracked_in_it(tmp_path):
    rig = ring(4, ceiling=False, size=SIZE)
    rig = Rig(tuple(map(fisheye, rig.cameras)), rig.volume)
    plan = FootagePlan(stills=True, fps=2.0, moving_s=20.0)
    filmed = write_setup(tmp_path / "room", rig, plan, motion="tour", seconds=3.0)
    found = calibrated(filmed, tmp_path)
    T_floor_world, session = np.linalg.inv(read_truth_floor(filmed)), filmed / "session"
    placed = [
        replace(camera, T_camera_world=camera.T_camera_world @ T_floor_world) for camera in load_rig(found).cameras
    ]
    for camera in placed:
        assert camera.distortion_model == "equidistant"
        assert np.linalg.norm(camera.centre_world - rig.camera(camera.name).centre_world) < 0.003
    save_rig(Rig(tuple(placed), rig.volume), session / "rig.yaml")
    shutil.copy(filmed / "truth.csv", session)
    score = json.loads(run("evaluate", session, "--json"))
    assert score["tracked"] > 0.8 * score["frames"]
    assert score["mean_mm"] < 25.0 and score["over_200mm"] == 0.0
