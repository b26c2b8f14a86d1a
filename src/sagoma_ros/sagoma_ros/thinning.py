"""The rule by which all clients thin out (`mocap_packets.thinning`), to and from a message that people can read."""

from __future__ import annotations

import math

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus

from capture_rig.errors import InputError
from mocap_packets.thinning import FrameDecimation

from .health import HOST
from .messages import key_values, to_ns, to_stamp

TOPIC = "hull/thinning"
_INTEGERS = ("resume_ns", "phase_ns", "keep", "of")


def thinning_message(rule: FrameDecimation, text: str = "") -> DiagnosticArray:
    """Return a rule as one status, stamped with the first capture stamp that it holds for; ``text`` says why."""
    thins = rule.keep < rule.of
    status = DiagnosticStatus(
        level=DiagnosticStatus.WARN if thins else DiagnosticStatus.OK,
        name="hull_server: thinning",
        hardware_id=HOST,
        message=text or ("thinned" if thins else "every frame"),
        values=key_values({name: getattr(rule, name) for name in _INTEGERS} | {"period_ns": f"{rule.period_ns:.3f}"}),
    )
    message = DiagnosticArray(status=[status])
    message.header.stamp = to_stamp(rule.from_ns)
    return message


def read_thinning(message: DiagnosticArray, where: str) -> FrameDecimation:
    """Return the inverse of :func:`thinning_message`. Raises InputError for a message that holds no rule."""
    values = {pair.key: pair.value for status in message.status[:1] for pair in status.values}
    try:
        numbers = {name: int(values[name]) for name in _INTEGERS}
        rule = FrameDecimation(from_ns=to_ns(message.header.stamp), period_ns=float(values["period_ns"]), **numbers)
    except (KeyError, ValueError) as error:
        remedy = "Run the same version on camera PCs and server."
        raise InputError(f"is no rule of thinning: {error!r}", where=where, remedy=remedy) from error
    if not (0 < rule.keep <= rule.of and 0.0 < rule.period_ns < math.inf):
        raise InputError(
            f"keeps {rule.keep} of {rule.of} every {rule.period_ns} ns", where=where, remedy="Restart the hull server."
        )
    return rule
