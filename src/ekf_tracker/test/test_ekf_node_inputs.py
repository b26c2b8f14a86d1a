"""The filter node over real topics: sets it cannot use, stamps that go back, bad parameters, several persons."""

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticStatus
from ekf_person import ALL, isotropic, stamp
from ekf_probe import OUTPUTS
from node_probe import FAILURE
from sensor_msgs.msg import JointState
from visualization_msgs.msg import MarkerArray

from ekf_tracker.filter import ArticulatedEkf
from mocap_packets.fit import ReferencePoints
from mocap_packets.people import FittedPeople, PeoplePoints
from sagoma_ros.packets import tables_message
from sagoma_ros.poses import read_predictions


def test_messages_that_cannot_be_read_are_counted_and_the_next_set_is_tracked(bench, person):
    b = bench().start()
    b.fit(stamp(0), person.points(0.0))
    people = PeoplePoints({1: ReferencePoints(person.points(1 / 60), isotropic(0.01), ALL)})
    elsewhere, short = (tables_message(FittedPeople(stamp(1), people, {1: person.body}), "map") for _ in range(2))
    elsewhere.layout.dim[0].label, short.data = "odom", short.data[:-3]
    for message in (elsewhere, short):
        b.people.publish(message)
    b.until(lambda: b.node.health.counter("bad_points") == 2)
    assert not b.answers(stamp(1))
    b.fit(stamp(2), person.points(2 / 60))
    assert b.latest("mocap/state").message == "tracking"


def test_covariance_that_is_none_counts_as_a_set_in_which_nothing_was_seen(bench, person):
    b = bench().start()
    b.fit(stamp(0), person.points(0.0))
    spoilt = isotropic(0.01)
    spoilt[5, 2, 2] = -1.0
    b.send_people(stamp(1), {1: ReferencePoints(person.points(1 / 60), spoilt, ALL)})
    b.until(lambda: b.answers(stamp(1)))
    assert b.node.health.counter("bad_points") == 1
    assert b.latest("mocap/state").message == "doubtful" and b.latest("ekf/prediction").joint_names


def test_stamps_that_go_back_far_begin_anew_and_others_that_go_back_are_left_out(bench, person, capfd):
    """A bag played twice, footage that starts again, a clock that was set back; a set that came too late."""
    b = bench().start()
    b.fit(stamp(1000), person.points(0.0))
    answers = [b.fit(stamp(k), person.points(k / 60)) for k in range(4)]
    assert all(dict(got)["ekf/prediction"].joint_names for got in answers)
    assert b.latest("mocap/state").message == "tracking"
    assert b.node.health.counter("restarts") == 1
    assert capfd.readouterr().err.count("stamps went back by 16.667 s: a new beginning") == 1
    b.send(stamp(2) + 5, person.points(1 / 60))
    b.fit(stamp(4), person.points(4 / 60))
    assert not b.answers(stamp(2) + 5) and b.node.health.counter("backward_stamps") == 1


@pytest.mark.parametrize(
    ("parameters", "words"),
    [
        ({"filter__lost_after_s": -3.0}, "filter.lost_after_s = -3.0"),
        ({"filter__gate": 3.0}, "unknown key 'filter.gate'"),
        ({"filter__motion_model": "magic"}, "filter.motion_model = 'magic' is not one of"),
        ({"publish_humans": True, "body_id": "1"}, "'1' is no REP-155 id"),
        ({"tf_prefix": "../.."}, "tf_prefix = '../..' is not a name"),
        ({"tf_prefix": "lab/studio"}, "'lab/studiob0001' is no REP-155 id"),
    ],
)
def test_bad_parameter_fails_the_configuration_with_a_clear_error(bench, parameters, words):
    b = bench(**parameters)
    assert b.node.trigger_configure() == FAILURE
    b.until_said(words)
    b.until(lambda: b.node.count_publishers("/ekf/prediction") == 0)


# --- several persons --------------------------------------------------------------------------------------------------

BESIDE = np.array([2.0, 0.0, 0.0])
SECOND = "mocap/bodies/b0002/"


@pytest.fixture
def couple(bench, person):
    """couple(parameter=value, ...): a started bench that listens to the topics of two persons, and what sends a set."""

    def start(**parameters):
        b = bench(skeleton_rate_hz=0.0, **parameters)
        for topic, kind in OUTPUTS.items():
            if topic.startswith("mocap/"):
                b.listen(kind, topic.replace("mocap/", SECOND))
        b.listen(MarkerArray, "mocap/skeletons")
        b.start()

        def fit(k, others=(2,)):
            """Send set k of the first person and others, 2 m beside; what was published until all was answered."""
            people = {1: ReferencePoints(person.points(k / 60), isotropic(0.01), ALL)}
            people |= {n: ReferencePoints(person.points(k / 60) + BESIDE, isotropic(0.01), ALL) for n in others}
            begin, states = len(b.arrived), {"mocap/state", *(f"{SECOND}state" for n in others if n == 2)}
            b.send_people(stamp(k), people)
            b.until(lambda: b.answers(stamp(k), begin) and states <= {t for t, _ in b.arrived[begin:]})
            return b.arrived[begin:]

        return b, fit

    return start


