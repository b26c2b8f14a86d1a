"""Tables of float64 fields as PointCloud2 in single precision, and back."""

from __future__ import annotations

import array

import numpy as np
from sensor_msgs.msg import PointCloud2, PointField

from capture_rig.errors import InputError

from .messages import to_stamp

DEFAULTS = {"body": 0.0, "person": 1.0, "doubtful": 0.0, "moved": 0.0}
"""What a cloud without one of these fields means: all is one body, one person's, nothing is doubtful or elsewhere."""

_NUMPY_TYPES = {
    PointField.INT8: "i1",
    PointField.UINT8: "u1",
    PointField.INT16: "i2",
    PointField.UINT16: "u2",
    PointField.INT32: "i4",
    PointField.UINT32: "u4",
    PointField.FLOAT32: "f4",
    PointField.FLOAT64: "f8",
}


def to_cloud(points: np.ndarray, stamp_ns: int, frame_id: str, rows: int = 1) -> PointCloud2:
    """Table (n,) to an unordered cloud of float32 fields, or to one of so many rows."""
    names = points.dtype.names or ()
    numbers = np.ascontiguousarray(points).view(np.float64).astype(np.float32)
    cloud = PointCloud2(height=rows, width=len(points) // rows, is_bigendian=False, is_dense=True)
    cloud.header.stamp = to_stamp(stamp_ns)
    cloud.header.frame_id = frame_id
    cloud.fields = [
        PointField(name=name, offset=4 * index, datatype=PointField.FLOAT32, count=1)
        for index, name in enumerate(names)
    ]
    cloud.point_step = 4 * len(names)
    cloud.row_step = cloud.point_step * cloud.width
    cloud.data = array.array("B", numbers.tobytes())
    return cloud


def from_cloud(cloud: PointCloud2, layout: np.dtype, where: str) -> np.ndarray:
    """Return the fields of ``layout`` of a cloud as a structured array (n,), whatever order and types they came in.

    A cloud without the field ``body`` is of one body, number 0; without ``person``, of the first person; without
    ``doubtful``, nothing in it is.

    Raises InputError when a field is missing, the size does not fit, or a number is not finite.
    """
    fields = {field.name: field for field in cloud.fields}
    wanted = [name for name in layout.names or () if name in fields or name not in DEFAULTS]
    missing = [name for name in wanted if name not in fields]
    if missing:
        what = f"the cloud has no field '{missing[0]}' (it has: {', '.join(fields)})"
        raise InputError(what, where=where, remedy=f"Publish the fields {', '.join(layout.names or ())}.")
    wire = np.frombuffer(_rows(cloud, where), _wire_layout(cloud, [fields[name] for name in wanted], where))
    points = np.empty(len(wire), layout)
    for name in layout.names or ():
        points[name] = wire[name] if name in fields else DEFAULTS[name]
    if not np.isfinite(points.view(np.float64)).all():
        remedy = "Drop such points before publishing."
        raise InputError("the cloud holds numbers that are not finite", where=where, remedy=remedy)
    return points


def vectors_of_cloud(cloud: PointCloud2, size: int, where: str) -> tuple[list[str], np.ndarray]:
    """Return the names of a cloud's fields, of ``size`` numbers each, and those of every point (n, fields, size).

    Raises InputError when a field has another size, or none is there.
    """
    names = [field.name for field in cloud.fields]
    if not names or len(set(names)) < len(names) or any(field.count != size for field in cloud.fields):
        what, remedy = f"the cloud has not fields of {size} numbers each", "Give each field its name and count."
        raise InputError(what, where=where, remedy=remedy)
    wire = np.frombuffer(_rows(cloud, where), _wire_layout(cloud, list(cloud.fields), where, size))
    return names, np.stack([wire[name].reshape(-1, size).astype(np.float64) for name in names], axis=1)


def _wire_layout(cloud: PointCloud2, fields: list[PointField], where: str, size: int = 1) -> np.dtype:
    """Return the dtype of the given fields, of ``size`` numbers each, as they lie in the message."""
    order = ">" if cloud.is_bigendian else "<"
    formats = [order + _NUMPY_TYPES.get(field.datatype, "") for field in fields]
    for field, format in zip(fields, formats, strict=True):
        if format == order or field.offset + size * np.dtype(format).itemsize > cloud.point_step:
            raise InputError(
                f"field '{field.name}' (datatype {field.datatype}, offset {field.offset}) does not fit points of "
                f"{cloud.point_step} bytes",
                where=where,
                remedy="The message is damaged; check its publisher.",
            )
    return np.dtype(
        {
            "names": [field.name for field in fields],
            "formats": [(format, (size,)) if size > 1 else format for format in formats],
            "offsets": [field.offset for field in fields],
            "itemsize": cloud.point_step,
        }
    )


def _rows(cloud: PointCloud2, where: str) -> np.ndarray:
    """Return the points' bytes, without the padding that an organised cloud may have at the end of each row."""
    used = cloud.width * cloud.point_step
    row = cloud.row_step if cloud.height > 1 else used
    if row < used or len(cloud.data) != cloud.height * row:
        raise InputError(
            f"the cloud says {cloud.height} x {cloud.width} points of {cloud.point_step} bytes "
            f"but carries {len(cloud.data)} bytes",
            where=where,
            remedy="The message is damaged; check its publisher.",
        )
    return np.ascontiguousarray(np.frombuffer(cloud.data, np.uint8).reshape(cloud.height, row)[:, :used])
