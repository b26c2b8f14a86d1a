"""The hull node among messages: one answer for every frame set, whatever arrives."""

import threading
import time
from types import SimpleNamespace

import cv2
import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from hull_scenes import capsule_person, ring_rig, silhouettes
from node_probe import FAILURE, PATIENCE_S, SUCCESS, NodeProbe, values_of
from plyfile import PlyData
from rclpy.publisher import Publisher
from sensor_msgs.msg import CameraInfo, CompressedImage, Image, PointCloud2
from std_msgs.msg import Int64MultiArray
from std_srvs.srv import Trigger

from capture_rig import load_rig, save_rig
from hull_server import hull_node
from hull_server.hull_node import HullNode
from hull_server.hull_pipeline import HullPipeline
from hull_server.overload.thinning_control import ThinningControl
from hull_server.settings import HullSettings
from mocap_packets.frame_set import FrameSet
from mocap_packets.hull import Centerline, ContourRays, VoxelSamples
from mocap_packets.thinning import EVERY_FRAME, Thinning
from sagoma_ros.images import camera_info_message, read_support, silhouette_message
from sagoma_ros.latency import read_times
from sagoma_ros.messages import to_ns
from sagoma_ros.packets import read_packet
from sagoma_ros.qos import LATCHED, SILHOUETTE_PUBLISHER
from sagoma_ros.thinning import read_thinning

PERIOD_NS = 16_666_667
EPOCH_NS = 7_000_000_000
NEVER_S = 600.0  # the deadline of frame sets, unless a test lets it pass
OUTPUTS = {
    "hull/contour_rays": PointCloud2,
    "hull/centerline": PointCloud2,
    "hull/voxels": PointCloud2,
    "hull/frame_set": DiagnosticArray,
}


def stamp(k):
    return EPOCH_NS + k * PERIOD_NS


class HullProbe(NodeProbe):
    """A HullNode; its peer plays the cameras."""

    def __init__(self, context, clock, **parameters):
        values = {"backend": "cpu", "voxel_size_m": 0.04, "reliable": True, "deadline_s": NEVER_S} | parameters
        super().__init__(context, HullNode, values)
        self.clock = clock
        for topic, kind in OUTPUTS.items():
            self.listen(kind, topic)

    def start(self, rig):
        super().start()
        self.images, self.infos = {}, {}
        for name in rig.names:
            topic = f"{name}/silhouette/compressed"
            self.images[name] = self.peer.create_publisher(CompressedImage, topic, SILHOUETTE_PUBLISHER)
            self.infos[name] = self.peer.create_publisher(CameraInfo, f"{name}/camera_info", SILHOUETTE_PUBLISHER)
        publishers = [*self.images.values(), *self.infos.values()]
        self.until(lambda: all(p.get_subscription_count() for p in publishers))
        self.until(lambda: all(self.peer.count_publishers(topic) for topic in self.heard))
        return self

    def send(self, masks, k, **extra_ns):
        for name, mask in masks.items():
            self.images[name].publish(silhouette_message(mask, stamp(k) + extra_ns.get(name, 0), name))

    def let_the_deadline_pass(self, frames):
        """Once the node has taken so many frames in all, its clock leaps beyond every deadline."""
        self.until_values(frames=str(frames))
        self.clock.ahead_ns += round(2 * NEVER_S * 1e9)

    def answers(self, count):
        """The values of hull/frame_set of the first ``count`` sets, once all four topics have told of them."""
        topics = list(OUTPUTS)
        self.until(lambda: all(len(self.heard[topic]) >= count for topic in topics))
        for topic in topics:
            assert len(self.heard[topic]) == count
        for topic in topics[:2]:
            assert [to_ns(m.header.stamp) for m in self.heard[topic]] == [
                to_ns(m.header.stamp) for m in self.heard[topics[3]]
            ]
        return [values_of(m) for m in self.heard["hull/frame_set"]]


@pytest.fixture(scope="module")
def scene(tmp_path_factory):
    """Rig file, the rig as read back, silhouettes of a person."""
    rig_file = tmp_path_factory.mktemp("rig") / "rig.yaml"
    save_rig(ring_rig(4), rig_file)
    rig = load_rig(rig_file)
    return rig_file, rig, silhouettes(rig, capsule_person(0.3))


