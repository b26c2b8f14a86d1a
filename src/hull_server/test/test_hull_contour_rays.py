"""Contour rays and silhouettes' edges against bodies and shapes whose surface is known."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from hull_scenes import VOLUME, capsule_person, look_at, ring_rig, silhouettes

from capture_rig import Rig
from capture_rig.kernel import njit
from hull_server.contour_rays.contour_tracer import ContourTracer, Scratch
from hull_server.contour_rays.outlines import RADIUS_PX, find_edge, pick_contour_pixels, weights
from hull_server.grid import BrickVolume
from hull_server.hull_pipeline import HullPipeline
from hull_server.settings import ContourRaySettings, HullSettings
from hull_server.slicing.skeletonisation import slice_hull
from mocap_packets.frame_set import FrameSet

STAMP_NS = 1_000_000_000
BALL = [(np.array([0.1, -0.1, 1.0]), np.array([0.1, -0.1, 1.0001]), 0.15)]
LIMB = [(np.array([0.0, -0.3, 1.0]), np.array([0.1, 0.3, 1.2]), 0.05)]


def frame_set(masks):
    return FrameSet.of_instant(STAMP_NS, masks)


def hull_of(rig, masks, **settings):
    return HullPipeline(rig, HullSettings(backend="cpu", **settings)).run(frame_set(masks))


def traced(pipeline, masks, volume):
    """The contour rays of a hull that has not been sliced yet."""
    return ContourTracer(pipeline.views, pipeline.grid, ContourRaySettings()).trace(masks, slice_hull(volume)[1])


def centres_of(rig, rays):
    """(n, 3) the camera that each ray comes from."""
    return np.stack([camera.centre_world for camera in rig.cameras])[rays.camera]


def rays_of(rig, masks, body, **settings):
    """The contour rays of a hull, and their signed distances (n,) from the body."""
    rays = hull_of(rig, masks, **settings).products.contour_rays
    return rays, clearance(centres_of(rig, rays), rays.directions, body)[0]


def clearance(centres, directions, body):
    """Signed distance (n,) of rays from a body of capsules, negative through it; the outward direction (n, 3) there and
    the place (n, 3): closest points of a line and a segment, in closed form, nearest capsule."""
    best, outward, place = np.full(len(centres), np.inf), np.zeros_like(centres), np.zeros_like(centres)
    for start, end, radius in body:
        axis, between = end - start, centres - start
        b, c, d, f = directions @ axis, axis @ axis, np.sum(directions * between, axis=1), between @ axis
        s = np.clip((f - b * d) / np.maximum(c - b * b, 1e-12), 0, 1)
        nearest = centres + (s * b - d)[:, None] * directions
        gap = nearest - start - s[:, None] * axis
        distance = np.linalg.norm(gap, axis=1)
        nearer = distance - radius < best
        best[nearer] = (distance - radius)[nearer]
        outward[nearer] = gap[nearer] / distance[nearer, None]
        place[nearer] = nearest[nearer]
    return best, outward, place


@pytest.fixture(scope="module")
def rig():
    return ring_rig(6, size=(640, 480), focal_px=470.0)  # a pixel is 6 to 8 mm on the body


@pytest.fixture(scope="module")
def person(rig):
    body = capsule_person(0.3, 0.1, -0.2)
    masks = silhouettes(rig, body)
    return body, masks, hull_of(rig, masks)


@pytest.mark.parametrize("body", [BALL, LIMB, None], ids=["ball", "limb", "person"])
def test_every_ray_leaves_its_camera_touches_the_true_surface_within_sigma_and_faces_outward(rig, person, body):
    rays = hull_of(rig, silhouettes(rig, body)).products.contour_rays if body else person[2].products.contour_rays
    body = body or person[0]
    assert len(rays) > 200 and set(rays.camera) == set(range(6))
    distance, outward, _ = clearance(centres_of(rig, rays), rays.directions, body)
    assert abs(distance.mean()) < 0.0005 and np.sqrt(np.mean(distance**2)) < 0.003 and np.abs(distance).max() < 0.008
    turn = np.degrees(np.arccos(np.clip(np.sum(outward * rays.normals, axis=1), -1, 1)))
    assert np.median(turn) < 5.0 and np.percentile(turn, 95) < 20.0
    for unit in (rays.directions, rays.normals):
        np.testing.assert_allclose(np.linalg.norm(unit, axis=1), 1.0, atol=1e-12)
    np.testing.assert_allclose(np.sum(rays.directions * rays.normals, axis=1), 0.0, atol=1e-9)
    from_camera = rays.points_world - centres_of(rig, rays)
    along = np.sum(from_camera * rays.directions, axis=1)
    assert along.min() > 1.0
    np.testing.assert_allclose(from_camera, along[:, None] * rays.directions, atol=1e-9)
    assert np.mean(np.abs(distance) < 2 * rays.sigma) > 0.99


@pytest.mark.parametrize("cameras", [3, 4])
def test_the_place_of_touch_lies_within_the_stretch(cameras):
    """Also where a ray meets the hull twice, at the limb that it touches and, for longer, at a phantom of another."""
    rig, body = ring_rig(cameras, size=(640, 480), focal_px=470.0), capsule_person(0.3, 0.1, -0.2)
    rays = hull_of(rig, silhouettes(rig, body)).products.contour_rays
    _, _, place = clearance(centres_of(rig, rays), rays.directions, body)
    away = np.abs(np.sum((place - rays.points_world) * rays.directions, axis=1))
    assert np.mean(away <= rays.half_lengths + 0.02) > 0.998
    assert np.median(rays.half_lengths) < 0.2 and rays.half_lengths.min() > 0


def test_sigma_is_the_width_of_a_half_pixel_there(rig, person):
    rays = person[2].products.contour_rays
    for index, camera in enumerate(rig.cameras):
        mine = rays.camera == index
        depth = rays.points_world[mine] @ camera.R_camera_world[2] + camera.t_camera_world[2]
        ideal = 0.5 * depth / camera.undistorted_view().camera.K[0, 0]
        np.testing.assert_allclose(rays.sigma[mine], ideal, rtol=0.15)  # rays beside the middle are slanted


def test_possible_shadow_rays_have_a_larger_sigma(rig, person):
    """Half of what one camera sends may be shadow, and is resolved as if it had been sure."""
    _, masks, _ = person
    sent = masks["cam02"].copy()
    middle = int(np.median(np.flatnonzero(sent.any(axis=1))))
    sent[middle:][sent[middle:] > 0] = 177
    settings = HullSettings(backend="cpu")
    rays = HullPipeline(rig, settings).run(frame_set(masks | {"cam02": sent})).products.contour_rays
    P = rig.camera("cam02").undistorted_view().camera.P
    mine = rays.camera == 1
    homogeneous = np.column_stack([rays.points_world[mine], np.ones(mine.sum())]) @ P.T
    row = homogeneous[:, 1] / homogeneous[:, 2]
    sigma_px = rays.sigma[mine] / homogeneous[:, 2] * P[2, :3].dot(P[2, :3]) ** 0.5 * 470
    assert np.median(sigma_px[row > middle + 5]) > 3 * np.median(sigma_px[row < middle - 5])
    assert np.median(sigma_px[row < middle - 5]) == pytest.approx(0.5, rel=0.2)


def test_a_body_cut_off_by_the_view_has_no_rays_at_the_border():
    body = capsule_person(0.3, 0.1, -0.2)
    narrow = ring_rig(4, size=(480, 360), focal_px=700.0)
    masks = silhouettes(narrow, body)
    seen = {camera.name: camera.undistorted_view().seen.astype(np.uint8) for camera in narrow.cameras}
    cut = {name: (seen[name] - cv2.erode(seen[name], np.ones((3, 3), np.uint8))) * mask for name, mask in masks.items()}
    assert sum(map(np.count_nonzero, cut.values())) > 100
    rays, distance = rays_of(narrow, masks, body)
    assert len(rays) > 200 and np.abs(distance).max() < 0.008


def test_silhouettes_of_what_no_other_camera_sees_have_no_rays(rig, person):
    body, masks, result = person
    disturbed = {name: mask.copy() for name, mask in masks.items()}
    free = rig.camera("cam03").undistorted_view().seen & (masks["cam03"] == 0)
    windows = np.lib.stride_tricks.sliding_window_view(free, (60, 60))[::10, ::10]
    v, u = 10 * np.argwhere(windows.all(axis=(2, 3)))[0]
    disturbed["cam03"][v + 10 : v + 50, u + 10 : u + 50] = 255
    rays, distance = rays_of(rig, disturbed, body)
    assert (rays.camera == 2).sum() > 100 and np.abs(distance).max() < 0.04
    assert len(rays) >= len(result.products.contour_rays) - 60


def test_settings_limit_the_rays_and_zero_switches_them_off(rig, person):
    _, masks, result = person
    few = hull_of(rig, masks, contour=ContourRaySettings(per_camera=20)).products.contour_rays
    assert 60 < len(few) <= 120 and np.bincount(few.camera).max() <= 20
    wide = hull_of(rig, masks, contour=ContourRaySettings(spacing_px=25.0)).products.contour_rays
    assert 100 < len(wide) < len(result.products.contour_rays) / 2
    off = hull_of(rig, masks, contour=ContourRaySettings(per_camera=0)).products.contour_rays
    assert len(off) == 0 and off.points_world.shape == off.normals.shape == (0, 3) and off.sigma.shape == (0,)


def test_an_empty_silhouette_and_an_empty_hull_have_no_rays(rig, person):
    _, masks, _ = person
    assert len(hull_of(rig, {name: np.zeros_like(mask) for name, mask in masks.items()}).products.contour_rays) == 0
    pipeline = HullPipeline(rig, HullSettings(backend="cpu"))
    volume = pipeline.run(frame_set(masks)).volume
    blank = masks | {"cam01": np.zeros_like(masks["cam01"])}
    rays = traced(pipeline, blank, volume)
    assert set(rays.camera) == {1, 2, 3, 4, 5}
    empty = BrickVolume.from_dense(pipeline.grid, np.zeros(pipeline.grid.shape, bool))
    assert len(traced(pipeline, masks, empty)) == 0


def test_rays_carry_the_time_of_their_camera_and_of_their_row(rig, person):
    line_s, later_ns = 31e-6, {"cam02": 4_000_000, "cam05": 16_000_000}
    cameras = [replace(each, line_time_s=line_s if each.name == "cam05" else 0.0) for each in rig.cameras]
    stamps_ns = {name: STAMP_NS + later_ns.get(name, 0) for name in rig.names}
    pipeline = HullPipeline(Rig(tuple(cameras), rig.volume), HullSettings(backend="cpu"))
    rays = pipeline.run(FrameSet.of_stamps(stamps_ns, person[1])).products.contour_rays
    rows = rig.cameras[4].project(rays.points_world)[:, 1] - 239.5  # an image's stamp is that of its middle
    mean_s = sum(later_ns.values()) / 6 * 1e-9
    for index, name in enumerate(rig.names):
        own = rays.camera == index
        expected_s = later_ns.get(name, 0) * 1e-9 - mean_s + (line_s * rows[own] if name == "cam05" else 0.0)
        np.testing.assert_allclose(rays.time_s[own], expected_s, atol=1e-9)
    assert np.ptp(rays.time_s[rays.camera == 4]) > 0.002  # a body is hundreds of rows high
    assert not person[2].products.contour_rays.time_s.any()


def test_rays_of_a_camera_inside_the_hulls_box_are_found_too():
    """A camera so near that the hull's box is around and behind it."""
    far = ring_rig(3, size=(640, 480), focal_px=470.0)
    near = look_at("cam09", np.array([0.3, 0.05, 1.5]), np.array([0.05, 0.0, 1.1]), 300.0, (640, 480))
    rig = Rig((*far.cameras, near), VOLUME)
    tall = [*LIMB, (np.array([0.6, 0.6, 0.3]), np.array([0.6, 0.6, 1.9]), 0.06)]
    rays, distance = rays_of(rig, silhouettes(rig, tall), tall)
    mine = distance[rays.camera == 3]
    assert len(mine) > 50 and np.sqrt(np.mean(mine**2)) < 0.003


