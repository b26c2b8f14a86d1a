"""Points of a cloud that are numbers."""

from __future__ import annotations

import array
from collections.abc import Collection

import numpy as np
from sensor_msgs.msg import PointCloud2, PointField


def only_finite(cloud: PointCloud2, names: Collection[str]) -> tuple[PointCloud2, int]:
    """The cloud without the points that have a NaN or infinity in one of the float32 fields ``names``.

    Returns the cloud itself when all is well (or when its layout is not plain enough to judge: the reader that follows
    says what is wrong with it), and the number of points dropped.
    """
    plain = cloud.point_step > 0 and len(cloud.data) % cloud.point_step == 0
    if not plain:
        return cloud, 0
    rows = np.frombuffer(cloud.data, np.uint8).reshape(-1, cloud.point_step)
    finite = np.ones(len(rows), dtype=bool)
    for field in cloud.fields:
        if field.name in names and field.datatype == PointField.FLOAT32:
            column = np.ascontiguousarray(rows[:, field.offset : field.offset + 4])
            finite &= np.isfinite(column.view(">f4" if cloud.is_bigendian else "<f4")[:, 0])
    if finite.all():
        return cloud, 0
    kept = PointCloud2(
        header=cloud.header,
        height=1,
        width=int(finite.sum()),
        fields=cloud.fields,
        is_bigendian=cloud.is_bigendian,
        point_step=cloud.point_step,
        row_step=cloud.point_step * int(finite.sum()),
        is_dense=True,
    )
    kept.data = array.array("B", rows[finite].tobytes())
    return kept, int((~finite).sum())
