"""The hull node among messages: what it publishes, and late, missing, broken and too many silhouettes."""

import threading
import time

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from hull_probe import PERIOD_NS, stamp
from node_probe import FAILURE, PATIENCE_S, SUCCESS, values_of
from sensor_msgs.msg import Image
from std_msgs.msg import Float64MultiArray
from std_srvs.srv import Trigger

from hull_server.hull_pipeline import HullPipeline
from hull_server.hull_ros import frame_set_message
from hull_server.overload import ThinningControl
from hull_server.settings import HullSettings
from mocap_packets.frame_set import FrameSet
from mocap_packets.hull import PARTS, Centerline
from mocap_packets.thinning import EVERY_FRAME, FrameDecimation
from sagoma_ros.images import absence_message, camera_info_message, read_support, silhouette_message
from sagoma_ros.messages import read_thinning, to_ns
from sagoma_ros.packets import HULL_PRODUCTS, read_packet
from sagoma_ros.qos import LATCHED


def test_node_publishes_what_the_pipeline_finds_with_the_sets_stamp(make_bench, scene):
    """As clouds, as one packet with its ages, and to every camera what the others see."""
    _, rig, masks = scene
    bench, topics = make_bench(), [f"{name}/silhouette/support" for name in rig.names]
    packets = bench.listen(Float64MultiArray, HULL_PRODUCTS.name)
    for topic in topics:
        bench.listen(Image, topic)
    bench.start(rig).send(masks, 0, cam02=300_000, cam04=900_000)
    (values,) = bench.answers(1)
    bench.until(lambda: packets and all(bench.heard[topic] for topic in topics))
    later_ns = {"cam01": 0, "cam02": 300_000, "cam03": 0, "cam04": 900_000}
    frame_set = FrameSet.of_stamps({name: stamp(0) + later_ns[name] for name in masks}, masks)
    expected = HullPipeline(rig, HullSettings(voxel_size_m=0.04, backend="cpu")).run(frame_set)
    cloud = bench.heard["hull/centerline"][0]
    assert to_ns(cloud.header.stamp) == stamp(0) + 300_000 and cloud.header.frame_id == "map"
    for name, kind in PARTS.items():
        message, found = bench.heard[f"hull/{name}"][0], getattr(expected.products, name)
        assert message.header == cloud.header and len(found) > 60
        for field, heard in vars(read_packet(message, kind, "test")).items():
            np.testing.assert_allclose(heard, getattr(found, field), rtol=1e-6, atol=1e-6, err_msg=f"{name}.{field}")
    rays = expected.products.contour_rays
    assert {round(1e6 * time_s) for time_s in rays.time_s} == {-300, 0, 600}
    assert bench.heard["hull/frame_set"][0].header.stamp == cloud.header.stamp
    told = values_of(frame_set_message(expected, "cpu", {}))
    assert {each for each in values.items() if "_ms" not in each[0]} == {e for e in told.items() if "_ms" not in e[0]}
    assert told["cameras"] == "cam01,cam02,cam03,cam04" and told["bodies"] == "1" and told["left_out"] == ""
    assert float(values["spread_ms"]) == pytest.approx(0.9) and {"carve_ms", "hull_ms", "queued_ms"} <= values.keys()
    assert HULL_PRODUCTS.header_of(packets[0]) == (frame_set.stamp_ns, "map")
    products = HULL_PRODUCTS.from_message(packets[0], "test")
    for name in PARTS:
        part, found = getattr(products, name), getattr(expected.products, name)
        np.testing.assert_array_equal(part.points_world, found.points_world)
    assert 0 < products.ages.received < products.ages.hull <= time.time_ns() - stamp(0)
    for report, topic in zip(expected.support, topics, strict=True):
        width = rig.camera(report.camera).undistorted_view().camera.width
        heard = read_support(bench.heard[topic][0], report.camera, width, topic)
        assert (heard.stamp_ns, heard.cell_px) == (frame_set.stamp_ns, report.cell_px)
        np.testing.assert_array_equal(heard.cells, report.cells)


def test_node_publishes_an_empty_hull_for_empty_silhouettes_and_flags_it(bench, scene):
    masks = {name: np.zeros_like(mask) for name, mask in scene[2].items()}
    bench.send(masks, 0)
    (values,) = bench.answers(1)
    assert values["blank"] == "cam01,cam02,cam03,cam04" and values["voxels"] == values["points"] == "0"
    assert bench.heard["hull/centerline"][0].width == bench.heard["hull/voxels"][0].width == 0
    assert bench.heard["hull/contour_rays"][0].width == 0
    assert "the hull is empty" in bench.heard["hull/frame_set"][0].status[0].message
    bench.until_values(sets_empty="1")


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
    ],
    ids=["no rig file", "no such file", "out of range"],
)
def test_node_refuses_to_configure_with_a_clear_error(make_bench, parameters, text):
    bench = make_bench(**parameters)
    assert bench.node.trigger_configure() == FAILURE
    bench.until_said(text)
    assert bench.diagnostics[-1].status[0].level == DiagnosticStatus.ERROR


