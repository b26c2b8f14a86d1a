"""Floor in shadow told from legs by all cameras: rendered scenes, and the rule pixel by pixel in float64."""

import cv2
import numpy as np
import pytest
from hull_scenes import VOLUME, capsule_person, look_at, ring_rig, silhouettes

from capture_rig import Rig
from capture_rig.mask_levels import ATTENUATED_LEVELS, CANDIDATE_LEVELS, SHADOW_CANDIDATE
from hull_server.carving.cpu_carver import CpuCarver
from hull_server.floor_shadows import FLOOR_M, ShadowResolver
from hull_server.grid import VoxelGrid
from hull_server.views import RigViews, min_seeing

SHADOW = [(-0.15, -0.1), (0.75, -0.25), (0.95, 0.25), (0.6, 0.45), (-0.05, 0.3)]  # on the floor, under the feet too
GRID = VoxelGrid.covering(VOLUME, 0.02)


def resolver(rig: Rig) -> ShadowResolver:
    return ShadowResolver(RigViews.from_rig(rig), rig.volume, GRID)


def hull(rig: Rig, levels: dict[str, np.ndarray]) -> np.ndarray:
    """The voxels (nx, ny, nz) that are left when shadows have been told from the body."""
    worker = resolver(rig)
    masks = worker.resolve(levels)
    carved = CpuCarver(RigViews.from_rig(rig), GRID).carve(masks, min_seeing(len(masks)))
    return worker.without_shadows(carved, masks).to_dense()


def hull_of_body(rig: Rig, body: dict[str, np.ndarray]) -> np.ndarray:
    """The hull of what is foreground for sure."""
    return hull(rig, {name: np.where(shown > 0, np.uint8(255), np.uint8(0)) for name, shown in body.items()})


LOW = round((FLOOR_M - GRID.origin[2]) / GRID.voxel_size)  # the layers next to the floor


def floor_patch(rig: Rig, outline=SHADOW) -> dict[str, np.ndarray]:
    """Where each camera's canvas shows a patch of the floor, as if nobody stood before it: bool (h, w)."""
    masks = {}
    for camera in rig.cameras:
        view = camera.undistorted_view()
        pixels = view.camera.project(np.column_stack([outline, np.zeros(len(outline))]))
        mask = np.zeros(view.seen.shape, np.uint8)
        cv2.fillPoly(mask, [np.rint(pixels).astype(np.int32)], 255)
        masks[camera.name] = (mask > 0) & view.seen
    return masks


def body_and_shadow(rig: Rig, body_level: int = 255, shadow_level: int = ATTENUATED_LEVELS[4]):
    """Levels, exact body and exact visible shadow of a person who stands in a shadow."""
    body, patch = silhouettes(rig, capsule_person(0.4)), floor_patch(rig)
    levels = {n: np.where(body[n] > 0, body_level, np.where(patch[n], shadow_level, 0)).astype(np.uint8) for n in body}
    return levels, {n: m > 0 for n, m in body.items()}, {n: patch[n] & (body[n] == 0) for n in body}


def share(masks: dict[str, np.ndarray], where: dict[str, np.ndarray]) -> float:
    """How much of the places is foreground, over all cameras."""
    found = sum(np.count_nonzero(masks[n][where[n]] > 127) for n in where)
    return found / sum(np.count_nonzero(w) for w in where.values())


def test_binary_masks_are_passed_on_as_they_are():
    rig = ring_rig(4)
    masks = silhouettes(rig, capsule_person())
    resolved = resolver(rig).resolve(masks)
    assert all(resolved[name] is masks[name] for name in masks)


@pytest.mark.parametrize("cameras", [3, 6])
def test_shadow_at_the_feet_is_removed_and_the_person_stays(cameras):
    rig = ring_rig(cameras, seed=2)
    levels, body, shadow = body_and_shadow(rig)
    before = {name: mask.copy() for name, mask in levels.items()}
    resolved = resolver(rig).resolve(levels)
    assert share(levels, shadow) == 1.0 and share(resolved, shadow) < 0.25 and share(resolved, body) == 1.0
    assert all(np.array_equal(levels[n], before[n]) for n in levels)
    exact, found = hull_of_body(rig, body), hull(rig, levels)
    everything = hull_of_body(rig, levels)
    assert (found & exact).sum() > 0.98 * exact.sum()
    extra, removed = (found & ~exact)[:, :, :LOW].sum(), (everything & ~found)[:, :, :LOW].sum()
    assert removed > 500 and extra < 0.1 * removed
    assert (found & ~exact)[:, :, LOW:].sum() < 0.1 * exact.sum()


