"""The graph as launch_ros actions; imported by launch files only, since launch_ros comes with a ROS installation."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from tempfile import NamedTemporaryFile
from typing import Any

from ament_index_python.packages import get_package_share_directory
from launch.actions import DeclareLaunchArgument
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue

from capture_rig.yaml_file import format_mapping

from .graph import NodeSpec
from .processes import ONE_PROCESS, SERVER_LAYOUTS, ProcessSpec, processes_of


def value_of(context: Any, argument: str) -> str:
    """Return the value that the user gave to a launch argument."""
    return LaunchConfiguration(argument).perform(context)


def server_argument() -> DeclareLaunchArgument:
    """The argument that says whether the server's nodes share a process."""
    text = f"hull, ICP and EKF nodes in one process, or in one each: {' or '.join(SERVER_LAYOUTS)}"
    return DeclareLaunchArgument("server", default_value=ONE_PROCESS, description=text)


def node_actions(graph: Sequence[NodeSpec], server: str, autostart: bool = True) -> list[Node]:
    """Return one action a process; launched nodes configure and activate themselves unless told not to."""
    started = [node.with_parameters({"autostart": autostart}) for node in graph]
    return [_action(process) for process in processes_of(started, server)]


def _action(process: ProcessSpec) -> Node:
    shown = {"package": process.package, "executable": process.executable, "output": "screen"}
    if len(process.nodes) > 1:  # a launch action names one node: these have their names, and parameters by name
        with NamedTemporaryFile("w", prefix=f"{process.label}_", suffix=".yaml", delete=False) as file:
            file.write(format_mapping(process.parameter_document()))
        return Node(parameters=[file.name], **shown)
    (node,) = process.nodes
    parameters = {key: _typed(value) for key, value in node.parameters.items()}
    return Node(name=node.name, namespace=node.namespace, parameters=[parameters], **shown)


def rviz_action(wanted: str) -> list[Node]:
    """rviz2 with our configuration when ``wanted`` is "true"."""
    if wanted.lower() != "true":
        return []
    configuration = Path(get_package_share_directory("sagoma_bringup")) / "config" / "rviz" / "sagoma.rviz"
    return [Node(package="rviz2", executable="rviz2", arguments=["-d", str(configuration)], output="screen")]


def _typed(value: Any) -> Any:
    # launch would read a text such as "1" as a number
    return ParameterValue(value, value_type=str) if isinstance(value, str) else value
