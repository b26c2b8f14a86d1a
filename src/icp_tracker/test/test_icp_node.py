"""The ICP node among messages: one answer for every hull, whatever arrives."""

import os
from dataclasses import fields, replace
from types import SimpleNamespace

import numpy as np
import pytest
import synthetic_people as synthetic
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from node_probe import FAILURE, SUCCESS, NodeProbe, values_of
from pose_file import save_initial_pose
from refinement_rays import grazing_rays
from sensor_msgs.msg import MultiDOFJointState, PointCloud2
from std_msgs.msg import Float64MultiArray, String
from std_srvs.srv import Trigger

from icp_tracker.extrinsic_monitor import ExtrinsicErrors
from icp_tracker.icp_node import IcpNode, fit_message
from icp_tracker.initialization.initial_pose import KnownPose
from icp_tracker.tracker import IcpTracker, fits_nothing
from mocap_packets.hull import Centerline, ContourRays, HullProducts, VoxelSamples
from mocap_packets.people import Predictions, parse_bodies
from mocap_packets.state import Prediction
from sagoma_ros.messages import to_ns
from sagoma_ros.packets import HULL_PRODUCTS, read_people_points, read_reference_points, tables_message
from sagoma_ros.poses import predictions_message
from sagoma_ros.qos import LATCHED, RESULT
from stick_figure.kinematics import forward

NAMESPACE = f"/test_{os.getpid()}"  # two runs of these tests at once do not hear each other
PERIOD_NS = 25_000_000
EPOCH_NS = 5_000_000_000
NEVER_S = 3600.0
WITH_RAYS = {"initial_pose.t_pose.hold_sets": 2, "articulated.contour.weight": 10_000.0}


def stamp(k):
    return EPOCH_NS + k * PERIOD_NS


def hull(seen, k):
    """Message of a hull whose centerline are the points (n, 3), or of `HullProducts`, at set k."""
    if not isinstance(seen, HullProducts):
        seen = HullProducts(0, Centerline.of_points(seen, 0.005))
    return tables_message(replace(seen, stamp_ns=stamp(k)), "map")


def prediction_message(stamp_ns, pose=None, velocity=None):
    """Message of the first person's prediction alone."""
    one = (
        Prediction(stamp_ns)
        if pose is None
        else Prediction.of(stamp_ns, pose, np.zeros(24) if velocity is None else velocity)
    )
    return predictions_message(Predictions(stamp_ns, {1: one}))


class IcpProbe(NodeProbe):
    """An IcpNode; its peer plays hull server and filter."""

    def __init__(self, context, **parameters):
        # neither voxels nor contour rays, but where a test is about them
        points_alone = {"articulated.volume.weight": 0.0, "articulated.contour.weight": 0.0}
        super().__init__(context, IcpNode, {**points_alone, **parameters}, NAMESPACE)
        self.points = self.listen(PointCloud2, "icp/reference_points")
        self.fits = self.listen(DiagnosticArray, "icp/fit")
        self.hulls = self.peer.create_publisher(Float64MultiArray, HULL_PRODUCTS.name, RESULT)
        self.predictions = self.peer.create_publisher(MultiDOFJointState, "ekf/prediction", RESULT)

    def start(self):
        super().start()
        outgoing = (self.hulls, self.predictions)
        self.until(lambda: all(p.get_subscription_count() for p in outgoing))
        self.until(lambda: all(self.peer.count_publishers(topic) for topic in self.heard))
        self.until(lambda: self.node._points_publisher.is_wanted and self.node._fit_publisher.is_wanted)
        return self

    def answer(self, message):
        """Publish a hull; the values of icp/fit and the points that answer it."""
        count = len(self.points)
        self.hulls.publish(message)
        self.until(lambda: len(self.points) > count and len(self.fits) > count)
        points, covariance, visible, *_ = read_reference_points(self.points[-1], "test")
        values = values_of(self.fits[-1])
        return SimpleNamespace(
            points=points,
            covariance=covariance,
            visible=visible,
            stamp_ns=to_ns(self.points[-1].header.stamp),
            reason=self.fits[-1].status[0].message,
            state=values["state"],
            started_from=values["started_from"],
            used=int(values.get("points", 0)),
        )


