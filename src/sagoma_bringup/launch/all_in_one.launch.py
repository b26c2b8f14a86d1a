"""All of a rig on one machine: ros2 launch sagoma_bringup all_in_one.launch.py rig:=FILE cameras:=FOLDER."""

from launch.actions import DeclareLaunchArgument, OpaqueFunction

from launch import LaunchDescription
from sagoma_bringup.graph import build_graph
from sagoma_bringup.launch_nodes import node_actions, rviz_action, server_argument, value_of

ARGUMENTS = [
    DeclareLaunchArgument("rig", description="rig YAML: the calibrated cameras and the capture volume"),
    DeclareLaunchArgument("cameras", description="folder with one parameter file a camera of the rig"),
    DeclareLaunchArgument("body", default_value="", description="body YAML; empty: measured when a person is found"),
    DeclareLaunchArgument("rviz", default_value="false", description="show it in rviz2"),
]


def nodes(context):
    """Return the graph's nodes for the arguments' values."""
    graph = build_graph(
        rig=value_of(context, "rig"), cameras=value_of(context, "cameras"), body=value_of(context, "body") or None
    )
    return node_actions(graph, value_of(context, "server")) + rviz_action(value_of(context, "rviz"))


def generate_launch_description():
    """Called by ros2 launch."""
    return LaunchDescription([*ARGUMENTS, server_argument(), OpaqueFunction(function=nodes)])