@pytest.fixture
def clock(monkeypatch):
    """The node's monotonic clock, which a test may put forward."""
    clock = SimpleNamespace(ahead_ns=0)
    monkeypatch.setattr(hull_node, "monotonic_ns", lambda: time.monotonic_ns() + clock.ahead_ns)
    return clock


@pytest.fixture
def make_bench(open_probe, scene, clock):
    return lambda **parameters: open_probe(HullProbe, clock, **({"rig_file": str(scene[0])} | parameters))


@pytest.fixture
def bench(make_bench, scene):
    return make_bench().start(scene[1])


def test_node_publishes_what_the_pipeline_finds_with_the_sets_stamp(bench, scene):
    _, rig, masks = scene
    bench.send(masks, 0, cam02=300_000, cam04=900_000)
    (values,) = bench.answers(1)
    expected = HullPipeline(rig, HullSettings(voxel_size_m=0.04, backend="cpu")).run(
        FrameSet.of_instant(stamp(0), masks)
    )
    cloud = bench.heard["hull/centerline"][0]
    line = read_packet(cloud, Centerline, "test")
    assert to_ns(cloud.header.stamp) == stamp(0) and cloud.header.frame_id == "map"
    found = expected.products.centerline
    np.testing.assert_allclose(line.points_world, found.points_world, atol=1e-6)
    np.testing.assert_allclose(line.sigma, found.sigma, atol=1e-7)
    np.testing.assert_array_equal(line.axis, found.axis)
    for name in ("area_m2", "elongation", "fill"):
        np.testing.assert_allclose(getattr(line, name), getattr(found, name), rtol=1e-6)
    voxels = read_packet(bench.heard["hull/voxels"][0], VoxelSamples, "test")
    np.testing.assert_allclose(voxels.points_world, expected.products.voxels.points_world, atol=1e-6)
    np.testing.assert_array_equal(voxels.surface, expected.products.voxels.surface)
    rays = read_packet(bench.heard["hull/contour_rays"][0], ContourRays, "test")
    assert bench.heard["hull/contour_rays"][0].header == cloud.header and len(rays) > 100
    found = expected.products.contour_rays
    np.testing.assert_allclose(rays.points_world, found.points_world, atol=1e-6)
    for name in ("directions", "normals"):
        np.testing.assert_allclose(getattr(rays, name), getattr(found, name), atol=1e-7)
    for name in ("half_lengths", "sigma"):
        np.testing.assert_allclose(getattr(rays, name), getattr(found, name), rtol=1e-6)
    np.testing.assert_array_equal(rays.camera, found.camera)
    assert set(rays.body) == {0} and int(values["contour_rays"]) == len(rays)
    assert to_ns(bench.heard["hull/frame_set"][0].header.stamp) == stamp(0)
    assert values["cameras"] == "cam01,cam02,cam03,cam04" and values["missing"] == values["blank"] == ""
    assert float(values["spread_ms"]) == pytest.approx(0.9) and values["backend"] == "cpu"
    assert int(values["voxels"]) == expected.volume.count and 40 < float(values["litres"]) < 200
    assert {
        "carve_ms",
        "slice_ms",
        "filter_ms",
        "sample_ms",
        "contour_rays_ms",
        "hull_ms",
        "queued_ms",
    } <= values.keys()


def test_node_gives_the_same_bytes_for_the_same_silhouettes(make_bench, scene):
    _, rig, masks = scene
    sent = []
    for _ in range(2):
        bench = make_bench().start(rig)
        bench.send(masks, 0)
        bench.answers(1)
        sent.append(
            [bytes(bench.heard[topic][0].data) for topic in ("hull/contour_rays", "hull/centerline", "hull/voxels")]
        )
        bench.close()
    assert sent[0] == sent[1]


def test_node_answers_an_incomplete_set_at_its_deadline_and_names_the_missing_camera(make_bench, scene):
    _, rig, masks = scene
    bench = make_bench().start(rig)
    bench.send({name: masks[name] for name in ("cam01", "cam02", "cam04")}, 0)
    bench.let_the_deadline_pass(frames=3)
    (values,) = bench.answers(1)
    assert values["missing"] == "cam03" and values["cameras"] == "cam01,cam02,cam04" and values["min_seeing"] == "3"
    assert int(values["voxels"]) > 0
    assert "nothing in time from cam03" in bench.heard["hull/frame_set"][0].status[0].message
    bench.until_values(sets_incomplete="1", frames_missing="1")


