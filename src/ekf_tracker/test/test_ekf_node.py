"""The node over real topics: one answer a set, the order of its messages, bad input, body, reset, lifecycle."""

from types import SimpleNamespace

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from ekf_person import ALL, NONE, isotropic, stamp
from geometry_msgs.msg import PoseWithCovarianceStamped
from node_probe import FAILURE, SUCCESS, NodeProbe
from rclpy.publisher import Publisher
from scipy.spatial.transform import Rotation
from sensor_msgs.msg import JointState, PointCloud2
from std_msgs.msg import Float64MultiArray, Int64MultiArray, String
from std_srvs.srv import Trigger
from visualization_msgs.msg import Marker, MarkerArray

from ekf_tracker.ekf_node import EkfNode
from ekf_tracker.filter import ArticulatedEkf
from mocap_packets.fit import ReferencePoints
from mocap_packets.latency import POINTS, HullTimes
from mocap_packets.people import PeoplePoints, format_bodies
from sagoma_ros.clouds import to_cloud
from sagoma_ros.latency import LATENCY_TOPIC, TIMES_TOPIC, times_message
from sagoma_ros.messages import to_ns
from sagoma_ros.packets import packet_cloud, people_cloud, read_prediction, read_predictions, read_reference_points
from sagoma_ros.qos import LATCHED, RESULT
from stick_figure.body import Body
from stick_figure.body_file import format_body, save_body
from stick_figure.skeleton import ANGLE_NAMES, POINT_NAMES, TANGENT_NAMES

OUTPUTS = {
    "mocap/joint_states": JointState,
    "mocap/torso": PoseWithCovarianceStamped,
    "mocap/joint_covariance": Float64MultiArray,
    "mocap/reference_points": PointCloud2,
    "mocap/skeleton": MarkerArray,
    "mocap/state": DiagnosticStatus,
    "ekf/prediction": JointState,
}


class EkfProbe(NodeProbe):
    """An EkfNode; its peer plays the ICP tracker and keeps what the node publishes in order of arrival."""

    def __init__(self, context, **parameters):
        super().__init__(context, EkfNode, parameters)
        self.arrived, self.listened = [], []
        self.points = self.peer.create_publisher(PointCloud2, "icp/reference_points", RESULT)
        self.body = self.peer.create_publisher(String, "icp/body", LATCHED)
        for topic, kind in OUTPUTS.items():
            self.listen(kind, topic)

    def listen(self, kind, topic, qos=RESULT):
        self.listened.append(topic)
        self.peer.create_subscription(kind, topic, lambda m, topic=topic: self.arrived.append((topic, m)), qos)

    def start(self):
        super().start()
        listeners = 1 + self.listened.count("icp/reference_points")
        self.until(lambda: self.points.get_subscription_count() == listeners)
        self.until(lambda: all(self.node.count_subscribers(topic) == 1 for topic in OUTPUTS))
        return self

    def send(self, stamp_ns, points, visible=ALL, frame_id="map", sd=0.01):
        measured = ReferencePoints(points, isotropic(sd), visible)
        self.points.publish(packet_cloud(measured, stamp_ns, frame_id))

    def fit(self, stamp_ns, points, **options):
        """Send a set and wait for its answer; returns what was published from the sending on."""
        begin = len(self.arrived)
        self.send(stamp_ns, points, **options)
        self.until(lambda: self.answers(stamp_ns, begin))
        return self.arrived[begin:]

    def answers(self, stamp_ns, begin=0):
        return [m for t, m in self.arrived[begin:] if t == "ekf/prediction" and to_ns(m.header.stamp) == stamp_ns]

    def latest(self, topic):
        return next(m for t, m in reversed(self.arrived) if t == topic)


@pytest.fixture
def bench(open_probe):
    """bench(parameter=value, ...): a node with these parameters, not yet started; ``__`` in names stands for a dot."""
    return lambda **given: open_probe(EkfProbe, **{name.replace("__", "."): value for name, value in given.items()})


@pytest.fixture
def body_file(body, tmp_path):
    save_body(body, tmp_path / "body.yaml")
    return str(tmp_path / "body.yaml")


