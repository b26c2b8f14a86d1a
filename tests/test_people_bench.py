"""bench/people.py scores what it says, its sets survive the file, and mesh people's silhouettes and clips are right."""

import numpy as np
import pytest
from mesh_body import NAMES, PARENTS, MeshBody
from mesh_motions import TURNING_S, _rounded
from mesh_silhouettes import silhouette
from people import judged
from products import Recorded, load

from capture_rig.camera import CameraModel, looking_at
from mocap_packets.hull import Centerline, ContourRays, HullProducts, VoxelSamples
from sagoma_tools.evaluation.track import Track
from virtual_studio.rig import ring

FRAMES = 20
PARTS = np.full((FRAMES, 5), "good")


def test_figures_of_a_row():
    truth = np.tile(np.random.default_rng(3).uniform(0.0, 1.0, (15, 3)), (FRAMES, 1, 1))
    points = truth.copy()
    points[:, 0, 2] += 0.03  # 30 mm on one of 15 points
    points[:4, 11, 2] += 0.3  # four bad frames
    states = np.full(FRAMES, "tracking")
    P = np.tile(0.02**2 * np.eye(3), (FRAMES, 15, 1, 1))
    track = Track(np.arange(2, FRAMES), points[2:], P[2:], np.zeros((FRAMES - 2, 18)), states[2:], PARTS[2:])
    figures = judged(_recorded(truth), {1: track}, 1.5)
    assert figures.frames == FRAMES and figures.ms == 1.5
    assert figures.tracked == pytest.approx((FRAMES - 2) / FRAMES)
    assert figures.mean_mm == pytest.approx((18 * 30.0 + 2 * 300.0) / (18 * 15))
    assert figures.over_200mm == pytest.approx(2 / 18)
    assert figures.inside_95 == pytest.approx(1.0 - 2 / (18 * 15))
    assert figures.worst_point_inside_95 == pytest.approx(16 / 18)


def test_a_set_that_was_not_found():
    figures = judged(_recorded(np.zeros((FRAMES, 15, 3))), {}, 2.0)
    assert figures.mean_mm is None and figures.tracked == 0.0


def test_two_persons_tracks_are_told_apart():
    truth = np.random.default_rng(1).normal(0.0, 0.05, (FRAMES, 15, 3))
    other = truth + np.array([1.0, 0.0, 0.0])
    states, P = np.full(FRAMES, "tracking"), np.tile(0.02**2 * np.eye(3), (FRAMES, 15, 1, 1))
    tracks = {
        number: Track(np.arange(FRAMES), points, P, np.zeros((FRAMES, 18)), states, PARTS)
        for number, points in ((1, other + np.array([0.0, 0.0, 0.01])), (2, truth))
    }
    figures = judged(_recorded(truth, other), tracks, 1.0)
    assert figures.frames == 2 * FRAMES and figures.switches == 0 and figures.ghosts == 0
    assert figures.mean_mm == pytest.approx(5.0)


def test_products_survive_the_file(tmp_path):
    centerline = Centerline.from_table(np.ones(3, Centerline.LAYOUT))
    rays = ContourRays.from_table(np.zeros(2, ContourRays.LAYOUT))
    products = HullProducts(7, centerline, VoxelSamples.from_table(np.zeros(4, VoxelSamples.LAYOUT)), rays)
    made = Recorded("a set", ring(2), 50.0, [products], (np.zeros((1, 15, 3)), np.ones((1, 15, 3))), {"a.b": 1})
    made.save(tmp_path / "kept" / "one.pkl")
    read = load(tmp_path / "kept" / "one.pkl")
    assert read.fps == 50.0 and read.start == {"a.b": 1} and read.rig.names == made.rig.names
    assert np.array_equal(read.products[0].centerline.to_table(), centerline.to_table())
    assert [truth.mean() for truth in read.truths] == [0.0, 1.0]


def test_silhouette_of_a_square():
    T = looking_at(np.array([0.0, -2.0, 0.0]), np.zeros(3))
    camera = CameraModel(
        "c", 64, 48, np.array([[100.0, 0, 31.5], [0, 100.0, 23.5], [0, 0, 1]]), "plumb_bob", np.zeros(5), T
    )
    corners = 0.15 * np.array([[-1.0, 0, -1], [1, 0, -1], [1, 0, 1], [-1, 0, 1]])
    picture = silhouette(camera, [corners], [np.array([[0, 1, 2], [0, 2, 3]], np.int32)])
    half = 100.0 * 0.15 / 2.0
    rows, columns = np.mgrid[:48, :64]
    assert np.array_equal(picture == 255, (abs(columns - 31.5) <= half) & (abs(rows - 23.5) <= half))


def test_bones_turn_what_hangs_on_them():
    heads = np.random.default_rng(2).normal(size=(len(NAMES), 3))
    body = MeshBody(
        heads.copy(), np.zeros((0, 3), np.int32), heads, np.eye(len(NAMES), dtype=np.float32), np.zeros(0), {}
    )
    elbow = NAMES.index("lowerarm01.L")
    quarter = np.tile(np.eye(3), (len(NAMES), 1, 1))
    quarter[elbow] = [[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]
    vertices, moved = body.posed(quarter, heads[0])
    wrist = NAMES.index("wrist.L")
    assert PARENTS[wrist] == elbow
    assert moved[wrist] == pytest.approx(heads[elbow] + quarter[elbow] @ (heads[wrist] - heads[elbow]))
    still = [k for k in range(len(NAMES)) if k != wrist]
    assert moved[still] == pytest.approx(heads[still]) and vertices == pytest.approx(moved, abs=1e-6)


def test_a_clip_played_there_and_back_has_no_kink():
    times = np.linspace(0.0, 2.0, 2001)
    within = _rounded(1.0 - np.abs(times - 1.0), 1.0)
    assert within.min() == pytest.approx(0.5 * TURNING_S) and within.max() == pytest.approx(1.0 - 0.5 * TURNING_S)
    assert np.abs(np.diff(within, 2)).max() < 1.1 * 0.001**2 / TURNING_S


def _recorded(*truths: np.ndarray) -> Recorded:
    return Recorded("made", ring(2), 50.0, [], truths)
