"""What a solution says about the footage: delays, a wrong lens, weak ties."""

from dataclasses import replace

import numpy as np
from bundle_studio import T_WORLD_FLOOR, TARGETS, carried, carried_and_floor, detections_of, ring

from capture_rig.verdict import REDO, USABLE
from rig_calibration.bundle.solve import solve_rig
from rig_calibration.extrinsics.verdict import common_pose_counts, footage_findings

CAMERAS = ring(4)


def test_good_footage_has_no_findings():
    solution = solve_rig(CAMERAS, carried_and_floor(CAMERAS, np.random.default_rng(1), 30), TARGETS)
    assert not list(footage_findings(solution))
    assert all(count > 3 for count in common_pose_counts(solution).values())


def test_board_carried_fast_before_cameras_that_are_not_synchronous_is_said():
    rng = np.random.default_rng(0)
    detections = []
    poses = carried(rng, 30)
    for late, (name, camera) in enumerate(CAMERAS.items()):
        moved = {frame_index: T.copy() for frame_index, T in poses.items()}
        for frame_index, T in moved.items():
            T[:3, 3] += 0.008 * late * np.array([np.sin(frame_index), np.cos(frame_index), 0])
        detections += detections_of({name: camera}, moved, "moving", rng)
    found = list(footage_findings(solve_rig(CAMERAS, detections, {"moving": TARGETS["moving"]})))
    assert [finding.grade for finding in found] == [USABLE]
    assert "mm apart" in found[0].what and "synchronise" in found[0].remedy


def test_camera_with_the_wrong_focal_length_is_named_with_the_right_one():
    wrong = dict(CAMERAS)
    wrong["cam03"] = replace(CAMERAS["cam03"], K=CAMERAS["cam03"].K @ np.diag([1.04, 1.04, 1.0]))
    solution = solve_rig(wrong, carried_and_floor(CAMERAS, np.random.default_rng(1), 30), TARGETS)
    ratio, sd = solution.focal_of["cam03"]
    assert abs(ratio * 1.04 - 1) < 3 * sd and sd < 0.01
    found = [finding for finding in footage_findings(solution) if "focal" in finding.what]
    assert len(found) == 1 and "cam03" in found[0].what and "intrinsics of cam03" in found[0].remedy


def test_cameras_tied_by_the_floor_board_alone_are_named():
    floor = detections_of(CAMERAS, {0: T_WORLD_FLOOR}, "floor", np.random.default_rng(0), max_tilt_deg=85)
    found = footage_findings(solve_rig(CAMERAS, floor, {"floor": TARGETS["floor"]}))
    assert [finding.what.split()[0] for finding in found] == list(CAMERAS)
    assert all("tied to the other cameras by 1 position" in finding.what for finding in found)


def test_camera_moved_in_the_middle_of_the_footage_asks_to_record_again():
    rng = np.random.default_rng(1)
    poses = carried(rng, 40)
    T = np.eye(4)
    T[:3, 3] = 0.2, 0.1, 0.0
    moved = {n: replace(c, T_camera_world=T @ c.T_camera_world) if n == "cam02" else c for n, c in CAMERAS.items()}
    early, late = ({m: T for m, T in poses.items() if (m < 20) == half} for half in (True, False))
    detections = detections_of(CAMERAS, early, "moving", rng) + detections_of(moved, late, "moving", rng)
    solution = solve_rig(CAMERAS, detections, {"moving": TARGETS["moving"]})
    touched = {out.detection.frame_index for out in solution.left_out}
    assert touched and (max(touched) < 20 or min(touched) >= 20)  # one of the two places of cam02 is believed
    assert any(finding.grade == REDO for finding in footage_findings(solution)) == (
        len(solution.left_out) > 0.3 * (len(solution.left_out) + len(solution.detections))
    )
