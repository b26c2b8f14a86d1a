"""The filter node over real topics: sets it cannot use, stamps that go back, bad parameters."""

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray
from ekf_person import ALL, isotropic, stamp
from node_probe import FAILURE
from std_msgs.msg import Int64MultiArray

from mocap_packets.fit import ReferencePoints
from sagoma_ros.clouds import to_cloud
from sagoma_ros.latency import LATENCY_TOPIC, TIMES_TOPIC
from sagoma_ros.qos import RESULT


@pytest.mark.parametrize("case", ["nan", "fields", "count", "frame", "covariance"])
def test_unusable_set_is_counted_answered_with_its_stamp_and_the_next_one_is_tracked(bench, body_file, person, case):
    b = bench(body_file=body_file).start()
    b.fit(stamp(0), person.points(0.0))
    array = ReferencePoints(person.points(1 / 60), isotropic(0.01), ALL).to_table()
    if case == "nan":
        array["x"][3] = np.nan
    if case == "covariance":
        array["cov_zz"][5] = -1.0
    cloud = to_cloud(array[:14] if case == "count" else array, stamp(1), "odom" if case == "frame" else "map")
    if case == "fields":
        cloud.fields[9].name = "seen"
    begin = len(b.arrived)
    b.points.publish(cloud)
    b.until(lambda: b.answers(stamp(1)))
    assert b.node.health.counter("bad_points") == 1
    bad = dict(b.arrived[begin:])
    assert bad["mocap/state"].message == "doubtful"  # treated as a set in which nothing was seen
    assert bad["ekf/prediction"].joint_names
    b.fit(stamp(2), person.points(2 / 60))
    assert b.latest("mocap/state").message == "tracking"


def test_stamp_that_goes_back_is_counted_and_answered_empty_with_its_own_stamp(bench, body_file, person):
    b = bench(body_file=body_file).start()
    for k in (0, 1, 2):
        b.fit(stamp(k), person.points(k / 60))
    got = b.fit(stamp(1) + 5, person.points(1 / 60))
    assert [topic for topic, _ in got] == ["mocap/state", "ekf/prediction"]
    assert not got[-1][1].joint_names
    assert b.node.health.counter("stamp_back") == 1
    got = b.fit(stamp(3), person.points(3 / 60))
    assert b.latest("mocap/state").message == "tracking" and got[-1][1].joint_names


def test_a_set_far_in_the_future_is_left_out_and_those_after_it_are_filtered(bench, body_file, person):
    b = bench(body_file=body_file).start()
    b.fit(stamp(0), person.points(0.0))
    got = b.fit(stamp(10**9), person.points(1 / 60))
    assert not got[-1][1].joint_names and b.node.health.counter("stamp_ahead") == 1
    got = b.fit(stamp(1), person.points(1 / 60))
    assert got[-1][1].joint_names and b.latest("mocap/state").message == "tracking"
    assert b.node.health.counter("restarts") == 0


def test_stamps_that_go_back_begin_anew_with_the_third_set_and_say_so_once(bench, body_file, person, capfd):
    """A bag played twice, footage that starts again, a clock that was set back."""
    b = bench(body_file=body_file).start()
    b.fit(stamp(1000), person.points(0.0))
    answers = [b.fit(stamp(k), person.points(k / 60)) for k in range(12)]
    assert [bool(got[-1][1].joint_names) for got in answers] == [False] * 2 + [True] * 10
    assert b.latest("mocap/state").message == "tracking"
    assert b.node.health.counter("restarts") == 1
    assert capfd.readouterr().err.count("stamps went back by 16.633 s: a new beginning") == 1


def test_footage_shorter_than_a_leap_begins_anew_after_some_sets(bench, body_file, person):
    b = bench(body_file=body_file).start()
    b.fit(stamp(12), person.points(0.0))
    empty = [not b.fit(stamp(k), person.points(k / 60))[-1][1].joint_names for k in range(12)]
    assert empty == [True] * 9 + [False] * 3


@pytest.mark.parametrize(
    ("parameters", "words"),
    [
        ({"body_file": "/nowhere/body.yaml"}, "/nowhere/body.yaml: cannot be read"),
        ({"filter__gate_chi2": -3.0}, "filter.gate_chi2 = -3.0"),
        ({"filter__gate": 3.0}, "unknown key 'filter.gate'"),
        ({"publish_humans": True, "body_id": "1"}, "body_id = '1' is no REP-155 id"),
    ],
)
def test_bad_parameter_fails_the_configuration_with_a_clear_error(bench, parameters, words):
    b = bench(**parameters)
    assert b.node.trigger_configure() == FAILURE
    b.until_said(words)
    b.until(lambda: b.node.count_publishers("/ekf/prediction") == 0)


def test_times_that_are_none_are_counted(bench):
    bench = bench().start()
    bench.listen(DiagnosticArray, LATENCY_TOPIC)
    times = bench.peer.create_publisher(Int64MultiArray, TIMES_TOPIC, RESULT)
    bench.until(times.get_subscription_count)
    times.publish(Int64MultiArray(data=[1]))
    bench.until(lambda: bench.node.health.counter("bad_times"))
    assert bench.node.health.counter("bad_times") == 1
