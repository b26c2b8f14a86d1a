"""The server's three nodes: ros2 launch sagoma_bringup server.launch.py rig:=FILE. Cameras: camera.launch.xml."""

from launch.actions import DeclareLaunchArgument, OpaqueFunction

from launch import LaunchDescription
from sagoma_bringup.graph import build_graph
from sagoma_bringup.launch_nodes import node_actions, server_argument, value_of

ARGUMENTS = [
    DeclareLaunchArgument("rig", description="rig YAML: the calibrated cameras and the capture volume"),
    DeclareLaunchArgument("body", default_value="", description="body YAML; empty: measured when a person is found"),
    DeclareLaunchArgument(
        "autostart", default_value="true", description="configure and activate at start; false: `sagoma start` does"
    ),
]


def nodes(context):
    """Return the graph's nodes for the arguments' values."""
    graph = build_graph(rig=value_of(context, "rig"), body=value_of(context, "body") or None)
    return node_actions(graph, value_of(context, "server"), autostart=value_of(context, "autostart").lower() == "true")


def generate_launch_description():
    """Called by ros2 launch."""
    return LaunchDescription([*ARGUMENTS, server_argument(), OpaqueFunction(function=nodes)])
