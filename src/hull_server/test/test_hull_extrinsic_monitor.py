"""A camera that moved is found by epipolar tangents; silhouettes and other cameras that err are not blamed."""

from functools import cache

import cv2
import numpy as np
import pytest
from hull_scenes import ring_rig, rotated_mask, silhouettes, walking_person

from capture_rig import Rig
from hull_server.consistency.camera_fault_detector import CameraFaultDetector
from hull_server.consistency.extrinsic_monitor import EpipolarTangentFinder, ExtrinsicMonitor, estimate_extrinsic_errors
from hull_server.hull_pipeline import HullPipeline
from hull_server.hull_ros import frame_set_message, summarise
from hull_server.settings import CalibrationSettings, CameraFaultSettings, HullSettings
from hull_server.views import RigViews
from mocap_packets.frame_set import FrameSet

SETS, SET_NS = 24, 200_000_000
FOCAL_PX = 235.0


@cache
def rig_of(cameras=6):
    six = ring_rig(6, focal_px=FOCAL_PX)
    return Rig(six.cameras[:cameras], six.volume)


@cache
def walking():
    return [silhouettes(rig_of(), walking_person(frame / SETS)) for frame in range(SETS)]


def turned(masks, name, turn_deg):
    return masks | {name: rotated_mask(rig_of(), name, masks[name], turn_deg)}


def monitor_of(rig, **settings):
    return ExtrinsicMonitor(rig, RigViews.from_rig(rig), CalibrationSettings(**settings))


def monitored(monitor, change=lambda masks: masks, sets=SETS, start=0):
    for frame in range(start, start + sets):
        result = monitor.update(change(walking()[frame % SETS]), frame * SET_NS)
    return result


@pytest.mark.parametrize("turn_deg", [(1.5, 0, 0), (0, -1.5, 0), (0, 0, 2.5)])
def test_turned_camera_is_named_with_the_size_of_the_turn_and_no_other_is(turn_deg):
    result = monitored(monitor_of(rig_of()), lambda masks: turned(masks, "cam03", turn_deg))
    assert list(result.suspects) == ["cam03"]
    size_deg = np.linalg.norm(turn_deg)
    assert np.degrees(result.of_camera["cam03"].angle_rad) == pytest.approx(size_deg, rel=0.25)
    assert np.degrees(result.of_camera["cam03"].roll_rad) == pytest.approx(turn_deg[2], abs=0.3)
    assert "cam03 stands" in result.suspects["cam03"] and "calibrate it again" in result.suspects["cam03"]


def test_turn_that_is_found_lies_within_its_own_errors_of_the_truth():
    rig, turn_deg = rig_of(), (0.6, -0.7, 0.4)
    finder = EpipolarTangentFinder(rig, RigViews.from_rig(rig))
    found = [finder.find(turned(masks, "cam02", turn_deg)) for masks in walking()[::2]]
    errors = estimate_extrinsic_errors(found, 6, 0.4)
    mine = errors[1]
    assert mine.evidence == max(error.evidence for error in errors) and mine.evidence > mine.evidence_of_growth
    assert np.linalg.norm(np.degrees(mine.rotation_rad) - turn_deg) < 0.35
    assert 0.02 < np.degrees(mine.sd_rad) < 0.3


def test_sound_cameras_are_not_named():
    result = monitored(monitor_of(rig_of()), sets=2 * SETS)
    assert result.suspects == {}
    assert np.degrees(max(error.angle_rad for error in result.of_camera.values())) < 0.3


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_cameras_that_all_err_by_a_fifth_of_a_degree_are_not_named(seed):
    rng, errors = np.random.default_rng(seed), {}
    for name in rig_of().names:
        axis = rng.normal(size=3)
        errors[name] = tuple(0.2 * axis / np.linalg.norm(axis))

    def change(masks):
        for name, turn_deg in errors.items():
            masks = turned(masks, name, turn_deg)
        return masks

    assert monitored(monitor_of(rig_of()), change).suspects == {}


@pytest.mark.parametrize("grow", [cv2.dilate, cv2.erode])
def test_silhouettes_that_are_two_pixels_too_large_or_small_all_around_are_no_rotation(grow):
    kernel = np.ones((5, 5), np.uint8)
    result = monitored(monitor_of(rig_of()), lambda masks: masks | {"cam04": grow(masks["cam04"], kernel)})
    assert (
        result.suspects == {} and np.degrees(result.of_camera["cam04"].angle_rad) < 0.5
    )  # two pixels are half a degree