def test_every_set_gets_its_messages_with_its_stamp_and_the_prediction_last(bench, body, body_file, person):
    b = bench(body_file=body_file, skeleton_rate_hz=0.0).start()
    reference = ArticulatedEkf(body)
    for k in range(5):
        points = person.points(k / 60)
        got = b.fit(stamp(k), points)
        # float32 on the wire: the reference filter gets the same numbers
        sent = ReferencePoints(points, isotropic(0.01), ALL).as_sent()
        expected = reference.step(stamp(k), *sent)
        assert [topic for topic, _ in got][-1] == "ekf/prediction"
        assert {topic for topic, _ in got} == set(OUTPUTS)
        stamps = {to_ns(m.header.stamp) for _, m in got if hasattr(m, "header")}
        assert stamps == {stamp(k)}
    by_topic = SimpleNamespace(**{topic.replace("/", "_"): m for topic, m in got})
    joints = by_topic.mocap_joint_states
    assert tuple(joints.name) == ANGLE_NAMES
    np.testing.assert_array_equal(joints.position, expected.angles)
    np.testing.assert_array_equal(joints.velocity, expected.rates)
    _check_torso(by_topic.mocap_torso, expected)
    covariance = by_topic.mocap_joint_covariance
    assert [d.size for d in covariance.layout.dim] == [24, 24]
    assert covariance.layout.dim[0].label.split(",") == list(TANGENT_NAMES)
    np.testing.assert_array_equal(np.reshape(covariance.data, (24, 24)), expected.covariance[:24, :24])
    points, covariances, used, _ = read_reference_points(by_topic.mocap_reference_points, "test")
    np.testing.assert_allclose(points, expected.points_world, atol=1e-6)
    np.testing.assert_allclose(covariances, expected.point_covariance, rtol=1e-5, atol=1e-12)
    assert used.all()
    prediction = read_prediction(by_topic.ekf_prediction, "test")
    assert np.abs(prediction.pose.minus(expected.pose)).max() < 1e-9
    np.testing.assert_array_equal(prediction.velocity, expected.predicted_velocity)
    assert by_topic.mocap_state.message == "tracking" and by_topic.mocap_state.level == DiagnosticStatus.OK


def test_prediction_is_published_after_everything_else(bench, body_file, person, monkeypatch):
    """It is the signal that a set is done: whoever hears it may rely on the rest."""
    b = bench(body_file=body_file, publish_humans=True).start()
    joints = "/humans/bodies/b0001/joint_states"
    b.listen(JointState, joints)
    b.until(lambda: b.node.count_subscribers(joints) == 1 and b.node._humans._bodies["b0001"]._joints.heard)
    order, publish = [], Publisher.publish

    def recorded(publisher, message):
        order.append(publisher.topic_name)
        publish(publisher, message)

    monkeypatch.setattr(Publisher, "publish", recorded)
    b.fit(stamp(0), person.points(0.0))
    order = [topic for topic in order if topic not in ("/diagnostics", "/icp/reference_points")]
    assert order == [
        "/mocap/joint_states",
        "/mocap/torso",
        "/mocap/joint_covariance",
        "/mocap/reference_points",
        "/mocap/skeleton",
        "/humans/bodies/b0001/urdf",
        joints,
        "/mocap/state",
        "/ekf/prediction",
    ]


def _check_torso(torso, expected):
    assert torso.header.frame_id == "map"
    p, q = torso.pose.pose.position, torso.pose.pose.orientation
    np.testing.assert_array_equal([p.x, p.y, p.z], expected.pose.position_world)
    np.testing.assert_allclose(
        Rotation.from_quat([q.x, q.y, q.z, q.w]).as_matrix(), expected.pose.R_world_torso, atol=1e-9
    )
    np.testing.assert_array_equal(np.reshape(torso.pose.covariance, (6, 6)), expected.covariance[:6, :6])


