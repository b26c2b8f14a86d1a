"""PointCloud2: our layouts there and back, what other publishers send, and what is refused."""

from __future__ import annotations

import array
import struct

import numpy as np
import pytest
from numpy.lib.recfunctions import repack_fields
from sensor_msgs.msg import PointCloud2, PointField

from capture_rig.errors import InputError
from mocap_packets.fit import ReferencePoints
from mocap_packets.hull import Centerline, ContourRays, VoxelSamples
from sagoma_ros.clouds import from_cloud, to_cloud
from sagoma_ros.messages import to_ns
from sagoma_ros.packets import packet_cloud, read_packet, read_reference_points

STAMP = 1_700_000_000_123_456_789
TOPIC = "hull/voxels"
CENTERLINE, VOXELS = Centerline.LAYOUT, VoxelSamples.LAYOUT
KINDS = (Centerline, VoxelSamples, ContourRays, ReferencePoints)


def random_points(layout: np.dtype, count: int) -> np.ndarray:
    """Numbers that single precision holds."""
    table = np.random.default_rng(1).normal(size=(count, len(layout.names))).astype(np.float32).astype(np.float64)
    return table.view(layout).reshape(-1)


def foreign_cloud(
    rows: list[tuple], pattern: str, fields: list[tuple[str, int, int]], **changes: object
) -> PointCloud2:
    """A cloud as another program may pack it: ``pattern`` of struct, fields (name, offset, datatype)."""
    step = struct.calcsize(pattern)
    cloud = PointCloud2(height=1, width=len(rows), point_step=step, row_step=step * len(rows))
    cloud.is_bigendian = pattern.startswith(">")
    cloud.fields = [PointField(name=n, offset=o, datatype=d, count=1) for n, o, d in fields]
    cloud.data = array.array("B", b"".join(struct.pack(pattern, *row) for row in rows))
    for name, value in changes.items():
        setattr(cloud, name, value)
    return cloud


def good_cloud() -> PointCloud2:
    return to_cloud(random_points(VOXELS, 3), STAMP, "map")


def refusal(cloud: PointCloud2) -> str:
    with pytest.raises(InputError) as caught:
        from_cloud(cloud, VOXELS, TOPIC)
    assert str(caught.value).startswith(f"{TOPIC}: ")
    assert caught.value.remedy
    return str(caught.value)


@pytest.mark.parametrize("layout", [kind.LAYOUT for kind in KINDS])
@pytest.mark.parametrize("count", [0, 1, 1000])
def test_cloud_comes_back_as_it_was(layout: np.dtype, count: int) -> None:
    points = random_points(layout, count)
    cloud = to_cloud(points, STAMP, "map")
    assert (to_ns(cloud.header.stamp), cloud.header.frame_id) == (STAMP, "map")
    assert np.array_equal(from_cloud(cloud, layout, TOPIC), points)


def test_cloud_is_laid_out_as_its_fields_say() -> None:
    points = random_points(CENTERLINE, 5)
    cloud = to_cloud(points, STAMP, "map")
    area = next(field for field in cloud.fields if field.name == "area")
    (value,) = struct.unpack_from("<f", bytes(cloud.data), 3 * cloud.point_step + area.offset)
    assert value == points["area"][3]
    assert (cloud.width, cloud.height, cloud.row_step) == (5, 1, len(cloud.data))


def test_foreign_order_types_padding_and_extra_fields_are_read() -> None:
    fields = [
        ("surface", 0, PointField.UINT8),
        ("z", 4, PointField.FLOAT32),
        ("rgb", 8, PointField.UINT32),
        ("y", 12, PointField.INT16),
        ("x", 16, PointField.FLOAT64),
    ]
    cloud = foreign_cloud([(1, 0.5, 7, -3, 0.25), (0, 1.5, 7, 4, 1e3)], "<BxxxfIhxxd", fields)
    points = from_cloud(cloud, VOXELS, TOPIC)
    assert points.dtype == VOXELS
    assert points.tolist() == [(0.25, -3.0, 0.5, 1.0, 0.0), (1000.0, 4.0, 1.5, 0.0, 0.0)]


def test_big_endian_cloud_is_read() -> None:
    fields = [(name, 4 * index, PointField.FLOAT32) for index, name in enumerate(("x", "y", "z", "surface"))]
    points = from_cloud(foreign_cloud([(1.0, -2.0, 3.5, 1.0)], ">4f", fields), VOXELS, TOPIC)
    assert points.tolist() == [(1.0, -2.0, 3.5, 1.0, 0.0)]


