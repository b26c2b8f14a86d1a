"""A lifecycle node for the supervisor's tests; the parameter ``behaviour`` says how it misbehaves. Run with -m."""

import os
import signal
import sys
import threading

import rclpy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.executors import ExternalShutdownException
from rclpy.lifecycle import LifecycleNode, TransitionCallbackReturn


class TinyNode(LifecycleNode):
    def __init__(self):
        super().__init__("tiny")
        self.behaviour = self.declare_parameter("behaviour", "good").value
        self.publisher = self.create_publisher(DiagnosticArray, "/diagnostics", 10)
        self.timer = self.create_timer(0.05, self.publish)
        print(f"I am {self.behaviour}", flush=True)

    def publish(self):
        values = [KeyValue(key="rate_hz", value="60.0"), KeyValue(key="dropped", value="7")]
        status = DiagnosticStatus(name=self.get_fully_qualified_name(), message="tiny", values=values)
        self.publisher.publish(DiagnosticArray(status=[status]))

    def on_configure(self, state):
        if self.behaviour == "refuses_to_configure":
            self.get_logger().error("cam99.mp4: cannot be opened as a video")
            return TransitionCallbackReturn.FAILURE
        if self.behaviour == "never_answers":
            threading.Event().wait()
        return TransitionCallbackReturn.SUCCESS

    def on_activate(self, state):
        if self.behaviour == "dies_when_activated":
            print("the last words of a dying node", flush=True)
            os._exit(3)
        return super().on_activate(state)


def main():
    rclpy.init()
    node = TinyNode()
    if node.declare_parameter("autostart", False).value:
        node.trigger_configure()
        node.trigger_activate()
    try:
        rclpy.spin(node)
    except (KeyboardInterrupt, ExternalShutdownException):
        pass
    finally:
        signal.signal(signal.SIGINT, signal.SIG_IGN)
        node.destroy_node()
        rclpy.try_shutdown()
    return 0


if __name__ == "__main__":
    sys.exit(main())
