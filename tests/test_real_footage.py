"""The four-camera real footage through the live graph, and its bag in lockstep, twice."""

from pathlib import Path

import pytest

from sagoma_bringup.launch_arguments import start_settings
from sagoma_tools.evaluation.live_inputs import FootageInput
from sagoma_tools.evaluation.live_run import LiveRun, evaluate_run, run_live
from sagoma_tools.recording.reader import bag_digest, first_difference
from sagoma_tools.recording.replayer import replay_through_graph

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def live(shared_data, tmp_path_factory) -> LiveRun:
    return run_live(FootageInput(shared_data("real_4cam")), tmp_path_factory.mktemp("real"))


@pytest.fixture(scope="module")
def replayed(live: LiveRun, tmp_path_factory) -> list[Path]:
    folder = tmp_path_factory.mktemp("real_lockstep")
    settings = start_settings(live.session, "auto")
    bags = [folder / name for name in ("first", "second")]
    for bag in bags:
        report = replay_through_graph(live.bag, bag, folder / f"{bag.name}_logs", settings=settings)
        assert report.unanswered_ns == []
    return bags


def test_all_hundred_frame_sets_of_the_real_footage_are_answered_and_none_is_mixed(live):
    assert live.sets == live.answered == 100
    assert live.incomplete == 0
    assert live.spread_ms == 0.0


def test_every_frame_of_the_real_reference_is_tracked(live):
    scores = evaluate_run(live).scores
    assert scores.tracked == scores.frames == 50
    assert scores.mean_mm < 80.0


def test_the_real_bag_replays_to_the_same_bytes_twice_and_to_the_live_run(live, replayed):
    assert bag_digest(replayed[0]) == bag_digest(replayed[1])
    assert first_difference(live.bag, replayed[0], "/mocap/joint_states") is None
