"""Plots and overlays: everything that is promised is drawn, where it belongs."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from evaluation_tracks import track_of

from capture_rig.video import Video
from sagoma_tools.evaluation.pictures import caption, draw_plots, draw_stills, sheets, write_overlay
from sagoma_tools.evaluation.track_evaluation import TrackEvaluation, evaluate_track
from sagoma_tools.overlays import LEFT_BGR, TRUTH_BGR, Window, draw_skeleton, overlay

FRAMES = 12


@pytest.fixture()
def evaluated(toured) -> TrackEvaluation:
    """A track that is the truth moved up by 30 mm, its left hand 250 mm off in frame 4, without frame 0."""
    points = toured.truth.points_world[1:] + np.array([0.0, 0.0, 0.03])
    points[3, 11] += [0.0, 0.0, 0.22]
    states = ["acquiring", "tracking", "tracking", "doubtful", *["tracking"] * 7]
    track = track_of(points, states, first=1, sd_m=0.03, angles=toured.truth.angles[1:].copy())
    return evaluate_track(toured, FRAMES, track, thesis=track)


@pytest.mark.slow
def test_every_plot_is_written_and_without_a_truth_the_angles_alone(evaluated, tmp_path):
    paths = draw_plots(tmp_path, evaluated)
    assert [path.stem for path in paths] == ["angles", "point_errors"]
    for path in paths:
        assert cv2.imread(str(path)).std() > 5.0  # there is something on it
    session = replace(evaluated.session, truth=None)
    assert [path.stem for path in draw_plots(tmp_path, evaluate_track(session, FRAMES, evaluated.track))] == ["angles"]


def test_the_caption_says_frame_time_state_and_error(evaluated):
    assert caption(evaluated, 0) == ("tour   frame 0   0.00 s   no body", None)
    assert "frame 4   0.20 s   doubtful   mean 45 mm   worst: left hand 250 mm" in caption(evaluated, 4)[0]


def test_the_video_has_every_frame_stills_some_and_the_worst_one_and_both_need_no_truth(evaluated, tmp_path):
    assert [path.name for path in draw_stills(tmp_path, evaluated)] == ["overlay.png", "worst.png"]
    blind = evaluate_track(replace(evaluated.session, truth=None), FRAMES, evaluated.track)
    assert caption(blind, 4) == ("tour   frame 4   0.20 s   doubtful", False)
    assert [path.name for path in draw_stills(tmp_path / "blind", blind)] == ["overlay.png"]
    with Video(write_overlay(tmp_path / "deep" / "overlay.mp4", blind)) as video:
        assert (video.frame_count, video.fps) == (FRAMES, 20.0)
        assert video.read() is not None
    ((height, width, _),) = {sheet.shape for sheet in sheets(blind, range(FRAMES))}
    assert height % 2 == width % 2 == 0


def test_limbs_are_drawn_where_the_camera_sees_them_and_truth_over_them(toured):
    camera, points = toured.rig.cameras[0], toured.truth.points_world[0]
    picture = overlay(camera, np.zeros((camera.height, camera.width), np.uint8), points, None)
    x, y = np.round(camera.project(points[[3, 7]].mean(0)[None])[0]).astype(int)  # half way along the left upper arm
    np.testing.assert_allclose(picture[y, x], LEFT_BGR, atol=30)  # lines have soft edges
    draw_skeleton(picture, camera, points, TRUTH_BGR)
    np.testing.assert_allclose(picture[y, x], TRUTH_BGR, atol=30)


def test_a_body_behind_the_camera_is_drawn_nowhere_and_the_window_is_the_whole_image(toured):
    camera = toured.rig.cameras[0]
    R, t = camera.T_camera_world[:3, :3], camera.T_camera_world[:3, 3]
    behind = (toured.truth.points_world[0] * [1, 1, 0.1] - [0, 0, 9.0] - t) @ R  # world points 9 m behind the lens
    picture = np.zeros((camera.height, camera.width, 3), np.uint8)
    draw_skeleton(picture, camera, behind)
    assert not picture.any()
    window = Window.around(camera, behind, 100)
    assert window.scale * max(camera.width, camera.height) < 100
