"""An OpenSim model of the person's size (.osim) and its motion (.mot): metres, y up, coordinates in degrees.

The model is our stick figure: its coordinates are the torso's six and the eighteen joint angles, its markers the
15 reference points, so that inverse dynamics, plots and the TRC of the same take go with it (Delp et al., IEEE TBME 54,
2007). Bone lengths are the medians of the take. The mass for want of a scale is that of an average build unless given.
"""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from xml.etree import ElementTree as xml

import numpy as np
from scipy.spatial.transform import Rotation

from capture_rig.files import write_bytes, write_text
from stick_figure.body import Body
from stick_figure.body_surface import SegmentInertia, segment_inertias
from stick_figure.skeleton import (
    ANGLE_HIGH,
    ANGLE_LOW,
    ANGLE_NAMES,
    PARENT,
    POINT_NAMES,
    POINT_STICK,
    STICK_AXIS,
    STICK_NAMES,
    STICK_SIGN,
    T_POSE_ANGLES,
    TORSO,
)

from .motion import R_BIOMECHANICS_WORLD, Motion, fill_linearly, fill_rotations, rotated

ROOT = ("torso_tilt", "torso_list", "torso_rotation", "torso_tx", "torso_ty", "torso_tz")
ROOT_ORDER = "ZXY"
"""Of the torso's rotation, body-fixed, as OpenSim's own gait models turn the pelvis."""
UNIT_AXES = ((1, 0, 0), (0, 1, 0), (0, 0, 1))
AXIS_OF = {"x": (1, 0, 0), "y": (0, 0, -1), "z": (0, 1, 0)}
"""Our axes in OpenSim's: x forward, y up, z right."""


_JOINTS: tuple[tuple[int, tuple[str, ...], str], ...] = (
    (1, ("neck_x", "neck_y"), "xy"),
    (2, ("left_shoulder_x", "left_shoulder_z", "left_shoulder_y"), "xzy"),
    (3, ("right_shoulder_x", "right_shoulder_z", "right_shoulder_y"), "xzy"),
    (4, ("left_hip_x", "left_hip_y", "left_hip_z"), "xyz"),
    (5, ("right_hip_x", "right_hip_y", "right_hip_z"), "xyz"),
    (6, ("left_elbow",), "z"),
    (7, ("right_elbow",), "z"),
    (8, ("left_knee",), "y"),
    (9, ("right_knee",), "y"),
)
"""Of each joint: the stick that it moves, its angles in the order in which they turn, the axis (ours) of each."""


def write_osim(motion: Motion, path: Path, mass_kg: float | None = None) -> None:
    """Write the model; ``mass_kg`` : of the person, else that of a BMI of 22."""
    body = Body.from_points(motion.points_world[motion.tracked])
    document = xml.Element("OpenSimDocument", Version="40000")
    model = xml.SubElement(document, "Model", name=motion.name)
    _text(model, "gravity", "0 -9.80665 0")
    bodies = xml.SubElement(xml.SubElement(model, "BodySet", name="bodyset"), "objects")
    for stick, inertia in enumerate(segment_inertias(body, mass_kg)):
        _add_body(bodies, stick, body, inertia)
    joints = xml.SubElement(xml.SubElement(model, "JointSet", name="jointset"), "objects")
    _add_root(joints)
    for joint in _JOINTS:
        _add_joint(joints, *joint, body)
    markers = xml.SubElement(xml.SubElement(model, "MarkerSet", name="markerset"), "objects")
    for point, name in enumerate(POINT_NAMES):
        marker = xml.SubElement(markers, "Marker", name=name)
        _text(marker, "socket_parent_frame", f"/bodyset/{STICK_NAMES[POINT_STICK[point]]}")
        _text(marker, "location", _numbers(_marker_place(body, point)))
    xml.indent(document)
    write_bytes(path, xml.tostring(document, "UTF-8", xml_declaration=True))


def write_mot(motion: Motion, path: Path) -> None:
    """Write the coordinates of :func:`write_osim`'s model over time; gaps are filled, since programs need every row."""
    tracked = motion.tracked
    R = rotated(fill_rotations(motion.R_world_torso, tracked), R_BIOMECHANICS_WORLD)
    turned = np.unwrap(Rotation.from_matrix(R).as_euler(ROOT_ORDER, degrees=True), period=360.0, axis=0)
    moved = fill_linearly(motion.torso_position_world, tracked) @ R_BIOMECHANICS_WORLD.T
    angles = motion.angles.copy()
    angles[tracked] = np.unwrap(angles[tracked], axis=0)
    rows = np.column_stack([motion.times_s, turned, moved, np.rad2deg(fill_linearly(angles, tracked))])
    names = ("time", *ROOT, *ANGLE_NAMES)
    head = [motion.name, "version=1", f"nRows={len(rows)}", f"nColumns={len(names)}", "inDegrees=yes", "endheader"]
    lines = ("\t".join(f"{value:.7f}" for value in row) for row in rows)
    write_text(path, "\n".join([*head, "\t".join(names), *lines]) + "\n")


