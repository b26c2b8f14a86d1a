"""The node graph as data: which nodes run, under which names, with which parameters. It does not import ROS.

Launch files turn it into launch_ros actions, the supervisor of sagoma_tools into processes. Nodes start unconfigured;
the program that starts them drives their lifecycle (or sets ``autostart``).
"""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from enum import Enum
from pathlib import Path
from typing import Any

from capture_rig.errors import InputError
from capture_rig.rig import load_rig
from capture_rig.session import Session, load_session
from capture_rig.settings import flatten
from capture_rig.yaml_file import read_mapping


class Role(Enum):
    """Which machine a node belongs to: one camera PC a camera, one server."""

    CAMERA = "camera"
    SERVER = "server"


@dataclass(frozen=True)
class NodeSpec:
    """A node: the module that runs it (it determines the package and, with the node's name, the executable of ``ros2
    run``), its name, and its parameters.

    namespace : "/" of the server, "/NAME" of a camera, below the graph's own where it has one.
    parameters : dotted keys; values are bool, int, float, str or lists of one of them.
    """

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
        """A short name for files, tables and settings: the camera's name, or the node's."""
        return self.namespace.rpartition("/")[2] if self.role is Role.CAMERA else self.name

    def with_parameters(self, parameters: Mapping[str, Any]) -> NodeSpec:
        """Return the same node with some parameters set or replaced."""
        return replace(self, parameters={**self.parameters, **parameters})

    def parameter_document(self) -> dict[str, Any]:
        """Return its parameters as the document of a ROS parameter file."""
        return {self.full_name: {"ros__parameters": dict(self.parameters)}}


CAMERA_NODE = "camera_client"
SERVER_NODES = ("hull_server", "icp_tracker", "ekf_tracker")
FOOTAGE_DEADLINE_S = 0.5  # all cameras' frames will come; on a machine that decodes them all, some come late
# Nothing is dropped, and nodes wait for each other's messages: for footage played as fast as the graph keeps up, for
# cameras in slow motion, and for lockstep replay. Results then depend on the input alone.
LOSSLESS_SETTINGS: Mapping[str, Any] = {
    "hull_server.reliable": True,
    "hull_server.deadline_s": 3.0,  # reached only by sets of a camera that lost a frame
    "hull_server.queue_depth": 1000,
    "icp_tracker.prediction_wait_s": 20.0,
    "icp_tracker.queue_depth": 1000,
    "icp_tracker.stale_after_s": 0.0,  # between two sets may lie any time
    "ekf_tracker.stale_after_s": 0.0,
}
ALL_CAMERAS, SERVER = "cameras", "server"


def build_graph(
    *,
    session: str | Path | None = None,
    rig: str | Path | None = None,
    cameras: str | Path | None = None,
    only: str | None = None,
    rate: float = 1.0,
    loop: bool = False,
    body: str | Path | None = None,
    settings: Mapping[str, Any] | None = None,
) -> list[NodeSpec]:
    """Return the nodes to run, the server's first, then the cameras in name order.

    session : a folder of footage: one camera node a video, and the server.
    rig, cameras : a rig YAML, and a folder with one parameter file a camera of the rig (or one such file); without
        ``cameras`` the server alone, without ``rig`` the cameras alone.
    only : "server", "cameras" or a camera's name: this part of the graph.
    rate, loop : how footage is played (parameters ``footage.*`` of the camera client).
    body : a body YAML for the ICP tracker, whose fits bring it to the filter.
    settings : more parameters, as NODE.PARAMETER (``hull_server.voxel_size_m``), CAMERA.PARAMETER or cameras.PARAMETER.

    Raises InputError for whatever does not fit: no such file, camera count, unknown camera or node.
    """
    if session is not None:
        if rig is not None or cameras is not None:
            remedy = "Give a session, or a rig with cameras."
            raise InputError("a session brings its own rig and cameras", where="rig, cameras", remedy=remedy)
        graph = session_graph(load_session(session), rate=rate, loop=loop, body=body)
    elif rig is not None:
        graph = server_graph(rig, body=body)
        if cameras is not None:
            clients = rig_cameras(rig, cameras)
            # stamps of slow motion fall behind time, as if there were a queue; and nothing need be dropped
            in_real_time = all(client.parameters.get("aravis.clock_speed", 1) == 1 for client in clients)
            graph = apply_settings(graph, {} if in_real_time else LOSSLESS_SETTINGS) + clients
    elif cameras is not None:
        graph = [node.with_parameters({"autostart": False}) for node in cameras_from_files(cameras)]
    else:
        raise InputError("neither a session nor a rig nor cameras are given", remedy="Name a session folder or a rig.")
    return apply_settings(select(graph, only), settings or {})


