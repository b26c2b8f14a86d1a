"""One node of the graph as plain data: enough to start it by hand, from a launch file or from the supervisor."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import Enum
from typing import Any


class Role(Enum):
    """Which machine a node belongs to: one camera PC a camera, one server."""

    CAMERA = "camera"
    SERVER = "server"


@dataclass(frozen=True)
class NodeSpec:
    """A node: the package and executable that ``ros2 run`` takes, its module, its name, and its parameters.

    namespace : "/" or "/NAME".
    parameters : dotted keys; values are bool, int, float, str or lists of one of them.
    """

    package: str
    executable: str
    module: str
    name: str
    namespace: str
    role: Role
    parameters: Mapping[str, Any] = field(default_factory=dict)

    @property
    def full_name(self) -> str:
        """The fully qualified node name, ``/cam01/camera_client``."""
        return f"{self.namespace.rstrip('/')}/{self.name}"

    @property
    def label(self) -> str:
        """A short name for files and tables: the camera's name, or the node's."""
        return self.namespace.strip("/").replace("/", "_") or self.name

    def with_parameters(self, parameters: Mapping[str, Any]) -> NodeSpec:
        """The same node with some parameters set or replaced."""
        return NodeSpec(
            self.package,
            self.executable,
            self.module,
            self.name,
            self.namespace,
            self.role,
            {**self.parameters, **parameters},
        )

    def parameter_document(self) -> dict[str, Any]:
        """Its parameters as the document of a ROS parameter file."""
        return {self.full_name: {"ros__parameters": dict(self.parameters)}}
