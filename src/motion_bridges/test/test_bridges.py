"""What other programs get of a person, read by clients that share no code with the bridges."""

import select
import socket

import numpy as np
import pytest
from node_probe import FAILURE, NodeProbe
from poses import angles_with
from pythonosc.osc_bundle import OscBundle
from sensor_msgs.msg import JointState, MultiDOFJointState, PointCloud2

from capture_rig.rigid import rotation_matrix
from mocap_packets.fit import FIRST_PERSON, ReferencePoints
from motion_bridges.isb_node import ContinuousAngles, IsbAngles
from motion_bridges.lsl_node import LslBridge
from motion_bridges.vmc_node import BONES, RIGID, VmcBridge
from motion_export.joint_tree import JOINTS
from sagoma_ros.messages import to_ns, to_stamp
from sagoma_ros.packets import packet_cloud
from sagoma_ros.poses import motion_message
from sagoma_ros.qos import RESULT
from stick_figure.body import Body
from stick_figure.kinematics import forward, stick_frames
from stick_figure.pose import JointMotion, Pose
from stick_figure.skeleton import POINT_NAMES

BODY = Body.from_stature(1.8)
STANDING_M = np.array([0.4, -0.3, 1.2])


def pose_of(lean=(0.0, 0.0, 0.0), place=STANDING_M, **degrees) -> Pose:
    """A T-pose but for the joint angles given; ``lean`` is a rotation vector."""
    angles = angles_with(**{name: np.deg2rad(value) for name, value in degrees.items()})
    return Pose.from_angles(place, rotation_matrix(np.array(lean)), angles)


BENT = pose_of(
    (0.2, -0.3, 1.9), left_elbow=-70.0, right_knee=50.0, right_shoulder_x=230.0, left_hip_y=-40.0, neck_y=20.0
)


class BridgeProbe(NodeProbe):
    """A bridge, and a peer that publishes a person."""

    def __init__(self, context, bridge, topics="mocap", **parameters):
        super().__init__(context, bridge, {"person": topics, **parameters})
        self._rotations = self.peer.create_publisher(MultiDOFJointState, f"{topics}/joint_rotations", RESULT)
        self._points = self.peer.create_publisher(PointCloud2, f"{topics}/reference_points", RESULT)

    def start(self):
        super().start()
        publishers = (self._rotations, self._points)
        self.until(lambda: all(one.get_subscription_count() for one in publishers), "the bridge's subscriptions")
        return self

    def publish(self, pose: Pose, stamp_ns=None, with_points=True):
        stamp_ns = self.peer.get_clock().now().nanoseconds if stamp_ns is None else stamp_ns
        motions = {FIRST_PERSON: JointMotion.of(pose, np.zeros(24))}
        self._rotations.publish(motion_message(motions, stamp_ns, "map"))
        if with_points:
            points = ReferencePoints(forward(BODY, pose), np.tile(1e-4 * np.eye(3), (15, 1, 1)), np.ones(15, bool))
            self._points.publish(packet_cloud(points, stamp_ns, "map"))
        return stamp_ns


# --- joint angles of the ISB


@pytest.fixture
def isb_angles(open_probe):
    """``isb_angles(topics)``: a bridge of a person's joint angles, and the list of its messages."""

    def start(topics="mocap"):
        probe = open_probe(BridgeProbe, IsbAngles, topics)
        heard = probe.listen(JointState, f"{topics}/isb_angles")
        probe.start()
        probe.until(lambda: probe.node.count_subscribers(f"{topics}/isb_angles"))
        return probe, heard

    return start


