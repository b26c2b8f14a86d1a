"""``--start-at``: the instant at which footage begins on every machine that plays a part of it.

Machines that are started one after the other cannot agree on a beginning by themselves, and frames of different
instants make no frame set, or a wrong one. Live cameras need none of this: they expose when they expose.
"""

from __future__ import annotations

import datetime
from collections.abc import Sequence
from typing import Any

from capture_rig.errors import InputError
from sagoma_bringup.graph import ALL_CAMERAS, NodeSpec, Role, apply_settings

FARTHEST_S = 3600.0  # the camera client refuses stamps further ahead; footage that began long ago is over
WAIT_S = 300.0  # at rate 0 nobody begins before all cameras are there, as in launched footage
EXAMPLE = "Write it as 14:30:05, 2026-03-01T14:30:05, or with a Z for UTC."


def start_instant_ns(text: str, now_ns: int) -> int:
    """Return a time of day (today's, of this machine's time zone) or a date and time as ns since 1970.

    Raises InputError for what is neither, and for more than an hour from now, which is a slip.
    """
    now = datetime.datetime.fromtimestamp(now_ns * 1e-9).astimezone()
    if ":" not in text:  # 14.30 would be read as 14 hours and three tenths
        raise InputError(f"'{text}' is no time", where="--start-at", remedy=EXAMPLE)
    try:
        time_of_day = datetime.time.fromisoformat(text)
        instant = datetime.datetime.combine(now.astimezone(time_of_day.tzinfo).date(), time_of_day)
    except ValueError:
        try:
            instant = datetime.datetime.fromisoformat(text)
        except ValueError:
            raise InputError(f"'{text}' is no time", where="--start-at", remedy=EXAMPLE) from None
    ahead_s = (instant.astimezone() - now).total_seconds()
    if abs(ahead_s) > FARTHEST_S:
        side = "ahead" if ahead_s > 0 else "ago"
        what = f"{text} is {datetime.timedelta(seconds=round(abs(ahead_s)))} {side}: it is {now:%H:%M:%S %Z} here"
        raise InputError(what, where="--start-at", remedy="Give a moment within the hour, the same on every machine.")
    return round(instant.astimezone().timestamp() * 1e9)


def in_step(graph: Sequence[NodeSpec], cameras: int, start_at_ns: int | None, rate: float) -> list[NodeSpec]:
    """Return the part of a session's graph that runs here, its footage beginning with the other machines'.

    cameras : of the whole session. Raises InputError for a part of several cameras without a common beginning.
    """
    here = [node.label for node in graph if node.role is Role.CAMERA]
    if start_at_ns is None:
        if 0 < len(here) < cameras:
            raise InputError(
                f"of {cameras} cameras only {', '.join(here)} plays here, and its frames would not meet the others'",
                where="--only",
                remedy="Give every machine the same moment to begin, a minute from now: --start-at 14:30:05.",
            )
        return list(graph)
    settings: dict[str, Any] = {"epoch_ns": start_at_ns}
    if rate > 0:
        settings |= {"keep_up": True, "wait_for_cameras": False}
    else:
        settings |= {"wait_for_cameras": True, "wait_for_consumer_s": WAIT_S}
    prefix = f"{ALL_CAMERAS}.footage."
    return apply_settings(graph, {f"{prefix}{key}": value for key, value in settings.items()} if here else {})
