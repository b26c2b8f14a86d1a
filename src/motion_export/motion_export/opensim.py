"""An OpenSim model of the person's size (.osim) and its motion (.mot): metres, y up, coordinates in degrees.

The model is our stick figure: its coordinates are the torso's six and the eighteen joint angles, its markers the
15 reference points, so that inverse dynamics, plots and the TRC of the same take go with it (Delp et al., IEEE TBME 54,
2007). Bone lengths are the medians of the take. The mass, if not given, is that of an average build.
"""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from xml.etree import ElementTree as xml

import numpy as np
from scipy.constants import g
from scipy.spatial.transform import Rotation

from capture_rig.files import write_bytes, write_text
from stick_figure.body import Body
from stick_figure.body_surface import SegmentInertia, segment_inertias
from stick_figure.skeleton import (
    ANGLE_HIGH,
    ANGLE_LOW,
    ANGLE_NAMES,
    BALL_ANGLES,
    BALL_EULER_AXES,
    HINGE_ANGLES,
    PARENT,
    POINT_NAMES,
    POINT_STICK,
    STICK_AXIS,
    STICK_NAMES,
    STICK_SIGN,
    T_POSE_ANGLES,
    TORSO,
    TORSO_POINTS,
)

from .motion import R_BIOMECHANICS_WORLD, Motion, fill_linearly, fill_rotations, rotated

ROOT = ("torso_tilt", "torso_list", "torso_rotation", "torso_tx", "torso_ty", "torso_tz")
ROOT_ORDER = "ZXY"
"""Of the torso's rotation, body-fixed, as OpenSim's own gait models turn the pelvis."""
UNIT_AXES = ((1, 0, 0), (0, 1, 0), (0, 0, 1))
AXES = ((1, 0, 0), (0, 0, -1), (0, 1, 0))
"""Our x, y, z in OpenSim's axes: x forward, y up, z right."""
Axis = tuple[int, int, int]
SETS = ("Body", "Joint", "Marker")
HINGE_AXES = np.array([[2], [2], [1], [1]])
"""(4, 1) of our axes about which elbows and knees turn."""


def write_osim(motion: Motion, path: Path, mass_kg: float | None = None) -> None:
    """Write the model; ``mass_kg`` : of the person, else that of a BMI of 22."""
    body = Body.from_points(motion.points_world[motion.tracked])
    document = xml.Element("OpenSimDocument", Version="40000")
    model = _add(document, "Model", motion.name, gravity=f"0 {-g} 0")
    bodies, joints, markers = (_add(_add(model, f"{of}Set", f"{of.lower()}set"), "objects") for of in SETS)
    for stick, inertia in enumerate(segment_inertias(body, mass_kg)):
        _add_body(bodies, stick, body, inertia)
    _add_root(joints)
    slots, axes = [*BALL_ANGLES, *HINGE_ANGLES[:, None]], [*BALL_EULER_AXES, *HINGE_AXES]
    for stick, (of_joint, turning) in enumerate(zip(slots, axes, strict=True), 1):
        _add_joint(joints, stick, of_joint[of_joint >= 0].tolist(), turning[turning >= 0].tolist(), body)
    for point, name in enumerate(POINT_NAMES):
        frame = f"/bodyset/{STICK_NAMES[POINT_STICK[point]]}"
        _add(markers, "Marker", name, socket_parent_frame=frame, location=_numbers(_marker_place(body, point)))
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
    along, R = _along(stick, body.lengths[stick]), R_BIOMECHANICS_WORLD
    start = -0.5 * along if stick == TORSO else np.zeros(3)
    moments = (R @ inertia.inertia @ R.T)[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]
    centre = _numbers(start + R @ inertia.centre)
    element = _add(
        bodies, "Body", STICK_NAMES[stick], mass=f"{inertia.mass:.6g}", mass_center=centre, inertia=_numbers(moments)
    )
    ends = {"start_point": _numbers(start), "end_point": _numbers(start + along)}
    _add(_add(element, "attached_geometry"), "LineGeometry", "bone", socket_frame="..", **ends)