def test_isb_angles_have_the_set_s_stamp_are_those_of_the_posture_and_go_on_as_a_person_turns_round(isb_angles):
    probe, heard = isb_angles("mocap/bodies/b0002")
    stamp_ns = probe.publish(pose_of(left_elbow=-70.0, right_knee=50.0, left_hip_y=-40.0))
    probe.until(lambda: heard)
    (message,) = heard
    angles = dict(zip(message.name, np.rad2deg(message.position), strict=True))
    assert to_ns(message.header.stamp) == stamp_ns and message.header.frame_id == "map" and len(angles) == 21
    assert angles["left_elbow_flexion"] == pytest.approx(70.0) and angles["right_knee_flexion"] == pytest.approx(50.0)
    assert angles["left_hip_flexion"] == pytest.approx(40.0) and angles["thorax_tilt"] == pytest.approx(0.0, abs=1e-6)
    turns = np.deg2rad(np.arange(0.0, 420.0, 30.0))
    for turn in turns:
        probe.publish(pose_of((0.0, 0.0, turn)))
    probe.until(lambda: len(heard) == 1 + len(turns))
    turned = [message.position[message.name.index("thorax_axial_rotation")] for message in heard[1:]]
    np.testing.assert_allclose(turned, turns, atol=1e-6)


def test_arms_that_swing_through_hanging_do_not_wind_up():
    angles, seen = ContinuousAngles(), []
    for k in range(200):  # ten swings forward and back, and a little to either side
        swing, side = 30.0 * np.sin(0.1 * np.pi * k), 8.0 * np.cos(0.1 * np.pi * k)
        pose = pose_of(left_shoulder_x=-90.0 + side, left_shoulder_z=-swing, right_shoulder_x=270.0 - side)
        seen.append(angles.update(stick_frames(pose)))
    planes = [one["left_shoulder_plane_of_elevation"] for one in seen]
    assert max(planes) - min(planes) > 90.0 and all(abs(v) <= 180.0 + 1e-9 for one in seen for v in one.values())


def test_what_cannot_be_read_is_counted_and_a_pose_without_points_is_not_handed_on(isb_angles):
    probe, heard = isb_angles()
    probe.publish(pose_of(), with_points=False)
    broken = PointCloud2()
    broken.header.stamp = to_stamp(1)
    probe._points.publish(broken)
    probe.until_values(failed="1")
    probe.publish(pose_of())
    probe.until(lambda: heard)
    assert len(heard) == 1


# --- VMC: the avatar's kinematics in Unity's left-handed axes


def turned(quaternion, vector):
    """A vector turned by a quaternion x y z w: the same formula in left-handed axes as in right-handed ones."""
    axis, w = np.array(quaternion[:3]), quaternion[3]
    return vector + 2.0 * np.cross(axis, np.cross(axis, vector) + w * vector)


CARRIERS = {
    **{"root": None, "Hips": "root", "Spine": "Hips", "Chest": "Spine", "UpperChest": "Chest", "Neck": "UpperChest"},
    **{f"{side}Shoulder": "UpperChest" for side in ("Left", "Right")},
    **{f"{side}UpperArm": f"{side}Shoulder" for side in ("Left", "Right")},
    **{f"{side}LowerArm": f"{side}UpperArm" for side in ("Left", "Right")},
    **{f"{side}UpperLeg": "Hips" for side in ("Left", "Right")},
    **{f"{side}LowerLeg": f"{side}UpperLeg" for side in ("Left", "Right")},
}


def in_avatar(bones, name, vector):
    """A vector in a bone, in the avatar's world; bones that the avatar has not are left out of the chain."""
    while name is not None:
        if name in bones:
            place, quaternion = np.array(bones[name][:3]), bones[name][3:]
            vector = place + turned(quaternion, np.asarray(vector, float))
        name = CARRIERS[name]
    return vector


def in_unity(point_world):
    """From x forward, y left, z up to Unity's x right, y up, z forward."""
    x, y, z = point_world
    return np.array([-y, z, x])