def test_skeleton_markers_keep_their_names_and_draw_sticks_joints_and_ellipsoids(bench, body_file, person):
    b = bench(body_file=body_file, skeleton_rate_hz=0.0, skeleton_covariance=True).start()
    for k in range(2):
        got = b.fit(stamp(k), person.points(k / 60))
        (markers,) = [m.markers for topic, m in got if topic == "mocap/skeleton"]
        assert [(m.ns, m.id, m.type) for m in markers[:2]] == [
            ("sticks", 0, Marker.LINE_LIST),
            ("joints", 0, Marker.SPHERE_LIST),
        ]
        assert [(m.ns, m.id) for m in markers[2:]] == [("covariance", i) for i in range(15)]
    lines, joints = markers[:2]
    assert len(lines.points) == 20 and len(joints.points) == 15
    drawn = np.array([[p.x, p.y, p.z] for p in joints.points])
    assert np.linalg.norm(drawn - person.points(1 / 60), axis=1).max() < 0.01
    lengths = np.linalg.norm(np.diff([[p.x, p.y, p.z] for p in lines.points], axis=0)[::2], axis=1)
    np.testing.assert_allclose(lengths, person.body.lengths, rtol=1e-6)
    assert all(0.0 < m.scale.x < 0.25 for m in markers[2:])


def test_skeleton_is_limited_to_its_rate_by_stamps(bench, body_file, person):
    b = bench(body_file=body_file, skeleton_rate_hz=20.0).start()
    for k in range(12):
        b.fit(stamp(k), person.points(k / 60))
    assert sum(topic == "mocap/skeleton" for topic, _ in b.arrived) == 4
    assert sum(topic == "mocap/joint_states" for topic, _ in b.arrived) == 12


def test_sets_before_the_first_visible_torso_get_an_empty_prediction_and_nothing_else(bench, body_file):
    b = bench(body_file=body_file).start()
    got = b.fit(stamp(0), np.zeros((15, 3)), visible=NONE)
    assert [topic for topic, _ in got] == ["mocap/state", "ekf/prediction"]
    assert got[0][1].message == "acquiring" and "waiting for the torso" in got[0][1].values[0].value
    assert read_prediction(got[1][1], "test").pose is None


def test_body_from_the_topic_is_used_when_no_file_is_given(bench, body, person):
    b = bench().start()
    b.body.publish(String(data=format_body(body)))
    got = b.fit(stamp(0), person.points(0.0))  # the set may overtake the body: it is held until the body is there
    assert read_prediction(got[-1][1], "test").pose is not None
    points, *_ = read_reference_points(b.latest("mocap/reference_points"), "test")
    assert np.linalg.norm(points - person.points(0.0), axis=1).max() < 5e-3


def test_visible_set_waits_for_the_body_and_is_then_answered_with_a_pose(bench, body, person):
    b = bench(body_wait_s=60.0).start()
    b.send(stamp(0), person.points(0.0))
    b.send(stamp(1), person.points(1 / 60))
    b.until(lambda: len(b.node._waiting) == 2)
    b.body.publish(String(data=format_body(body)))
    b.until(lambda: b.answers(stamp(1)))
    order = [(topic, to_ns(m.header.stamp)) for topic, m in b.arrived if topic == "ekf/prediction"]
    assert order == [("ekf/prediction", stamp(0)), ("ekf/prediction", stamp(1))]
    assert all(m.name for topic, m in b.arrived if topic == "ekf/prediction")


def test_visible_set_without_a_body_is_answered_empty_in_the_end(bench, person):
    b = bench(body_wait_s=0.05).start()
    got = b.fit(stamp(0), person.points(0.0))
    assert not got[-1][1].name
    assert "waiting for the body" in got[-2][1].values[0].value
    assert b.node.health.counter("without_body") == 1


def test_another_body_starts_the_filter_anew_and_the_same_one_does_not(bench, body, person):
    b = bench(body_wait_s=60.0).start()
    b.body.publish(String(data=format_body(body)))
    b.fit(stamp(0), person.points(0.0))
    before = b.node._filters.of(1)
    b.body.publish(String(data=format_body(body)))
    b.body.publish(String(data="lengths: 7"))  # latched topic: the last message stays the bad one
    b.until(lambda: b.node.health.counter("bad_body") == 1)
    assert b.node._filters.of(1) is before
    b.body.publish(String(data=format_body(Body.from_stature(1.6))))
    b.until(lambda: before.body.stature == pytest.approx(1.6, rel=1e-3))
    assert not before.is_past(0)  # it has forgotten the sets of the body before


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
    assert bad["ekf/prediction"].name
    b.fit(stamp(2), person.points(2 / 60))
    assert b.latest("mocap/state").message == "tracking"