def _add_root(joints: xml.Element) -> None:
    """Add the torso's joint to the ground: three rotations, three translations."""
    turns = zip(ROOT[:3], ((0, 0, 1), (1, 0, 0), (0, 1, 0)), strict=True)
    limits = [(name, 0.0, -limit, limit) for name, limit in zip(ROOT, [np.pi] * 3 + [10.0] * 3, strict=True)]
    _add_joint_between(joints, "torso", "/ground", limits, [*turns], ROOT[3:])


def _add_joint(joints: xml.Element, stick: int, slots: list[int], axes: list[int], body: Body) -> None:
    """Add a ball joint or hinge between a stick and its parent: its angles and their axes, in the order they turn."""
    name, parent = STICK_NAMES[stick], int(PARENT[stick])
    limits = [(ANGLE_NAMES[slot], T_POSE_ANGLES[slot], ANGLE_LOW[slot], ANGLE_HIGH[slot]) for slot in slots]
    turns = [(ANGLE_NAMES[slot], AXES[axis]) for slot, axis in zip(slots, axes, strict=True)]
    turns += [("", axis) for k, axis in enumerate(AXES) if k not in axes]
    on_torso = parent == TORSO
    origin = (
        R_BIOMECHANICS_WORLD @ body.stick_origins_torso[stick] if on_torso else _along(parent, body.lengths[parent])
    )
    frame = {"socket_parent": f"/bodyset/{STICK_NAMES[parent]}", "translation": _numbers(origin)}
    _add_joint_between(joints, name, f"{name}_origin", limits, turns, ("", "", ""), **frame)


def _add_joint_between(
    joints: xml.Element,
    name: str,
    parent: str,
    limits: Iterable[tuple[str, float, float, float]],
    turns: Iterable[tuple[str, Axis]],
    moves: Iterable[str],
    **frame: str,
) -> None:
    """Add a joint between two frames.

    limits : name, default, least and greatest value of each coordinate. turns : coordinate ("" for none) and axis of
    each rotation, in their order; moves : coordinate of each translation. frame : of the parent's, where it is no body.
    """
    sockets = {"socket_parent_frame": parent, "socket_child_frame": f"/bodyset/{name}"}
    joint = _add(joints, "CustomJoint", f"{name}_joint" if frame else name, **sockets)
    coordinates = _add(joint, "coordinates")
    for coordinate, value, low, high in limits:
        limit = {"default_value": f"{value:.9g}", "range": f"{low:.9g} {high:.9g}", "clamped": "false"}
        _add(coordinates, "Coordinate", coordinate, **limit)
    if frame:
        _add(_add(joint, "frames"), "PhysicalOffsetFrame", parent, **frame, orientation="0 0 0")
    transform = _add(joint, "SpatialTransform")
    for kind, axes in (("rotation", turns), ("translation", zip(moves, UNIT_AXES, strict=True))):
        for k, (coordinate, axis) in enumerate(axes, 1):
            along = {"coordinates": coordinate, "axis": " ".join(map(str, axis))}
            element = _add(transform, "TransformAxis", f"{kind}{k}", **along)
            if coordinate:
                _add(element, "LinearFunction", "function", coefficients="1 0")
            else:
                _add(element, "Constant", "function", value="0")


def _marker_place(body: Body, point: int) -> np.ndarray:
    """(3,) of a reference point in the OpenSim frame of its stick."""
    stick = int(POINT_STICK[point])
    if stick != TORSO:
        return _along(stick, body.lengths[stick])
    return R_BIOMECHANICS_WORLD @ body.torso_points[TORSO_POINTS.tolist().index(point)]


def _along(stick: int, length: float) -> np.ndarray:
    """(3,) vector along a stick from its joint, in OpenSim axes."""
    vector = np.zeros(3)
    vector[STICK_AXIS[stick]] = STICK_SIGN[stick] * length
    return R_BIOMECHANICS_WORLD @ vector


def _add(parent: xml.Element, tag: str, name: str = "", **texts: str) -> xml.Element:
    """Add an element with a name and elements of text in it; returns it."""
    element = xml.SubElement(parent, tag, {"name": name} if name else {})
    for key, text in texts.items():
        xml.SubElement(element, key).text = text
    return element


def _numbers(values: np.ndarray) -> str:
    return " ".join(f"{value:.9g}" for value in values)