def session_graph(
    session: Session, *, rate: float = 1.0, loop: bool = False, body: str | Path | None = None
) -> list[NodeSpec]:
    """Return the whole graph on recorded footage."""
    rig_file = (session.folder / "rig.yaml").resolve()
    without_background = [name for name in session.rig.names if name not in session.backgrounds]
    if without_background:
        what = f"there is no background for {', '.join(without_background)}"
        remedy = f"Add {without_background[0]}_background.mp4 or .png: the empty scene."
        raise InputError(what, where=str(session.folder), remedy=remedy)
    common = {
        "rig_file": str(rig_file),
        "source": "footage",
        "footage.fps": session.fps,
        "footage.rate": float(rate),
        "footage.epoch_ns": 0 if rate else time.time_ns(),  # by no clock, the cameras' stamps begin alike
        "footage.loop": loop,
        "footage.wait_for_cameras": rate > 0,
    }
    files = {name: (session.backgrounds[name].resolve(), session.videos[name].resolve()) for name in session.rig.names}
    cameras = [
        camera_node(name, {**common, "background": str(background), "footage.path": str(video)})
        for name, (background, video) in files.items()
    ]
    graph = server_graph(rig_file, body=body) + cameras
    waits: dict[str, Any] = {"hull_server.deadline_s": FOOTAGE_DEADLINE_S}
    if rate != 1.0:
        waits["hull_server.thin_out"] = False  # stamps slower or faster than time would pass for a queue
    if rate == 0:
        waits = dict(LOSSLESS_SETTINGS)
    return apply_settings(graph, {"hull_server.tolerance_s": 0.5 / session.fps, **waits})


def server_graph(rig: str | Path, *, body: str | Path | None = None) -> list[NodeSpec]:
    """Hull server, ICP tracker and EKF tracker for one rig."""
    rig_file = Path(rig).resolve()
    load_rig(rig_file)
    if body is not None and not Path(body).is_file():
        raise InputError("there is no such file", where=str(body), remedy="Give a body YAML, or none: it is measured.")
    known = {"body_file": str(Path(body).resolve())} if body is not None else {}
    parameters: dict[str, Mapping[str, Any]] = {
        "hull_server": {"rig_file": str(rig_file)},
        "icp_tracker": {"initial_pose.rig_file": str(rig_file), **known},
        "ekf_tracker": {},
    }
    modules = ("hull_server.hull_node", "icp_tracker.icp_node", "ekf_tracker.ekf_node")
    named = zip(modules, SERVER_NODES, strict=True)
    return [NodeSpec(module, name, "/", Role.SERVER, parameters[name]) for module, name in named]


def camera_node(name: str, parameters: Mapping[str, Any]) -> NodeSpec:
    """Return the camera client of one camera."""
    given = {"camera_name": name, **parameters}
    return NodeSpec(f"{CAMERA_NODE}.camera_node", CAMERA_NODE, f"/{name}", Role.CAMERA, given)


def rig_cameras(rig: str | Path, cameras: str | Path) -> list[NodeSpec]:
    """Return one camera node for each camera of the rig, from the parameter files in ``cameras``."""
    names = load_rig(rig).names
    nodes = {node.label: node for node in cameras_from_files(cameras)}
    if set(nodes) != set(names):
        what = f"has parameter files of {', '.join(nodes)}; the cameras of {rig} are {', '.join(names)}"
        raise InputError(what, where=str(cameras), remedy="Give one file for each camera of the rig, and no other.")
    rig_file = str(Path(rig).resolve())
    return [camera_node(name, {**nodes[name].parameters, "rig_file": rig_file, "autostart": False}) for name in names]