def test_stamp_that_goes_back_is_counted_and_answered_empty_with_its_own_stamp(bench, body_file, person):
    b = bench(body_file=body_file).start()
    for k in (0, 1, 2):
        b.fit(stamp(k), person.points(k / 60))
    got = b.fit(stamp(1) + 5, person.points(1 / 60))
    assert [topic for topic, _ in got] == ["mocap/state", "ekf/prediction"]
    assert not got[-1][1].name
    assert b.node.health.counter("stamp_back") == 1
    got = b.fit(stamp(3), person.points(3 / 60))
    assert b.latest("mocap/state").message == "tracking" and got[-1][1].name


def test_stamps_that_go_back_begin_anew_at_once_and_say_so_once(bench, body_file, person, capfd):
    """A bag played twice, footage that starts again, a clock that was set back."""
    b = bench(body_file=body_file).start()
    b.fit(stamp(1000), person.points(0.0))
    answers = [b.fit(stamp(k), person.points(k / 60)) for k in range(12)]
    assert all(got[-1][1].name for got in answers)
    assert b.latest("mocap/state").message == "tracking"
    assert b.node.health.counter("restarts") == 1
    assert capfd.readouterr().err.count("stamps went back by 16.667 s: a new beginning") == 1


def test_footage_shorter_than_a_leap_begins_anew_after_some_sets(bench, body_file, person):
    b = bench(body_file=body_file).start()
    b.fit(stamp(12), person.points(0.0))
    empty = [not b.fit(stamp(k), person.points(k / 60))[-1][1].name for k in range(12)]
    assert empty == [True] * 9 + [False] * 3


def test_reset_service_lets_the_next_set_start_anew(bench, body_file, person):
    b = bench(body_file=body_file).start()
    b.fit(stamp(10), person.points(0.0))
    assert b.ask(Trigger, "/ekf_tracker/reset").success
    got = b.fit(stamp(5), person.points(5.0))  # earlier, elsewhere: fine after a reset
    assert got[-1][1].name
    points, *_ = read_reference_points(b.latest("mocap/reference_points"), "test")
    assert np.linalg.norm(points - person.points(5.0), axis=1).max() < 5e-3


def test_identity_model_predicts_no_motion(bench, body_file, person):
    b = bench(body_file=body_file, filter__motion_model="identity").start()
    for k in range(3):
        got = b.fit(stamp(k), person.points(k / 60))
    np.testing.assert_array_equal(read_prediction(got[-1][1], "test").velocity, 0.0)
    assert np.abs(b.latest("mocap/joint_states").velocity).max() > 0.01


def test_lost_body_is_not_published_but_every_set_is_still_answered(bench, body_file, person):
    b = bench(body_file=body_file, filter__lost_after_s=0.05).start()
    b.fit(stamp(0), person.points(0.0))
    for k in range(1, 6):
        got = b.fit(stamp(k), np.zeros((15, 3)), visible=NONE)
    assert [topic for topic, _ in got] == ["mocap/state", "ekf/prediction"]
    assert got[0][1].message == "lost" and got[0][1].level == DiagnosticStatus.ERROR


def test_suspended_node_is_silent_and_goes_on_where_it_was(bench, body_file, person):
    b = bench(body_file=body_file).start()
    b.listen(PointCloud2, "icp/reference_points")
    b.until(lambda: b.points.get_subscription_count() == 2)
    b.fit(stamp(0), person.points(0.0))
    assert b.node.trigger_deactivate() == SUCCESS
    b.send(stamp(1), person.points(1 / 60))
    b.until(lambda: [t for t, _ in b.arrived].count("icp/reference_points") == 2)
    b.executor.spin_once(timeout_sec=0.1)
    assert not b.answers(stamp(1))
    assert b.node.trigger_activate() == SUCCESS
    b.fit(stamp(2), person.points(2 / 60))
    assert b.node.trigger_deactivate() == SUCCESS
    assert b.node.trigger_cleanup() == SUCCESS
    b.until(lambda: b.node.count_publishers("/ekf/prediction") == 0)
    b.start()
    b.fit(stamp(0), person.points(0.0))


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


