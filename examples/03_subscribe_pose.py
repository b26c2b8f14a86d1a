"""Print where somebody is and how the left elbow moves, until Ctrl-C. Any machine of the ROS network; needs only rclpy.

python examples/03_subscribe_pose.py
"""

import rclpy
from geometry_msgs.msg import PoseWithCovarianceStamped
from rclpy.executors import ExternalShutdownException
from sensor_msgs.msg import JointState


def show_torso(torso: PoseWithCovarianceStamped) -> None:
    place = torso.pose.pose.position  # in map: metres, z up
    print(f"torso at {place.x:.2f} {place.y:.2f} {place.z:.2f} m", flush=True)


def show_elbow(joints: JointState) -> None:
    elbow = list(joints.name).index("left_elbow")
    print(f"left_elbow {joints.position[elbow]:.3f} rad, {joints.velocity[elbow]:.2f} rad/s", flush=True)


rclpy.init()
node = rclpy.create_node("pose_listener")
node.create_subscription(PoseWithCovarianceStamped, "/mocap/torso", show_torso, 10)
node.create_subscription(JointState, "/mocap/joint_states", show_elbow, 10)
try:
    rclpy.spin(node)
except (KeyboardInterrupt, ExternalShutdownException):
    print("bye")