def test_body_that_stands_still_counts_once():
    monitor, masks = monitor_of(rig_of()), turned(walking()[0], "cam01", (0, 3.0, 0))
    for number in range(30):
        result = monitor.update(masks, number * SET_NS)
    assert result.suspects == {} and result.of_camera == {}  # one measured set is not enough


def test_camera_that_is_put_back_is_no_suspect_any_more():
    monitor = monitor_of(rig_of())
    assert "cam05" in monitored(monitor, lambda masks: turned(masks, "cam05", (0, 2.0, 0))).suspects
    assert monitored(monitor, sets=2 * SETS, start=SETS).suspects == {}


def test_two_cameras_are_never_told_apart_and_nobody_is_named():
    rig = rig_of(2)
    assert monitored(monitor_of(rig), lambda masks: turned(masks, "cam01", (2.0, 0, 0))).suspects == {}


def test_empty_room_and_flooded_pictures_tell_nothing():
    monitor = monitor_of(rig_of())
    for number in range(12):
        monitor.update({name: np.zeros_like(mask) for name, mask in walking()[0].items()}, number * SET_NS)
    assert monitor.errors.of_camera == {}
    result = monitored(monitor, lambda masks: masks | {"cam02": np.full_like(masks["cam02"], 255)}, start=20)
    assert result.suspects == {} and "cam02" not in result.of_camera


def test_contours_that_may_be_shadow_and_contours_that_are_cut_off_are_not_used():
    rig, masks = rig_of(), walking()[3]
    finder = EpipolarTangentFinder(rig, RigViews.from_rig(rig))
    shadowed = masks["cam01"].copy()
    low = np.flatnonzero(shadowed.any(1))[-1]
    shadowed[low - 2 : low + 8, 20:300][shadowed[low - 2 : low + 8, 20:300] == 0] = 85  # on either side of the feet
    whole, shadowed_tangents = finder.find(masks), finder.find(masks | {"cam01": shadowed})
    mine = (whole.first == 0) | (whole.second == 0)
    assert mine.sum() > ((shadowed_tangents.first == 0) | (shadowed_tangents.second == 0)).sum()
    assert np.abs(shadowed_tangents.difference_px).max() < 3.0
    view = rig.cameras[0].undistorted_view()
    cut = np.where(view.seen, np.uint8(255), np.uint8(0))
    filled = finder.find(masks | {"cam01": cut})
    assert not ((filled.first == 0) | (filled.second == 0)).any()


def test_consistency_is_near_one_for_sound_cameras_and_low_for_one_that_vetoes_or_shows_what_is_not_there():
    rig = rig_of()
    monitor = CameraFaultDetector(rig, RigViews.from_rig(rig), CameraFaultSettings(period_s=0.2))
    for frame in range(SETS):
        faults = monitor.update(walking()[frame], frame * SET_NS)
    assert min(faults.consistency.values()) > 0.9
    for frame in range(SETS, 2 * SETS):
        masks = walking()[frame % SETS]
        faults = monitor.update(masks | {"cam03": np.ascontiguousarray(masks["cam03"][:, ::-1])}, frame * SET_NS)
    assert faults.consistency["cam03"] < 0.6 < min(v for name, v in faults.consistency.items() if name != "cam03")


def test_messages_of_a_frame_set_tell_degrees_consistency_and_the_remedy():
    pipeline = HullPipeline(rig_of(), HullSettings(voxel_size_m=0.04, backend="cpu"))
    for frame in range(SETS):
        masks = turned(walking()[frame], "cam02", (0, 1.5, 0))
        result = pipeline.run(FrameSet.of_instant(frame * SET_NS, masks))
    values = {pair.key: pair.value for pair in frame_set_message(result, {}).status[0].values}
    assert float(values["calibration_rotation_error_deg_cam02"]) == pytest.approx(1.5, rel=0.25)
    assert 0.0 < float(values["calibration_rotation_error_sd_deg_cam02"]) < 0.3
    assert 0.5 < float(values["calibration_consistency_cam02"]) <= 1.0
    assert values["calibration_suspects"] == "cam02"
    assert "cam02" in summarise(result)[1]
    pipeline.close()
