"""A wand of bright markers: found in images, numbered, and a rig calibrated with nothing else."""

import bundle_studio as studio
import cv2
import numpy as np
import pytest

from capture_rig.errors import InputError
from rig_calibration.boards.board import TargetDetection
from rig_calibration.boards.wand import WAND, find_blobs, find_wand, wand_looks_alike, wand_points
from rig_calibration.bundle.solve import solve_rig

UNEVEN, EVEN, TWO = (0.0, 0.25, 0.4), (0.0, 0.2, 0.4), (0.0, 0.4)
CAMERA = studio.camera_at("cam01", (3, 0, 1.5))


def picture(pixels: np.ndarray, rng: np.random.Generator, radius_px: float = 3.0, room: float = 12.0) -> np.ndarray:
    """Discs with soft edges in a dark, slightly noisy image."""
    image = np.full((studio.SIZE[1], studio.SIZE[0]), room)
    for u, v in pixels:
        left, top = int(u - radius_px) - 2, int(v - radius_px) - 2
        rows, columns = np.mgrid[top : top + int(2 * radius_px) + 6, left : left + int(2 * radius_px) + 6]
        image[rows, columns] += 230 * np.clip(radius_px + 0.5 - np.hypot(columns - u, rows - v), 0, 1)
    return np.clip(image + 2 * rng.normal(size=image.shape), 0, 255).astype(np.uint8)


def wand_detections(marks: tuple[float, ...], frames: int, seed: int) -> list[TargetDetection]:
    """Markers with 0.1 px of noise; of a wand that looks the same from both ends, numbered at random."""
    rng, found = np.random.default_rng(seed), []
    for frame_index, T in studio.waved(rng, frames).items():
        for name, camera in studio.ring(4).items():
            pixels = studio.project(camera, T, wand_points(marks))
            if np.all((pixels > 2) & (pixels < np.array(studio.SIZE) - 3)):
                ids = np.arange(len(marks))[:: rng.choice([1, -1]) if wand_looks_alike(marks) else 1].copy()
                noisy = pixels + 0.1 * rng.normal(size=pixels.shape)
                found.append(TargetDetection(name, frame_index, ids, noisy, studio.SIZE, WAND, 0.1))
    return found


@pytest.mark.parametrize("radius_px", [1.0, 3.0, 6.0])
def test_blobs_lie_where_the_markers_are(radius_px: float):
    pixels = np.array([[100.3, 80.7], [320.1, 240.4], [500.8, 400.2]])
    blobs = find_blobs(picture(pixels, np.random.default_rng(0), radius_px))
    assert len(blobs) == 3
    found = blobs[np.argsort(blobs[:, 0])]
    assert np.abs(found - pixels).max() < 0.15


def test_dark_stick_before_a_brighter_wall_does_not_shift_the_balls():
    rng, fine = np.random.default_rng(0), 8
    ends = np.array([[50.3, 50.6], [102.7, 71.2]])
    light = np.full((120 * fine, 160 * fine), 0.12)
    place = ((ends + 0.5) * fine - 0.5).astype(np.float32)
    cv2.line(light, *(tuple(np.rint(p).astype(int).tolist()) for p in place), 0.01, 3 * fine)
    rows, columns = np.mgrid[: light.shape[0], : light.shape[1]]
    for x, y in place:
        light[np.hypot(columns - x, rows - y) < 3.6 * fine] = 1.2  # beyond what the sensor takes
    blurred = cv2.GaussianBlur(cv2.resize(light, (160, 120), interpolation=cv2.INTER_AREA), (0, 0), 0.6)
    along, away = (ends[1] - ends[0]) / np.linalg.norm(ends[1] - ends[0]), []
    for _ in range(12):
        image = np.clip(np.rint(255 * blurred + 2 * rng.normal(size=blurred.shape)), 0, 255).astype(np.uint8)
        found = find_blobs(image)
        away.append((found[np.argsort(found[:, 0])] - ends) @ along)
    first, last = np.mean(away, axis=0)
    assert abs(last - first) < 0.03  # 0.07 px when what lies behind is taken for the wall all around


def test_dark_image_has_no_blobs_and_streaks_are_none():
    rng = np.random.default_rng(0)
    assert len(find_blobs(picture(np.empty((0, 2)), rng))) == 0
    streak = cv2.line(picture(np.array([[100.0, 100]]), rng), (200, 200), (260, 200), 250, 5)
    np.testing.assert_allclose(find_blobs(streak), [[100, 100]], atol=0.1)


