"""All of a rig on one machine: ros2 launch sagoma_bringup all_in_one.launch.py rig:=FILE cameras:=FOLDER."""

from sagoma_bringup.launch_nodes import describe


def generate_launch_description():
    """Called by ros2 launch."""
    return describe("all_in_one")
