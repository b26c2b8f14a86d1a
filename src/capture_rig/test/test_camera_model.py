"""The camera against OpenCV and a plain pinhole formula, and its undistorted canvas against the camera."""

import cv2
import numpy as np
import pytest

from capture_rig import lens
from capture_rig.camera import CameraModel, looking_at
from capture_rig.errors import InputError

WIDTH, HEIGHT = 320, 240
K = np.array([[235.0, 0, 156.4], [0, 233.0, 123.1], [0, 0, 1]])
LENSES = {
    "none": ("plumb_bob", [0, 0, 0, 0, 0]),
    "mild_barrel": ("plumb_bob", [-0.19, 0.084, 3.3e-4, -5.9e-4, 0]),
    "strong_barrel": ("plumb_bob", [-0.45, 0.2, 2e-3, -1e-3, -0.03]),
    "rational": ("rational_polynomial", [8.0, 3.5, 1e-4, 1e-4, 0.15, 8.4, 6.1, 1.2]),
    "fisheye": ("equidistant", [-0.02, 0.01, -0.004, 0.0006]),
}
FOLDING = ("plumb_bob", [-0.5, 0, 0, 0, 0])  # r (1 - r^2 / 2) turns back at r = sqrt(2/3)


def make_camera(model: str, D: list[float]) -> CameraModel:
    T = np.eye(4)
    T[:3, :3], _ = cv2.Rodrigues(np.array([1.2, -0.8, 0.5]))
    T[:3, 3] = 0.3, -0.2, 3.5
    return CameraModel("cam01", WIDTH, HEIGHT, K, model, np.array(D, float), T)


@pytest.fixture(params=LENSES)
def camera(request: pytest.FixtureRequest) -> CameraModel:
    return make_camera(*LENSES[request.param])


def all_pixels() -> np.ndarray:
    columns, rows = np.meshgrid(np.arange(WIDTH, dtype=float), np.arange(HEIGHT, dtype=float))
    return np.stack([columns.ravel(), rows.ravel()], axis=1)


def world_points_in_view(camera: CameraModel, count: int = 200) -> np.ndarray:
    """Points 1 to 6 m in front of the camera and about 30 degrees around its axis."""
    rng = np.random.default_rng(1)
    depth = rng.uniform(1, 6, count)
    points_camera = np.stack([*(rng.uniform(-0.55, 0.55, (2, count)) * depth), depth], axis=1)
    return (points_camera - camera.t_camera_world) @ camera.R_camera_world


def projected_by_opencv(points: np.ndarray, rotation_vector: np.ndarray, t: np.ndarray, D: np.ndarray) -> np.ndarray:
    project = cv2.fisheye.projectPoints if lens.is_fisheye(D) else cv2.projectPoints
    return np.asarray(project(points.reshape(-1, 1, 3), rotation_vector, t, K, D)[0].reshape(-1, 2))


def test_projection_agrees_with_opencv(camera: CameraModel) -> None:
    points = world_points_in_view(camera)
    rotation_vector, _ = cv2.Rodrigues(camera.R_camera_world)
    oracle = projected_by_opencv(points, rotation_vector, camera.t_camera_world, camera.D)
    assert np.abs(camera.project(points) - oracle).max() < 1e-6


def test_pinhole_projection_is_P_times_the_point_whatever_the_leading_axes() -> None:
    camera = make_camera(*LENSES["none"])
    points = world_points_in_view(camera, 6)
    homogeneous = np.column_stack([points, np.ones(len(points))]) @ camera.P.T
    pixels = camera.project(points)
    assert np.abs(pixels - homogeneous[:, :2] / homogeneous[:, 2:]).max() < 1e-9
    assert np.array_equal(camera.project(points.reshape(2, 3, 3)), pixels.reshape(2, 3, 2))
    assert camera.project(points[0].tolist()) == pytest.approx(pixels[0])


def test_projection_behind_the_camera_is_nan(camera: CameraModel) -> None:
    forward = camera.R_camera_world[2]
    pixels = camera.project([camera.centre_world - forward, camera.centre_world, camera.centre_world + forward])
    assert np.isnan(pixels[:2]).all()
    assert np.isfinite(pixels[2]).all()


def test_projection_where_the_lens_model_folds_back_is_nan() -> None:
    camera = make_camera(*FOLDING)
    angles = np.arctan([0.80, 0.83, 1.40])  # the last would be put at radius 0.03, in the middle of the image
    rays = np.stack([np.sin(angles), 0 * angles, np.cos(angles)], axis=1) @ camera.R_camera_world
    finite = np.isfinite(camera.project(camera.centre_world + rays)).all(axis=1)
    assert finite.tolist() == [True, False, False]