def test_candidates_deny_no_body_that_the_others_see_and_no_floor_is_left_of_them():
    above = look_at("cam06", np.array([0.4, 0.3, 4.0]), np.array([0.0, 0, 0]), 235.0, (320, 240))
    rig = Rig((*ring_rig(5, seed=2).cameras, above), VOLUME)
    levels, body, shadow = body_and_shadow(rig)
    exact = hull_of_body(rig, body)
    levels["cam06"][body["cam06"] | shadow["cam06"]] = CANDIDATE_LEVELS[2]  # a person who looks like floor in shadow
    found = hull(rig, levels)
    assert (found & exact)[:, :, LOW:].sum() > 0.99 * exact[:, :, LOW:].sum()
    assert not found[:, :, :LOW].any()


def test_two_cameras_candidates_deny_a_place_at_any_height_and_one_alone_does_not():
    rig = ring_rig(5, seed=2)
    body = {n: np.where(m > 0, np.uint8(255), np.uint8(0)) for n, m in silhouettes(rig, capsule_person()).items()}
    exact = hull(rig, body)
    for name, left in (("cam01", 0.99), ("cam02", 0.0)):
        body[name][body[name] > 0] = SHADOW_CANDIDATE
        found = hull(rig, body)
        assert (found & exact)[:, :, LOW:].sum() >= left * exact[:, :, LOW:].sum()
    assert not found.any()


def test_clothes_exactly_as_dark_as_the_shadow_lose_little_more_than_the_soles():
    rig = ring_rig(6, seed=3)
    levels, body, shadow = body_and_shadow(rig, body_level=ATTENUATED_LEVELS[4])
    assert share(resolver(rig).resolve(levels), shadow) < 0.25
    exact, found = hull_of_body(rig, body), hull(rig, levels)
    assert (found & exact)[:, :, LOW:].sum() > 0.95 * exact[:, :, LOW:].sum()


def test_dark_clothes_on_a_bright_floor_are_the_person():
    rig = ring_rig(5, seed=4)
    body = silhouettes(rig, capsule_person(1.0))
    levels = {n: np.where(m > 0, ATTENUATED_LEVELS[k % 9], 0).astype(np.uint8) for k, (n, m) in enumerate(body.items())}
    masks = resolver(rig).resolve(levels)
    assert share(masks, {n: m > 0 for n, m in body.items()}) > 0.999


@pytest.mark.parametrize(
    ("level_of", "judged", "least"),
    [
        (lambda k: ATTENUATED_LEVELS[4] if k < 2 else 0, 2, 0.85),
        (lambda k: ATTENUATED_LEVELS[2 * k], 5, 1.0),
        (lambda k: CANDIDATE_LEVELS[0] if k else ATTENUATED_LEVELS[4], 1, 1.0),  # of the steps 0 and 1
    ],
    ids=["bright for most", "of another darkness in every camera", "a candidate of another shadow"],
)
def test_a_place_that_the_others_see_otherwise_is_no_shadow(level_of, judged, least):
    rig = ring_rig(5, seed=2)
    levels, _, shadow = body_and_shadow(rig)
    for k, name in enumerate(levels):
        levels[name][shadow[name]] = level_of(k)
    masks = resolver(rig).resolve(levels)
    assert share(masks, {name: shadow[name] for name in rig.names[:judged]}) >= least


def test_candidates_of_other_cameras_are_witnesses_and_their_own_pixels_background():
    rig = ring_rig(5, seed=2)
    levels, body, shadow = body_and_shadow(rig)
    for name in list(levels)[1:]:
        levels[name][shadow[name]] = CANDIDATE_LEVELS[2]  # of the steps 4 and 5
    masks = resolver(rig).resolve(levels)
    assert share(masks, shadow) < 0.05 and share(masks, body) == 1.0


def test_a_camera_alone_or_one_under_the_floor_removes_nothing():
    rig = ring_rig(4, seed=2)
    levels, body, shadow = body_and_shadow(rig)
    alone = resolver(rig).resolve({"cam02": levels["cam02"]})["cam02"]
    assert np.array_equal(alone > 0, body["cam02"] | shadow["cam02"])
    low = look_at("cam05", np.array([3.0, 0.5, -0.3]), np.array([0.0, 0, 1]), 235.0, (320, 240))
    more = Rig((*rig.cameras, low), VOLUME)
    levels["cam05"] = np.full(low.undistorted_view().seen.shape, ATTENUATED_LEVELS[4], np.uint8)
    assert resolver(more).resolve(levels)["cam05"].all()


def test_the_same_masks_give_the_same_bytes_whatever_came_between():
    rig = ring_rig(5, seed=2)
    levels, _, _ = body_and_shadow(rig)
    worker = resolver(rig)
    first = worker.resolve(levels)
    worker.resolve({n: np.full_like(m, ATTENUATED_LEVELS[4]) for n, m in list(levels.items())[:3]})
    again = worker.resolve(dict(reversed(levels.items())))
    assert all(np.array_equal(first[n], again[n]) for n in levels)
