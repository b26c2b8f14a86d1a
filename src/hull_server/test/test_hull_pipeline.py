"""From frame sets of silhouettes to the published quantities, without ROS."""

from concurrent.futures import ThreadPoolExecutor
from itertools import count

import numpy as np
import pytest
from hull_scenes import capsule_person, distance_to_axes, ring_rig, silhouettes

from hull_server.hull_pipeline import HullPipeline
from hull_server.hull_ros import summarise
from hull_server.settings import HullSettings
from mocap_packets.frame_set import FrameSet

CPU = HullSettings(backend="cpu")


def frame_set(masks, stamp_ns=1_000_000_000):
    return FrameSet.of_instant(stamp_ns, masks)


@pytest.fixture(scope="module")
def scene():
    rig = ring_rig(5)
    body = capsule_person(0.3, 0.1, -0.2)
    return rig, body, silhouettes(rig, body)


def test_pipeline_finds_the_hull_and_the_centerline_of_a_person(scene):
    rig, body, masks = scene
    result = HullPipeline(rig, CPU).run(frame_set(masks))
    assert 60 < result.volume.litres < 130
    assert len(result.products.centerline) > 60
    distances = distance_to_axes(result.products.centerline.points_world, body).min(axis=0)
    assert np.median(distances) < 0.02 and np.mean(distances < 0.06) > 0.85
    assert len(result.products.voxels) == 3000
    assert tuple(result.masks) == rig.names and result.blank == () and not result.empty
    assert result.min_seeing == 3 and result.stamp_ns == 1_000_000_000
    assert " ".join(result.stage_ms) == "consistency shadows carve support floor slice filter sample contour_rays"


def all_bytes(result, reports=()):
    parts = result.products.centerline, result.products.voxels, result.products.contour_rays, result.bodies
    arrays = [result.volume.leaves, *(array for part in parts for array in vars(part).values())]
    return [array.tobytes() for array in (*arrays, *(report.cells for report in reports))]


def test_pipeline_gives_the_same_bytes_twice_and_warming_up_leaves_no_trace(scene):
    cold, warm = HullPipeline(scene[0], CPU), HullPipeline(scene[0], CPU)
    warm.warm_up()
    assert all_bytes(cold.run(frame_set(scene[2]))) == all_bytes(warm.run(frame_set(scene[2])))


def test_two_threads_that_overlap_sets_change_no_byte(scene):
    alone, overlapped = HullPipeline(scene[0], CPU), HullPipeline(scene[0], CPU)
    moved = [{name: np.roll(mask, 4 * step, axis=1) for name, mask in scene[2].items()} for step in range(6)]
    sets = [frame_set(masks, stamp_ns=step * 100_000_000) for step, masks in enumerate(moved)]
    with ThreadPoolExecutor(1) as slicer:
        waiting = [slicer.submit(overlapped.finish, overlapped.begin(each)) for each in sets]
    for one, two in zip(map(alone.run, sets), [each.result() for each in waiting], strict=True):
        assert all_bytes(one, one.support) == all_bytes(two, two.support)


def test_covered_camera_is_left_out_and_named_and_taken_back(scene):
    pipeline, masks = HullPipeline(scene[0], CPU), scene[2]
    covered, steps = masks | {"cam04": np.zeros_like(masks["cam04"])}, count()

    def run_until(left_out, shown):
        while (result := pipeline.run(frame_set(shown, next(steps) * 100_000_000))).camera_faults.left_out != left_out:
            assert next(steps) < 200
        return result

    whole, without = run_until((), masks), run_until(("cam04",), covered)
    assert without.volume.litres > 0.95 * whole.volume.litres and "cam04" not in without.masks
    assert "cam04 contradicts" in summarise(without)[1]
    assert "cam04" in run_until((), masks).masks


def test_two_people_are_two_bodies_with_points_voxels_and_rays_of_their_own():
    rig = ring_rig(7)
    pair = capsule_person(0.3, -0.45, -0.4) + capsule_person(0.3, 0.5, 0.45)
    result = HullPipeline(rig, HullSettings(backend="cpu", voxel_size_m=0.03)).run(frame_set(silhouettes(rig, pair)))
    assert sorted(result.bodies.number) == [0, 1] and result.bodies.litres.sum() > 0.98 * result.volume.litres
    left = result.bodies.number[np.argmin(result.bodies.centroid_world[:, 0])]
    for cloud in (result.products.centerline, result.products.voxels, result.products.contour_rays):
        assert min(np.bincount(cloud.body)) > 20
        x, y, _ = cloud.points_world.T
        assert np.mean(cloud.body == np.where(x + y < 0.05, left, 1 - left)) > 0.97