SIDE = 128
V, U = np.mgrid[:SIDE, :SIDE].astype(float)


@njit(cache=True)
def _pick(mask, box, rules, most, scratch):
    pixels = np.empty((most, 2), np.int32)
    return pixels[: pick_contour_pixels(mask, box, scratch, rules, pixels)]


@njit(cache=True)
def _edges(mask, pixels, weights):
    rows, n = np.empty((pixels.shape[0], 4)), 0
    for u, v in pixels:
        is_edge, edge = find_edge(mask, u, v, weights)
        if is_edge:
            for k in range(4):
                rows[n, k] = edge[k]
            n += 1
    return rows[:n]


def pick(inside, *, shortest_px=4.0, spacing_px=1.0, most=2000):
    mask = np.where(inside, 255, 0).astype(np.uint8)
    return _pick(mask, (0, 0, SIDE, SIDE), (shortest_px, spacing_px), most, Scratch.of(SIDE, SIDE))


def edges(inside, **rules):
    """Points (n, 2) and normals (n, 2) along all outlines of a shape, but for those whose window leaves the image."""
    pixels = pick(inside, **rules)
    whole = ((pixels >= RADIUS_PX) & (pixels < SIDE - RADIUS_PX)).all(axis=1)
    found = _edges(np.where(inside, 255, 0).astype(np.uint8), pixels[whole], weights())
    return found[:, :2], found[:, 2:]