@pytest.fixture
def bench(open_probe):
    return lambda **parameters: open_probe(IcpProbe, **parameters)


@pytest.fixture
def walk(body, tmp_path):
    """Poses, clouds, and the parameters that start the node at the first of them."""
    rng = np.random.default_rng(1)
    poses = synthetic.smooth_motion(12, seed=1)
    save_initial_pose(poses[0], tmp_path / "start.yaml", body)
    clouds = [synthetic.stick_cloud(body, pose, rng, 300, 0.02) for pose in poses]
    parameters = {
        "initial_pose.source": "file",
        "initial_pose.file": str(tmp_path / "start.yaml"),
        "prediction_wait_s": 0.0,
    }
    return SimpleNamespace(body=body, poses=poses, clouds=clouds, parameters=parameters)


def test_camera_that_was_moved_is_named_in_the_diagnostics_until_it_is_put_back(bench, walk):
    node = bench(**walk.parameters, stale_after_s=0.0).start().node
    why = "cam02: people 12 mm beside where other cameras show them"
    moved = ExtrinsicErrors({"cam01": 0.001, "cam02": 0.0123}, {"cam02": why})
    (fit,) = node._tracker.step(HullProducts.of_points(stamp(0), walk.clouds[0], 0.005), {})
    for errors, level, suspects in (
        (ExtrinsicErrors(), DiagnosticStatus.OK, ""),
        (moved, DiagnosticStatus.WARN, "cam02"),
        (ExtrinsicErrors({"cam02": 0.001}), DiagnosticStatus.OK, ""),
    ):
        node._report_cameras(errors)
        node._publish((fit,), ())
        status = node.health.snapshot()
        values = {pair.key: pair.value for pair in status.values}
        assert (status.level, values["calibration_suspects"]) == (level, suspects)
        assert (why in status.message) == bool(suspects)
    assert values["calibration_shift_mm"] == "cam02=1.0"


def test_every_centerline_is_answered_with_its_stamp_and_exactly_what_the_tracker_returns(bench, walk):
    node = bench(**walk.parameters).start()
    tracker = IcpTracker(KnownPose(walk.poses[0], walk.body), node.node.settings)
    for k, cloud in enumerate([*walk.clouds[:4], np.empty((0, 3)), *walk.clouds[5:7]]):
        answer = node.answer(hull(cloud, k))
        expected = tracker.step(HullProducts.of_points(stamp(k), cloud, 0.005))
        assert answer.stamp_ns == stamp(k)
        assert np.array_equal(answer.points, expected.reference_points_world.astype(np.float32))
        assert fit_message((expected,), "articulated") == node.fits[-1]
        if len(cloud):
            assert answer.visible.all() and answer.state == "tracking" and answer.used == len(cloud)
            assert (np.linalg.eigvalsh(answer.covariance) > 0).all()
            assert answer.started_from == ("initial" if k == 0 else "own")
        else:
            assert not answer.visible.any() and "0 centerline points" in answer.reason
    assert node.points[-1].header.frame_id == "map"
    assert node.node.health.counter("dropped_sets") == 0


def test_fit_starts_from_the_prediction_of_the_previous_set(bench, walk):
    node = bench(**{**walk.parameters, "prediction_wait_s": NEVER_S}).start()
    node.answer(hull(walk.clouds[0], 0))
    node.hulls.publish(hull(walk.clouds[1], 1))
    node.until(lambda: node.node._feedback.waiting)
    assert len(node.points) == 1  # no fit without the filter's word
    node.predictions.publish(prediction_message(stamp(0), walk.poses[0]))
    node.until(lambda: len(node.fits) == 2)
    assert values_of(node.fits[1])["started_from"] == str(stamp(0))


