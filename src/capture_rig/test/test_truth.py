"""Reference data: both file forms, midpoints, wrists against hand tips, and damaged tables."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from capture_rig.errors import InputError
from capture_rig.session import ANGLE_COUNT, POSE_NETWORK, RENDERED, WRIST_FRACTION, Truth, load_truth

ANGLES = [f"angle{k}_rad" for k in range(ANGLE_COUNT)]


def columns_of(table: tuple[tuple[str, ...], ...]) -> list[str]:
    return [f"{part}_{axis}" for part in sorted({part for parts in table for part in parts}) for axis in "xyz"]


def write(path: Path, columns: list[str], rows: list[list[object]]) -> Path:
    lines = [["frame", *columns], *rows]
    path.write_text("\n".join(",".join(map(str, line)) for line in lines) + "\n")
    return path


def numbers(columns: list[str], frame: int = 0) -> list[object]:
    return [frame, *(np.random.default_rng(frame).normal(size=len(columns)).round(5).tolist())]


def test_rendered_truth_gives_frames_and_points_in_order(tmp_path: Path) -> None:
    columns = columns_of(RENDERED)
    rows = [numbers(columns, frame) for frame in (0, 1, 5)]
    truth = load_truth(write(tmp_path / "truth.csv", columns, rows))
    assert truth.frames.tolist() == [0, 1, 5]
    assert truth.points_world.shape == (3, 15, 3)
    head = 1 + columns.index("head_top_x")
    assert truth.points_world[2, 1].tolist() == rows[2][head : head + 3]
    right_foot = 1 + columns.index("r_ankle_x")
    assert truth.points_world[1, 14].tolist() == rows[1][right_foot : right_foot + 3]
    assert truth.angles is None


def test_torso_centre_is_half_way_from_neck_to_mid_hips(tmp_path: Path) -> None:
    columns = columns_of(RENDERED)
    points = load_truth(write(tmp_path / "truth.csv", columns, [numbers(columns)])).points_world[0]
    assert points[0] == pytest.approx((points[2] + (points[5] + points[6]) / 2) / 2)


def test_empty_cells_are_unknown_points(tmp_path: Path) -> None:
    columns = columns_of(RENDERED)
    row = numbers(columns)
    row[1 + columns.index("l_knee_y")] = ""
    points = load_truth(write(tmp_path / "truth.csv", columns, [row])).points_world[0]
    assert np.isnan(points[9, 1])
    assert np.isfinite(np.delete(points, 9, axis=0)).all()


def test_eighteen_angle_columns_are_read_as_angles(tmp_path: Path) -> None:
    columns = [*columns_of(RENDERED), *ANGLES, "torso_rx_rad"]
    row = numbers(columns)
    truth = load_truth(write(tmp_path / "truth.csv", columns, [row]))
    assert truth.angles is not None
    assert truth.angles.tolist() == [row[-1 - ANGLE_COUNT : -1]]


def test_pose_network_reference_ends_at_the_wrist(tmp_path: Path) -> None:
    columns = columns_of(POSE_NETWORK)
    row = numbers(columns)
    truth = load_truth(write(tmp_path / "reference.csv", columns, [row]))
    wrist = 1 + columns.index("LWrist_x")
    assert truth.points_world[0, 11].tolist() == row[wrist : wrist + 3]
    assert truth.wrist_fraction == WRIST_FRACTION


def test_stick_figure_of_a_wrist_reference_ends_at_the_finger_tips(tmp_path: Path) -> None:
    columns = columns_of(POSE_NETWORK)
    truth = load_truth(write(tmp_path / "reference.csv", columns, [numbers(columns)]))
    reference, stick_figure = truth.points_world[0], truth.stick_figure_points()[0]
    for elbow, hand in ((7, 11), (8, 12)):
        wrist_m, tip_m = (np.linalg.norm(points[hand] - points[elbow]) for points in (reference, stick_figure))
        assert wrist_m / tip_m == pytest.approx(0.146 / 0.254)  # forearm, and forearm with hand, of stature
    assert truth.comparable(stick_figure) == pytest.approx(reference)


def test_shared_reference_is_a_person_of_plausible_size(shared_data: Callable[..., Path]) -> None:
    truth = load_truth(shared_data("real_4cam", "reference_first50.csv"))
    points = truth.stick_figure_points()
    assert truth.frames.tolist() == list(range(50))
    thigh_m = np.linalg.norm(points[:, 9] - points[:, 5], axis=1)
    assert 0.35 < np.nanmedian(thigh_m) < 0.5
    assert (np.nanmedian(points[:, 1, 2]) > np.nanmedian(points[:, [5, 6], 2])).all()  # head above hips: z is up


def test_shared_sessions_have_the_torso_centroid_where_the_renderer_put_it(shared_data: Callable[..., Path]) -> None:
    truth = load_truth(shared_data("sessions", "walk_ring5top", "truth.csv"))
    # the rig's pelvis joint is not exactly between the hip joints, so the two torso centres differ by millimetres
    assert truth.points_world[0, 2] == pytest.approx([-0.00477, 1.48977, 1.50445])
    assert len(truth.frames) == 240


@pytest.mark.parametrize("axis", "xyz")
def test_missing_column_is_named(tmp_path: Path, axis: str) -> None:
    columns = [c for c in columns_of(RENDERED) if c != f"l_knee_{axis}"]
    with pytest.raises(InputError, match=rf"truth\.csv: column 'l_knee_{axis}' is missing.*every reference point"):
        load_truth(write(tmp_path / "truth.csv", columns, [numbers(columns)]))


@pytest.mark.parametrize("text", ["", "frame,a\n0,high\n", "frame,a\n0,1\n1\n", "frame,a\n", "a,b\n1,2\n", "\x00\xff"])
def test_text_that_is_no_table_of_numbers_is_refused(tmp_path: Path, text: str) -> None:
    (tmp_path / "truth.csv").write_text(text, encoding="latin-1")
    with pytest.raises(InputError, match=r"truth\.csv: ") as caught:
        load_truth(tmp_path / "truth.csv")
    assert caught.value.remedy


@pytest.mark.parametrize("frame", ["0.5", ""])
def test_frame_that_is_no_whole_number_is_refused(tmp_path: Path, frame: str) -> None:
    columns = columns_of(RENDERED)
    with pytest.raises(InputError, match=r"column 'frame' holds something else than whole numbers"):
        load_truth(write(tmp_path / "truth.csv", columns, [[frame, *numbers(columns)[1:]]]))


def test_rows_of_chosen_frames_are_kept_with_their_angles() -> None:
    frames = np.array([2, 4, 6, 9])
    points = np.arange(4.0)[:, None, None] * np.ones((15, 3))
    truth = Truth(frames, points, np.arange(4.0)[:, None] * np.ones(18), 1.0, Path("truth.csv"))
    chosen = truth.of_frames(np.array([1, 4, 9, 10]))
    assert chosen.frames.tolist() == [4, 9]
    assert chosen.points_world[:, 0, 0].tolist() == [1.0, 3.0] and chosen.angles[:, 0].tolist() == [1.0, 3.0]
