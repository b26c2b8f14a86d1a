"""Shadows resolved in groups of cameras: the hull is the same, bit for bit."""

import numpy as np
import pytest
from hull_scenes import capsule_person, ring_rig, silhouettes
from node_probe import FAILURE, NodeProbe
from sensor_msgs.msg import CompressedImage

from capture_rig import load_rig, save_rig
from capture_rig.mask_levels import ATTENUATED_LEVELS, CANDIDATE_LEVELS, UNCERTAIN
from hull_server.camera_groups import GroupResolver, resolved_levels
from hull_server.hull_pipeline import HullPipeline
from hull_server.level_stack import binary_mask
from hull_server.resolver_node import ResolverNode
from hull_server.settings import NodeSettings, hull_settings
from hull_server.silhouette_input_ros import RESOLVED
from mocap_packets.frame_set import FrameSet
from sagoma_ros.images import decode_silhouette, silhouette_message
from sagoma_ros.messages import to_ns
from sagoma_ros.qos import SILHOUETTE_PUBLISHER

RIG = ring_rig(5, seed=2)
SETTINGS = NodeSettings(backend="cpu", voxel_size_m=0.04)
GROUPS = (RIG.names[:2], RIG.names[2:])
PERIOD_NS = 100_000_000


def levels_of(rng, x_m=0.3):
    """A person with clothes of every darkness, and candidates all around."""
    masks = {}
    for name, body in silhouettes(RIG, capsule_person(x_m)).items():
        clothes = rng.choice(np.array([*ATTENUATED_LEVELS, 255], np.uint8), body.shape)
        around = rng.choice(np.array([0, UNCERTAIN, *CANDIDATE_LEVELS, ATTENUATED_LEVELS[4]], np.uint8), body.shape)
        seen = RIG.camera(name).undistorted_view().seen
        masks[name] = np.where(
            seen, np.where(body > 0, clothes, np.where(np.arange(body.shape[1]) % 50 < 9, around, 0)), 0
        )
    return {name: mask.astype(np.uint8) for name, mask in masks.items()}


def products_of(result):
    packets = result.products.centerline, result.products.voxels, result.products.contour_rays
    return [values.tobytes() for packet in packets for values in vars(packet).values()]


def test_hull_of_levels_resolved_in_groups_is_that_of_one_process():
    rng = np.random.default_rng(4)
    whole = HullPipeline(RIG, SETTINGS)
    after = HullPipeline(RIG, hull_settings(NodeSettings(backend="cpu", voxel_size_m=0.04, resolved=True)))
    resolvers = [GroupResolver(RIG, SETTINGS, group) for group in GROUPS]
    changed = 0
    for k in range(4):
        sent = levels_of(rng, 0.1 * k)
        resolved = {}
        for resolver in resolvers:
            resolved |= resolver.run(FrameSet.of_instant(k * PERIOD_NS, sent))
        assert tuple(sorted(resolved)) == RIG.names
        changed += sum(np.count_nonzero(resolved[name] != sent[name]) for name in sent)
        one = whole.run(FrameSet.of_instant(k * PERIOD_NS, sent))
        two = after.run(FrameSet.of_instant(k * PERIOD_NS, resolved))
        assert not one.empty
        assert products_of(one) == products_of(two)
        assert repr((one.camera_faults, one.extrinsic_errors)) == repr((two.camera_faults, two.extrinsic_errors))
    assert changed > 100


def test_absent_camera_is_absent_in_its_group():
    sent = levels_of(np.random.default_rng(1))
    del sent[RIG.names[0]]
    resolved = GroupResolver(RIG, SETTINGS, GROUPS[0]).run(FrameSet.of_instant(0, sent, (RIG.names[0],)))
    assert list(resolved) == [RIG.names[1]]


@pytest.mark.parametrize("found", [0, 255])
def test_resolved_level_says_what_was_found_and_keeps_the_attenuation(found):
    levels = np.array([[0, UNCERTAIN, *CANDIDATE_LEVELS, *ATTENUATED_LEVELS, 255]], np.uint8)
    wanted = np.where(np.isin(levels, [0, UNCERTAIN, 255]), levels, np.uint8(found))
    resolved = resolved_levels(levels, wanted)
    assert (binary_mask(resolved) == wanted).all()
    assert ((resolved == 0) == (levels == 0)).all() and ((resolved == 255) == (levels == 255)).all()
    assert (np.diff(resolved[0, 2:6].astype(int)) > 0).all() and (np.diff(resolved[0, 6:15].astype(int)) >= 0).all()


class ResolverProbe(NodeProbe):
    """A ResolverNode of one group; its peer plays the cameras and takes what the node hands on."""

    def __init__(self, context, rig_file, cameras):
        values = {"rig_file": str(rig_file), "cameras": list(cameras), "reliable": True, "deadline_s": 600.0}
        super().__init__(context, ResolverNode, values)
        self.topics = {name: f"{name}/{RESOLVED}/compressed" for name in cameras}
        for topic in self.topics.values():
            self.listen(CompressedImage, topic)

    def start(self):
        super().start()
        self.images = {
            name: self.peer.create_publisher(CompressedImage, f"{name}/silhouette/compressed", SILHOUETTE_PUBLISHER)
            for name in RIG.names
        }
        self.until(lambda: all(p.get_subscription_count() for p in self.images.values()))
        self.until(lambda: all(self.peer.count_publishers(topic) for topic in self.topics.values()))
        return self


def test_node_hands_on_the_resolved_levels_of_its_cameras_alone(open_probe, tmp_path):
    save_rig(RIG, tmp_path / "rig.yaml")
    sent = levels_of(np.random.default_rng(2))
    expected = GroupResolver(load_rig(tmp_path / "rig.yaml"), SETTINGS, GROUPS[0])
    probe = open_probe(ResolverProbe, tmp_path / "rig.yaml", GROUPS[0]).start()
    for name, mask in sent.items():
        probe.images[name].publish(silhouette_message(mask, PERIOD_NS, name))
    probe.until(lambda: all(len(probe.heard[topic]) == 1 for topic in probe.topics.values()))
    for name, levels in expected.run(FrameSet.of_instant(PERIOD_NS, sent)).items():
        message = probe.heard[probe.topics[name]][0]
        height, width = levels.shape
        assert to_ns(message.header.stamp) == PERIOD_NS
        assert (decode_silhouette(message, width, height, name, candidates=127) == levels).all()


def test_node_refuses_a_camera_that_the_rig_does_not_have(open_probe, tmp_path):
    save_rig(RIG, tmp_path / "rig.yaml")
    probe = open_probe(ResolverProbe, tmp_path / "rig.yaml", ["cam77"])
    assert probe.node.trigger_configure() == FAILURE