def test_filter_that_never_answers_is_waited_for_once(bench, walk):
    node = bench(**{**walk.parameters, "prediction_wait_s": 0.2}).start()
    answers = [node.answer(hull(cloud, k)) for k, cloud in enumerate(walk.clouds)]
    assert [answer.started_from for answer in answers] == ["initial"] + ["own"] * 11
    assert node.node._feedback.timeouts == 1
    node.predictions.publish(prediction_message(stamp(11), walk.poses[-1]))  # it is back
    node.until(lambda: node.node._feedback._newest is not None)
    assert node.answer(hull(walk.clouds[-1], 12)).started_from == str(stamp(11))


@pytest.mark.parametrize("readable", [True, False], ids=["no state", "damaged"])
def test_prediction_without_a_state_or_that_cannot_be_read_leaves_the_start_to_the_tracker(bench, walk, readable):
    node = bench(**{**walk.parameters, "prediction_wait_s": NEVER_S if readable else 0.0}).start()
    node.answer(hull(walk.clouds[0], 0))
    message = prediction_message(stamp(0), None if readable else walk.poses[0])
    if not readable:
        message.joint_names[3] = "nonsense"
    node.predictions.publish(message)
    node.until(lambda: readable or node.node.health.counter("bad_predictions") == 1)
    assert node.answer(hull(walk.clouds[1], 1)).started_from == "own"


def test_damaged_hull_is_counted_and_the_graph_goes_on(bench, walk):
    node = bench(**walk.parameters).start()
    node.answer(hull(walk.clouds[0], 0))
    other, short = hull(walk.clouds[1], 1), hull(walk.clouds[2], 2)
    other.layout.dim[1].label = "centerline: x y z"
    short.layout.dim[1].size += 5
    for damaged in (other, short):
        node.hulls.publish(damaged)
    node.until(lambda: node.node.health.counter("bad_hulls") == 2)
    assert node.answer(hull(walk.clouds[3], 3)).visible.all() and len(node.points) == 2


def test_stamps_that_go_back_far_begin_anew_at_once_and_are_logged_once(bench, walk, capfd):
    """A bag played twice, footage that starts again, a clock that was set back."""
    node = bench(**{**walk.parameters, "prediction_wait_s": 0.0}).start()
    for k in (40, 41):
        node.answer(hull(walk.clouds[0], k))
    node.predictions.publish(prediction_message(stamp(41), walk.poses[5], np.ones(24)))
    node.until(lambda: node.node._feedback._newest is not None)
    answers = [node.answer(hull(walk.clouds[k], k)) for k in range(4)]
    assert [answer.started_from for answer in answers] == ["initial", "own", "own", "own"]
    assert {answer.state for answer in answers} == {"tracking"}
    damaged = prediction_message(stamp(3), walk.poses[3])
    damaged.joint_names[3] = "nonsense"
    late = prediction_message(stamp(41), walk.poses[5])  # of before: it comes behind the answer to the new set
    for message in (prediction_message(stamp(3), walk.poses[3]), late, damaged):
        node.predictions.publish(message)
    node.until(lambda: node.node.health.counter("bad_predictions") == 1)
    for k in (4, 5):  # the newest state serves where that of the set before does not come in time
        assert node.answer(hull(walk.clouds[k], k)).started_from == str(stamp(3))
    assert node.node.health.counter("restarts") == 1
    assert capfd.readouterr().err.count("stamps went back by 1.025 s: a new beginning") == 1


def test_silence_of_the_hull_server_is_reported_within_a_second_and_its_return_too(bench, walk):
    node = bench(**{**walk.parameters, "stale_after_s": 0.4}).start()
    node.until_said("no frame sets for")
    node.answer(hull(walk.clouds[0], 0))
    node.until(lambda: not node.diagnostics[-1].status[0].message.startswith("no frame sets"))
    node.until_said("no frame sets for")
    assert node.diagnostics[-1].status[0].level == DiagnosticStatus.WARN