def test_node_never_mixes_a_late_frame_into_another_set(make_bench, scene):
    _, rig, masks = scene
    bench = make_bench().start(rig)
    bench.send({name: masks[name] for name in ("cam01", "cam02", "cam04")}, 0)
    bench.let_the_deadline_pass(frames=3)
    bench.answers(1)
    bench.send({"cam03": masks["cam03"]}, 0)
    bench.until_values(frames_late="1")
    bench.send(masks, 1)
    assert [values["missing"] for values in bench.answers(2)] == ["cam03", ""]


def test_node_counts_duplicate_stamps_and_stamps_that_go_back(bench, scene):
    masks = scene[2]
    bench.send({"cam01": masks["cam01"]}, 1)
    bench.send({"cam01": masks["cam01"]}, 1)
    bench.until_values(frames_duplicate="1")
    bench.send({"cam01": masks["cam01"]}, 0)
    bench.until_values(frames_backwards="1", frames="3")
    bench.send({name: masks[name] for name in ("cam02", "cam03", "cam04")}, 1)
    (values,) = bench.answers(1)
    assert values["missing"] == "" and to_ns(bench.heard["hull/frame_set"][0].header.stamp) == stamp(1)


def png(image):
    message = CompressedImage(format="mono8; png compressed mono8")
    message.data = cv2.imencode(".png", image)[1].tobytes()
    return message


def garbage(data, format="mono8; png compressed mono8"):
    message = CompressedImage(format=format)
    message.data = data
    return message


@pytest.mark.parametrize(
    ("make_message", "text"),
    [
        (lambda mask: png(mask[:-2]), "pixels, the undistorted canvas"),
        (lambda mask: png(np.dstack([mask] * 3)), "not mono8"),
        (lambda mask: garbage(b"\x00\x01\x02not an image"), "is not a PNG"),
        (lambda mask: garbage(b""), "is not a PNG"),
        (lambda mask: garbage(b"\xff\xd8\xff\xe0 truncated", "jpeg"), "'jpeg' is not a PNG"),
        (lambda mask: garbage(png(mask).data.tobytes()[:60]), "cannot be decoded"),
    ],
    ids=["wrong size", "colour", "garbage", "empty", "jpeg", "truncated"],
)
def test_node_drops_and_counts_a_bad_image_and_goes_on(bench, scene, make_message, text):
    masks = scene[2]
    bad = make_message(masks["cam01"])
    bad.header = silhouette_message(masks["cam01"], stamp(0), "cam01").header
    bench.images["cam01"].publish(bad)
    status = bench.until_values(bad_images="1")
    said = {pair.key: pair.value for pair in status.values}["last_bad_image"]
    assert said.startswith("cam01/silhouette/compressed") and text in said
    bench.send(masks, 1)
    assert [values["missing"] for values in bench.answers(1)] == [""]


@pytest.mark.parametrize(
    ("spoil", "text"),
    [
        (lambda info: setattr(info, "width", info.width + 32), "the rig's undistorted canvas is"),
        (lambda info: info.k.__setitem__(0, info.k[0] * 1.01), "K with fx"),
        (lambda info: setattr(info, "d", [0.1, 0.0, 0.0, 0.0, 0.0]), "must be undistorted"),
        (lambda info: info.k.__setitem__(0, 0.0), "K = 0: its client is not calibrated"),
    ],
    ids=["size", "focal length", "distortion", "uncalibrated"],
)
def test_node_refuses_a_camera_whose_camera_info_disagrees_until_it_agrees_again(make_bench, scene, spoil, text):
    _, rig, masks = scene
    bench = make_bench().start(rig)
    canvas = rig.camera("cam02").undistorted_view().camera
    info = camera_info_message(canvas, stamp(0), "cam02")
    spoil(info)
    bench.infos["cam02"].publish(info)
    bench.until(lambda: "cam02" in bench.node.refused)
    bench.send(masks, 0)
    bench.let_the_deadline_pass(frames=3)
    assert [values["missing"] for values in bench.answers(1)] == ["cam02"]
    status = bench.until_values(frames_refused="1")
    said = {pair.key: pair.value for pair in status.values}["refused_cam02"]
    assert said.startswith("cam02/camera_info") and text in said and "same rig file" in said
    assert status.level == b"\x02"
    bench.infos["cam02"].publish(camera_info_message(canvas, stamp(1), "cam02"))
    bench.until(lambda: not bench.node.refused)
    bench.send(masks, 1)
    assert bench.answers(2)[1]["missing"] == ""


