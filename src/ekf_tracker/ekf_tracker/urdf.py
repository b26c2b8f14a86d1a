"""The stick figure as a URDF: its joints are those of mocap/joint_states, so robot_state_publisher and rviz show it.

Every ball joint is a chain of revolute ones, in the order in which `stick_figure.skeleton` applies its angles; the
links between them have no extent and no mass. The root link is the torso's frame, and the origin of one link each lies
in every reference point. REP-155 has a URDF of its own (`rep155`), with other axes and another zero pose.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple
from xml.etree import ElementTree

import numpy as np

from stick_figure.body import Body
from stick_figure.body_surface import BodySurface, SegmentInertia, segment_inertias
from stick_figure.pose import HINGE_AXIS
from stick_figure.rotations import BALL_SLACK_RAD, HINGE_SLACK_RAD, TURN
from stick_figure.skeleton import (
    ANGLE_HIGH,
    ANGLE_LOW,
    ANGLE_NAMES,
    BALL_ANGLES,
    BALL_EULER_AXES,
    BALL_NAMES,
    HINGE_ANGLES,
    HINGE_NAMES,
    PARENT,
    STICK_AXIS,
    STICK_NAMES,
    STICK_SIGN,
    TORSO,
)

SKIN_RGBA = "0.55 0.68 0.80 1"
FASTEST_RAD_S = 150.0
"""No joint of a person turns faster; a throw turns a shoulder by 130 (Fleisig et al. 1995)."""
SAME_BODY_M = 2e-4
"""Sizes that differ by less leave the frames of the longest chain, four sizes, within a millimetre."""
TIPS = {1: "head_top", 6: "left_hand", 7: "right_hand", 8: "left_foot", 9: "right_foot"}
"""Stick that ends a limb -> the link at its end."""
Vector = tuple[float, float, float]
Range = tuple[float, float]
_AXES: tuple[Vector, ...] = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))


@dataclass(frozen=True)
class LinkJoint:
    """A joint and the link that it carries, at ``origin`` (m) of its parent's, turning about ``axis``; None: fixed."""

    name: str
    parent: str
    child: str
    origin: Vector = (0.0, 0.0, 0.0)
    axis: Vector | None = None


def link_joints(body: Body) -> Iterator[LinkJoint]:
    """Yield all joints, parents before children; names of links are without the body's id."""
    for ball, name in enumerate(BALL_NAMES):
        place, parent = _vector(body.stick_origins_torso[ball + 1]), name
        yield LinkJoint(f"{name}_place", STICK_NAMES[TORSO], name, place)
        used = [(slot, axis) for slot, axis in zip(BALL_ANGLES[ball], BALL_EULER_AXES[ball], strict=True) if slot >= 0]
        for slot, axis in used:
            child = STICK_NAMES[ball + 1] if slot == used[-1][0] else f"{ANGLE_NAMES[slot]}_axis"
            yield LinkJoint(ANGLE_NAMES[slot], parent, child, axis=_AXES[axis])
            parent = child
    for hinge, name in enumerate(HINGE_NAMES):
        stick = 6 + hinge
        upper = int(PARENT[stick])
        yield LinkJoint(f"{name}_place", STICK_NAMES[upper], name, _end(body, upper))
        yield LinkJoint(ANGLE_NAMES[HINGE_ANGLES[hinge]], name, STICK_NAMES[stick], axis=_AXES[HINGE_AXIS[hinge]])
    for stick, tip in TIPS.items():
        yield LinkJoint(f"{tip}_place", STICK_NAMES[stick], tip, _end(body, stick))


def link_name(body_id: str, part: str) -> str:
    """Return the name of a link, which is that of its frame on /tf: ``b0001_left_forearm``."""
    return f"{body_id}_{part}"


def body_urdf(body: Body, body_id: str, mass_kg: float | None = None) -> str:
    """Return the URDF; the joints are named as in mocap/joint_states, links begin with ``body_id``.

    ``mass_kg`` : of the person, else that of an average build.
    """
    joints, parts = list(link_joints(body)), segments(body, mass_kg)
    return robot_urdf(f"sagoma_{body_id}", joints, parts, JOINT_RANGES.get, prefix=f"{body_id}_")


def _joint_ranges() -> dict[str, Range | None]:
    """Return the range of each joint, rad, with its tolerance; None of a joint with a whole turn, whose angle is
    continuous beyond it."""
    slack = np.full(len(ANGLE_NAMES), BALL_SLACK_RAD)
    slack[HINGE_ANGLES] = HINGE_SLACK_RAD
    low, high = (ANGLE_LOW - slack).tolist(), (ANGLE_HIGH + slack).tolist()
    whole = (ANGLE_HIGH - ANGLE_LOW >= TURN).tolist()
    return {n: None if turns else (a, b) for n, turns, a, b in zip(ANGLE_NAMES, whole, low, high, strict=True)}


JOINT_RANGES = _joint_ranges()