@pytest.mark.parametrize("radius", [7.0, 12.0, 20.0, 45.0])
def test_edge_of_a_circle_is_found_without_bias_in_any_direction(radius):
    rng = np.random.default_rng(int(radius))
    offsets, bearings, turns = [], [], []
    for centre in rng.uniform(63, 65, (60, 2)):
        points, normals = edges(np.hypot(U - centre[0], V - centre[1]) <= radius)
        radial = points - centre
        distance = np.linalg.norm(radial, axis=1)
        offsets.append(distance - radius)
        bearings.append(np.degrees(np.arctan2(radial[:, 1], radial[:, 0])) % 360)
        cosines = np.sum(normals * radial, axis=1) / distance
        turns.append(np.degrees(np.arccos(np.clip(cosines, -1, 1))))
    offsets, bearings, turns = np.concatenate(offsets), np.concatenate(bearings), np.concatenate(turns)
    assert abs(offsets.mean()) < 0.1 and offsets.std() < 0.2
    by_direction = [offsets[(bearings >= low) & (bearings < low + 30)].mean() for low in range(0, 360, 30)]
    assert np.ptp(by_direction) < 0.1
    assert np.median(turns) < 2.5 and np.percentile(turns, 95) < 8


def test_edge_in_the_corner_of_a_wedge_is_left_out():
    """The tip of a sharp wedge is no edge with a direction."""
    wedge = (U > 40) & (np.abs(V - 64) < 0.15 * (U - 40)) & (U < 110)
    points, _ = edges(wedge)
    assert len(points) > 80 and np.hypot(points[:, 0] - 40, points[:, 1] - 64).min() > 5


