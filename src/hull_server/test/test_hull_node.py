"""The hull node among messages: what it publishes and answers."""

import time

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticStatus
from hull_probe import stamp
from hull_scenes import capsule_person, ring_rig, silhouettes
from node_probe import FAILURE, SUCCESS
from sensor_msgs.msg import Image
from std_msgs.msg import Float64MultiArray
from std_srvs.srv import Trigger

from capture_rig import load_rig, save_rig
from hull_server.hull_pipeline import HullPipeline
from hull_server.settings import HullSettings
from mocap_packets.frame_set import FrameSet
from mocap_packets.hull import PARTS, Centerline, ContourRays, VoxelSamples
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
    line = read_packet(cloud, Centerline, "test")
    assert to_ns(cloud.header.stamp) == stamp(0) + 300_000 and cloud.header.frame_id == "map"
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
    np.testing.assert_allclose(rays.time_s, found.time_s, atol=1e-9)
    assert {round(1e6 * time_s) for time_s in rays.time_s} == {-300, 0, 600}
    assert set(rays.body) == {0} and int(values["contour_rays"]) == len(rays)
    assert bench.heard["hull/frame_set"][0].header.stamp == cloud.header.stamp
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


def test_node_publishes_an_empty_hull_for_empty_silhouettes_and_flags_it(bench, scene):
    masks = {name: np.zeros_like(mask) for name, mask in scene[2].items()}
    bench.send(masks, 0)
    (values,) = bench.answers(1)
    assert values["blank"] == "cam01,cam02,cam03,cam04" and values["voxels"] == values["points"] == "0"
    assert bench.heard["hull/centerline"][0].width == bench.heard["hull/voxels"][0].width == 0
    assert bench.heard["hull/contour_rays"][0].width == 0
    assert "the hull is empty" in bench.heard["hull/frame_set"][0].status[0].message
    bench.until_values(sets_empty="1")


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
    bench = make_bench(**{"mesh.folder": str(tmp_path), "mesh.smoothing_voxels": 0.0}).start(rig)
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