@pytest.mark.parametrize("kind", [*LENSES, "pincushion"])
def test_rays_of_every_pixel_project_back_onto_it(kind: str) -> None:
    camera, pixels = make_camera(*LENSES.get(kind, ("plumb_bob", [0.3, 0.1, 1e-3, 0, 0]))), all_pixels()
    rays = camera.rays_world(pixels)
    assert np.abs(np.linalg.norm(rays, axis=1) - 1).max() < 1e-12
    oracle = projected_by_opencv(rays @ camera.R_camera_world.T, np.zeros(3), np.zeros(3), camera.D)
    assert np.abs(oracle - pixels).max() < 1e-6


@pytest.mark.parametrize(
    ("D", "radius"),
    [
        (FOLDING[1], np.sqrt(2 / 3)),
        (LENSES["mild_barrel"][1], np.inf),
        ([0] * 5, np.inf),
        ([0.1, 0, 0, 0, 0, -0.5, 0, 0], np.sqrt(2)),  # a pole: 1 - r^2 / 2 = 0
    ],
)
def test_lens_reaches_to_just_before_its_radial_polynomial_turns(D: list[float], radius: float) -> None:
    reach = lens.reach_radius(np.array(D, float))
    assert reach == radius or 0.98 * radius < reach < radius


def test_undistorted_canvas_keeps_pose_and_scale_and_loses_no_original_pixel(camera: CameraModel) -> None:
    view = camera.undistorted_view()
    canvas = view.camera
    columns, rows = np.rint(canvas.project(camera.centre_world + camera.rays_world(all_pixels()))).astype(int).T
    assert columns.min() >= 0 and columns.max() < canvas.width and canvas.width % 32 == 0
    assert rows.min() >= 0 and rows.max() < canvas.height
    assert view.seen[rows, columns].all()
    assert not canvas.D.any() and np.array_equal(canvas.K[:2, :2], K[:2, :2])
    assert np.array_equal(canvas.T_camera_world, camera.T_camera_world)
    assert camera.undistorted_view() is view  # computed once


def test_undistorted_canvas_without_distortion_is_the_image_padded_to_32() -> None:
    camera = make_camera(*LENSES["none"])
    narrow = CameraModel("cam01", 300, HEIGHT, K, camera.distortion_model, camera.D, camera.T_camera_world)
    view = narrow.undistorted_view()
    assert (view.camera.width, view.camera.height) == (320, HEIGHT)
    assert np.array_equal(view.camera.K, K)
    assert view.seen[:, :300].all() and not view.seen[:, 300:].any()


def test_seen_canvas_pixels_are_those_that_opencv_maps_into_the_image(camera: CameraModel) -> None:
    view = camera.undistorted_view()
    size = (view.camera.width, view.camera.height)
    make_map = cv2.fisheye.initUndistortRectifyMap if lens.is_fisheye(camera.D) else cv2.initUndistortRectifyMap
    x, y = make_map(K, camera.D, np.eye(3), view.camera.K, size, cv2.CV_32FC1)
    inside = (x >= -0.5) & (x <= WIDTH - 0.5) & (y >= -0.5) & (y <= HEIGHT - 0.5)
    at_the_edge = (
        np.minimum.reduce([np.abs(x + 0.5), np.abs(x - WIDTH + 0.5), np.abs(y + 0.5), np.abs(y - HEIGHT + 0.5)]) < 1e-3
    )
    assert np.array_equal(view.seen[~at_the_edge], inside[~at_the_edge])


def test_mask_painted_at_a_projected_point_lands_at_its_canvas_projection(camera: CameraModel) -> None:
    view = camera.undistorted_view()
    points = world_points_in_view(camera)
    pixels = np.rint(camera.project(points)).astype(int)
    framed = ((pixels >= 2) & (pixels < [WIDTH - 2, HEIGHT - 2])).all(axis=1)
    assert framed.sum() > 50
    for point, (column, row) in zip(points[framed], pixels[framed], strict=True):
        mask = np.zeros((HEIGHT, WIDTH), np.uint8)
        mask[row - 1 : row + 2, column - 1 : column + 2] = 255
        rows, columns = np.nonzero(view.undistort_mask(mask))
        centre = np.array([columns.mean(), rows.mean()])
        assert np.abs(centre - view.camera.project(point)).max() < 1.0


def test_undistort_mask_of_another_size_names_camera_and_both_sizes() -> None:
    view = make_camera(*LENSES["none"]).undistorted_view()
    with pytest.raises(InputError, match=r"640 x 480 .*'cam01'.* 320 x 240.*rig file"):
        view.undistort_mask(np.zeros((480, 640), np.uint8))


