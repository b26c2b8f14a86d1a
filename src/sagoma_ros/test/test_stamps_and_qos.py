"""Stamps without loss, and the quality of service that the graph's delivery rests on."""

from __future__ import annotations

import pytest
from rclpy.qos import DurabilityPolicy, QoSCompatibility, QoSProfile, ReliabilityPolicy, qos_check_compatible

from sagoma_ros import qos
from sagoma_ros.messages import to_ns, to_stamp


@pytest.mark.parametrize("ns", [0, 1, 999_999_999, 1_000_000_000, 1_700_000_000_123_456_789])
def test_stamp_keeps_every_nanosecond(ns: int) -> None:
    stamp = to_stamp(ns)
    assert (stamp.sec, stamp.nanosec) == (ns // 10**9, ns % 10**9)
    assert to_ns(stamp) == ns


@pytest.mark.parametrize("subscriber", [qos.SILHOUETTE_SUBSCRIBER, qos.SILHOUETTE_RELIABLE_SUBSCRIBER])
def test_silhouettes_reach_the_live_server_and_the_recorder(subscriber: QoSProfile) -> None:
    assert qos_check_compatible(qos.SILHOUETTE_PUBLISHER, subscriber)[0] != QoSCompatibility.ERROR


def test_publishers_are_reliable_and_the_live_server_is_not() -> None:
    for profile in (qos.SILHOUETTE_PUBLISHER, qos.RESULT, qos.LATCHED):
        assert profile.reliability == ReliabilityPolicy.RELIABLE
    assert qos.SILHOUETTE_SUBSCRIBER.reliability == ReliabilityPolicy.BEST_EFFORT
    assert qos.SILHOUETTE_SUBSCRIBER.depth >= 20


def test_latched_topics_reach_those_who_come_later() -> None:
    assert (qos.LATCHED.durability, qos.LATCHED.depth) == (DurabilityPolicy.TRANSIENT_LOCAL, 1)