def robot_urdf(
    name: str,
    joints: Sequence[LinkJoint],
    parts: Mapping[str, Segment],
    range_of: Callable[[str], Range | None],
    prefix: str = "",
    suffix: str = "",
) -> str:
    """Return a robot of these joints, the first one's parent the root; ``parts`` : segments by link.

    ``range_of`` a joint's name : rad, None if unlimited. The names of links stand between prefix and suffix, those of
    joints have the suffix alone. A person's joints have no drive, so their effort is 0.
    """
    robot = ElementTree.Element("robot", name=name)
    material = ElementTree.SubElement(robot, "material", name="skin")
    ElementTree.SubElement(material, "color", rgba=SKIN_RGBA)
    for part in (joints[0].parent, *(joint.child for joint in joints)):
        _add_link(robot, f"{prefix}{part}{suffix}", parts.get(part))
    for joint in joints:
        limits = None if joint.axis is None else range_of(joint.name)
        kind = "fixed" if joint.axis is None else "continuous" if limits is None else "revolute"
        element = ElementTree.SubElement(robot, "joint", name=f"{joint.name}{suffix}", type=kind)
        ElementTree.SubElement(element, "parent", link=f"{prefix}{joint.parent}{suffix}")
        ElementTree.SubElement(element, "child", link=f"{prefix}{joint.child}{suffix}")
        ElementTree.SubElement(element, "origin", xyz=_text(joint.origin), rpy="0 0 0")
        if joint.axis is not None:
            ElementTree.SubElement(element, "axis", xyz=_text(joint.axis))
        if limits is not None:
            low, high = (f"{limit:.6g}" for limit in limits)
            ElementTree.SubElement(element, "limit", lower=low, upper=high, effort="0", velocity=f"{FASTEST_RAD_S:g}")
    ElementTree.indent(robot)
    return ElementTree.tostring(robot, encoding="unicode") + "\n"


def _add_link(robot: ElementTree.Element, name: str, segment: Segment | None) -> None:
    """Add a link with visual, collision and inertia; without a segment it has no extent."""
    link = ElementTree.SubElement(robot, "link", name=name)
    if segment is None:
        return
    for use in ("visual", "collision"):
        for shape, sizes, place, rpy in segment.shapes():
            element = ElementTree.SubElement(link, use)
            ElementTree.SubElement(element, "origin", xyz=_text(place), rpy=_text(rpy))
            ElementTree.SubElement(ElementTree.SubElement(element, "geometry"), shape, sizes)
            if use == "visual":
                ElementTree.SubElement(element, "material", name="skin")
    (mass, centre, inertia), axes = segment.inertia, "xyz"
    inertial = ElementTree.SubElement(link, "inertial")
    ElementTree.SubElement(inertial, "origin", xyz=_text(_vector(centre)), rpy="0 0 0")
    ElementTree.SubElement(inertial, "mass", value=f"{mass:.9g}")
    moments = {f"i{axes[i]}{axes[k]}": f"{inertia[i, k]:.9g}" for i in range(3) for k in range(i, 3)}
    ElementTree.SubElement(inertial, "inertia", moments)


def same_sizes(body: Body, other: Body | None) -> bool:
    """Return whether two bodies have the same URDF, as far as anybody sees."""
    if other is None:
        return False
    origins = np.abs(body.stick_origins_torso - other.stick_origins_torso).max()
    return max(float(origins), float(np.abs(body.lengths - other.lengths).max())) < SAME_BODY_M


Shape = tuple[str, dict[str, str], Vector, Vector]


class Segment(NamedTuple):
    """What a link is made of, in its frame: capsules (k, 2, 3) m from end to end, their radii (k, 2) m, inertia."""

    capsules: np.ndarray
    radii: np.ndarray
    inertia: SegmentInertia

    def moved(self, R: np.ndarray, t: np.ndarray) -> Segment:
        """Return the same in another frame, in which this one is turned by R (3, 3) and lies at t (3,)."""
        mass, centre, about = self.inertia
        inertia = SegmentInertia(mass, R @ centre + t, R @ about @ R.T)
        return Segment(self.capsules @ R.T + t, self.radii, inertia)

    def shapes(self) -> Iterator[Shape]:
        """Yield a cylinder and two balls for each capsule, which URDF has not."""
        for (first, last), (r0, r1) in zip(self.capsules, self.radii.tolist(), strict=True):
            x, y, z = (last - first).tolist()
            length, level = math.sqrt(x * x + y * y + z * z), math.hypot(x, y)
            sizes = {"radius": f"{0.5 * (r0 + r1):.4f}", "length": f"{length:.4f}"}
            yield "cylinder", sizes, _vector(0.5 * (first + last)), (0.0, math.atan2(level, z), math.atan2(y, x))
            for place, radius in ((first, r0), (last, r1)):
                yield "sphere", {"radius": f"{radius:.4f}"}, _vector(place), (0.0, 0.0, 0.0)


def segments(body: Body, mass_kg: float | None = None) -> dict[str, Segment]:
    """Return the segment of each stick by name, in its frame, whose origin is the stick's start, of the torso its
    middle."""
    surface, found = BodySurface.of(body), dict[str, Segment]()
    for stick, inertia in enumerate(segment_inertias(body, mass_kg)):
        own = surface.stick == stick
        capsules = np.stack([surface.start[own], surface.end[own]], axis=1)
        shift = body.stick_origins_torso[TORSO] if stick == TORSO else np.zeros(3)
        found[STICK_NAMES[stick]] = Segment(capsules, surface.radii[own], inertia).moved(np.eye(3), shift)
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
