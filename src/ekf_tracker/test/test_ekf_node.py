"""The filter node over real topics: one answer a set, the order of its messages, body, reset, lifecycle, silence."""

from types import SimpleNamespace

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticStatus
from ekf_person import ALL, NONE, isotropic, stamp
from ekf_probe import OUTPUTS
from node_probe import SUCCESS
from scipy.spatial.transform import Rotation
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray, String
from std_srvs.srv import Trigger
from visualization_msgs.msg import Marker

from ekf_tracker.filter import ArticulatedEkf
from mocap_packets.table import AGE_POINTS, NO_AGES, SetAges
from sagoma_ros.messages import LATENCY_TOPIC, to_ns
from sagoma_ros.packets import read_reference_points
from sagoma_ros.poses import read_motions, read_predictions
from sagoma_ros.qos import LATCHED
from stick_figure.body import Body
from stick_figure.skeleton import ANGLE_NAMES, POINT_NAMES, TANGENT_NAMES


def test_every_set_gets_its_messages_with_its_stamp_and_the_latency_last(bench, body, person):
    b = bench(skeleton_rate_hz=0.0).start()
    reference = ArticulatedEkf(body)
    for k in range(5):
        points = person.points(k / 60)
        got = b.fit(stamp(k), points)
        expected = reference.step(stamp(k), points, isotropic(0.01), ALL)
        assert [topic for topic, _ in got][-1] == LATENCY_TOPIC
        assert {topic for topic, _ in got} == set(OUTPUTS)
        stamps = {to_ns(m.header.stamp) for _, m in got if hasattr(m, "header")}
        assert stamps == {stamp(k)}
    by_topic = SimpleNamespace(**{topic.replace("/", "_"): m for topic, m in got})
    joints = by_topic.mocap_joint_states
    assert tuple(joints.name) == ANGLE_NAMES
    np.testing.assert_array_equal(joints.position, expected.angles)
    np.testing.assert_array_equal(joints.velocity, expected.rates)
    torso = by_topic.mocap_torso
    assert torso.header.frame_id == "map"
    p, q = torso.pose.pose.position, torso.pose.pose.orientation
    np.testing.assert_array_equal([p.x, p.y, p.z], expected.pose.position_world)
    R = Rotation.from_quat([q.x, q.y, q.z, q.w]).as_matrix()
    np.testing.assert_allclose(R, expected.pose.R_world_torso, atol=1e-9)
    np.testing.assert_array_equal(np.reshape(torso.pose.covariance, (6, 6)), expected.covariance[:6, :6])
    covariance = by_topic.mocap_joint_covariance
    assert [field.name for field in covariance.fields] == list(TANGENT_NAMES)
    found = np.frombuffer(covariance.data, "<f8").reshape(24, 24)
    np.testing.assert_array_equal(found, expected.covariance[:24, :24])
    (motion,) = read_motions(by_topic.mocap_joint_rotations, "test").values()
    assert np.abs(motion.pose.minus(expected.pose)).max() < 1e-9
    np.testing.assert_array_equal(motion.velocity, expected.velocity)
    points, covariances, used, *_ = read_reference_points(by_topic.mocap_reference_points, "test")
    np.testing.assert_allclose(points, expected.points_world, atol=1e-6)
    np.testing.assert_allclose(covariances, expected.point_covariance, rtol=1e-5, atol=1e-12)
    assert used.all()
    prediction = prediction_in(by_topic.ekf_prediction)
    assert np.abs(prediction.pose.minus(expected.pose)).max() < 1e-9
    np.testing.assert_array_equal(prediction.velocity, expected.predicted_velocity)
    assert by_topic.mocap_state.message == "tracking" and by_topic.mocap_state.level == DiagnosticStatus.OK


def prediction_in(message):
    return read_predictions(message, "test").of[1]


def test_skeleton_markers_keep_their_names_and_draw_sticks_and_joints(bench, person):
    b = bench(skeleton_rate_hz=0.0).start()
    for k in range(2):
        got = b.fit(stamp(k), person.points(k / 60))
        (markers,) = [m.markers for topic, m in got if topic == "mocap/skeleton"]
        assert [(m.ns, m.id, m.type, m.lifetime.sec) for m in markers] == [
            ("sticks", 0, Marker.LINE_LIST, 1),
            ("joints", 0, Marker.SPHERE_LIST, 1),
        ]
    lines, joints = markers
    assert len(lines.points) == 20 and len(joints.points) == 15
    drawn = np.array([[p.x, p.y, p.z] for p in joints.points])
    assert np.linalg.norm(drawn - person.points(1 / 60), axis=1).max() < 0.01
    lengths = np.linalg.norm(np.diff([[p.x, p.y, p.z] for p in lines.points], axis=0)[::2], axis=1)
    np.testing.assert_allclose(lengths, person.body.lengths, rtol=1e-6)


def test_skeleton_is_limited_to_its_rate_by_stamps(bench, person):
    b = bench(skeleton_rate_hz=20.0).start()
    for k in range(12):
        b.fit(stamp(k), person.points(k / 60))
    assert sum(topic == "mocap/skeleton" for topic, _ in b.arrived) == 4
    assert sum(topic == "mocap/joint_states" for topic, _ in b.arrived) == 12


@pytest.mark.parametrize("missing", ["torso", "body"])
def test_sets_without_a_body_or_before_the_first_visible_torso_are_answered_empty(bench, person, missing):
    b = (bench(body=None) if missing == "body" else bench()).start()
    got = b.fit(stamp(0), person.points(0.0), visible=ALL if missing == "body" else NONE)
    assert [topic for topic, _ in got] == ["mocap/state", "ekf/prediction", LATENCY_TOPIC]
    assert got[0][1].message == "acquiring" and f"waiting for the {missing}" in got[0][1].values[0].value
    assert prediction_in(got[1][1]).pose is None