def test_node_publishes_an_empty_hull_for_empty_silhouettes_and_flags_it(bench, scene):
    masks = {name: np.zeros_like(mask) for name, mask in scene[2].items()}
    bench.send(masks, 0)
    (values,) = bench.answers(1)
    assert values["blank"] == "cam01,cam02,cam03,cam04" and values["voxels"] == values["points"] == "0"
    assert bench.heard["hull/centerline"][0].width == bench.heard["hull/voxels"][0].width == 0
    assert bench.heard["hull/contour_rays"][0].width == 0
    assert "the hull is empty" in bench.heard["hull/frame_set"][0].status[0].message
    bench.until_values(sets_empty="1")


def test_node_publishes_the_contour_rays_before_the_centerline_of_the_same_set(make_bench, scene, monkeypatch):
    """The tracker starts to fit when the centerline comes; the contour rays must be there."""
    _, rig, masks = scene
    bench, order, publish = make_bench().start(rig), [], Publisher.publish

    def recorded(publisher, message):
        order.append(publisher.topic_name)
        publish(publisher, message)

    monkeypatch.setattr(Publisher, "publish", recorded)
    for k in range(3):
        bench.send(masks, k)
    bench.answers(3)
    clouds = ["/hull/contour_rays", "/hull/centerline", "/hull/voxels"]
    assert [topic for topic in order if topic in clouds] == clouds * 3


@pytest.mark.parametrize(("stage", "answered"), [("begin", [0, 5]), ("finish", [0, 1, 2, 5])])
def test_node_drops_the_oldest_set_when_a_stage_cannot_keep_up(make_bench, scene, stage, answered, monkeypatch):
    """One set waits for the carver; when slicing is slow, one more waits for the slicer, and one for room there."""
    _, rig, masks = scene
    bench = make_bench(queue_depth=1).start(rig)
    busy, released, begun = threading.Event(), threading.Event(), []
    stages = {name: getattr(HullPipeline, name) for name in ("begin", "finish")}

    def slow(name):
        def work(pipeline, item):
            begun.extend([item] if name == "begin" else [])
            if name == stage:
                busy.set()
                assert released.wait(PATIENCE_S)
            return stages[name](pipeline, item)

        return work

    for name in stages:
        monkeypatch.setattr(HullPipeline, name, slow(name))
    bench.send(masks, 0)
    bench.until(busy.is_set)
    for k in range(1, 6):
        bench.send(masks, k)
        bench.until_values(sets_complete=str(k + 1))
        if stage == "finish" and k <= 2:  # that the carver has taken it
            bench.until(lambda k=k: len(begun) > k)
    bench.until_values(sets_dropped=str(6 - len(answered)))
    released.set()
    bench.answers(len(answered))
    stamps = [to_ns(message.header.stamp) for message in bench.heard["hull/frame_set"]]
    assert stamps == [stamp(k) for k in answered]