def cameras_from_files(cameras: str | Path) -> list[NodeSpec]:
    """Return the camera nodes of the parameter files in a folder (or of one file), in name order."""
    path = Path(cameras)
    files = sorted(path.glob("*.yaml")) if path.is_dir() else [path]
    if not files or not all(file.is_file() for file in files):
        remedy = "Give a folder with one YAML a camera, or one such file."
        raise InputError("no camera parameter file", where=str(path), remedy=remedy)
    return sorted(map(camera_from_file, files), key=lambda node: node.label)


def camera_from_file(path: str | Path) -> NodeSpec:
    """Return a camera node from a ROS parameter file whose one key is ``/CAMERA/camera_client``."""
    path = Path(path)
    document = read_mapping(path, f"Give a ROS parameter file with the key /CAMERA/{CAMERA_NODE}.")
    camera, _, name = str(next(iter(document), "")).removeprefix("/").partition("/")
    entry = next(iter(document.values()), None)
    parameters = entry.get("ros__parameters") if isinstance(entry, Mapping) else None
    if len(document) != 1 or name != CAMERA_NODE or not isinstance(parameters, Mapping):
        what = f"has {', '.join(map(str, document)) or 'no key'}"
        remedy = (
            f"A camera's parameter file has one key, /CAMERA/{CAMERA_NODE}, and the parameters in its ros__parameters."
        )
        raise InputError(what, where=str(path), remedy=remedy)
    return camera_node(camera, flatten(parameters))


def select(graph: Sequence[NodeSpec], only: str | None) -> list[NodeSpec]:
    """Return the part of ``graph`` that runs on one machine: "server", "cameras", or one camera by name."""
    if only is None:
        return list(graph)
    parts = {SERVER: Role.SERVER, ALL_CAMERAS: Role.CAMERA}
    if only in parts:
        return [node for node in graph if node.role is parts[only]]
    chosen = [node for node in graph if node.label == only]
    if not chosen:
        labels = ", ".join(node.label for node in graph)
        remedy = f"Give server, cameras, or one of: {labels}."
        raise InputError(f"the graph has no part '{only}'", where="only", remedy=remedy)
    return chosen


def apply_settings(graph: Sequence[NodeSpec], settings: Mapping[str, Any]) -> list[NodeSpec]:
    """Set parameters written as NODE.PARAMETER, CAMERA.PARAMETER or cameras.PARAMETER."""
    labels = {node.label for node in graph}
    for key in settings:
        target, _, parameter = key.partition(".")
        if not parameter or target not in labels | {ALL_CAMERAS}:
            known = ", ".join([*sorted(labels), ALL_CAMERAS])
            remedy = f"Write NODE.PARAMETER, with NODE one of: {known}."
            raise InputError(f"'{key}' names no node of the graph", where="settings", remedy=remedy)
    # a single camera's own value comes last, so that it wins over the one given for all
    ordered = sorted(settings.items(), key=lambda item: not item[0].startswith(ALL_CAMERAS + "."))

    def own(node: NodeSpec) -> dict[str, Any]:
        targets = (node.label, ALL_CAMERAS) if node.role is Role.CAMERA else (node.label,)
        return {key.partition(".")[2]: value for key, value in ordered if key.partition(".")[0] in targets}

    return [node.with_parameters(own(node)) for node in graph]


# processes ------------------------------------------------------------------------------------------------------------


ONE_PROCESS, THREE_PROCESSES = "one_process", "three_processes"
SERVER_LAYOUTS = (ONE_PROCESS, THREE_PROCESSES)
SERVER_EXECUTABLE, SERVER_MODULE = "mocap_server", "mocap_pipeline.server_node"


@dataclass(frozen=True)
class ProcessSpec:
    """A process: its module and its nodes. label : a short name for files and tables."""

    module: str
    label: str
    nodes: tuple[NodeSpec, ...]

    def __str__(self) -> str:
        return ", ".join(node.full_name for node in self.nodes)

    @property
    def package(self) -> str:
        """The package, for ``ros2 run``."""
        return self.module.partition(".")[0]

    @property
    def executable(self) -> str:
        """The executable, for ``ros2 run``."""
        return self.nodes[0].name if len(self.nodes) == 1 else self.label

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
    together = [ProcessSpec(SERVER_MODULE, SERVER_EXECUTABLE, tuple(shared))] if shared else []
    return together + [ProcessSpec(node.module, node.label, (node,)) for node in graph if node not in shared]
