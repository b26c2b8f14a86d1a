"""``sagoma evaluate`` from the footage to the line of JSON, on a short session of the virtual studio; why nobody was
tracked; the rows of the ablation."""

import json
import shutil
from dataclasses import fields, replace
from itertools import pairwise
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from rclpy.serialization import serialize_message
from take_bags import EPOCH_NS as FIRST_NS
from take_bags import PERIOD_NS, write_take

from capture_rig.errors import InputError
from capture_rig.session import Session
from icp_tracker.extrinsic_monitor import ExtrinsicErrors
from icp_tracker.icp_node import fit_message
from icp_tracker.people.people_tracker import PeopleTracker
from icp_tracker.tracker import fits_nothing
from mocap_packets.fit import DOUBTFUL, PART_NAMES, Fit
from mocap_pipeline.configuration import Configuration
from mocap_pipeline.pipeline import MocapPipeline
from sagoma_bringup.launch_arguments import start_settings
from sagoma_tools.cli import main
from sagoma_tools.commands.evaluate import find
from sagoma_tools.evaluation.in_process import OURS, PARTS, ROWS, THESIS, ablation_rows, track_people, track_session
from sagoma_tools.evaluation.track import explain, rank_reasons, reasons_of_bag, tracks_from_bag
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


def test_without_truth_a_session_is_judged_by_what_can_be_said_and_without_a_background_not(
    tour, capsys, tmp_path, monkeypatch
):
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
    next(blind.glob("cam03_background.*")).unlink()
    assert main(["evaluate", str(blind)]) == 2
    said = capsys.readouterr().err
    assert "there is no background for cam03" in said and "Add cam03_background" in said


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


# --- why nobody was tracked

WATCHED = "somebody is here: watched for {:.1f} of 1.0 s"
BELOW = "cam02 does not see your feet: step 0.4 m away from cam02"


def test_the_most_frequent_reasons_are_said_and_those_that_differ_in_numbers_or_the_way_to_step_are_one():
    sets = [(WATCHED.format(0.1 * k),) for k in range(5)] + [("no hull",)] * 2
    assert rank_reasons(sets) == [(WATCHED.format(0.2), 5), ("no hull", 2)]
    other_way, other_camera = (
        BELOW.replace("0.4 m away from", "0.7 m towards"),
        BELOW.replace("cam02 does", "cam03 does"),
    )
    assert [count for _, count in rank_reasons([(BELOW,), (other_camera,), (other_way,)])] == [2, 1]
    sets = [(WATCHED.format(0.5),)] * 9 + [("nobody upright",)] * 2 + [("anything",), ("no hull",)]
    said = f'of 13 frame sets the tracker said "{WATCHED.format(0.5)}" in 9, "nobody upright" in 2, "anything" in 1'
    assert explain(sets) == said
    assert explain([()] * 4) == "of 4 frame sets the tracker said nothing"


def write_bag(folder: Path, fits: list[Fit]) -> Path:
    with BagWriter(folder) as bag:
        bag.add_topic("/icp/fit", "diagnostic_msgs/msg/DiagnosticArray")
        for fit in fits:
            bag.write("/icp/fit", fit.stamp_ns, serialize_message(fit_message((fit,), "articulated")))
    return folder


def test_a_bag_tells_the_same_reasons_and_that_of_a_tracked_person_without_the_topics_asks_for_these(tmp_path):
    bag = write_bag(tmp_path / "bag", [fits_nothing(k, WATCHED.format(0.1 * k)) for k in range(1, 4)])
    assert reasons_of_bag(bag, lambda stamp_ns: stamp_ns > 1) == [(WATCHED.format(0.2),), (WATCHED.format(0.3),)]
    with pytest.raises(InputError, match=r'of 3 frame sets the tracker said "somebody .* watched for 0\.2 of .* in 3'):
        tracks_from_bag(bag, lambda stamp_ns: stamp_ns)[1]
    bag = write_bag(tmp_path / "tracked", [replace(fits_nothing(1, ""), state="tracking", reason="")])
    assert reasons_of_bag(bag) == [()]
    with pytest.raises(InputError, match="Record /mocap/reference_points"):
        tracks_from_bag(bag, lambda stamp_ns: stamp_ns)[1]


def test_evaluate_ends_with_the_reasons_of_a_session_in_which_nobody_is_found(tour, capsys):
    settings = ("hull_server.backend=cpu", "icp_tracker.initial_pose.t_pose.stature_high_m=1.4")
    arguments = ["--exact-masks", "--json", *(word for one in settings for word in ("--set", one))]
    assert main(["evaluate", str(tour), *arguments]) == 2
    said = " ".join(capsys.readouterr().err.split())
    assert "no body was found in any frame: of 12 frame sets the tracker said" in said


# --- the rows of the ablation


def started(session: Session, **changes) -> Configuration:
    settings = {**start_settings(session, "session"), "hull_server.backend": "cpu"}
    return replace(Configuration.of(settings), **changes)


def differing(a, b, prefix="") -> set[str]:
    """Dotted names of the settings in which two configurations differ."""
    if type(a) is not type(b) or not hasattr(a, "__dataclass_fields__"):
        return set() if a == b else {prefix}
    found = [differing(getattr(a, f.name), getattr(b, f.name), f"{prefix}.{f.name}".lstrip(".")) for f in fields(a)]
    return set().union(*found)


def test_the_last_row_is_the_settings_own_the_first_the_thesis_method_and_each_adds_exactly_one_part():
    settings = {"icp_tracker.refinement.keyframes": 20}
    rows = ablation_rows(settings)
    assert tuple(rows) == ROWS
    assert differing(rows[OURS], Configuration.of(settings)) == set()
    first = rows[THESIS]
    assert (first.icp.method, first.ekf.motion_model, first.feedback) == ("hierarchical", "identity", False)
    assert first.icp.refinement.keyframes == 20
    for (before, after), without in zip(pairwise(rows.values()), PARTS.values(), strict=True):
        switched = {key.replace("icp_tracker.", "icp.").replace("ekf_tracker.filter.", "ekf.") for key in without}
        assert differing(before, after) == switched


def test_a_configuration_tracks_the_same_alone_and_beside_others_which_share_one_carving(toured, monkeypatch):
    alone = track_session(toured, started(toured), exact_masks=True)
    carved = []
    carve = MocapPipeline.carve_set
    monkeypatch.setattr(MocapPipeline, "carve_set", lambda *args: carved.append(args[1].stamp_ns) or carve(*args))
    both = {"a": started(toured), "b": started(toured, feedback=False)}
    beside = {name: people[1] for name, people in track_people(toured, both, exact_masks=True).items()}
    assert len(carved) == len(set(carved)) == 12
    assert alone.points_world.tobytes() == beside["a"].points_world.tobytes()
    assert not np.array_equal(beside["a"].points_world, beside["b"].points_world)