def test_an_avatar_takes_the_person_s_posture_and_place_with_all_bones_or_those_it_must_have(open_probe):
    receiver, received = socket.socket(socket.AF_INET, socket.SOCK_DGRAM), []
    receiver.bind(("127.0.0.1", 0))
    with receiver:
        probe = open_probe(BridgeProbe, VmcBridge, port=receiver.getsockname()[1]).start()
        for pose in (pose_of(), BENT):
            probe.publish(pose)
            probe.until(lambda: select.select([receiver], [], [], 0.0)[0], "a bundle")
            received.append(receiver.recv(65535))
    at_rest, bent = ([(each.address, each.params) for each in OscBundle(datagram)] for datagram in received)
    assert [address for address, _ in bent].count("/VMC/Ext/Bone/Pos") == len(BONES) + len(RIGID)
    assert ("/VMC/Ext/OK", [1]) in bent
    rest = {values[0]: values[1:] for address, values in at_rest if address.endswith("/Pos")}
    assert all(np.allclose(np.abs(values[3:]), [0, 0, 0, 1], atol=1e-6) for values in rest.values())  # of a T-pose
    bones = {values[0]: values[1:] for address, values in bent if address.endswith("/Pos")}
    assert bones["root"][1] == 0.0 and bones["root"][3:] == [0.0, 0.0, 0.0, 1.0]
    for avatars in (bones, {name: place for name, place in bones.items() if name not in RIGID}):
        assert_posture(avatars, dict(zip(POINT_NAMES, forward(BODY, BENT), strict=True)))


def assert_posture(bones, points):
    """The avatar's joints, hands and feet are where the person's are."""
    for joint in JOINTS:
        if joint.name in BONES and joint.point is not None:
            place = in_avatar(bones, BONES[joint.name], np.zeros(3))
            np.testing.assert_allclose(place, in_unity(points[joint.point]), atol=1e-5)
    for side, left in (("left", -1.0), ("right", 1.0)):  # in a T-pose forearms point sideways, calves down
        forearm = np.linalg.norm(points[f"{side}_hand"] - points[f"{side}_elbow"])
        calf = np.linalg.norm(points[f"{side}_foot"] - points[f"{side}_knee"])
        hand = in_avatar(bones, f"{side.title()}LowerArm", [left * forearm, 0.0, 0.0])
        foot = in_avatar(bones, f"{side.title()}LowerLeg", [0.0, -calf, 0.0])
        np.testing.assert_allclose(hand, in_unity(points[f"{side}_hand"]), atol=1e-5)
        np.testing.assert_allclose(foot, in_unity(points[f"{side}_foot"]), atol=1e-5)


def test_a_machine_that_is_none_fails_the_configuration_with_a_remedy(open_probe):
    probe = open_probe(BridgeProbe, VmcBridge, host="no machine")
    assert probe.node.trigger_configure() == FAILURE
    probe.until_said("there is no machine 'no machine'. Give a name or an address.")


# --- Lab Streaming Layer


def test_a_recorder_of_lsl_gets_points_and_angles_with_the_instant_of_exposure(open_probe):
    pylsl = pytest.importorskip("pylsl", reason="pylsl (optional) is not installed", exc_type=Exception)
    probe = open_probe(BridgeProbe, LslBridge).start()
    (found,) = pylsl.resolve_byprop("source_id", "sagoma /mocap", timeout=20.0)
    inlet = pylsl.StreamInlet(found)
    inlet.open_stream(timeout=20.0)
    labels = inlet.info().get_channel_labels()
    age_s = 0.25
    before_s = pylsl.local_clock() - age_s
    probe.publish(BENT, probe.peer.get_clock().now().nanoseconds - round(age_s * 1e9))
    received = []
    probe.until(lambda: received.append(inlet.pull_sample(timeout=0.0)) or received[-1][0] is not None, "a sample")
    sample, stamp_s = received[-1]
    after_s = pylsl.local_clock() - age_s
    assert before_s - 1e-3 < stamp_s < after_s + 1e-3
    values = dict(zip(labels, sample, strict=True))
    points = dict(zip(POINT_NAMES, forward(BODY, BENT), strict=True))
    for name, point in points.items():
        np.testing.assert_allclose([values[f"{name}_{axis}"] for axis in "xyz"], point, atol=1e-5)
    assert values["left_elbow_flexion"] == pytest.approx(70.0, abs=1e-3)
    assert inlet.info().get_channel_units()[0] == "meters" and found.type() == "MoCap"
