"""Overload for bench/live.py: twice what the server holds, then half of that; cameras follow the server's rule.

What the server holds is looked for first, with a server that thins nothing out: the rate rises by a tenth until sets
are dropped or wait. Then the server that is measured gets twice that rate, and half of it again.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from report import Table

import numpy as np
from clips import Clip
from live_servers import TREE, running

FIRST_HZ, STEP = 45.0, 1.1
SETTLE_S, TRY_S = 1.5, 2.5
HELD_SHARE, HELD_P95_MS = 0.99, 100.0  # answered, and within this, at a rate that is held
OVERLOAD_S, LOW_S = 15.0, 6.0


@dataclass(frozen=True)
class OverloadFigures:
    """Rates in Hz; ``overload_share``: of the held rate that is answered, whole, at twice that rate."""

    hz_held: float
    overload_hz_sent: float
    overload_hz_answered: float
    overload_share: float
    overload_incomplete: int
    overload_latency_p50_ms: float
    overload_latency_p95_ms: float
    recovery_s: float


def measure_overload(
    clip: Clip, processes: str, folder: Path, domain: int, settings: Mapping[str, Any], hz: float | None = None
) -> OverloadFigures:
    """Find the rate that is held (or take ``hz``), play twice that rate, then half of it."""
    if hz is None:
        with running(
            "held", TREE, processes, clip, folder / "held", domain, {**settings, "hull_server.thin_out": False}
        ) as s:
            hz = held_hz(s)
    with running("overload", TREE, processes, clip, folder / "overload", domain + 2, settings) as server:
        _, over, low = server.play_phases([(0.5 * hz, SETTLE_S), (2.0 * hz, OVERLOAD_S), (0.5 * hz, LOW_S)])
    ages = [age for _, age in over["ages"]]
    answered_hz = (len(over["answered_s"]) - over["incomplete"]) / OVERLOAD_S
    return OverloadFigures(
        hz_held=round(hz, 1),
        overload_hz_sent=round(2 * hz, 1),
        overload_hz_answered=round(answered_hz, 1),
        overload_share=round(answered_hz / hz, 3),
        overload_incomplete=over["incomplete"],
        overload_latency_p50_ms=round(float(np.percentile(ages, 50)), 1),
        overload_latency_p95_ms=round(float(np.percentile(ages, 95)), 1),
        recovery_s=round(recovery_s(low["answered_s"], low["hz"], low["seconds"]), 2),
    )


def held_hz(server: Any) -> float:
    """The highest rate, in steps of a tenth, at which sets are neither dropped nor wait."""
    hz, held = FIRST_HZ, 0.0
    while True:
        _, tried = server.play_phases([(hz, SETTLE_S), (hz, TRY_S)])
        answered, sent = len(tried["answered_s"]), tried["sent"]
        p95 = float(np.percentile([age for _, age in tried["ages"]], 95)) if tried["ages"] else np.inf
        print(f"{hz:.0f} Hz: {answered} of {sent} answered, 95 % within {p95:.0f} ms", flush=True)
        if answered < HELD_SHARE * sent or p95 > HELD_P95_MS:
            return held or hz
        held, hz = hz, hz * STEP


def recovery_s(answered_s: list[float], hz: float, seconds: float) -> float:
    """When the last exposure lay that was not answered, since the phase began; its length where it never ended."""
    gaps = np.diff([0.0, *answered_s, seconds])
    late = np.flatnonzero(gaps > 1.5 / hz)
    return 0.0 if len(late) == 0 else float([0.0, *answered_s, seconds][late[-1] + 1])


def print_overload(figures: OverloadFigures) -> None:
    """One row."""
    table = Table(
        "held Hz:>8.1f | offered Hz:>11.1f | answered Hz:>12.1f | share:>6.2f | incomplete:>11d | p50 ms:>7.1f"
        " | p95 ms:>7.1f | recovery s:>11.2f",
        "twice the rate that is held, then half of it: sets answered, latency, time until every set is answered again",
    )
    table.row(*vars(figures).values())
