"""An EkfNode under test, whose peer plays the ICP tracker."""

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from ekf_person import ALL, isotropic
from geometry_msgs.msg import PoseWithCovarianceStamped
from node_probe import NodeProbe
from sensor_msgs.msg import JointState, MultiDOFJointState, PointCloud2
from std_msgs.msg import Float64MultiArray
from visualization_msgs.msg import MarkerArray

from ekf_tracker.ekf_node import EkfNode
from mocap_packets.fit import ReferencePoints
from mocap_packets.people import FittedPeople, PeoplePoints
from mocap_packets.table import NO_AGES
from sagoma_ros.messages import LATENCY_TOPIC, to_ns
from sagoma_ros.packets import FITTED_PEOPLE, tables_message
from sagoma_ros.qos import RESULT

OUTPUTS = {
    "mocap/joint_states": JointState,
    "mocap/torso": PoseWithCovarianceStamped,
    "mocap/joint_covariance": PointCloud2,
    "mocap/joint_rotations": MultiDOFJointState,
    "mocap/reference_points": PointCloud2,
    "mocap/skeleton": MarkerArray,
    "mocap/state": DiagnosticStatus,
    "ekf/prediction": MultiDOFJointState,
    LATENCY_TOPIC: DiagnosticArray,
}


class EkfProbe(NodeProbe):
    """An EkfNode; its peer plays the ICP tracker and keeps what the node publishes in order of arrival."""

    def __init__(self, context, body, **parameters):
        super().__init__(context, EkfNode, {"stale_after_s": 0.0} | parameters)  # a busy machine is no silence
        self.body, self.arrived, self.listened = body, [], []
        self.people = self.peer.create_publisher(Float64MultiArray, FITTED_PEOPLE.name, RESULT)
        for topic, kind in OUTPUTS.items():
            self.listen(kind, topic)

    def listen(self, kind, topic, qos=RESULT):
        self.listened.append(topic)
        self.peer.create_subscription(kind, topic, lambda m, topic=topic: self.arrived.append((topic, m)), qos)

    def start(self):
        super().start()
        listeners = 1 + self.listened.count(FITTED_PEOPLE.name)
        self.until(lambda: self.people.get_subscription_count() == listeners)
        self.until(lambda: all(self.node.count_subscribers(topic) == 1 for topic in OUTPUTS))
        return self

    def send(self, stamp_ns, points, visible=ALL, frame_id="map", sd=0.01, ages=NO_AGES):
        self.send_people(stamp_ns, {1: ReferencePoints(points, isotropic(sd), visible)}, frame_id, ages)

    def send_people(self, stamp_ns, people, frame_id="map", ages=NO_AGES):
        """Send a set of reference points by person; all have the bench's body, if it has one."""
        bodies = {} if self.body is None else dict.fromkeys(people, self.body)
        self.people.publish(tables_message(FittedPeople(stamp_ns, PeoplePoints(people), bodies, ages), frame_id))

    def fit(self, stamp_ns, points, **options):
        """Send a set and wait for its answer; returns what was published from the sending on."""
        begin = len(self.arrived)
        self.send(stamp_ns, points, **options)
        self.until(lambda: self.answers(stamp_ns, begin))
        return self.arrived[begin:]

    def answers(self, stamp_ns, begin=0):
        return [m for t, m in self.arrived[begin:] if t == LATENCY_TOPIC and to_ns(m.header.stamp) == stamp_ns]

    def latest(self, topic):
        return next(m for t, m in reversed(self.arrived) if t == topic)