def test_node_counts_people_and_says_whose_each_point_is(make_bench, scene):
    rig, rig_file = ring_rig(7), scene[0].with_name("seven.yaml")
    save_rig(rig, rig_file)
    places = ((-0.45, -0.4), (0.5, 0.45))
    people = [capsule_person(0.3, *place) for place in places]
    bench = make_bench(rig_file=str(rig_file), voxel_size_m=0.03).start(load_rig(rig_file))
    bench.send(silhouettes(rig, [limb for person in people for limb in person]), 0)
    (values,) = bench.answers(1)
    assert values["bodies"] == "2" and sorted(values["bodies_numbers"].split(",")) == ["0", "1"]
    centres = {
        number: [float(v) for v in place.split(",")]
        for number, place in zip(values["bodies_numbers"].split(","), values["bodies_at"].split("; "), strict=True)
    }
    for topic, kind in (
        ("hull/contour_rays", ContourRays),
        ("hull/centerline", Centerline),
        ("hull/voxels", VoxelSamples),
    ):
        packet = read_packet(bench.heard[topic][0], kind, "test")
        for number, (x, y, _) in centres.items():
            mine = packet.points_world[packet.body == int(number)]
            nearest = min(places, key=lambda place: np.hypot(place[0] - x, place[1] - y))
            assert len(mine) > 20 and np.hypot(*(mine[:, :2].mean(axis=0) - nearest)) < 0.25
    assert len({min(places, key=lambda p: np.hypot(p[0] - x, p[1] - y)) for x, y, _ in centres.values()}) == 2


def test_node_leaves_out_a_covered_camera_by_name_and_takes_it_back(make_bench, scene):
    rig = ring_rig(6)
    rig_file = scene[0].with_name("six.yaml")
    save_rig(rig, rig_file)
    masks = silhouettes(rig, capsule_person(0.3))
    covered = masks | {"cam04": np.zeros_like(masks["cam04"])}
    bench = make_bench(
        rig_file=str(rig_file), **{"camera_fault.reinstate_s": 0.5, "camera_fault.period_s": 0.05}
    ).start(load_rig(rig_file))
    shown = []

    def send_until(wanted, masks_of_camera):
        while not shown or shown[-1]["left_out"] != wanted:
            assert len(shown) < 200
            bench.send(masks_of_camera, len(shown))
            shown.append(bench.answers(len(shown) + 1)[-1])

    bench.send(masks, 0)
    shown.append(bench.answers(1)[-1])
    whole = float(shown[0]["litres"])
    send_until("cam04", covered)
    assert float(shown[-1]["litres"]) > 0.95 * whole and "cam04" not in shown[-1]["cameras"].split(",")
    assert "cam04" in bench.heard["hull/frame_set"][-1].status[0].message
    send_until("", masks)
    assert "cam04" in shown[-1]["cameras"].split(",")


def test_node_ignores_silhouettes_while_suspended_and_resumes(bench, scene):
    masks = scene[2]
    assert bench.node.trigger_deactivate() == SUCCESS
    bench.send(masks, 0)
    bench.until_values(frames_while_suspended="4")
    assert bench.node.trigger_activate() == SUCCESS
    bench.send(masks, 1)
    bench.until(lambda: bench.heard["hull/frame_set"])
    assert to_ns(bench.heard["hull/frame_set"][-1].header.stamp) == stamp(1)
    assert bench.node.trigger_deactivate() == SUCCESS
    assert bench.node.trigger_cleanup() == SUCCESS
    assert bench.node.trigger_configure() == SUCCESS


@pytest.mark.parametrize(
    ("parameters", "text"),
    [
        ({"rig_file": ""}, "rig_file is not set"),
        ({"rig_file": "/nowhere/rig.yaml"}, "/nowhere/rig.yaml: cannot be read"),
        ({"voxel_size_m": 0.5}, "voxel_size_m = 0.5 m is out of range"),
        ({"voxel_sise_m": 0.02}, "unknown key 'voxel_sise_m'. Did you mean 'voxel_size_m'?"),
        ({"backend": "cuda"}, "backend = 'cuda' is not one of"),
    ],
    ids=["no rig file", "no such file", "out of range", "misspelt", "unknown backend"],
)
def test_node_refuses_to_configure_with_a_clear_error(make_bench, parameters, text):
    bench = make_bench(**parameters)
    assert bench.node.trigger_configure() == FAILURE
    bench.until_said(text)
    assert bench.diagnostics[-1].status[0].level == DiagnosticStatus.ERROR