def test_another_body_starts_the_filter_anew_and_the_same_one_does_not(bench, body, person):
    b = bench().start()
    b.fit(stamp(0), person.points(0.0))
    before, covariance = b.node._filters.of(1), b.node._filters.of(1).track.passage[1].covariance
    b.fit(stamp(1), person.points(1 / 60))
    assert b.node._filters.of(1) is before and before.body is b.node._filters.bodies[1]
    assert np.trace(before.track.passage[0].covariance) < 4 * np.trace(covariance)  # no other sizes, nothing unsure
    b.body = Body.from_stature(1.6)
    b.fit(stamp(2), np.zeros((15, 3)), visible=NONE)
    assert before.body.stature == pytest.approx(1.6, rel=1e-3)
    assert b.latest("mocap/state").message == "acquiring"  # it has forgotten the sets of the body before


def test_reset_service_lets_the_next_set_start_anew(bench, person):
    b = bench().start()
    b.fit(stamp(10), person.points(0.0))
    assert b.ask(Trigger, "/ekf_tracker/reset").success
    b.fit(stamp(5), person.points(5.0))  # earlier, elsewhere: fine after a reset
    assert b.latest("ekf/prediction").joint_names
    points, *_ = read_reference_points(b.latest("mocap/reference_points"), "test")
    assert np.linalg.norm(points - person.points(5.0), axis=1).max() < 5e-3


def test_lost_body_is_not_published_but_every_set_is_still_answered(bench, person):
    b = bench(skeleton_rate_hz=0.0, filter__lost_after_s=0.05).start()
    b.fit(stamp(0), person.points(0.0))
    for k in range(1, 8):
        got = b.fit(stamp(k), np.zeros((15, 3)), visible=NONE)
    assert [topic for topic, _ in got] == ["mocap/state", "ekf/prediction", LATENCY_TOPIC]
    assert got[0][1].message == "lost" and got[0][1].level == DiagnosticStatus.ERROR


def test_suspended_node_is_silent_and_goes_on_where_it_was(bench, person):
    b = bench().start()
    b.listen(Float64MultiArray, "icp/people")
    b.until(lambda: b.people.get_subscription_count() == 2)
    b.fit(stamp(0), person.points(0.0))
    assert b.node.trigger_deactivate() == SUCCESS
    b.send(stamp(1), person.points(1 / 60))
    b.until(lambda: [t for t, _ in b.arrived].count("icp/people") == 2)
    b.executor.spin_once(timeout_sec=0.1)
    assert not b.answers(stamp(1))
    assert b.node.trigger_activate() == SUCCESS
    b.fit(stamp(2), person.points(2 / 60))
    assert b.node.trigger_deactivate() == SUCCESS
    assert b.node.trigger_cleanup() == SUCCESS
    b.until(lambda: b.node.count_publishers("/ekf/prediction") == 0)
    b.start()
    b.fit(stamp(0), person.points(0.0))


def test_humans_topics_carry_the_person_under_its_id(bench, person):
    b = bench(publish_humans=True, body_id="anna")
    b.listen(JointState, "/humans/bodies/anna/joint_states")
    b.listen(String, "/humans/bodies/anna/urdf", LATCHED)
    b.start()
    b.until(lambda: b.node.count_subscribers("/humans/bodies/anna/joint_states") == 1)
    b.until(lambda: b.node.count_subscribers("/humans/bodies/anna/urdf") == 1)
    b.fit(stamp(0), person.points(0.0))
    b.until(lambda: any(topic.endswith("urdf") for topic, _ in b.arrived))
    joints = b.latest("/humans/bodies/anna/joint_states")
    named = dict(zip(joints.name, joints.position, strict=True))
    true = person.pose(0.0)
    assert to_ns(joints.header.stamp) == stamp(0)
    assert named["l_elbow_anna"] == pytest.approx(-true.hinges[0], abs=0.05)
    assert named["r_knee_anna"] == pytest.approx(-true.hinges[3], abs=0.05)
    assert 'name="body_anna"' in b.latest("/humans/bodies/anna/urdf").data


def test_latency_is_published_last_of_every_set_with_what_is_known_of_its_ages(bench, person):
    bench = bench().start()
    for k, ages in enumerate([SetAges(9_000_000, 15_500_000)] * 3 + [NO_AGES]):
        bench.fit(stamp(k), person.points(k / 60), ages=ages)
    bench.until(lambda: sum(topic == LATENCY_TOPIC for topic, _ in bench.arrived) == 4)
    *heard, unknown = [message for topic, message in bench.arrived if topic == LATENCY_TOPIC]
    assert [to_ns(message.header.stamp) for message in (*heard, unknown)] == [stamp(k) for k in range(4)]
    assert unknown.status[0].values == []
    for message in heard:
        ages = {pair.key: float(pair.value) for pair in message.status[0].values}
        assert list(ages) == [f"{point}_ms" for point in AGE_POINTS]
        assert ages["received_ms"] == 9.0 and ages["hull_ms"] == 15.5 and ages["fitted_ms"] <= ages["published_ms"]


def test_names_of_the_points_are_on_the_wire(bench):
    b = bench()
    b.listen(String, "mocap/point_names", LATCHED)
    b.start()
    b.until(lambda: any(t == "mocap/point_names" for t, _ in b.arrived))
    assert tuple(b.latest("mocap/point_names").data.split(",")) == POINT_NAMES
