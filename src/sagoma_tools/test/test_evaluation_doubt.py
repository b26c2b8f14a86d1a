"""Wrong parts that are called, clear frames in which a part is called: on flags set by hand, and through a bag."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from rclpy.serialization import serialize_message

from capture_rig.session import Truth, load_session
from ekf_tracker.state_ros import state_message
from mocap_packets.fit import DOUBTFUL, GOOD, LOST, PART_NAMES
from mocap_packets.state import BodyState, NoState
from mocap_pipeline.configuration import Configuration
from mocap_pipeline.pipeline import TrackingStage
from sagoma_bringup.launch_arguments import start_settings
from sagoma_ros.packets import joint_state_message, packet_cloud
from sagoma_tools.evaluation.in_process import EPOCH_NS, OURS, track_people
from sagoma_tools.evaluation.scores import PartCalls, score
from sagoma_tools.evaluation.track import Track, tracks_from_bag
from sagoma_tools.evaluation.track_evaluation import evaluate_track, identify, score_people
from sagoma_tools.recording.writer import BagWriter
from stick_figure.body import Body
from stick_figure.skeleton import ANGLE_NAMES
from virtual_studio.recording.session import write_session
from virtual_studio.rig import ring

LEFT_ARM, RIGHT_LEG = PART_NAMES.index("left arm"), PART_NAMES.index("right leg")
LEFT_ELBOW, LEFT_HAND, RIGHT_FOOT = 7, 11, 14
FRAMES, FPS = 10, 50.0


def truth(x=0.0):
    points = np.random.default_rng(4).uniform(-0.5, 0.5, (FRAMES, 15, 3)) + np.array([x, 0.0, 1.0])
    return Truth(np.arange(FRAMES), points, None, 1.0, Path("truth.csv"))


def track(of, errors_m=None, parts=None):
    """The truth moved along x by (F, 15) m, with the states (F, 5) of the parts."""
    points = of.points_world + np.zeros((FRAMES, 15, 1))
    points[..., 0] += np.zeros((FRAMES, 15)) if errors_m is None else errors_m
    parts = np.full((FRAMES, 5), GOOD, "<U8") if parts is None else parts
    covariance = np.tile(1e-4 * np.eye(3), (FRAMES, 15, 1, 1))
    return Track(of.frames, points, covariance, np.zeros((FRAMES, 18)), np.full(FRAMES, "tracking"), parts)


def flagged_by_hand():
    """Frames 0 to 3: the left arm is wrong, in 0 and 1 it is called, as lost in 1; frame 0: so is the right leg, which
    is not called. Frame 4: a hand is 150 mm off, neither wrong nor clear, and called. Frame 5: clear, a leg called."""
    errors, parts = np.zeros((FRAMES, 15)), np.full((FRAMES, 5), GOOD, "<U8")
    errors[:4, LEFT_HAND], errors[0, LEFT_ELBOW], errors[0, RIGHT_FOOT], errors[4, LEFT_HAND] = 0.3, 0.25, 0.21, 0.15
    parts[0, LEFT_ARM], parts[1, LEFT_ARM], parts[4, LEFT_ARM], parts[5, RIGHT_LEG] = DOUBTFUL, LOST, DOUBTFUL, LOST
    return errors, parts


def test_shares_are_those_of_flags_set_by_hand():
    scores = score(track(truth(), *flagged_by_hand()), truth())
    assert scores.calls.wrong.sum() == 5 and scores.calls.clear.tolist() == [False] * 5 + [True] * 5
    assert scores.calls.flagged_of_bad == pytest.approx(2 / 5)
    assert scores.calls.false_alarms == pytest.approx(1 / 5)
    assert scores.figures()["flagged_of_bad"] == 0.4 and scores.figures()["false_alarms"] == 0.2


def test_shares_of_nothing_are_null():
    figures = score(track(truth()), truth()).figures()
    assert (figures["flagged_of_bad"], figures["false_alarms"]) == (None, 0.0)
    figures = score(track(truth(), np.full((FRAMES, 15), 0.15)), truth()).figures()
    assert (figures["flagged_of_bad"], figures["false_alarms"]) == (None, None)


def test_frames_without_a_track_or_a_state_of_the_parts_say_nothing():
    errors, parts = flagged_by_hand()
    parts[[1, 5]] = ""  # as in the bag of a version that told no parts
    calls = score(track(truth(), errors, parts).chosen(np.arange(1, FRAMES)), truth()).calls
    assert calls.wrong.sum() == 2 and calls.clear.sum() == 4
    assert (calls.flagged_of_bad, calls.false_alarms) == (0.0, 0.0)


def test_a_frame_with_an_unknown_point_is_not_clear_but_may_hold_a_wrong_part():
    errors_mm = np.zeros((2, 15))
    errors_mm[0, LEFT_HAND], errors_mm[:, RIGHT_FOOT] = 300.0, np.nan
    calls = PartCalls.of(errors_mm, np.full((2, 5), DOUBTFUL))
    assert calls.wrong[0].tolist() == [part == LEFT_ARM for part in range(5)]
    assert not calls.clear.any() and calls.flagged_of_bad == 1.0


def test_one_person_has_no_switches_unless_a_number_is_given_anew():
    session_truths = (truth(),)
    whole = track(truth())
    assert identify({1: whole}, session_truths, FPS).switches_of(0) == 0
    halves = {1: whole.chosen(np.arange(5)), 2: whole.chosen(np.arange(5, FRAMES))}
    assert identify(halves, session_truths, FPS).switches_of(0) == 1
    assert identify({1: Track.of_states([])}, session_truths, FPS).switches_of(0) is None


def test_several_truths_give_a_record_a_person_and_their_mean():
    first, second, third = truth(), truth(3.0), truth(6.0)
    errors, parts = flagged_by_hand()
    tracks = {1: track(first, errors, parts), 2: track(second, errors)}
    thesis = {1: track(second, np.full((FRAMES, 15), 0.08)), 2: track(first, np.full((FRAMES, 15), 0.04))}
    truths = first, second, third
    figures = score_people(tracks, truths, FPS).figures(score_people(thesis, truths, FPS))
    persons = figures["persons"]
    assert [one["flagged_of_bad"] for one in persons] == [0.4, 0.0, None] and figures["flagged_of_bad"] == 0.2
    assert [one["false_alarms"] for one in persons] == [0.2, 0.0, None] and figures["false_alarms"] == 0.1
    assert [one["thesis_mean_mm"] for one in persons] == [40.0, 80.0, None] and figures["thesis_mean_mm"] == 60.0
    assert [one["identity_switches"] for one in persons] == [0, 0, None] and figures["identity_switches"] == 0
    assert [one["tracked"] for one in persons] == [FRAMES, FRAMES, 0]
    assert figures["mean_mm"] == pytest.approx(np.mean([one["mean_mm"] for one in persons[:2]]))
    assert set(persons[2]) == set(persons[0]) and persons[2]["mean_mm"] is None


def publish(bag, state):
    """What the EKF node publishes of the first person after a set."""
    messages = {"/mocap/state": state_message(state, "/ekf_tracker")}
    if isinstance(state, BodyState):
        messages["/mocap/reference_points"] = packet_cloud(state.reference_points, state.stamp_ns, "map")
        angles = joint_state_message(ANGLE_NAMES, state.angles, state.rates, state.stamp_ns, "map")
        messages["/mocap/joint_states"] = angles
    for topic, message in messages.items():
        bag.write(topic, state.stamp_ns, serialize_message(message))


@pytest.mark.slow
def test_bag_and_session_evaluate_alike(tmp_path, monkeypatch):
    """A person an arm of whom is doubtful for a while, in process and read back from what the graph publishes."""
    folder = write_session(tmp_path / "tour", ring(4, True), Body.from_stature(1.75), "tour", fps=20.0, seconds=1.0)
    session = load_session(folder)
    answers: list[BodyState | NoState] = []
    step = TrackingStage.step

    def stepped(self, products):
        """Six frames in which the left arm is not believed, whatever it looks like."""
        answer = step(self, products)
        if answer.state is not None and 8 <= len(answers) < 14:
            doubtful = np.isin(np.arange(15), [LEFT_ELBOW, LEFT_HAND])
            people = (replace(answer.people[0], answer=replace(answer.state, doubtful=doubtful)),)
            answer = replace(answer, people=people)
        answers.append(answer.answer)
        return answer

    monkeypatch.setattr(TrackingStage, "step", stepped)
    configuration = Configuration.of({**start_settings(session, "session"), "hull_server.backend": "cpu"})
    in_process = track_people(session, {OURS: configuration}, exact_masks=True)[OURS][1]
    with BagWriter(tmp_path / "bag") as bag:
        bag.add_topic("/mocap/state", "diagnostic_msgs/msg/DiagnosticStatus")
        bag.add_topic("/mocap/reference_points", "sensor_msgs/msg/PointCloud2")
        bag.add_topic("/mocap/joint_states", "sensor_msgs/msg/JointState")
        for answer in answers:
            publish(bag, answer)
    read = tracks_from_bag(tmp_path / "bag", lambda stamp_ns: round((stamp_ns - EPOCH_NS) * 1e-9 * session.fps))[1]
    assert len(answers) == 20 and (in_process.parts[8:14, LEFT_ARM] == DOUBTFUL).all()
    assert np.array_equal(read.frames, in_process.frames) and np.array_equal(read.parts, in_process.parts)
    figures = [evaluate_track(session, len(answers), one, switches=0).figures() for one in (in_process, read)]
    assert figures[0]["flagged_of_bad"] is None and figures[0]["identity_switches"] == 0
    assert figures[0]["false_alarms"] == pytest.approx(6 / len(in_process), abs=1e-4)
    for key in ("flagged_of_bad", "false_alarms", "identity_switches", "tracked", "states"):
        assert figures[1][key] == figures[0][key]
    assert figures[1]["mean_mm"] == pytest.approx(figures[0]["mean_mm"], abs=1e-3)