def test_contour_pixels_follow_every_boundary_pixel_that_opencv_finds():
    """Outer outlines, holes, and pixels that touch in a corner, against OpenCV's contours."""
    rng = np.random.default_rng(3)
    blurred = cv2.GaussianBlur(rng.normal(size=(SIDE, SIDE)), (0, 0), 3)
    inside = blurred > 0.05
    found = {tuple(pixel) for pixel in pick(inside, spacing_px=0.4, most=50_000)}
    contours, _ = cv2.findContours(inside.astype(np.uint8), cv2.RETR_LIST, cv2.CHAIN_APPROX_NONE)
    boundary = {tuple(point) for contour in contours for point in contour[:, 0]}
    # an 8-connected chain may cut the corner of a hole: every pixel on it beside background is on a crack
    cross = cv2.getStructuringElement(cv2.MORPH_CROSS, (3, 3))
    within = cv2.erode(inside.astype(np.uint8), cross, borderType=cv2.BORDER_CONSTANT, borderValue=[0.0])
    beside = {(u, v) for u, v in boundary if not within[v, u]}
    assert len(beside) > 500 and found == beside


def test_contour_pixels_of_small_holes_and_specks_are_left_out():
    body = np.hypot(U - 64, V - 64) <= 40
    body &= ~(np.hypot(U - 55, V - 64) <= 3)  # about 20 px around
    body |= np.hypot(U - 115, V - 10) <= 3
    body &= ~(np.hypot(U - 75, V - 64) <= 9)  # about 57 px around
    pixels = pick(body, shortest_px=30.0)
    assert np.hypot(pixels[:, 0] - 55, pixels[:, 1] - 64).min() > 5
    assert np.hypot(pixels[:, 0] - 115, pixels[:, 1] - 10).min() > 5
    assert (np.hypot(pixels[:, 0] - 75, pixels[:, 1] - 64) < 11).sum() > 40