def test_organised_cloud_with_padded_rows_is_read() -> None:
    points = random_points(VOXELS, 6)
    cloud = to_cloud(points, STAMP, "map")
    data = bytes(cloud.data)
    rows = [data[: len(data) // 2] + b"\xff" * 8, data[len(data) // 2 :] + b"\xff" * 8]
    cloud.height, cloud.width, cloud.row_step, cloud.data = 2, 3, len(rows[0]), array.array("B", b"".join(rows))
    assert np.array_equal(from_cloud(cloud, VOXELS, TOPIC), points)


def test_not_finite_number_in_a_field_that_is_not_ours_does_not_matter() -> None:
    fields = [(name, 4 * index, PointField.FLOAT32) for index, name in enumerate(("x", "y", "z", "surface", "normal"))]
    cloud = foreign_cloud([(1, 2, 3, 1, float("nan"))], "<5f", fields)
    assert from_cloud(cloud, VOXELS, TOPIC).tolist() == [(1, 2, 3, 1, 0)]


def test_missing_field_names_it_and_those_present() -> None:
    cloud = good_cloud()
    cloud.fields = [field for field in cloud.fields if field.name != "surface"]
    assert "no field 'surface' (it has: x, y, z, body)" in refusal(cloud)


def test_cloud_without_fields_is_refused() -> None:
    assert "no field 'x'" in refusal(PointCloud2())


@pytest.mark.parametrize("bad", [float("nan"), float("inf")])
def test_not_finite_point_is_refused(bad: float) -> None:
    points = random_points(VOXELS, 4)
    points["y"][2] = bad
    assert "not finite" in refusal(to_cloud(points, STAMP, "map"))


def test_data_of_another_size_than_stated_is_refused_with_both_sizes() -> None:
    cloud = good_cloud()
    cloud.data = cloud.data[:-1]
    text = refusal(cloud)
    assert "1 x 3 points of 20 bytes" in text and "59 bytes" in text


def test_rows_shorter_than_their_points_are_refused() -> None:
    cloud = good_cloud()
    cloud.height, cloud.width, cloud.row_step = 3, 2, 20
    assert "3 x 2 points" in refusal(cloud)


@pytest.mark.parametrize(("key", "value"), [("offset", 18), ("datatype", 0), ("datatype", 9)])
def test_field_that_cannot_lie_in_a_point_is_refused_by_name(key: str, value: int) -> None:
    cloud = good_cloud()
    setattr(cloud.fields[2], key, value)
    assert "field 'z'" in refusal(cloud)


@pytest.mark.parametrize("kind", KINDS)
def test_packet_comes_back_with_the_same_table_in_double_precision(kind) -> None:
    table = random_points(kind.LAYOUT, 15)
    for name in {"axis", "body", "camera", "surface", "visible", "doubtful", "moved"} & set(table.dtype.names):
        table[name] = np.arange(15) % 2
    packet = read_packet(packet_cloud(kind.from_table(table), STAMP, "map"), kind, TOPIC)
    assert packet.points_world.dtype == np.float64
    assert packet.points_world[1].tolist() == [table["x"][1], table["y"][1], table["z"][1]]
    assert np.array_equal(packet.to_table(), table)


def test_reference_points_keep_covariance_and_visibility() -> None:
    rng = np.random.default_rng(2)
    roots = rng.normal(size=(15, 3, 3)) * 0.02
    sent = ReferencePoints(rng.normal(size=(15, 3)), roots @ roots.transpose(0, 2, 1), rng.random(15) > 0.3)
    again = read_reference_points(packet_cloud(sent, STAMP, "map"), "icp/reference_points")
    assert again.points_world == pytest.approx(sent.points_world, abs=1e-6)  # float32 on the wire: a micrometre
    assert again.covariance == pytest.approx(sent.covariance, rel=1e-6)
    assert np.array_equal(again.covariance, again.covariance.transpose(0, 2, 1))
    assert np.array_equal(again.visible, sent.visible)


def test_reference_points_of_a_cloud_that_knows_no_doubt_are_not_doubtful() -> None:
    names = [name for name in ReferencePoints.LAYOUT.names or () if name != "doubtful"]
    table = random_points(ReferencePoints.LAYOUT, 15)
    table["doubtful"] = 1.0
    assert read_reference_points(to_cloud(table, STAMP, "map"), TOPIC).doubtful.all()
    assert not read_reference_points(to_cloud(repack_fields(table[names]), STAMP, "map"), TOPIC).doubtful.any()


def test_another_number_of_reference_points_is_refused() -> None:
    with pytest.raises(InputError, match="14 points"):
        read_reference_points(to_cloud(random_points(ReferencePoints.LAYOUT, 14), STAMP, "map"), TOPIC)


def test_cloud_without_bodies_is_of_one_body():
    points = random_points(CENTERLINE, 4)
    points["body"] = 2.0
    assert np.array_equal(from_cloud(to_cloud(points, STAMP, "map"), CENTERLINE, TOPIC)["body"], np.full(4, 2.0))
    names = [name for name in CENTERLINE.names if name != "body"]
    old = np.ascontiguousarray(np.stack([points[name] for name in names], axis=1)).view(
        np.dtype([(name, np.float64) for name in names])
    )
    read = from_cloud(to_cloud(old.reshape(-1), STAMP, "map"), CENTERLINE, TOPIC)
    assert (read["body"] == 0).all() and np.array_equal(read["sigma"], points["sigma"])
