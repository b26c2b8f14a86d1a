"""The stick figure as a URDF: its joints are those of mocap/joint_states, so robot_state_publisher and rviz show it.

Every ball joint is a chain of revolute ones, in the order in which `stick_figure.skeleton` applies its angles; the
links between them have no extent. The root link is the torso's frame, and the origin of one link each lies in every
reference point. REP-155 has a URDF of its own (`rep155`), with other axes and another zero pose.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from xml.etree import ElementTree

import numpy as np

from stick_figure.body import Body
from stick_figure.body_surface import BodySurface
from stick_figure.joint_motion import HINGE_AXIS
from stick_figure.skeleton import (
    ANGLE_NAMES,
    BALL_ANGLES,
    BALL_EULER_AXES,
    BALL_NAMES,
    HINGE_ANGLES,
    HINGE_NAMES,
    PARENT,
    POINT_NAMES,
    STICK_AXIS,
    STICK_NAMES,
    STICK_SIGN,
    TORSO,
)

SKIN_RGBA = "0.55 0.68 0.80 1"
SAME_BODY_M = 2e-4
"""Sizes that differ by less leave the frames of the longest chain, four sizes, within a millimetre."""
TIPS = {1: "head_top", 6: "left_hand", 7: "right_hand", 8: "left_foot", 9: "right_foot"}
"""Stick that ends a limb -> the link at its end."""
Vector = tuple[float, float, float]


@dataclass(frozen=True)
class LinkJoint:
    """A joint and the link that it carries, at ``origin`` (m) of its parent's; ``axis``: 0 x, 1 y, 2 z, None fixed."""

    name: str
    parent: str
    child: str
    origin: Vector
    axis: int | None = None


def link_joints(body: Body) -> Iterator[LinkJoint]:
    """Yield all joints, parents before children; names of links are without the body's id."""
    for ball, name in enumerate(BALL_NAMES):
        place, parent = _vector(body.stick_origins_torso[ball + 1]), name
        yield LinkJoint(f"{name}_place", STICK_NAMES[TORSO], name, place)
        used = [(slot, axis) for slot, axis in zip(BALL_ANGLES[ball], BALL_EULER_AXES[ball], strict=True) if slot >= 0]
        for slot, axis in used:
            child = STICK_NAMES[ball + 1] if slot == used[-1][0] else f"{ANGLE_NAMES[slot]}_axis"
            yield LinkJoint(ANGLE_NAMES[slot], parent, child, (0.0, 0.0, 0.0), int(axis))
            parent = child
    for hinge, name in enumerate(HINGE_NAMES):
        stick = 6 + hinge
        upper = int(PARENT[stick])
        yield LinkJoint(f"{name}_place", STICK_NAMES[upper], name, _end(body, upper))
        yield LinkJoint(
            ANGLE_NAMES[HINGE_ANGLES[hinge]], name, STICK_NAMES[stick], (0.0, 0.0, 0.0), int(HINGE_AXIS[hinge])
        )
    for stick, tip in TIPS.items():
        yield LinkJoint(f"{tip}_place", STICK_NAMES[stick], tip, _end(body, stick))


def link_name(body_id: str, part: str) -> str:
    """Return the name of a link, which is that of its frame on /tf: ``b0001_left_forearm``."""
    return f"{body_id}_{part}"


def link_of_point(point: int) -> str:
    """Return the link, without the body's id, whose origin is a reference point of `skeleton.POINT_NAMES`."""
    return {"head": "head_top"}.get(POINT_NAMES[point], POINT_NAMES[point])


