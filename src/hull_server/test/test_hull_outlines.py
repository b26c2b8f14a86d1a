"""Silhouettes' edges to a fraction of a pixel, against shapes whose edges are known in closed form."""

import cv2
import numpy as np
import pytest

from capture_rig.kernel import njit
from hull_server.contour_rays.contour_tracer import Scratch
from hull_server.contour_rays.outlines import RADIUS_PX, find_edge, pick_contour_pixels, weights

SIDE = 128
V, U = np.mgrid[:SIDE, :SIDE].astype(float)


def scratch():
    cracks = 2 * SIDE * SIDE + 4
    path, along = np.empty((cracks, 2), np.int16), np.empty(cracks)
    return Scratch(
        np.zeros((SIDE, SIDE), np.uint8),
        np.zeros((SIDE + 2, SIDE + 16), np.uint8),
        np.empty(cracks // 4, np.int32),
        path,
        along,
        1,
    )


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


def pick(inside, *, shortest_px=4.0, spacing_px=1.0, most=2000, box=(0, 0, SIDE, SIDE)):
    mask = np.where(inside, 255, 0).astype(np.uint8)
    return _pick(mask, box, (shortest_px, spacing_px), most, scratch())


def edges(inside, **rules):
    """Points (n, 2) and normals (n, 2) along all outlines of a shape, but for those whose window leaves the image."""
    pixels = pick(inside, **rules)
    whole = ((pixels >= RADIUS_PX) & (pixels < SIDE - RADIUS_PX)).all(axis=1)
    found = _edges(np.where(inside, 255, 0).astype(np.uint8), pixels[whole], weights())
    return found[:, :2], found[:, 2:]


def degrees_between(a, b):
    return np.degrees(np.arccos(np.clip(np.sum(a * b, axis=1), -1, 1)))


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
        turns.append(degrees_between(normals, radial / distance[:, None]))
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
    background = (
        cv2.erode(
            inside.astype(np.uint8),
            cv2.getStructuringElement(cv2.MORPH_CROSS, (3, 3)),
            borderType=cv2.BORDER_CONSTANT,
            borderValue=[0.0],
        )
        == 0
    )
    beside = {(u, v) for u, v in boundary if background[v, u]}
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


def test_contour_pixels_outside_the_box_are_not_looked_for():
    inside = (np.hypot(U - 30, V - 64) <= 20) | (np.hypot(U - 100, V - 64) <= 20)
    pixels = pick(inside, box=(72, 20, 128, 100))
    assert len(pixels) > 100 and pixels[:, 0].min() >= 80
