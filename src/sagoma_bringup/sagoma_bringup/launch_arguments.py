"""The arguments of the launch files, and the graph that their values describe. It does not import ROS.

One table lists each file's arguments; the files, `ros2 launch --show-args` and the tests read it.
"""

from __future__ import annotations

from argparse import ArgumentTypeError
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from capture_rig.errors import InputError
from capture_rig.session import Session, load_session
from capture_rig.settings import PLAYING_SPEED

from .graph import ALL_CAMERAS, ONE_PROCESS, SERVER_LAYOUTS, NodeSpec, apply_settings, build_graph, camera_from_file

AUTO_START, T_POSE_START, REFERENCE_START = "auto", "t_pose", "session"
STARTS = (AUTO_START, T_POSE_START, REFERENCE_START)
# the cameras of launched footage wait for each other
PLAY_IN_STEP = {f"{ALL_CAMERAS}.footage.wait_for_cameras": True}
RESTART_DELAY_S = 2.0  # long enough to read why a node died, short enough not to miss the next person


@dataclass(frozen=True)
class Argument:
    """One argument of a launch file; required without a default."""

    name: str
    description: str
    default: str | None = None
    choices: tuple[str, ...] = ()


def switch(name: str, description: str, default: str = "false") -> Argument:
    """Return an argument that is true or false."""
    return Argument(name, description, default, ("true", "false"))


RIG = Argument("rig", "rig YAML: the calibrated cameras and the capture volume; a path, or package://PACKAGE/FILE")
OF_ANY_NODE = (
    Argument(
        "namespace",
        "put the whole graph below this namespace, as in /studio/mocap/joint_states; its frames and ids begin with it, "
        "as studio_map, unless a parameter file sets tf_prefix",
        "",
    ),
    switch("use_sim_time", "every node takes the time from /clock, as of a bag that is played"),
    switch("autostart", "configure and activate at start; false: `sagoma start` does, from any machine", "true"),
)
OF_A_SERVER = (
    Argument("body", "body YAML; empty: measured when a person is found", ""),
    Argument("start", "first pose: a T-pose or whoever walks in (auto), or a T-pose alone", AUTO_START, STARTS[:2]),
    Argument("params", "ROS parameter file for all nodes, read last: its values win (keys: /**/hull_server ...)", ""),
    Argument("server", "hull, ICP and EKF nodes in one process, or in one each", ONE_PROCESS, SERVER_LAYOUTS),
)
OF_FOOTAGE = (
    Argument("session", "folder with rig.yaml, camNN.mp4, camNN_background.png or .mp4"),
    Argument("rate", "playing speed; 0: as fast as the graph can, which drops nothing then", "0"),
    switch("loop", "play the footage again and again"),
)
FROM_A_SESSION = Argument(
    "start",
    "first pose: the session's reference where it was measured on its footage, else a T-pose or whoever walks in "
    "(auto); a T-pose alone; the session's reference or truth",
    AUTO_START,
    STARTS,
)
CAMERAS = Argument("cameras", "folder with one parameter file a camera of the rig")
ARGUMENTS: Mapping[str, tuple[Argument, ...]] = {
    "server": (RIG, *OF_A_SERVER, *OF_ANY_NODE),
    "all_in_one": (RIG, CAMERAS, *OF_A_SERVER, *OF_ANY_NODE),
    "demo": (*OF_FOOTAGE, *(FROM_A_SESSION if one.name == "start" else one for one in OF_A_SERVER), *OF_ANY_NODE),
    "camera": (
        Argument("camera", "name of the camera in the rig, e.g. cam01"),
        Argument("params", "parameter file of this camera (default: config/camera/CAMERA.yaml of sagoma_bringup)", ""),
        Argument("rig", "rig YAML in place of the one that the parameter file names; a path, or package://...", ""),
        *OF_ANY_NODE,
    ),
}
"""By the name of the launch file."""


def described_graph(file: str, values: Mapping[str, str]) -> list[NodeSpec]:
    """Return the nodes that the launch file named ``file`` has to start for the arguments' values.

    Raises InputError, before anything is started, for a value that cannot be used.
    """
    graph = camera_graph(values) if file == "camera" else server_graph(values)
    common: dict[str, Any] = {"autostart": is_true(values, "autostart")}
    if is_true(values, "use_sim_time"):
        common["use_sim_time"] = True
    namespace = values["namespace"].strip("/")
    prefix = {"tf_prefix": f"{namespace.replace('/', '_')}_"} if namespace else {}
    return [node.with_parameters({**prefix, **node.parameters, **common}) for node in graph]


def server_graph(values: Mapping[str, str]) -> list[NodeSpec]:
    """Return the server's nodes, and the cameras' of a session or of ``cameras``."""
    session = load_session(values["session"]) if "session" in values else None
    settings = start_settings(session, values["start"])
    if session is not None:
        settings |= PLAY_IN_STEP
    try:
        rate = PLAYING_SPEED(values.get("rate", "1"))
    except ArgumentTypeError as error:
        raise InputError(f"is {values['rate']}", where="argument rate", remedy=f"{error}.") from None
    return build_graph(
        session=values.get("session"),
        rig=values.get("rig"),
        cameras=values.get("cameras"),
        rate=rate,
        loop=is_true(values, "loop"),
        body=values["body"] or None,
        settings=settings,
    )


def camera_graph(values: Mapping[str, str]) -> list[NodeSpec]:
    """Return the client of one camera, from its parameter file."""
    camera, path = values["camera"], values["params"]
    node = camera_from_file(path)
    if node.label != camera:
        remedy = f"Give camera:={node.label}, or the parameter file of {camera}."
        raise InputError(f"describes {node.label}, not {camera}", where=path, remedy=remedy)
    return apply_settings([node], {f"{ALL_CAMERAS}.rig_file": values["rig"]} if values["rig"] else {})


def start_settings(session: Session | None, start: str = AUTO_START) -> dict[str, Any]:
    """Return the ICP tracker's settings for the source of its first pose.

    start : "t_pose", "session" (its reference), or "auto": the reference if the session has one made from its footage
    (``reference*.csv``), else a T-pose or a person who walks in, as for live cameras.

    Raises InputError without a reference to start from.
    """
    truth = None if session is None else session.truth
    if start == AUTO_START and truth is not None and truth.source.name.startswith("reference"):
        start = REFERENCE_START
    if start != REFERENCE_START:
        return {"icp_tracker.initial_pose.source": start}
    if session is None or truth is None:
        where = "live cameras" if session is None else str(session.folder)
        raise InputError("has no reference to start from", where=where, remedy="Start from a T-pose.")
    return {
        "icp_tracker.initial_pose.source": REFERENCE_START,
        "icp_tracker.initial_pose.session": str(session.folder.resolve()),
        "icp_tracker.initial_pose.frame": int(truth.frames[0]),
    }


def is_true(values: Mapping[str, str], name: str) -> bool:
    """Return the value of a boolean argument; false if the file does not have it."""
    text = values.get(name, "false").lower()
    if text not in ("true", "false"):
        raise InputError(f"is '{text}'", where=f"argument {name}", remedy="Give true or false.")
    return text == "true"