def test_wand_is_found_before_a_lit_room_with_its_background():
    rng = np.random.default_rng(1)
    room = np.tile(np.linspace(40, 150, studio.SIZE[0]), (studio.SIZE[1], 1))
    room[100:200, 300:330] = 245  # a window
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = studio.rotation([0, 0, 1.3]), (0.2, 0.1, 1.1)
    pixels = studio.project(CAMERA, T, wand_points(UNEVEN))
    lamps = picture(pixels, rng, room=0.0).astype(float)
    noise = 2 * rng.normal(size=(2, *room.shape))
    image, background = (np.clip(i, 0, 255).astype(np.uint8) for i in (room + lamps + noise[0], room + noise[1]))
    found = find_wand(image, UNEVEN, CAMERA, background=background)
    assert found is not None
    np.testing.assert_allclose(found.pixels, pixels, atol=0.3)
    with pytest.raises(InputError, match="background has 320 x 240"):
        find_wand(image, UNEVEN, CAMERA, background=background[::2, ::2])


def test_uneven_wand_is_numbered_right_among_stray_lights():
    rng, right, found = np.random.default_rng(2), 0, 0
    for T in studio.waved(rng, 30).values():
        pixels = studio.project(CAMERA, T, wand_points(UNEVEN))
        length = np.linalg.norm(pixels[-1] - pixels[0])
        if not np.all((pixels > 10) & (pixels < np.array(studio.SIZE) - 10)) or length < 40:
            continue
        strays = rng.uniform([10, 10], np.array(studio.SIZE) - 10, size=(2, 2))
        detection = find_wand(picture(np.concatenate([pixels, strays]), rng), UNEVEN, CAMERA, frame_index=3)
        if detection is not None:
            found += 1
            right += int(np.abs(detection.pixels - pixels).max() < 1.0)
    assert found >= 15 and right == found


def test_spots_that_are_no_wand_are_not_taken_for_one():
    crooked = np.array([[100.0, 100], [200, 180], [300, 100]])
    wrong_spacing = np.array([[100.0, 100], [120, 100], [300, 100]])
    for pixels in (crooked, wrong_spacing, crooked[:2]):
        assert find_wand(picture(pixels, np.random.default_rng(0)), UNEVEN, CAMERA) is None


@pytest.mark.parametrize("marks", [UNEVEN, EVEN])
def test_rig_from_a_wand_alone(marks: tuple[float, ...]):
    cameras = studio.ring(4)
    solution = solve_rig(
        cameras,
        wand_detections(marks, 20, seed=1),
        {WAND: wand_points(marks)},
        alike={WAND} if wand_looks_alike(marks) else (),
    )
    others = [name for name in cameras if solution.covariance[name].any()]
    (root,) = set(cameras) - set(others)
    found = studio.errors(solution, studio.truth(cameras, root), root)
    centre_mm, rotation_deg = studio.worst(found)
    assert centre_mm < 5 and rotation_deg < 0.1
    normalised = np.array([found[name] / np.sqrt(np.diag(solution.covariance[name])) for name in others])
    assert 0.5 < np.sqrt(np.mean(normalised**2)) < 1.7


def test_wand_and_floor_board_together_give_the_world():
    cameras = studio.ring(4)
    floor = studio.detections_of(cameras, {0: studio.T_WORLD_FLOOR}, "floor", np.random.default_rng(0), max_tilt_deg=85)
    solution = solve_rig(
        cameras,
        wand_detections(TWO, 20, seed=2) + floor,
        {WAND: wand_points(TWO), "floor": studio.TARGETS["floor"]},
        reference=studio.ON_FLOOR,
        alike={WAND},
    )
    centre_mm, rotation_deg = studio.worst(studio.errors(solution, studio.truth(cameras)))
    assert centre_mm < 7 and rotation_deg < 0.12
    ratio, sd = solution.scale_of["floor"]
    assert abs(ratio - 1) < 3 * sd


def test_too_few_views_of_a_wand_are_an_error_that_names_the_cameras():
    with pytest.raises(InputError, match=r"too few common views of the wand"):
        solve_rig(studio.ring(4), wand_detections(UNEVEN, 3, seed=1), {WAND: wand_points(UNEVEN)})


@pytest.mark.parametrize(
    ("marks", "said"),
    [((0.4,), "wand of 1 markers"), ((0.0, 0.4, 0.2), "do not rise"), ((0.0, 0.21, 0.4), "almost, but not quite")],
)
def test_impossible_wands_are_refused(marks: tuple[float, ...], said: str):
    with pytest.raises(InputError, match=said):
        wand_looks_alike(marks)