def test_node_tells_the_cameras_its_rule_and_leaves_out_what_it_does_not_keep(make_bench, scene, monkeypatch):
    _, rig, masks = scene
    half = Thinning(stamp(2), stamp(2), stamp(0), PERIOD_NS, 1, 2)
    rules = iter([EVERY_FRAME, half])

    def update(control, load, now_ns):
        rule = next(rules, None)
        if rule is not None:
            control._selector.follow(rule, now_ns)
        return rule

    monkeypatch.setattr(ThinningControl, "update", update)
    bench = make_bench(reliable=False)
    bench.listen(DiagnosticArray, "/hull/thinning", LATCHED)
    bench.start(rig)
    bench.until(lambda: len(bench.heard["/hull/thinning"]) == 2)
    assert [read_thinning(message, "test") for message in bench.heard["/hull/thinning"]] == [EVERY_FRAME, half]
    for k in range(6):  # cameras that do not know the rule
        bench.send(masks, k)
    bench.until_values(frames_thinned="8")
    assert [values["missing"] for values in bench.answers(4)] == [""] * 4
    stamps = [to_ns(message.header.stamp) for message in bench.heard["hull/frame_set"]]
    assert stamps == [stamp(k) for k in (0, 1, 2, 4)]


@pytest.mark.parametrize("parameters", [{"reliable": True}, {"reliable": False, "thin_out": False}])
def test_node_of_a_replay_thins_nothing_out(make_bench, scene, parameters):
    bench = make_bench(**parameters).start(scene[1])
    assert bench.peer.count_publishers("/hull/thinning") == 0


def test_node_says_when_a_set_was_closed_and_when_its_hull_left(make_bench, scene):
    _, rig, masks = scene
    bench = make_bench()
    heard = bench.listen(Int64MultiArray, "hull/times")
    bench.start(rig).send(masks, 0)
    bench.answers(1)
    bench.until(lambda: heard)
    times = read_times(heard[0], "test")
    assert times.stamp_ns == stamp(0) and stamp(0) < times.received_ns < times.hull_ns <= time.time_ns()


def test_save_mesh_writes_the_newest_hull(make_bench, scene, tmp_path):
    _, rig, masks = scene
    bench = make_bench(**{"mesh.folder": str(tmp_path), "mesh.smoothing_voxels": 0.0}).start(rig)
    bench.send(masks, 0)
    bench.send(masks, 1)
    values = bench.answers(2)[1]
    answer = bench.ask(Trigger, "hull_server/save_mesh")
    assert answer.success
    vertices = PlyData.read(str(tmp_path / f"hull_{stamp(1)}.ply"))["vertex"]
    assert f"{tmp_path}/hull_{stamp(1)}.ply" in answer.message
    line = read_packet(bench.heard["hull/centerline"][1], Centerline, "test").points_world
    for axis, name in enumerate("xyz"):  # the centerline runs inside the mesh
        assert vertices[name].min() < line[:, axis].min() and line[:, axis].max() < vertices[name].max()
    said_litres = float(answer.message.split(",")[-1].removesuffix("litres"))
    assert said_litres == pytest.approx(float(values["litres"]), rel=0.1)


@pytest.mark.parametrize(("sets", "why"), [(0, "no frame set"), (1, "the hull is empty")])
def test_save_mesh_without_a_hull_says_why(make_bench, scene, tmp_path, sets, why):
    _, rig, masks = scene
    bench = make_bench(**{"mesh.folder": str(tmp_path)}).start(rig)
    for k in range(sets):
        bench.send({name: np.zeros_like(mask) for name, mask in masks.items()}, k)
        bench.answers(k + 1)
    answer = bench.ask(Trigger, "hull_server/save_mesh")
    assert not answer.success and why in answer.message and not list(tmp_path.iterdir())


def test_node_tells_every_camera_what_the_others_see(make_bench, scene):
    _, rig, masks = scene
    bench, topics = make_bench(), [f"{name}/silhouette/support" for name in rig.names]
    for topic in topics:
        bench.listen(Image, topic)
    bench.start(rig).send(masks, 0)
    bench.answers(1)
    bench.until(lambda: all(bench.heard[topic] for topic in topics))
    expected = HullPipeline(rig, HullSettings(voxel_size_m=0.04, backend="cpu")).run(
        FrameSet.of_instant(stamp(0), masks)
    )
    for report, topic in zip(expected.support, topics, strict=True):
        width = rig.camera(report.camera).undistorted_view().camera.width
        heard = read_support(bench.heard[topic][0], report.camera, width, topic)
        assert (heard.stamp_ns, heard.cell_px) == (stamp(0), report.cell_px)
        np.testing.assert_array_equal(heard.cells, report.cells)
