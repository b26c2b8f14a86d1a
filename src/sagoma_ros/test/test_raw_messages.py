"""Stamps without loss, the rule of thinning, and what delivery rests on."""

from __future__ import annotations

import pytest
from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rclpy.qos import DurabilityPolicy, QoSCompatibility, QoSProfile, ReliabilityPolicy, qos_check_compatible
from rclpy.serialization import serialize_message
from sensor_msgs.msg import CameraInfo
from std_msgs.msg import Header

from capture_rig.errors import InputError
from mocap_packets.thinning import EVERY_FRAME, FrameDecimation
from sagoma_ros import qos
from sagoma_ros.limits import same_but_for_stamp
from sagoma_ros.messages import read_thinning, thinning_message, to_ns, to_stamp


def test_messages_are_compared_without_their_stamps() -> None:
    def info(stamp: int, width: int) -> bytes:
        return serialize_message(CameraInfo(header=Header(stamp=Time(sec=stamp), frame_id="cam01"), width=width))

    assert same_but_for_stamp(info(1, 640), info(2, 640))
    assert not same_but_for_stamp(info(1, 640), info(1, 641))
    assert not same_but_for_stamp(info(1, 640), None)


# --- stamps, thinning and quality of service --------------------------------------------------------------------------

RULE = FrameDecimation(
    1_790_000_000_123_456_789, 1_790_000_000_200_000_000, 1_789_999_999_000_000_001, 16_666_666.667, 9, 20
)


@pytest.mark.parametrize("ns", [0, 1, 999_999_999, 1_000_000_000, 1_700_000_000_123_456_789])
def test_stamp_keeps_every_nanosecond(ns: int) -> None:
    stamp = to_stamp(ns)
    assert (stamp.sec, stamp.nanosec) == (ns // 10**9, ns % 10**9)
    assert to_ns(stamp) == ns


@pytest.mark.parametrize(
    ("rule", "level", "said"),
    [(RULE, DiagnosticStatus.WARN, "thinned to 9 of 20"), (EVERY_FRAME, DiagnosticStatus.OK, "every frame")],
)
def test_rule_of_thinning_survives_the_message_which_warns_while_it_thins_and_says_why(
    rule: FrameDecimation, level: bytes, said: str
) -> None:
    message = thinning_message(rule, said if rule is RULE else "")
    assert read_thinning(message, "test") == rule
    assert (message.status[0].level, message.status[0].message) == (level, said)


@pytest.mark.parametrize(
    ("key", "value"), [("keep", "0"), ("keep", "21"), ("of", "x"), ("period_ns", "0"), ("phase_ns", None), (None, None)]
)
def test_message_without_a_usable_rule_of_thinning_is_refused(key: str | None, value: str | None) -> None:
    message = DiagnosticArray() if key is None else thinning_message(RULE)
    for status in message.status:
        status.values = [pair for pair in status.values if pair.key != key or value is not None]
        for pair in status.values:
            pair.value = value if pair.key == key else pair.value
    with pytest.raises(InputError, match="test"):
        read_thinning(message, "test")


@pytest.mark.parametrize("subscriber", [qos.SILHOUETTE_SUBSCRIBER, qos.SILHOUETTE_RELIABLE_SUBSCRIBER])
def test_silhouettes_reach_the_live_server_and_the_recorder(subscriber: QoSProfile) -> None:
    assert qos_check_compatible(qos.SILHOUETTE_PUBLISHER, subscriber)[0] != QoSCompatibility.ERROR


def test_publishers_are_reliable_the_live_server_is_not_and_latched_topics_keep_one_message() -> None:
    for profile in (qos.SILHOUETTE_PUBLISHER, qos.RESULT, qos.LATCHED):
        assert profile.reliability == ReliabilityPolicy.RELIABLE
    assert qos.SILHOUETTE_SUBSCRIBER.reliability == ReliabilityPolicy.BEST_EFFORT
    assert qos.SILHOUETTE_SUBSCRIBER.depth >= 20
    assert (qos.LATCHED.durability, qos.LATCHED.depth) == (DurabilityPolicy.TRANSIENT_LOCAL, 1)
