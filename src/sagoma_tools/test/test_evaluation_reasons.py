"""Why nobody was tracked: reasons are counted by set, whatever their numbers."""

from pathlib import Path

import pytest
from rclpy.serialization import serialize_message

from capture_rig.errors import InputError
from icp_tracker.icp_node import fit_message
from icp_tracker.tracker import fits_nothing
from mocap_packets.fit import Fit
from sagoma_tools.cli import main
from sagoma_tools.evaluation.track import explain, rank_reasons, reasons_of_bag, tracks_from_bag
from sagoma_tools.recording.writer import BagWriter

WATCHED = "somebody is here: watched for {:.1f} of 1.0 s"
BELOW = "cam02 does not see your feet: step 0.4 m away from cam02"


def test_reasons_that_differ_in_numbers_are_one_with_the_numbers_of_a_typical_set():
    sets = [(WATCHED.format(0.1 * k),) for k in range(5)] + [("no hull",)] * 2
    assert rank_reasons(sets) == [(WATCHED.format(0.2), 5), ("no hull", 2)]


def test_the_number_in_a_cameras_name_is_none_but_the_way_to_step_may_differ():
    sets = [
        (BELOW,),
        (BELOW.replace("cam02 does", "cam03 does"),),
        (BELOW.replace("0.4 m away from", "0.7 m towards"),),
    ]
    assert [count for _, count in rank_reasons(sets)] == [2, 1]


def test_the_most_frequent_reasons_are_said():
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


def test_a_bag_tells_the_same_reasons(tmp_path):
    bag = write_bag(tmp_path / "bag", [fits_nothing(k, WATCHED.format(0.1 * k)) for k in range(1, 4)])
    assert reasons_of_bag(bag, lambda stamp_ns: stamp_ns > 1) == [(WATCHED.format(0.2),), (WATCHED.format(0.3),)]
    with pytest.raises(InputError, match=r'of 3 frame sets the tracker said "somebody .* watched for 0\.2 of .* in 3'):
        tracks_from_bag(bag, lambda stamp_ns: stamp_ns)[1]


def test_a_bag_of_a_tracked_person_without_the_topics_asks_for_these(tmp_path):
    fit = fits_nothing(1, "")
    tracked = Fit(1, "tracking", "own", "", 0, fit.reference_points_world, fit.covariance, fit.visible, None, None)
    bag = write_bag(tmp_path / "bag", [tracked])
    assert reasons_of_bag(bag) == [()]
    with pytest.raises(InputError, match="Record /mocap/reference_points"):
        tracks_from_bag(bag, lambda stamp_ns: stamp_ns)[1]


def test_evaluate_ends_with_the_reasons_of_a_session_in_which_nobody_is_found(tour, capsys):
    settings = ("hull_server.backend=cpu", "icp_tracker.initial_pose.t_pose.stature_high_m=1.4")
    arguments = ["--exact-masks", "--json", *(word for one in settings for word in ("--set", one))]
    assert main(["evaluate", str(tour), *arguments]) == 2
    said = " ".join(capsys.readouterr().err.split())
    assert "no body was found in any frame: of 12 frame sets the tracker said" in said
