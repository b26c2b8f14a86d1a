"""One camera PC: ros2 launch sagoma_bringup camera.launch.py camera:=cam01 params:=FILE."""

from sagoma_bringup.launch_nodes import describe


def generate_launch_description():
    """Called by ros2 launch."""
    return describe("camera")