def body_urdf(body: Body, body_id: str) -> str:
    """Return the URDF; the joints are named as in mocap/joint_states, links begin with ``body_id``."""
    robot = ElementTree.Element("robot", name=f"sagoma_{body_id}")
    material = ElementTree.SubElement(robot, "material", name="skin")
    ElementTree.SubElement(material, "color", rgba=SKIN_RGBA)
    visuals = _visuals(body)
    joints = list(link_joints(body))
    for part in (STICK_NAMES[TORSO], *(joint.child for joint in joints)):
        link = ElementTree.SubElement(robot, "link", name=link_name(body_id, part))
        for shape, sizes, place, rpy in visuals.get(part, ()):
            visual = ElementTree.SubElement(link, "visual")
            ElementTree.SubElement(visual, "origin", xyz=_text(place), rpy=_text(rpy))
            ElementTree.SubElement(ElementTree.SubElement(visual, "geometry"), shape, sizes)
            ElementTree.SubElement(visual, "material", name="skin")
    for joint in joints:
        axis = None if joint.axis is None else _vector(np.eye(3)[joint.axis])
        links = link_name(body_id, joint.parent), link_name(body_id, joint.child)
        add_joint(robot, joint.name, links, joint.origin, axis)
    ElementTree.indent(robot)
    return ElementTree.tostring(robot, encoding="unicode") + "\n"


def add_joint(
    robot: ElementTree.Element, name: str, links: tuple[str, str], origin: Vector, axis: Vector | None
) -> None:
    """Add a joint from the first of the ``links`` to the second, at ``origin`` (m) of the first; no axis: fixed."""
    element = ElementTree.SubElement(robot, "joint", name=name, type="fixed" if axis is None else "continuous")
    ElementTree.SubElement(element, "parent", link=links[0])
    ElementTree.SubElement(element, "child", link=links[1])
    ElementTree.SubElement(element, "origin", xyz=_text(origin), rpy="0 0 0")
    if axis is not None:
        ElementTree.SubElement(element, "axis", xyz=_text(axis))


def same_sizes(body: Body, other: Body | None) -> bool:
    """Return whether two bodies have the same URDF, as far as anybody sees."""
    if other is None:
        return False
    origins = np.abs(body.stick_origins_torso - other.stick_origins_torso).max()
    return max(float(origins), float(np.abs(body.lengths - other.lengths).max())) < SAME_BODY_M


Shape = tuple[str, dict[str, str], Vector, Vector]


def _visuals(body: Body) -> dict[str, list[Shape]]:
    """Return the shapes of each stick's link: a cylinder and two balls for a capsule of the body's surface."""
    surface, found = BodySurface.of(body), dict[str, list[Shape]]()
    for stick, start, end, radii in zip(surface.stick, surface.start, surface.end, surface.radii, strict=True):
        # the torso's link lies in its middle, those of the other sticks where they begin
        shift = body.stick_origins_torso[TORSO] if stick == TORSO else np.zeros(3)
        first, last, (r0, r1) = start + shift, end + shift, radii.tolist()
        x, y, z = (last - first).tolist()
        length, level = math.sqrt(x * x + y * y + z * z), math.hypot(x, y)
        turned = (0.0, math.atan2(level, z), math.atan2(y, x))
        shapes = found.setdefault(STICK_NAMES[stick], [])
        sizes = {"radius": f"{0.5 * (r0 + r1):.4f}", "length": f"{length:.4f}"}
        shapes.append(("cylinder", sizes, _vector(0.5 * (first + last)), turned))
        for place, radius in ((first, r0), (last, r1)):
            shapes.append(("sphere", {"radius": f"{radius:.4f}"}, _vector(place), (0.0, 0.0, 0.0)))
    return found


def _end(body: Body, stick: int) -> Vector:
    """Return the end of a stick in its own frame, which begins with it, m."""
    place = np.zeros(3)
    place[STICK_AXIS[stick]] = STICK_SIGN[stick] * body.lengths[stick]
    return _vector(place)


def _vector(xyz: np.ndarray) -> Vector:
    x, y, z = xyz.tolist()
    return x, y, z


def _text(vector: Vector) -> str:
    return " ".join(f"{value:.9g}" for value in vector)