def in_a_t_pose(body, *places):
    """People in a T-pose at these x: poses, and products of all, each row with its body's number."""
    poses = [synthetic.t_pose((x, 0.1, 0.53 * 1.75 + body.half_lengths[0]), heading=0.4) for x in places]
    rng = np.random.default_rng(3)
    clouds = [synthetic.stick_cloud(body, pose, rng, 300, 0.01) for pose in poses]
    voxels = [synthetic.voxels(body, pose) for pose in poses]
    rays = [grazing_rays(body, pose, rng) for pose in poses]
    lines, hulls, outlines = (
        np.repeat(np.arange(len(places)), [len(p) for p in kind]) for kind in (clouds, voxels, rays)
    )
    columns = (np.concatenate([getattr(one, field.name) for one in rays]) for field in fields(ContourRays))
    return poses, HullProducts(
        0,
        Centerline.of_points(np.vstack(clouds), 0.005, lines),
        VoxelSamples(np.vstack(voxels), np.zeros(len(hulls), bool), hulls),
        contour_rays=replace(ContourRays(*columns), body=outlines),
    )


def test_t_pose_is_acquired_from_a_hull_and_reset_looks_for_it_again(bench, body):
    _, seen = in_a_t_pose(body, 0.2)
    node = bench(**{**WITH_RAYS, "prediction_wait_s": 0.0}).start()
    for k in range(3):
        answer = node.answer(hull(seen, k))
        assert answer.state == ("acquiring" if k == 0 else "tracking")
        if k == 0:
            assert answer.reason == "T-pose seen, hold it (1 of 2)"
            assert not answer.points.any() and not answer.visible.any()
    response = node.ask(Trigger, "icp_tracker/reset")
    assert response.success and "auto" in response.message
    assert node.answer(hull(seen, 3)).state == "acquiring"


def test_two_persons_are_answered_in_one_message_with_a_body_each(bench, body, tmp_path):
    poses, seen = in_a_t_pose(body, -1.0, 1.0)
    parameters = {**WITH_RAYS, "prediction_wait_s": NEVER_S}
    node = bench(**parameters, **{"bodies.folder": str(tmp_path)})
    others = node.listen(String, "icp/bodies", LATCHED)
    node.start()
    for k in range(3):
        node.hulls.publish(hull(seen, k))
        node.until(lambda count=k + 1: len(node.points) == len(node.fits) == count)
        if k == 0:
            assert node.points[0].height == 1 and len(read_people_points(node.points[0], "test").of) == 1
        predictions = {1: Prediction(stamp(k)), 2: Prediction.of(stamp(k), poses[1], np.zeros(24))}
        node.predictions.publish(predictions_message(Predictions(stamp(k), predictions)))
    assert (node.points[-1].height, node.points[-1].width) == (2, 15)
    people = read_people_points(node.points[-1], "test")
    for pose, points in zip(poses, people.of.values(), strict=True):
        assert np.linalg.norm(points.points_world - forward(body, pose), axis=1).mean() < 0.05
    started = {status.name: status.values[2].value for status in node.fits[-1].status}
    assert started == {"icp_tracker: fit": "own", "icp_tracker: fit of person 2": str(stamp(1))}
    node.until(lambda: others)
    assert list(parse_bodies(others[-1].data, "test")) == [2]
    node.until_said("2 persons: 1 tracking, 2 tracking")
    saved = node.ask(Trigger, "icp_tracker/save_body")
    assert saved.success and [path.split("_")[-1] for path in saved.message.split(", ")][1] == "person2.yaml"


def test_no_more_persons_are_followed_than_the_parameter_says(bench, body):
    _, seen = in_a_t_pose(body, -1.0, 1.0)
    parameters = {**WITH_RAYS, "prediction_wait_s": 0.0}
    node = bench(**parameters, **{"people.max": 1}).start()
    for k in range(3):
        node.hulls.publish(hull(seen, k))
        node.until(lambda count=k + 1: len(node.points) == count)
    assert [message.height for message in node.points] == [1, 1, 1]