def test_two_persons_have_topics_each_and_one_answer_a_set(couple, body, person):
    """A publisher that comes with a person finds listeners that were there before: nothing is lost."""
    (b, fit), published = couple(), {}
    references = {"mocap/": ArticulatedEkf(body), SECOND: ArticulatedEkf(body)}
    for k in range(3):
        for topic, message in fit(k):
            published.setdefault(topic, []).append(message)
        for prefix, reference in references.items():
            points = person.points(k / 60) + (BESIDE if prefix == SECOND else 0.0)
            expected = reference.step(stamp(k), points, isotropic(0.01), ALL)
            np.testing.assert_array_equal(published[f"{prefix}joint_states"][k].position, expected.angles)
    assert {topic.removeprefix(SECOND) for topic in published if topic.startswith(SECOND)} == {
        *("joint_states", "torso", "joint_rotations", "joint_covariance", "reference_points", "skeleton", "state")
    }
    assert all(len(messages) == 3 for topic, messages in published.items() if topic != "mocap/skeletons")
    predictions = read_predictions(published["ekf/prediction"][-1], "test").of
    apart = predictions[2].pose.position_world - predictions[1].pose.position_world
    np.testing.assert_allclose(apart, BESIDE, atol=0.01)
    b.until_said("1 tracking: 15 points used; 2 tracking: 15 points used")


def test_markers_of_each_person_have_a_namespace_and_a_colour_of_their_own(couple):
    b, fit = couple()
    fit(0)
    shown = [m for t, m in b.arrived if t == "mocap/skeletons"]
    sticks = {one.ns: (one.color.r, one.color.g, one.color.b) for m in shown for one in m.markers if "sticks" in one.ns}
    assert set(sticks) == {"b0001/sticks", "b0002/sticks"} and len(set(sticks.values())) == 2
    assert [m.ns for m in b.latest("mocap/skeleton").markers] == ["sticks", "joints"]


def test_person_who_leaves_is_lost_then_gone_with_the_topics_in_the_end(couple):
    b, fit = couple()
    fit(0)
    begin = len(b.arrived)
    fit(1, others=())
    b.until(lambda: f"{SECOND}state" in {t for t, _ in b.arrived[begin:]})
    said = {t.removeprefix(SECOND): m for t, m in b.arrived[begin:] if t.startswith(SECOND)}
    assert set(said) == {"state"}
    assert said["state"].message == "lost" and said["state"].values[0].value == "has left"
    state = "/mocap/bodies/b0002/state"
    fit(300, others=())
    assert b.node.count_publishers(state) == 1  # comes back within ten seconds, maybe
    fit(700, others=())
    b.until(lambda: b.node.count_publishers(state) == 0)
    got = fit(701)  # the same number
    assert [m.message for t, m in got if t == "mocap/bodies/b0002/state"] == ["tracking"]


def test_everybody_tracked_is_listed_with_hri_msgs_and_nobody_once_sets_stop(couple, monkeypatch):
    """A stand-in of hri_msgs/IdsList, which is not in the wheels: a message with a header and a list of names."""
    monkeypatch.setattr("ekf_tracker.humans_ros.IdsList", JointState)
    monkeypatch.setattr("ekf_tracker.humans_ros._ids_message", lambda ids, stamp_ns: JointState(name=ids))
    b, fit = couple(publish_humans=True, stale_after_s=0.1)
    b.listen(JointState, "/humans/bodies/tracked")
    b.listen(JointState, "/humans/bodies/b0002/joint_states")
    b.until(lambda: b.node.count_subscribers("/humans/bodies/tracked") == 1)
    b.until(lambda: b.node.count_subscribers("/humans/bodies/b0002/joint_states") == 1)
    b.until(lambda: b.node._bodies[0]._tracked.is_wanted)

    def tracked():
        return [list(m.name) for t, m in b.arrived if t == "/humans/bodies/tracked"]

    fit(0)
    fit(1)
    b.until(lambda: ["b0001", "b0002"] in tracked())
    fit(2, others=())
    b.until(lambda: ["b0001"] in tracked())
    b.until(lambda: tracked()[-1] == [])
    assert b.latest("/humans/bodies/b0002/joint_states").name[0] == "waist_b0002"


def test_silence_is_reported_of_everybody(couple):
    b, fit = couple(stale_after_s=0.1)
    fit(0)
    begin = len(b.arrived)
    b.until(lambda: [t for t, _ in b.arrived[begin:]].count("mocap/bodies/b0002/state"))
    said = dict(b.arrived[begin:])
    for prefix in ("mocap/", SECOND):
        assert said[f"{prefix}state"].message == "lost" and said[f"{prefix}state"].level == DiagnosticStatus.ERROR
        assert "no frame sets" in said[f"{prefix}state"].values[0].value
    b.until_said("lost: no frame sets")
    assert "tracking" in [m.message for t, m in fit(1) if t == "mocap/state"]
