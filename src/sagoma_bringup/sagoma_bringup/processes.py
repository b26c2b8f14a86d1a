"""Which nodes of the graph share a process. It does not import ROS."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from .graph import SERVER_NODES, NodeSpec, Role

ONE_PROCESS, THREE_PROCESSES = "one_process", "three_processes"
SERVER_LAYOUTS = (ONE_PROCESS, THREE_PROCESSES)
SERVER_PACKAGE, SERVER_EXECUTABLE, SERVER_MODULE = "mocap_pipeline", "mocap_server", "mocap_pipeline.server_node"


@dataclass(frozen=True)
class ProcessSpec:
    """A process: the package and executable that ``ros2 run`` takes, its module, and its nodes.

    label : a short name for files and tables.
    """

    package: str
    executable: str
    module: str
    label: str
    nodes: tuple[NodeSpec, ...]

    def __str__(self) -> str:
        return ", ".join(node.full_name for node in self.nodes)

    @property
    def name_arguments(self) -> list[str]:
        """ROS arguments that give the nodes their namespace, and a node alone its name; several have theirs already."""
        name = ["-r", f"__node:={self.nodes[0].name}"] if len(self.nodes) == 1 else []
        return [*name, "-r", f"__ns:={self.nodes[0].namespace}"]

    def parameter_document(self) -> dict[str, Any]:
        """Return its nodes' parameters as the document of a ROS parameter file."""
        return {name: entry for node in self.nodes for name, entry in node.parameter_document().items()}


def processes_of(graph: Sequence[NodeSpec], server: str = ONE_PROCESS) -> list[ProcessSpec]:
    """Return the processes that run a graph, in its order; with ``server`` ONE_PROCESS its whole server is one."""
    shared = [node for node in graph if node.role is Role.SERVER and node.name in SERVER_NODES]
    if server != ONE_PROCESS or len(shared) < len(SERVER_NODES):
        shared = []
    together = [ProcessSpec(SERVER_PACKAGE, SERVER_EXECUTABLE, SERVER_MODULE, SERVER_EXECUTABLE, tuple(shared))]
    alone = [ProcessSpec(n.package, n.executable, n.module, n.label, (n,)) for n in graph if n not in shared]
    return (together if shared else []) + alone