def test_slow_fit_drops_the_oldest_sets_and_counts_them(bench, walk):
    node = bench(**{**walk.parameters, "prediction_wait_s": NEVER_S, "queue_depth": 2}).start()
    node.answer(hull(walk.clouds[0], 0))
    node.hulls.publish(hull(walk.clouds[1], 1))
    node.until(lambda: node.node._feedback.waiting)
    for k in range(2, 8):  # set 1 waits for the filter; of 2 to 7 only the last two fit into the queue
        node.hulls.publish(hull(walk.clouds[k], k))
    node.until(lambda: node.node.health.counter("dropped_sets") == 4)
    for count, k in enumerate((0, 1, 6), start=2):
        node.predictions.publish(prediction_message(stamp(k), walk.poses[k]))
        node.until(lambda wanted=count: len(node.points) == wanted)
    assert [to_ns(message.header.stamp) for message in node.points] == [stamp(k) for k in (0, 1, 6, 7)]


def test_suspended_node_is_silent_and_resumes(bench, walk):
    node = bench(**{**walk.parameters, "prediction_wait_s": NEVER_S}).start()
    node.answer(hull(walk.clouds[0], 0))
    node.hulls.publish(hull(walk.clouds[1], 1))  # its fit waits for the filter
    assert node.node.trigger_deactivate() == SUCCESS
    assert node.node.trigger_activate() == SUCCESS
    node.until(lambda: node.hulls.get_subscription_count())
    assert node.answer(hull(walk.clouds[2], 2)).state == "tracking"
    assert node.node.trigger_deactivate() == SUCCESS
    assert node.node.trigger_cleanup() == SUCCESS


@pytest.mark.parametrize(
    ("parameters", "words"),
    [
        ({"initial_pose.source": "file"}, ["initial_pose.file"]),
        ({"initial_pose.source": "file", "initial_pose.file": "/no/such.yaml"}, ["/no/such.yaml"]),
        ({"initial_pose.source": "session"}, ["initial_pose.session"]),
        ({"initial_pose.source": "session", "initial_pose.session": "/no/such"}, ["/no/such"]),
        ({"initial_pose.source": "guess"}, ["initial_pose.source", "guess", "t_pose"]),
        ({"body_file": "/no/body.yaml"}, ["/no/body.yaml"]),
        ({"people.max": -1}, ["people.max", "-1"]),
        ({"people.most": 2}, ["people.most", "people.max"]),
    ],
)
def test_bad_parameter_fails_configure_with_a_clear_line(bench, capfd, parameters, words):
    node = bench(**parameters)
    assert node.node.trigger_configure() == FAILURE
    shown = capfd.readouterr().err
    for word in words:
        assert word in shown


def test_state_or_reason_is_logged_when_it_changes_and_at_most_once_a_second(bench, monkeypatch, capfd):
    clock = SimpleNamespace(now_s=100.0)
    monkeypatch.setattr("icp_tracker.icp_node.time", SimpleNamespace(monotonic=lambda: clock.now_s))
    node = bench().node
    for k in range(60):  # three seconds of sets, whose reasons change with each, then stay
        clock.now_s = 100.0 + 0.05 * k
        node._log_state(fits_nothing(stamp(k), f"arm {k} cm too low" if k < 50 else "stand still"))
    lines = [line for line in capfd.readouterr().err.splitlines() if "acquiring" in line]
    assert [line.rpartition("acquiring: ")[2] for line in lines] == [
        *("arm 0 cm too low", "arm 20 cm too low", "arm 40 cm too low")
    ]
    clock.now_s += 1.0
    node._log_state(fits_nothing(stamp(60), "stand still"))
    node._log_state(fits_nothing(stamp(61), "stand still"))
    assert capfd.readouterr().err.count("stand still") == 1
    for k in range(50):  # two and a half seconds in which every set has another state
        clock.now_s += 0.05
        node._log_state(replace(fits_nothing(stamp(62 + k), ""), state=("tracking", "doubtful")[k % 2]))
    assert len(capfd.readouterr().err.splitlines()) == 2