def test_humans_topics_carry_the_person_under_its_id(bench, body_file, person):
    b = bench(body_file=body_file, publish_humans=True, body_id="anna")
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


def test_latency_of_every_set_is_published_while_somebody_listens(bench, body_file, person):
    bench = bench(body_file=body_file).start()
    assert bench.node.count_subscribers("hull/times") == 0
    bench.listen(DiagnosticArray, LATENCY_TOPIC)
    times = bench.peer.create_publisher(Int64MultiArray, TIMES_TOPIC, RESULT)
    bench.until(times.get_subscription_count)
    for k in range(3):
        times.publish(times_message(HullTimes(stamp(k), stamp(k) + 9_000_000, stamp(k) + 15_500_000)))
        bench.fit(stamp(k), person.points(k / 60))
    bench.until(lambda: sum(topic == LATENCY_TOPIC for topic, _ in bench.arrived) == 3)
    heard = [message for topic, message in bench.arrived if topic == LATENCY_TOPIC]
    assert [to_ns(message.header.stamp) for message in heard] == [stamp(k) for k in range(3)]
    for message in heard:
        ages = {pair.key: float(pair.value) for pair in message.status[0].values}
        assert list(ages) == [f"{point}_ms" for point in POINTS]
        assert ages["received_ms"] == 9.0 and ages["hull_ms"] == 15.5 and ages["fitted_ms"] <= ages["published_ms"]


def test_times_that_are_none_are_counted(bench):
    bench = bench().start()
    bench.listen(DiagnosticArray, LATENCY_TOPIC)
    times = bench.peer.create_publisher(Int64MultiArray, TIMES_TOPIC, RESULT)
    bench.until(times.get_subscription_count)
    times.publish(Int64MultiArray(data=[1]))
    bench.until(lambda: bench.node.health.counter("bad_times"))
    assert bench.node.health.counter("bad_times") == 1


# --- several persons, silence


BESIDE = np.array([2.0, 0.0, 0.0])
SECOND = "mocap/bodies/b0002/"


class Couple:
    """The bench with two persons: one message a set holds both."""

    def __init__(self, bench, body, person):
        self.bench, self.body, self.person = bench, body, person
        self.bodies = bench.peer.create_publisher(String, "icp/bodies", LATCHED)
        bench.until(lambda: self.bodies.get_subscription_count() == 1)
        self.bodies.publish(String(data=format_bodies({2: body})))

    def fit(self, k, others=(2,), visible=ALL):
        """Send set k with the first person and these others, 2 m beside; what was published until its answer and all
        states have come."""
        beside = self.person.points(k / 60) + BESIDE
        people = {1: ReferencePoints(self.person.points(k / 60), isotropic(0.01), ALL)}
        people |= {number: ReferencePoints(beside, isotropic(0.01), visible) for number in others}
        begin = len(self.bench.arrived)
        self.bench.points.publish(people_cloud(PeoplePoints(people), stamp(k), "map"))
        states = {"mocap/state", *(f"mocap/bodies/b000{number}/state" for number in others if number == 2)}
        self.bench.until(
            lambda: self.bench.answers(stamp(k), begin) and states <= {t for t, _ in self.bench.arrived[begin:]}
        )
        return self.bench.arrived[begin:]


@pytest.fixture
def couple(bench, body, body_file, person):
    """couple(parameter=value, ...): a started bench with two persons; the topics of the second are listened to."""

    def start(**parameters):
        b = bench(skeleton_rate_hz=0.0, **parameters)
        for topic, kind in OUTPUTS.items():
            if topic.startswith("mocap/"):
                b.listen(kind, topic.replace("mocap/", SECOND))
        b.listen(MarkerArray, "mocap/skeletons")
        b.start()
        b.body.publish(String(data=format_body(body)))
        return Couple(b, body, person)

    return start


