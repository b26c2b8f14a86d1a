"""Print the left elbow as it moves, until Ctrl-C. Runs on any machine of the ROS network; needs only rclpy."""

import rclpy
from rclpy.executors import ExternalShutdownException
from sensor_msgs.msg import JointState


def show(joints: JointState) -> None:
    elbow = list(joints.name).index("left_elbow")
    print(f"left_elbow {joints.position[elbow]:.3f} rad, {joints.velocity[elbow]:.2f} rad/s", flush=True)


rclpy.init()
node = rclpy.create_node("elbow_listener")
node.create_subscription(JointState, "/mocap/joint_states", show, 10)
try:
    rclpy.spin(node)
except (KeyboardInterrupt, ExternalShutdownException):
    print("bye")
