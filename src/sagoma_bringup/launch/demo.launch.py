"""The whole graph on a folder of footage: ros2 launch sagoma_bringup demo.launch.py session:=FOLDER."""

from sagoma_bringup.launch_nodes import describe


def generate_launch_description():
    """Called by ros2 launch."""
    return describe("demo")
