"""How every node is, as HTML: a block a node, in the colour of its level, with figures, what it says and since when."""

from __future__ import annotations

import time
from collections.abc import Mapping
from html import escape

from diagnostic_msgs.msg import DiagnosticStatus

from ..graph.diagnostics_table import STALE_S, NodeReport

GREEN, AMBER, RED, GREY = "#3cbe5a", "#f0aa1e", "#e5484d", "#868e96"
COLOURS = {DiagnosticStatus.OK: GREEN, DiagnosticStatus.WARN: AMBER, DiagnosticStatus.ERROR: RED}
RATE, AGE = "rate_hz", "latency_p50_ms"
"""Of the diagnostics: results a second, and how old they are (median)."""
SILENT = (
    "no word since {} ({:.0f} s): its process has ended, or its computer or network is down; see its log, and start it "
    "again"
)
NO_NODES = "no node is in the graph yet: `sagoma up SESSION` plays footage, docs/first_capture.md leads to cameras"
UNHEARD = "has not been heard yet"
SECONDS_FROM_MS = 2000.0
MOST_TEXT = 400
"""Characters of what a node says: more than any of ours, and less than a panel."""


def label_of(name: str) -> str:
    """Return what to call a node: a camera client by its camera."""
    return name.strip("/").removesuffix("/camera_client")


def is_camera(name: str) -> bool:
    """Is this the full name of a camera client?"""
    return name.endswith("/camera_client")


def trouble_of(report: NodeReport | None, now_s: float) -> str:
    """Return why nothing comes from a node: it is silent, or says error; empty while it works."""
    if report is None:
        return ""
    silent_s = now_s - report.heard_s
    if silent_s > STALE_S:
        return f"silent {silent_s:.0f} s"
    return "error" if COLOURS.get(report.level, RED) == RED else ""


def states_html(reports: Mapping[str, NodeReport | None], now_s: float) -> str:
    """Return a block a node (full name -> its last report), cameras last; those in trouble first of their kind."""
    if not reports:
        return _html(GREY, "nothing to see yet", "", NO_NODES)
    order = sorted(reports, key=lambda name: (is_camera(name), not trouble_of(reports[name], now_s), name))
    return "".join(_block(label_of(name), reports[name], now_s) for name in order)


def _block(label: str, report: NodeReport | None, now_s: float) -> str:
    if report is None:
        return _html(GREY, label, "", UNHEARD)
    silent_s = now_s - report.heard_s
    if silent_s > STALE_S:
        since = time.strftime("%H:%M:%S", time.localtime(time.time() - silent_s))
        return _html(RED, label, "", SILENT.format(since, silent_s))
    figures = [f"{report.values[RATE]} Hz"] if RATE in report.values else []
    figures += [age_of(report.values[AGE])] if AGE in report.values else []
    figures += [f"{count} {key.replace('_', ' ')}" for key, count in report.losses().items()]
    return _html(COLOURS.get(report.level, RED), label, ", ".join(figures), report.message)


def age_of(text: str) -> str:
    """Say how old results are, of milliseconds as a node writes them; its own text where that is no number."""
    try:
        age_ms = float(text)
    except ValueError:
        return text
    return f"{age_ms:.0f} ms old" if age_ms < SECONDS_FROM_MS else f"{age_ms / 1e3:.1f} s old"


def _html(colour: str, label: str, figures: str, says: str) -> str:
    return (
        f'<div style="border-left: 4px solid {colour}; padding: 0 0 2px 8px; margin: 0 10px 6px 10px; font-size: 13px; '
        f'line-height: 1.35; overflow-wrap: anywhere">'
        f"<b>{escape(label[:MOST_TEXT])}</b> "
        f'<span style="opacity: 0.7">{escape(figures[:MOST_TEXT])}</span>'
        f"<br>{escape(says[:MOST_TEXT])}</div>"
    )
