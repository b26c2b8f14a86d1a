"""The hull node among messages: what it publishes and answers."""

import time

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticStatus
from hull_probe import stamp
from node_probe import FAILURE, SUCCESS
from sensor_msgs.msg import Image
from std_msgs.msg import Float64MultiArray
from std_srvs.srv import Trigger

from hull_server.hull_pipeline import HullPipeline
from hull_server.settings import HullSettings
from mocap_packets.frame_set import FrameSet
from mocap_packets.hull import PARTS, Centerline
from sagoma_ros.images import read_support
from sagoma_ros.messages import to_ns
from sagoma_ros.packets import HULL_PRODUCTS, read_packet


def test_node_publishes_what_the_pipeline_finds_with_the_sets_stamp(bench, scene):
    _, rig, masks = scene
    bench.send(masks, 0, cam02=300_000, cam04=900_000)
    (values,) = bench.answers(1)
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
    assert set(rays.body) == {0} and int(values["contour_rays"]) == len(rays)
    assert bench.heard["hull/frame_set"][0].header.stamp == cloud.header.stamp
    assert values["cameras"] == "cam01,cam02,cam03,cam04" and values["missing"] == values["blank"] == ""
    assert float(values["spread_ms"]) == pytest.approx(0.9) and values["backend"] == "cpu"
    assert int(values["voxels"]) == expected.volume.count and 40 < float(values["litres"]) < 200
    stages = ("carve", "slice", "filter", "sample", "contour_rays", "hull", "queued")
    assert {f"{stage}_ms" for stage in stages} <= values.keys()
    assert values["bodies"] == "1" and values["bodies_numbers"] == "0"
    assert values["left_out"] == "" and "cam02=" in values["veto_fraction"]
    assert 0.9 < float(values["consistency_cam02"]) <= 1.0
    (place,) = expected.bodies.centroid_world
    assert [float(v) for v in values["bodies_at"].split(",")] == pytest.approx(place, abs=0.01)


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


def test_node_hands_on_one_packet_a_set_with_all_that_the_clouds_hold_and_its_ages(make_bench, scene):
    _, rig, masks = scene
    bench = make_bench()
    heard = bench.listen(Float64MultiArray, HULL_PRODUCTS.name)
    bench.start(rig).send(masks, 0)
    bench.answers(1)
    bench.until(lambda: heard)
    assert HULL_PRODUCTS.header_of(heard[0]) == (stamp(0), "map")
    products = HULL_PRODUCTS.from_message(heard[0], "test")
    for name, kind in PARTS.items():
        part, cloud = getattr(products, name), read_packet(bench.heard[f"hull/{name}"][0], kind, "test")
        np.testing.assert_array_equal(part.points_world.astype(np.float32), cloud.points_world)
    assert 0 < products.ages.received < products.ages.hull <= time.time_ns() - stamp(0)


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
