"""The rule of thinning survives the message; a message that holds none is refused."""

import pytest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus

from capture_rig.errors import InputError
from mocap_packets.thinning import EVERY_FRAME, FrameDecimation
from sagoma_ros.messages import read_thinning, thinning_message

RULE = FrameDecimation(
    1_790_000_000_123_456_789, 1_790_000_000_200_000_000, 1_789_999_999_000_000_001, 16_666_666.667, 9, 20
)


@pytest.mark.parametrize("rule", [RULE, EVERY_FRAME])
def test_rule_survives_the_message(rule):
    assert read_thinning(thinning_message(rule, "thinned to 9 of 20"), "test") == rule


def test_message_warns_while_it_thins_and_says_why():
    status = thinning_message(RULE, "thinned to 9 of 20: the graph holds 27 Hz of 60").status[0]
    assert status.level == DiagnosticStatus.WARN and "27 Hz" in status.message
    assert thinning_message(EVERY_FRAME).status[0].level == DiagnosticStatus.OK


SPOILT = [("keep", "0"), ("keep", "21"), ("of", "x"), ("period_ns", "0"), ("phase_ns", None)]


@pytest.mark.parametrize(("key", "value"), SPOILT)
def test_message_without_a_usable_rule_is_refused(key, value):
    message = thinning_message(RULE)
    message.status[0].values = [pair for pair in message.status[0].values if pair.key != key or value is not None]
    for pair in message.status[0].values:
        pair.value = value if pair.key == key else pair.value
    with pytest.raises(InputError, match="test"):
        read_thinning(message, "test")
    with pytest.raises(InputError):
        read_thinning(DiagnosticArray(), "test")