def test_two_persons_have_topics_each_and_one_answer_a_set(couple, body, person):
    """A publisher that comes with a person finds listeners that were there before: nothing is lost."""
    pair, published = couple(), {}
    references = {"mocap/": ArticulatedEkf(body), SECOND: ArticulatedEkf(body)}
    for k in range(3):
        for topic, message in pair.fit(k):
            published.setdefault(topic, []).append(message)
        for prefix, reference in references.items():
            points = person.points(k / 60) + (BESIDE if prefix == SECOND else 0.0)
            expected = reference.step(stamp(k), *ReferencePoints(points, isotropic(0.01), ALL).as_sent())
            np.testing.assert_array_equal(published[f"{prefix}joint_states"][k].position, expected.angles)
    assert {topic.removeprefix(SECOND) for topic in published if topic.startswith(SECOND)} == {
        *("joint_states", "torso", "joint_covariance", "reference_points", "skeleton", "state")
    }
    assert all(len(messages) == 3 for topic, messages in published.items() if topic != "mocap/skeletons")
    predictions = read_predictions(published["ekf/prediction"][-1], "test").of
    apart = predictions[2].pose.position_world - predictions[1].pose.position_world
    np.testing.assert_allclose(apart, BESIDE, atol=0.01)
    pair.bench.until_said("2 persons: 1 tracking, 2 tracking")


def test_the_first_persons_messages_are_the_same_with_another_person_and_alone(couple, bench, body_file, person):
    pair = couple()
    together = [dict(pair.fit(k)) for k in range(3)]
    pair.bench.close()
    b = bench(body_file=body_file, skeleton_rate_hz=0.0).start()
    alone = [dict(b.fit(stamp(k), person.points(k / 60))) for k in range(3)]
    for topic in set(OUTPUTS) - {"ekf/prediction"}:
        assert [got[topic] for got in together] == [got[topic] for got in alone]


def test_markers_of_each_person_have_a_namespace_and_a_colour_of_their_own(couple):
    pair = couple()
    pair.fit(0)
    shown = [m for t, m in pair.bench.arrived if t == "mocap/skeletons"]
    sticks = {one.ns: (one.color.r, one.color.g, one.color.b) for m in shown for one in m.markers if "sticks" in one.ns}
    assert set(sticks) == {"b0001/sticks", "b0002/sticks"} and len(set(sticks.values())) == 2
    assert [m.ns for m in pair.bench.latest("mocap/skeleton").markers] == ["sticks", "joints"]
    assert all(one.lifetime.sec == 1 for m in shown for one in m.markers)


def test_person_who_leaves_is_lost_then_gone_with_the_markers_and_the_topics_in_the_end(couple):
    pair = couple()
    pair.fit(0)
    begin = len(pair.bench.arrived)
    pair.fit(1, others=())
    pair.bench.until(lambda: {t for t, _ in pair.bench.arrived[begin:]} >= {f"{SECOND}state", f"{SECOND}skeleton"})
    got = pair.bench.arrived[begin:]
    said = {t.removeprefix(SECOND): m for t, m in got if t.startswith(SECOND)}
    assert set(said) == {"state", "skeleton"}
    assert said["state"].message == "lost" and said["state"].values[0].value == "has left"
    assert {(m.ns, m.action) for m in said["skeleton"].markers} == {
        ("b0002/sticks", Marker.DELETE),
        ("b0002/joints", Marker.DELETE),
    }
    state = "/mocap/bodies/b0002/state"
    pair.fit(300, others=())
    assert pair.bench.node.count_publishers(state) == 1  # comes back within ten seconds, maybe
    pair.fit(700, others=())
    pair.bench.until(lambda: pair.bench.node.count_publishers(state) == 0)
    got = pair.fit(701)  # the same number, its body known
    assert [m.message for t, m in got if t == "mocap/bodies/b0002/state"] == ["tracking"]