def test_save_mesh_writes_the_newest_hull(make_bench, scene, tmp_path):
    _, rig, masks = scene
    bench = make_bench(**{"mesh.folder": str(tmp_path)}).start(rig)
    bench.send(masks, 0)
    bench.send(masks, 1)
    values = bench.answers(2)[1]
    answer = bench.ask(Trigger, "hull_server/save_mesh")
    assert answer.success
    trimesh = pytest.importorskip("trimesh", reason="trimesh is not installed (requirements-dev.txt)")
    vertices = trimesh.load_mesh(str(tmp_path / f"hull_{stamp(1)}.ply")).vertices.T
    assert f"{tmp_path}/hull_{stamp(1)}.ply" in answer.message
    line = read_packet(bench.heard["hull/centerline"][1], Centerline, "test").points_world
    for axis in range(3):  # the centerline runs inside the mesh
        assert vertices[axis].min() < line[:, axis].min() and line[:, axis].max() < vertices[axis].max()
    said_litres = float(answer.message.split(",")[-1].removesuffix("litres"))
    assert said_litres == pytest.approx(float(values["litres"]), rel=0.2)  # the surface is smoothed


@pytest.mark.parametrize(("sets", "why"), [(0, "no frame set"), (1, "the hull is empty")])
def test_save_mesh_without_a_hull_says_why(make_bench, scene, tmp_path, sets, why):
    _, rig, masks = scene
    bench = make_bench(**{"mesh.folder": str(tmp_path)}).start(rig)
    for k in range(sets):
        bench.send({name: np.zeros_like(mask) for name, mask in masks.items()}, k)
        bench.answers(k + 1)
    answer = bench.ask(Trigger, "hull_server/save_mesh")
    assert not answer.success and why in answer.message and not list(tmp_path.iterdir())


def test_node_answers_an_incomplete_set_at_its_deadline_and_mixes_what_is_late_into_no_other(make_bench, scene):
    _, rig, masks = scene
    bench = make_bench().start(rig)
    bench.send({name: masks[name] for name in ("cam01", "cam02", "cam04")}, 0)
    bench.let_the_deadline_pass(frames=3)
    (values,) = bench.answers(1)
    assert values["missing"] == "cam03" and values["cameras"] == "cam01,cam02,cam04" and values["min_seeing"] == "3"
    assert int(values["voxels"]) > 0
    assert "nothing in time from cam03" in bench.heard["hull/frame_set"][0].status[0].message
    bench.until_values(sets_incomplete="1", frames_missing="1")
    bench.send({"cam03": masks["cam03"]}, 0)
    bench.until_values(frames_late="1")
    bench.send(masks, 1)
    assert [values["missing"] for values in bench.answers(2)] == ["cam03", ""]


def test_node_waits_for_no_frame_that_a_replay_says_there_is_not(bench, scene):
    _, rig, masks = scene
    three = {name: masks[name] for name in rig.names[:3]}
    for k in range(2):
        bench.send(three, k)
        bench.images[rig.names[3]].publish(absence_message(stamp(k)))
    bench.send(masks, 2)  # back at once, for it has not been waited for in vain
    assert [answer["missing"] for answer in bench.answers(3)] == [rig.names[3], rig.names[3], ""]


def test_node_drops_and_counts_a_bad_image_and_goes_on(bench, scene):
    masks = scene[2]
    bad = silhouette_message(masks["cam01"], stamp(0), "cam01")
    bad.data = bad.data[:60]
    bench.images["cam01"].publish(bad)
    status = bench.until_values(bad_images="1")
    said = {pair.key: pair.value for pair in status.values}["last_bad_image"]
    assert said.startswith("cam01/silhouette/compressed") and "cannot be decoded" in said
    bench.send(masks, 1)
    assert [values["missing"] for values in bench.answers(1)] == [""]


@pytest.mark.parametrize(
    ("spoil", "text"),
    [
        (lambda info: setattr(info, "width", info.width + 32), " px, fx"),
        (lambda info: info.k.__setitem__(0, 0.0), "fx 0.000"),
        (lambda info: setattr(info, "d", [0.1, 0.0, 0.0, 0.0, 0.0]), "distortion [0.1"),
    ],
    ids=["size", "uncalibrated", "distortion"],
)
def test_node_refuses_a_camera_whose_camera_info_disagrees_until_it_agrees_again(make_bench, scene, spoil, text):
    _, rig, masks = scene
    bench = make_bench().start(rig)
    canvas = rig.camera("cam02").undistorted_view().camera
    info = camera_info_message(canvas, stamp(0), "cam02")
    spoil(info)
    bench.infos["cam02"].publish(info)
    bench.until(lambda: "cam02" in bench.node.silhouettes.refused)
    bench.send(masks, 0)
    bench.let_the_deadline_pass(frames=3)
    assert [values["missing"] for values in bench.answers(1)] == ["cam02"]
    status = bench.until_values(frames_refused="1")
    said = {pair.key: pair.value for pair in status.values}["refused_cam02"]
    assert said.startswith("cam02/camera_info") and text in said and "same rig file" in said
    assert status.level == b"\x02"
    bench.infos["cam02"].publish(camera_info_message(canvas, stamp(1), "cam02"))
    bench.until(lambda: not bench.node.silhouettes.refused)
    bench.send(masks, 1)
    assert bench.answers(2)[1]["missing"] == ""


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


def test_node_tells_the_cameras_its_rule_and_leaves_out_what_it_does_not_keep(make_bench, scene, monkeypatch):
    _, rig, masks = scene
    half = FrameDecimation(stamp(2), stamp(2), stamp(0), PERIOD_NS, 1, 2)
    rules = iter([EVERY_FRAME, half])

    def update(control, now_ns):
        rule = next(rules, None)
        if rule is not None:
            control._selector.update(rule, now_ns)
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
