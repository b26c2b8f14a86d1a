"""The server's nodes: ros2 launch sagoma_bringup server.launch.py rig:=FILE. Cameras: camera.launch.py."""

from sagoma_bringup.launch_nodes import describe


def generate_launch_description():
    """Called by ros2 launch."""
    return describe("server")
