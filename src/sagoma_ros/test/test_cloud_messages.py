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


def random_points(layout: np.dtype, count: int, **columns: float) -> np.ndarray:
    """Numbers that single precision holds; single columns as given."""
    table = np.random.default_rng(1).normal(size=(count, len(layout.names))).astype(np.float32).astype(np.float64)
    points = table.view(layout).reshape(-1)
    for name, value in columns.items():
        points[name] = value
    return points


def foreign_cloud(rows: list[tuple], pattern: str, fields: list[tuple[str, int, int]]) -> PointCloud2:
    """A cloud as another program may pack it: ``pattern`` of struct, fields (name, offset, datatype)."""
    step = struct.calcsize(pattern)
    cloud = PointCloud2(height=1, width=len(rows), point_step=step, row_step=step * len(rows))
    cloud.is_bigendian = pattern.startswith(">")
    cloud.fields = [PointField(name=n, offset=o, datatype=d, count=1) for n, o, d in fields]
    cloud.data = array.array("B", b"".join(struct.pack(pattern, *row) for row in rows))
    return cloud


def floats(*names: str) -> list[tuple[str, int, int]]:
    return [(name, 4 * index, PointField.FLOAT32) for index, name in enumerate(names)]


@pytest.mark.parametrize("count", [0, 1000])
def test_cloud_comes_back_with_stamp_frame_and_points(count: int) -> None:
    points = random_points(CENTERLINE, count)
    cloud = to_cloud(points, STAMP, "map")
    assert (to_ns(cloud.header.stamp), cloud.header.frame_id) == (STAMP, "map")
    assert np.array_equal(from_cloud(cloud, CENTERLINE, TOPIC), points)


def test_cloud_is_laid_out_as_its_fields_say() -> None:
    points = random_points(CENTERLINE, 5)
    cloud = to_cloud(points, STAMP, "map")
    area = next(field for field in cloud.fields if field.name == "area")
    (value,) = struct.unpack_from("<f", bytes(cloud.data), 3 * cloud.point_step + area.offset)
    assert value == points["area"][3]
    assert (cloud.width, cloud.height, cloud.row_step) == (5, 1, len(cloud.data))


MIXED = [
    ("surface", 0, PointField.UINT8),
    ("z", 4, PointField.FLOAT32),
    ("rgb", 8, PointField.UINT32),
    ("y", 12, PointField.INT16),
    ("x", 16, PointField.FLOAT64),
]


@pytest.mark.parametrize(
    ("cloud", "expected"),
    [
        pytest.param(
            foreign_cloud([(1, 0.5, 7, -3, 0.25), (0, 1.5, 7, 4, 1e3)], "<BxxxfIhxxd", MIXED),
            [(0.25, -3.0, 0.5, 1.0, 0.0), (1000.0, 4.0, 1.5, 0.0, 0.0)],
            id="other order, types, padding, extra field",
        ),
        pytest.param(
            foreign_cloud([(1.0, -2.0, 3.5, 1.0)], ">4f", floats("x", "y", "z", "surface")),
            [(1.0, -2.0, 3.5, 1.0, 0.0)],
            id="big endian",
        ),
        pytest.param(
            foreign_cloud([(1, 2, 3, 1, np.nan)], "<5f", floats("x", "y", "z", "surface", "normal")),
            [(1, 2, 3, 1, 0)],
            id="NaN in a field that is not ours",
        ),
    ],
)
def test_cloud_of_another_program_is_read(cloud: PointCloud2, expected: list[tuple]) -> None:
    points = from_cloud(cloud, VOXELS, TOPIC)
    assert points.dtype == VOXELS and points.tolist() == expected


def test_organised_cloud_with_padded_rows_is_read() -> None:
    points = random_points(VOXELS, 6)
    cloud = to_cloud(points, STAMP, "map")
    data = bytes(cloud.data)
    rows = [data[: len(data) // 2] + b"\xff" * 8, data[len(data) // 2 :] + b"\xff" * 8]
    cloud.height, cloud.width, cloud.row_step, cloud.data = 2, 3, len(rows[0]), array.array("B", b"".join(rows))
    assert np.array_equal(from_cloud(cloud, VOXELS, TOPIC), points)


def spoilt(fields: str = "xyzsb", z: dict[str, int] | None = None, **changes: object) -> PointCloud2:
    """A cloud of three voxels with some of its fields, by first letter; a changed field z; changed members."""
    cloud = to_cloud(random_points(VOXELS, 3), STAMP, "map")
    cloud.fields = [field for field in cloud.fields if field.name[0] in fields]
    for holder, values in ((cloud.fields[2], z or {}), (cloud, changes)):
        for name, value in values.items():
            setattr(holder, name, value)
    return cloud


@pytest.mark.parametrize(
    ("cloud", "said"),
    [
        (PointCloud2(), "no field 'x'"),
        (spoilt(fields="xyzb"), "no field 'surface' (it has: x, y, z, body)"),
        (spoilt(data=spoilt().data[:-1]), "1 x 3 points of 20 bytes but carries 59 bytes"),
        (spoilt(height=3, width=2, row_step=20), "3 x 2 points"),
        (spoilt(z={"offset": 18}), "field 'z'"),
        (spoilt(z={"datatype": 9}), "field 'z' (datatype 9"),
        (to_cloud(random_points(VOXELS, 4, y=np.inf), STAMP, "map"), "not finite"),
    ],
)
def test_cloud_that_cannot_be_read_is_refused_with_topic_cause_and_remedy(cloud: PointCloud2, said: str) -> None:
    with pytest.raises(InputError) as caught:
        from_cloud(cloud, VOXELS, TOPIC)
    assert str(caught.value).startswith(f"{TOPIC}: ") and caught.value.remedy
    assert said in str(caught.value)


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


def test_another_number_of_reference_points_is_refused() -> None:
    with pytest.raises(InputError, match="14 points"):
        read_reference_points(to_cloud(random_points(ReferencePoints.LAYOUT, 14), STAMP, "map"), TOPIC)


@pytest.mark.parametrize(("layout", "name"), [(CENTERLINE, "body"), (ReferencePoints.LAYOUT, "doubtful")])
def test_cloud_of_a_former_version_is_of_one_body_and_nothing_in_it_is_doubtful(layout: np.dtype, name: str) -> None:
    points = random_points(layout, 15, **{name: 1.0})
    former = repack_fields(points[[each for each in layout.names if each != name]])
    assert (from_cloud(to_cloud(points, STAMP, "map"), layout, TOPIC)[name] == 1.0).all()
    read = from_cloud(to_cloud(former, STAMP, "map"), layout, TOPIC)
    assert (read[name] == 0.0).all() and np.array_equal(read["z"], points["z"])