def _add_body(bodies: xml.Element, stick: int, body: Body, inertia: SegmentInertia) -> None:
    """Add a stick as a rigid body whose origin is its joint; the torso's is its centre."""
    length, R = body.lengths[stick], R_BIOMECHANICS_WORLD
    start = -0.5 * _along(stick, length) if stick == TORSO else np.zeros(3)
    element = xml.SubElement(bodies, "Body", name=STICK_NAMES[stick])
    _text(element, "mass", f"{inertia.mass:.6g}")
    _text(element, "mass_center", _numbers(start + R @ inertia.centre))
    moments = R @ inertia.inertia @ R.T
    _text(element, "inertia", _numbers(moments[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]))
    geometry = xml.SubElement(element, "attached_geometry")
    line = xml.SubElement(geometry, "LineGeometry", name="bone")
    _text(line, "socket_frame", "..")
    _text(line, "start_point", _numbers(start))
    _text(line, "end_point", _numbers(start + _along(stick, length)))


def _add_root(joints: xml.Element) -> None:
    """Add the torso's joint to the ground: three rotations, three translations."""
    joint = xml.SubElement(joints, "CustomJoint", name="torso")
    _text(joint, "socket_parent_frame", "/ground")
    _text(joint, "socket_child_frame", "/bodyset/torso")
    coordinates = xml.SubElement(joint, "coordinates")
    for name in ROOT:
        limit = np.pi if name in ROOT[:3] else 10.0
        _add_coordinate(coordinates, name, 0.0, -limit, limit)
    transform = xml.SubElement(joint, "SpatialTransform")
    for k, (name, axis) in enumerate(zip(ROOT[:3], ((0, 0, 1), (1, 0, 0), (0, 1, 0)), strict=True), 1):
        _add_axis(transform, f"rotation{k}", name, axis)
    for k, (name, axis) in enumerate(zip(ROOT[3:], UNIT_AXES, strict=True), 1):
        _add_axis(transform, f"translation{k}", name, axis)


def _add_joint(joints: xml.Element, stick: int, angles: tuple[str, ...], axes: str, body: Body) -> None:
    """Add a ball joint or hinge between a stick and its parent."""
    name, parent = STICK_NAMES[stick], int(PARENT[stick])
    joint = xml.SubElement(joints, "CustomJoint", name=f"{name}_joint")
    _text(joint, "socket_parent_frame", f"{name}_origin")
    _text(joint, "socket_child_frame", f"/bodyset/{name}")
    coordinates = xml.SubElement(joint, "coordinates")
    for angle in angles:
        slot = ANGLE_NAMES.index(angle)
        _add_coordinate(coordinates, angle, T_POSE_ANGLES[slot], ANGLE_LOW[slot], ANGLE_HIGH[slot])
    frame = xml.SubElement(xml.SubElement(joint, "frames"), "PhysicalOffsetFrame", name=f"{name}_origin")
    _text(frame, "socket_parent", f"/bodyset/{STICK_NAMES[parent]}")
    origin = (
        R_BIOMECHANICS_WORLD @ body.stick_origins_torso[stick]
        if parent == TORSO
        else _along(parent, body.lengths[parent])
    )
    _text(frame, "translation", _numbers(origin))
    _text(frame, "orientation", "0 0 0")
    transform = xml.SubElement(joint, "SpatialTransform")
    used = [AXIS_OF[axis] for axis in axes]
    spare = [axis for axis in AXIS_OF.values() if axis not in used]
    for k, axis in enumerate([*used, *spare], 1):
        _add_axis(transform, f"rotation{k}", angles[k - 1] if k <= len(used) else "", axis)
    for k, axis in enumerate(UNIT_AXES, 1):
        _add_axis(transform, f"translation{k}", "", axis)


def _add_coordinate(coordinates: xml.Element, name: str, value: float, low: float, high: float) -> None:
    coordinate = xml.SubElement(coordinates, "Coordinate", name=name)
    _text(coordinate, "default_value", f"{value:.9g}")
    _text(coordinate, "range", f"{low:.9g} {high:.9g}")
    _text(coordinate, "clamped", "false")


def _add_axis(transform: xml.Element, name: str, coordinate: str, axis: Iterable[int]) -> None:
    """Add one axis of a joint's transform, driven by a coordinate or fixed at 0."""
    element = xml.SubElement(transform, "TransformAxis", name=name)
    _text(element, "coordinates", coordinate)
    _text(element, "axis", " ".join(map(str, axis)))
    if coordinate:
        function = xml.SubElement(element, "LinearFunction", name="function")
        _text(function, "coefficients", "1 0")
    else:
        function = xml.SubElement(element, "Constant", name="function")
        _text(function, "value", "0")


def _marker_place(body: Body, point: int) -> np.ndarray:
    """(3,) of a reference point in the OpenSim frame of its stick."""
    stick = int(POINT_STICK[point])
    if stick != TORSO:
        return _along(stick, body.lengths[stick])
    torso_points = {0: 0, 2: 1, 3: 2, 4: 3, 5: 4, 6: 5}
    return R_BIOMECHANICS_WORLD @ body.torso_points[torso_points[point]]


def _along(stick: int, length: float) -> np.ndarray:
    """(3,) vector along a stick from its joint, in OpenSim axes."""
    vector = np.zeros(3)
    vector[STICK_AXIS[stick]] = STICK_SIGN[stick] * length
    return R_BIOMECHANICS_WORLD @ vector


def _text(parent: xml.Element, tag: str, text: str) -> None:
    xml.SubElement(parent, tag).text = text


def _numbers(values: np.ndarray) -> str:
    return " ".join(f"{value:.9g}" for value in values)
