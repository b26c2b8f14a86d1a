"""The URDF of a tracked person for REP-155: names as in ROS4HRI's `human_description`, measured sizes."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from xml.etree import ElementTree

from stick_figure.body import Body

Vector = tuple[float, float, float]


@dataclass(frozen=True)
class UrdfJoint:
    """One joint: its child link hangs at ``origin`` (m, parent's frame), unturned in the zero pose; no axis: fixed."""

    name: str
    parent: str
    child: str
    origin: Vector = (0.0, 0.0, 0.0)
    axis: Vector | None = None


def human_urdf(body: Body, body_id: str) -> str:
    """The person's URDF; every link and joint name ends in ``_<body_id>``, the root link is ``body_<body_id>``."""
    robot = ElementTree.Element("robot", name=f"human_{body_id}")
    ElementTree.SubElement(robot, "link", name=f"body_{body_id}")
    for joint in human_joints(body):
        ElementTree.SubElement(robot, "link", name=f"{joint.child}_{body_id}")
        kind = "fixed" if joint.axis is None else "continuous"
        element = ElementTree.SubElement(robot, "joint", name=f"{joint.name}_{body_id}", type=kind)
        ElementTree.SubElement(element, "parent", link=f"{joint.parent}_{body_id}")
        ElementTree.SubElement(element, "child", link=f"{joint.child}_{body_id}")
        ElementTree.SubElement(element, "origin", xyz=_text(joint.origin), rpy="0 0 0")
        if joint.axis is not None:
            ElementTree.SubElement(element, "axis", xyz=_text(joint.axis))
    ElementTree.indent(robot)
    return ElementTree.tostring(robot, encoding="unicode")


def human_joints(body: Body) -> Iterator[UrdfJoint]:
    """All joints, parents before children; sizes from the stick figure (the wrist stands for its hand tip)."""
    h, w = body.half_lengths[0], body.half_shoulder_width
    yield UrdfJoint("waist", "body", "waist", axis=(0, 1, 0))
    yield UrdfJoint("torso", "waist", "torso", (0.0, 0.0, 2 * h))
    yield UrdfJoint("r_head", "torso", "r_head", axis=(1, 0, 0))
    yield UrdfJoint("y_head", "r_head", "y_head", axis=(0, 0, 1))
    yield UrdfJoint("p_head", "y_head", "p_head", axis=(0, -1, 0))
    yield UrdfJoint("head", "p_head", "head", (0.0, 0.0, body.lengths[1]))
    for side, (s, name) in enumerate(((1, "l"), (-1, "r"))):
        upper_arm, forearm, thigh, calf = body.lengths[[2 + side, 6 + side, 4 + side, 8 + side]]
        shoulder = (0.0, s * w, (body.shoulder_height_ratio - 1.0) * h)
        yield UrdfJoint(f"{name}_y_shoulder", "torso", f"{name}_y_shoulder", shoulder, (0, 0, -s))
        yield UrdfJoint(f"{name}_p_shoulder", f"{name}_y_shoulder", f"{name}_p_shoulder", axis=(s, 0, 0))
        yield UrdfJoint(f"{name}_r_shoulder", f"{name}_p_shoulder", f"{name}_shoulder", axis=(0, 0, s))
        yield UrdfJoint(f"{name}_elbow", f"{name}_shoulder", f"{name}_elbow", (0.0, 0.0, -upper_arm), (0, -1, 0))
        yield UrdfJoint(f"{name}_wrist", f"{name}_elbow", f"{name}_wrist", (0.0, 0.0, -forearm))
        hip = (0.0, s * body.hip_width_ratio * w, 0.0)
        yield UrdfJoint(f"{name}_y_hip", "body", f"{name}_y_hip", hip, (0, 0, -1))
        yield UrdfJoint(f"{name}_p_hip", f"{name}_y_hip", f"{name}_p_hip", axis=(s, 0, 0))
        yield UrdfJoint(f"{name}_r_hip", f"{name}_p_hip", f"{name}_hip", axis=(0, -1, 0))
        yield UrdfJoint(f"{name}_knee", f"{name}_hip", f"{name}_knee", (0.0, 0.0, -thigh), (0, -1, 0))
        yield UrdfJoint(f"{name}_ankle", f"{name}_knee", f"{name}_ankle", (0.0, 0.0, -calf))


def _text(vector: Vector) -> str:
    return " ".join(f"{value:.9g}" for value in vector)
