"""A HullNode under test, whose peer plays the cameras."""

from diagnostic_msgs.msg import DiagnosticArray
from node_probe import NodeProbe, values_of
from sensor_msgs.msg import CameraInfo, CompressedImage, PointCloud2

from hull_server.hull_node import HullNode
from sagoma_ros.images import silhouette_message
from sagoma_ros.messages import to_ns
from sagoma_ros.qos import SILHOUETTE_PUBLISHER

PERIOD_NS = 16_666_667
EPOCH_NS = 7_000_000_000
NEVER_S = 600.0  # the deadline of frame sets, unless a test lets it pass
OUTPUTS = {
    "hull/contour_rays": PointCloud2,
    "hull/centerline": PointCloud2,
    "hull/voxels": PointCloud2,
    "hull/frame_set": DiagnosticArray,
}


def stamp(k):
    return EPOCH_NS + k * PERIOD_NS


class HullProbe(NodeProbe):
    """A HullNode; its peer plays the cameras."""

    def __init__(self, context, clock, **parameters):
        values = {"backend": "cpu", "voxel_size_m": 0.04, "reliable": True, "deadline_s": NEVER_S} | parameters
        super().__init__(context, HullNode, values)
        self.clock = clock
        for topic, kind in OUTPUTS.items():
            self.listen(kind, topic)

    def start(self, rig):
        super().start()
        self.images, self.infos = {}, {}
        for name in rig.names:
            topic = f"{name}/silhouette/compressed"
            self.images[name] = self.peer.create_publisher(CompressedImage, topic, SILHOUETTE_PUBLISHER)
            self.infos[name] = self.peer.create_publisher(CameraInfo, f"{name}/camera_info", SILHOUETTE_PUBLISHER)
        publishers = [*self.images.values(), *self.infos.values()]
        self.until(lambda: all(p.get_subscription_count() for p in publishers))
        self.until(lambda: all(self.peer.count_publishers(topic) for topic in self.heard))
        return self

    def send(self, masks, k, **extra_ns):
        for name, mask in masks.items():
            self.images[name].publish(silhouette_message(mask, stamp(k) + extra_ns.get(name, 0), name))

    def let_the_deadline_pass(self, frames):
        """Once the node has taken so many frames in all, its clock leaps beyond every deadline."""
        self.until_values(frames=str(frames))
        self.clock.ahead_ns += round(2 * NEVER_S * 1e9)

    def answers(self, count):
        """The values of hull/frame_set of the first ``count`` sets, once all four topics have told of them."""
        topics = list(OUTPUTS)
        self.until(lambda: all(len(self.heard[topic]) >= count for topic in topics))
        for topic in topics:
            assert len(self.heard[topic]) == count
        for topic in topics[:2]:
            assert [to_ns(m.header.stamp) for m in self.heard[topic]] == [
                to_ns(m.header.stamp) for m in self.heard[topics[3]]
            ]
        return [values_of(m) for m in self.heard["hull/frame_set"]]
