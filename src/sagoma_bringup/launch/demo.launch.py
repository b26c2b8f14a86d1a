"""The whole graph on a folder of footage: ros2 launch sagoma_bringup demo.launch.py session:=FOLDER."""

from launch.actions import DeclareLaunchArgument, OpaqueFunction

from launch import LaunchDescription
from sagoma_bringup.graph import build_graph
from sagoma_bringup.launch_nodes import node_actions, rviz_action, server_argument, value_of

ARGUMENTS = [
    DeclareLaunchArgument("session", description="folder with rig.yaml, camNN.mp4, camNN_background.png or .mp4"),
    DeclareLaunchArgument("rate", default_value="1.0", description="playing speed; 0: as fast as the graph can"),
    DeclareLaunchArgument("loop", default_value="false", description="play the footage again and again"),
    DeclareLaunchArgument("body", default_value="", description="body YAML; empty: measured when a person is found"),
    DeclareLaunchArgument("rviz", default_value="false", description="show it in rviz2"),
]


def nodes(context):
    """Return the graph's nodes for the arguments' values."""
    graph = build_graph(
        session=value_of(context, "session"),
        rate=float(value_of(context, "rate")),
        loop=value_of(context, "loop").lower() == "true",
        body=value_of(context, "body") or None,
    )
    return node_actions(graph, value_of(context, "server")) + rviz_action(value_of(context, "rviz"))


def generate_launch_description():
    """Called by ros2 launch."""
    return LaunchDescription([*ARGUMENTS, server_argument(), OpaqueFunction(function=nodes)])