def test_lost_body_is_drawn_red_once(bench, body_file, person):
    b = bench(body_file=body_file, skeleton_rate_hz=0.0, filter__lost_after_s=0.05).start()
    b.fit(stamp(0), person.points(0.0))
    for k in range(1, 8):
        b.fit(stamp(k), np.zeros((15, 3)), visible=NONE)
    drawn = [m.markers[0] for t, m in b.arrived if t == "mocap/skeleton"]
    red = [one for one in drawn if (one.color.r, one.color.g) == (pytest.approx(0.9), pytest.approx(0.2))]
    assert len(red) == 1 and drawn[-1] is red[0] and red[0].lifetime.sec == 1


def test_silence_is_reported_and_the_markers_go(couple):
    pair = couple(stale_after_s=0.1)
    pair.fit(0)
    begin = len(pair.bench.arrived)
    pair.bench.until(lambda: [t for t, _ in pair.bench.arrived[begin:]].count("mocap/bodies/b0002/state"))
    said = dict(pair.bench.arrived[begin:])
    for prefix in ("mocap/", SECOND):
        assert said[f"{prefix}state"].message == "lost" and said[f"{prefix}state"].level == DiagnosticStatus.ERROR
        assert "no frame sets" in said[f"{prefix}state"].values[0].value
        assert {one.action for one in said[f"{prefix}skeleton"].markers} == {Marker.DELETE}
    pair.bench.until_said("lost: no frame sets")
    assert "tracking" in [m.message for t, m in pair.fit(1) if t == "mocap/state"]


def test_everybody_tracked_is_listed_with_hri_msgs_and_nobody_once_sets_stop(couple, monkeypatch):
    """A stand-in of hri_msgs/IdsList, which is not in the wheels: a message with a header and a list of names."""
    monkeypatch.setattr("ekf_tracker.humans_ros.IdsList", JointState)
    monkeypatch.setattr("ekf_tracker.humans_ros._ids_message", lambda ids, stamp_ns: JointState(name=ids))
    pair = couple(publish_humans=True, stale_after_s=0.1)
    pair.bench.listen(JointState, "/humans/bodies/tracked")
    pair.bench.listen(JointState, "/humans/bodies/b0002/joint_states")
    pair.bench.until(lambda: pair.bench.node.count_subscribers("/humans/bodies/tracked") == 1)
    pair.bench.until(lambda: pair.bench.node.count_subscribers("/humans/bodies/b0002/joint_states") == 1)
    pair.bench.until(lambda: pair.bench.node._humans._tracked.heard)

    def tracked():
        return [list(m.name) for t, m in pair.bench.arrived if t == "/humans/bodies/tracked"]

    pair.fit(0)
    pair.fit(1)
    pair.bench.until(lambda: ["b0001", "b0002"] in tracked())
    pair.fit(2, others=())
    pair.bench.until(lambda: ["b0001"] in tracked())
    pair.bench.until(lambda: tracked()[-1] == [])
    assert pair.bench.latest("/humans/bodies/b0002/joint_states").name[0] == "waist_b0002"


def test_names_of_the_points_are_on_the_wire(bench):
    b = bench()
    b.listen(String, "mocap/point_names", LATCHED)
    b.start()
    b.until(lambda: any(t == "mocap/point_names" for t, _ in b.arrived))
    assert tuple(b.latest("mocap/point_names").data.split(",")) == POINT_NAMES


def test_others_wait_for_their_body_too(couple, body):
    pair = couple(body_wait_s=60.0)
    pair.fit(0)
    people = {n: ReferencePoints(pair.person.points(1 / 60), isotropic(0.01), ALL) for n in (1, 3)}
    pair.bench.points.publish(people_cloud(PeoplePoints(people), stamp(1), "map"))
    pair.bench.until(lambda: len(pair.bench.node._waiting) == 1)
    pair.bodies.publish(String(data=format_bodies({2: body, 3: Body.from_stature(1.6)})))
    pair.bench.until(lambda: pair.bench.answers(stamp(1)))
    assert list(read_predictions(pair.bench.answers(stamp(1))[0], "test").of) == [1, 3]
