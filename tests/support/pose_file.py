"""Writes a pose file, as a user would."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from capture_rig.rigid import rotation_vector
from capture_rig.yaml_file import save_mapping
from stick_figure.body import Body, save_body
from stick_figure.pose import Pose
from stick_figure.skeleton import ANGLE_NAMES


def save_initial_pose(pose: Pose, path: str | Path, body: Body | None = None) -> None:
    """Write a pose so that `load_initial_pose` reads it back; a body goes into a file of its own beside it."""
    path = Path(path)
    document: dict[str, Any] = {
        "torso_position": [float(v) for v in pose.position_world],
        "torso_rotation": rotation_vector(pose.R_world_torso).tolist(),
        "angles": {name: float(v) for name, v in zip(ANGLE_NAMES, pose.angles(), strict=True)},
    }
    if body is not None:
        body_path = path.with_name(path.stem + "_body.yaml")
        save_body(body, body_path)
        document["body"] = body_path.name
    save_mapping(path, document)
