"""``sagoma evaluate`` from the footage to the line of JSON, on a short session of the virtual studio."""

import json
import shutil
from pathlib import Path
from types import SimpleNamespace

import pytest
from take_bags import EPOCH_NS as FIRST_NS
from take_bags import PERIOD_NS, write_take

from capture_rig.errors import InputError
from icp_tracker.extrinsic_monitor import ExtrinsicErrors
from icp_tracker.people.people_tracker import PeopleTracker
from mocap_packets.fit import DOUBTFUL, PART_NAMES
from sagoma_tools.cli import main
from sagoma_tools.commands.evaluate import find
from sagoma_tools.evaluation.in_process import OURS, ROWS, THESIS
from sagoma_tools.evaluation.track import tracks_from_bag
from sagoma_tools.recording.writer import BagWriter

FRAMES = 12
DOUBT = ("flagged_of_bad", "false_alarms", "identity_switches")
FIGURES = {*DOUBT, "p95_mm", "over_200mm", "mean_mm_without_offset", "inside_95"}
LEFT_ARM = PART_NAMES.index("left arm")


def evaluated(capsys, *arguments) -> dict:
    assert main(["evaluate", *map(str, arguments), "--set", "hull_server.backend=cpu"]) == 0
    return json.loads(capsys.readouterr().out.splitlines()[-1])


def test_evaluate_prints_every_figure_and_compares_with_the_thesis_method(tour, capsys):
    figures = evaluated(capsys, tour, "--start", "session", "--exact-masks", "--json")
    assert set(figures) >= FIGURES
    assert (figures["frames"], figures["tracked"], figures["time_to_track_s"]) == (FRAMES, FRAMES, 0.0)
    assert 0.0 < figures["mean_mm"] < 40.0
    assert figures["mean_mm"] != figures["thesis_mean_mm"] > 0.0
    assert figures["states"] == {"tracking": FRAMES}
    assert tuple(figures[key] for key in DOUBT) == (None, 0.0, 0)


@pytest.mark.slow
def test_the_ablation_ends_with_our_figures_and_begins_with_the_thesis(tour, capsys, tmp_path):
    arguments = (tour, "--start", "session", "--exact-masks", "--ablation", "--plots", tmp_path)
    assert main(["evaluate", *map(str, arguments), "--set", "hull_server.backend=cpu"]) == 0
    said = capsys.readouterr().out
    figures = json.loads(said.splitlines()[-1])
    assert tuple(figures["ablation"]) == ROWS
    assert figures["ablation"][OURS]["mean_mm"] == figures["mean_mm"]
    assert figures["ablation"][THESIS]["mean_mm"] == figures["thesis_mean_mm"]
    assert "ablation: each row adds one part" in said
    assert {path.name for path in tmp_path.iterdir()} >= {"point_errors.png", "overlay.png", "worst.png"}


def test_a_session_without_truth_is_tracked_and_judged_by_what_can_be_said(tour, capsys, tmp_path, monkeypatch):
    moved = ExtrinsicErrors({"cam02": 0.012}, dict.fromkeys(("cam02", "cam03"), "cam02 or cam03 was moved"))
    monkeypatch.setattr(PeopleTracker, "extrinsic_errors", moved)
    blind = shutil.copytree(tour, tmp_path / "blind")
    (blind / "truth.csv").unlink()
    assert main(["evaluate", str(blind), "--exact-masks", "--json"]) == 0
    said = capsys.readouterr()
    assert said.err.count("sagoma: cam02 or cam03 was moved") == 1
    figures = json.loads(said.out.splitlines()[-1])
    assert figures["frames"] == FRAMES
    assert figures["time_to_track_s"] is not None
    assert not {"mean_mm", "thesis_mean_mm", "inside_95"} & set(figures)
    assert main(["evaluate", str(blind), "--ablation"]) == 2
    assert "Leave out --ablation" in capsys.readouterr().err


def test_a_bag_is_judged_on_the_session_that_it_names_and_one_of_unknown_origin_asks_for_it(tour, tmp_path):
    asked = SimpleNamespace(session=str(tmp_path / "bag"), bag=None)
    with BagWriter(tmp_path / "bag") as bag:
        bag.add_topic("/mocap/joint_states", "sensor_msgs/msg/JointState")
    with pytest.raises(InputError, match="neither of which session it is nor"):
        find(asked)
    bag.describe({"session": str(tour)})
    found, path = find(asked)
    assert (found.folder, path) == (tour, asked.session)


@pytest.fixture
def live(tour, tmp_path):
    """``live(ids)``: a bag of 40 frame sets of live cameras at 50 Hz, the first four of which nobody answers, and two
    of which are doubtful; ``ids`` of further bodies."""

    def write(*ids):
        prefixes = ("/mocap", *(f"/mocap/bodies/{body_id}" for body_id in ids))
        bag = write_take(tmp_path / "live", 40, missing=range(4), doubtful=range(4, 6), prefixes=prefixes)
        return Path(shutil.copy(tour / "rig.yaml", bag)).parent

    return write


def test_a_bag_of_live_cameras_is_judged_by_what_can_be_said(live, capsys):
    bag = live()
    figures = evaluated(capsys, bag, "--json")
    assert figures.pop("states") == {"doubtful": 2, "tracking": 34}
    assert {key: figures.pop(key) for key in DOUBT} == dict.fromkeys(DOUBT)  # there is no truth
    assert figures == {"frames": 40, "tracked": 36, "time_to_track_s": 0.12, "jitter_mm": None}  # nothing rests
    assert main(["evaluate", str(bag), "--ablation"]) == 2
    assert "one track and no variants" in capsys.readouterr().err


def test_a_bag_holds_a_track_of_each_person(live, capsys):
    bag = live("b0003", "anna")
    tracks = tracks_from_bag(bag, lambda stamp_ns: (stamp_ns - FIRST_NS) // PERIOD_NS)
    found = [(person, int(track.frames[0]), len(track)) for person, track in tracks.items()]
    assert found == [(1, 4, 36), (3, 4, 36), (5, 4, 36)]  # anna is of no number of ours
    assert tracks[1].parts[:3, LEFT_ARM].tolist() == [DOUBTFUL, DOUBTFUL, ""]
    places = [track.points_world[0, 0, 0] for track in tracks.values()]
    assert places == pytest.approx([places[0], places[0] + 1.0, places[0] + 2.0])
    figures = evaluated(capsys, bag, "--json")
    assert figures["tracked"] == 36 and "persons" not in figures  # there is no truth of several persons
