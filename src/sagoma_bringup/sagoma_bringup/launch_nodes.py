"""What the launch files start, as launch_ros actions; only they import it: launch comes with a ROS installation.

Names are relative: a launch file that includes ours may push a namespace, and all of the graph stands below it.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from pathlib import Path
from tempfile import NamedTemporaryFile
from typing import Any

from launch.actions import DeclareLaunchArgument, OpaqueFunction
from launch.launch_description import LaunchDescription
from launch.logging import launch_config
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

from capture_rig.yaml_file import format_mapping, read_mapping
from sagoma_ros.middleware import SCHEME, package_path, resolve_packages

from .graph import ONE_PROCESS, ProcessSpec, processes_of
from .launch_arguments import ARGUMENTS, RESTART_DELAY_S, described_graph

CONFIG = f"{SCHEME}sagoma_bringup/config"


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
        values["params"] = str(package_path(CONFIG) / "camera" / f"{values['camera']}.yaml")
    files = []
    if file != "camera" and values["params"]:
        read_mapping(Path(values["params"]), "Give a ROS parameter file.")
        files.append(str(Path(values["params"]).resolve()))
    processes = processes_of(described_graph(file, values), values.get("server", ONE_PROCESS))
    return [_process(process, values, files) for process in processes]


def _process(process: ProcessSpec, values: Mapping[str, str], files: list[str]) -> Node:
    """``files`` : parameter files that are read after the process's own."""
    return Node(
        package=process.package,
        executable=process.executable,
        namespace=f"{values['namespace'].strip('/')}{process.nodes[0].namespace}".strip("/") or None,
        output="screen",
        parameters=[_write_parameters(process), *files],
        name=process.nodes[0].name if len(process.nodes) == 1 else None,  # it would rename all of several
        respawn=True,
        respawn_delay=RESTART_DELAY_S,
    )


def _write_parameters(process: ProcessSpec) -> str:
    """Write the nodes' parameters into a file that holds in every namespace, values typed as they are (launch would
    read the text "1" as a number), beside the launch's logs; return its path."""
    document = {f"/**/{node.name}": {"ros__parameters": dict(node.parameters)} for node in process.nodes}
    folder, prefix = launch_config.log_dir, f"{process.label}_"
    with NamedTemporaryFile("w", dir=folder, prefix=prefix, suffix=".yaml", delete=False) as file:
        file.write(format_mapping(document))
    return file.name