def test_pixels_without_a_ray_are_those_beyond_the_largest_radius_of_the_polynomial() -> None:
    """About 100 degrees across, the polynomial turns back before it reaches the image's corners."""
    K = np.array([[418.0, 0.0, 326.8], [0.0, 418.0, 239.4], [0.0, 0.0, 1.0]])
    camera = CameraModel("cam01", 644, 486, K, "plumb_bob", np.array([-0.4, 0.15, 0.0, 0.0, -0.03]), np.eye(4))
    r = np.linspace(0.0, 2.0, 200_001)
    largest = 418.0 * float((r * (1 - 0.4 * r**2 + 0.15 * r**4 - 0.03 * r**6)).max())
    y, x = np.meshgrid(np.r_[:486:3, 485], np.r_[:644:3, 643], indexing="ij")
    beyond = np.hypot(x - 326.8, y - 239.4) - largest
    rayless = np.isnan(camera.rays_world(np.column_stack([x.ravel(), y.ravel()]))).any(axis=1).reshape(x.shape)
    clear = np.abs(beyond) > 0.5
    assert np.array_equal(rayless[clear], beyond[clear] > 0)
    assert camera.unused_share == pytest.approx((beyond > 0).mean(), abs=0.005)


def test_whole_image_of_a_lens_that_does_not_fold_is_used_up_to_its_corner() -> None:
    camera = make_camera(*LENSES["mild_barrel"])
    corners = camera.rays_world([[0, 0], [WIDTH - 1, 0], [0, HEIGHT - 1], [WIDTH - 1, HEIGHT - 1]])
    off_axis = np.arccos(corners @ camera.R_camera_world[2])
    assert camera.unused_share == 0.0
    assert camera.reach_rad == pytest.approx(off_axis.max())


def test_fold_all_inside_the_image_is_the_canvas_border() -> None:
    K = np.array([[350.0, 0.0, 322.0], [0.0, 350.0, 243.0], [0.0, 0.0, 1.0]])
    camera = CameraModel("cam01", 644, 486, K, "plumb_bob", np.array([-0.6, 0.0, 0.0, 0.0, 0.0]), np.eye(4))
    view = camera.undistorted_view()
    radius_px = 350.0 * lens.reach_radius(camera.D)
    rows, columns = np.nonzero(view.seen)
    assert np.ptp(columns) == pytest.approx(2 * radius_px, abs=2.0)
    assert np.ptp(rows) == pytest.approx(min(2 * radius_px, 2 * 486), abs=2.0)


@pytest.mark.parametrize(("centre", "up"), [((3.0, -2.0, 1.5), (0, 0, 1)), ((0.1, 0.0, 3.4), (1, 0, 0))])
def test_camera_that_looks_at_a_place_sees_it_in_the_middle_and_level(
    centre: tuple[float, float, float], up: tuple[float, float, float]
) -> None:
    target, roll = np.array([0.2, 0.3, 0.9]), 0.3
    level, rolled = (looking_at(np.array(centre), target, roll_rad=r) for r in (0.0, roll))
    for T in (level, rolled):
        np.testing.assert_allclose(T[:3, :3] @ T[:3, :3].T, np.eye(3), atol=1e-12)
        np.testing.assert_allclose(-T[:3, :3].T @ T[:3, 3], centre, atol=1e-12)
        np.testing.assert_allclose((T[:3, :3] @ target + T[:3, 3])[:2], 0.0, atol=1e-12)
        assert (T[:3, :3] @ target + T[:3, 3])[2] > 0
    assert level[0, :3] @ up == pytest.approx(0.0, abs=1e-12)
    assert level[1, :3] @ up < 0
    assert level[0, :3] @ rolled[0, :3] == pytest.approx(np.cos(roll))


def test_fisheye_of_180_degrees_is_undistorted_as_far_as_a_canvas_of_twice_the_image_goes() -> None:
    focal = WIDTH / np.pi
    K = np.array([[focal, 0, (WIDTH - 1) / 2], [0, focal, (HEIGHT - 1) / 2], [0, 0, 1]])
    camera = CameraModel("cam01", WIDTH, HEIGHT, K, "equidistant", np.zeros(4), np.eye(4))
    angles = np.deg2rad([0.0, 60.0, 87.9, 88.1, 120.0])
    pixels = camera.project(np.stack([np.sin(angles), 0 * angles, np.cos(angles)], axis=1))
    assert pixels[:3, 0] == pytest.approx(K[0, 2] + focal * angles[:3]) and np.isnan(pixels[3:]).all()
    rays = camera.rays_world([[K[0, 2] + focal * np.deg2rad(80.0), K[1, 2]], [WIDTH, K[1, 2]]])
    assert np.rad2deg(np.arccos(rays[0, 2])) == pytest.approx(80.0) and np.isnan(rays[1]).all()
    view = camera.undistorted_view()
    assert (view.camera.width, view.camera.height) == (2 * WIDTH, 2 * HEIGHT)
    across = view.seen[view.camera.height // 2]
    assert across.all() and np.rad2deg(np.arctan(WIDTH / focal)) == pytest.approx(72.3, abs=0.1)
    assert 0.3 < camera.unused_share < 0.5 and np.rad2deg(camera.reach_rad) < 80.0
