"""What the launch files start, as launch_ros actions; only they import it: launch comes with a ROS installation.

Names are relative: a launch file that includes ours may push a namespace, and all of the graph stands below it.
"""

from __future__ import annotations

from functools import partial
from pathlib import Path
from tempfile import NamedTemporaryFile
from typing import Any

from ament_index_python.packages import PackageNotFoundError, get_package_prefix
from launch.actions import DeclareLaunchArgument, OpaqueFunction, Shutdown
from launch.launch_description import LaunchDescription
from launch.logging import launch_config
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

from capture_rig.errors import InputError
from capture_rig.yaml_file import format_mapping, read_mapping
from sagoma_ros.middleware import SCHEME, package_path, resolve_packages

from .graph import ProcessSpec
from .launch_arguments import ARGUMENTS, LaunchRequest, read_request

PACKAGE = "sagoma_bringup"


def describe(file: str) -> LaunchDescription:
    """Return the description of the launch file named ``file``: its arguments, and what their values start."""
    declared = [
        DeclareLaunchArgument(
            one.name, default_value=one.default, description=one.description, choices=list(one.choices) or None
        )
        for one in ARGUMENTS[file]
    ]
    return LaunchDescription([*declared, OpaqueFunction(function=partial(start, file))])


def start(file: str, context: Any) -> list[Node]:
    """Return one action a process. Raises InputError for values that cannot be used, before there is any."""
    names = [argument.name for argument in ARGUMENTS[file]]
    values = {name: resolve_packages(LaunchConfiguration(name).perform(context)) for name in names}
    if file == "camera" and not values["params"]:
        values["params"] = str(_config() / "camera" / f"{values['camera']}.yaml")
    request = read_request(file, values)
    viewer = [rviz(request)] if request.rviz else []
    return [_process(process, request) for process in request.processes] + viewer


def rviz(request: LaunchRequest) -> Node:
    """Return rviz2 with our configuration. Raises InputError when it is not installed."""
    try:
        get_package_prefix("rviz2")
    except (PackageNotFoundError, OSError):  # OSError: nothing is sourced
        remedy = "Install ros-jazzy-rviz2, or look at the graph with `sagoma view`."
        raise InputError("rviz2 is not installed", where="argument rviz", remedy=remedy) from None
    configuration = _config() / "rviz" / "sagoma.rviz"
    topics = sorted(_topics(read_mapping(configuration, "Install sagoma_bringup anew.")))
    return Node(
        package="rviz2",
        executable="rviz2",
        namespace=request.namespace or None,
        arguments=["-d", str(configuration), "-f", f"{request.tf_prefix}map"],
        # the file names them as they are without a namespace
        remappings=[(topic, topic.removeprefix("/")) for topic in topics],
        parameters=[{"use_sim_time": request.use_sim_time}],
        output="screen",
    )


def _process(process: ProcessSpec, request: LaunchRequest) -> Node:
    restarts = request.respawn_delay_s is not None
    below = f"{request.namespace}{process.nodes[0].namespace}".strip("/")
    options: dict[str, Any] = {
        "package": process.package,
        "executable": process.executable,
        "namespace": below or None,
        "output": "screen",
        "respawn": restarts,
    }
    if restarts:
        options["respawn_delay"] = request.respawn_delay_s
    else:
        options["on_exit"] = [Shutdown(reason=f"{process} has ended")]
    if len(process.nodes) == 1:  # a name would rename all of several
        options["name"] = process.nodes[0].name
    return Node(parameters=[_write_parameters(process), *request.parameter_files], **options)


def _write_parameters(process: ProcessSpec) -> str:
    """Write the nodes' parameters into a file that holds in every namespace, values typed as they are (launch would
    read the text "1" as a number), beside the launch's logs; return its path."""
    document = {f"/**/{node.name}": {"ros__parameters": dict(node.parameters)} for node in process.nodes}
    folder, prefix = launch_config.log_dir, f"{process.label}_"
    with NamedTemporaryFile("w", dir=folder, prefix=prefix, suffix=".yaml", delete=False) as file:
        file.write(format_mapping(document))
    return file.name


def _config() -> Path:
    return package_path(f"{SCHEME}{PACKAGE}/config")


def _topics(part: Any) -> set[str]:
    """Return the topics that an rviz configuration names: each ``Topic: {Value: NAME}``."""
    if isinstance(part, list):
        return set().union(*map(_topics, part))
    if not isinstance(part, dict):
        return set()
    own = part.get("Topic")
    named = {own["Value"]} if isinstance(own, dict) and own.get("Value") else set()
    return named.union(*(_topics(value) for value in part.values()))
