"""The graph as launch_ros actions; imported by launch files only, since launch_ros comes with a ROS installation."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from ament_index_python.packages import get_package_share_directory
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue

from .graph import NodeSpec


def value_of(context: Any, argument: str) -> str:
    """Return the value that the user gave to a launch argument."""
    return LaunchConfiguration(argument).perform(context)


def node_actions(graph: Sequence[NodeSpec], autostart: bool = True) -> list[Node]:
    """Return one node action each; launched nodes configure and activate themselves unless told not to."""
    return [
        Node(
            package=spec.package,
            executable=spec.executable,
            name=spec.name,
            namespace=spec.namespace,
            parameters=[{key: _typed(value) for key, value in {**spec.parameters, "autostart": autostart}.items()}],
            output="screen",
        )
        for spec in graph
    ]


def rviz_action(wanted: str) -> list[Node]:
    """rviz2 with our configuration when ``wanted`` is "true"."""
    if wanted.lower() != "true":
        return []
    configuration = Path(get_package_share_directory("sagoma_bringup")) / "config" / "rviz" / "sagoma.rviz"
    return [Node(package="rviz2", executable="rviz2", arguments=["-d", str(configuration)], output="screen")]


def _typed(value: Any) -> Any:
    # launch would read a text such as "1" as a number
    return ParameterValue(value, value_type=str) if isinstance(value, str) else value
