#!/usr/bin/env python3
"""Writes the list of every node parameter into docs/reference/parameters.md: ``scripts/reference.py``."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path

from camera_client.settings import CameraClientSettings
from capture_rig.settings import Leaf, leaves
from ekf_tracker.settings import EkfNodeSettings
from hull_server.settings import NodeSettings as HullNodeSettings
from icp_tracker.settings import IcpNodeSettings
from motion_bridges.lsl_node import LslSettings
from motion_bridges.person_node import PersonSettings
from motion_bridges.vmc_node import VmcSettings

PAGE = Path(__file__).resolve().parents[1] / "docs" / "reference" / "parameters.md"
SETTINGS = {
    "camera_client": CameraClientSettings,
    "hull_server": HullNodeSettings,
    "icp_tracker": IcpNodeSettings,
    "ekf_tracker": EkfNodeSettings,
    "isb_angles": PersonSettings,
    "vmc_bridge": VmcSettings,
    "lsl_bridge": LslSettings,
}
GENERATED = re.compile(r"(<!-- parameters -->\n).*(<!-- /parameters -->)", re.S)


def with_lists(page: str) -> str:
    """Return the page with the lists of today's settings between its marks."""
    return GENERATED.sub(lambda marks: marks[1] + "\n".join(lists()) + "\n" + marks[2], page)


def lists() -> Iterator[str]:
    """Yield the lines of one list a node, parameters in the order of its settings class."""
    for node, settings in SETTINGS.items():
        yield from ("", f"### {node}", "")
        for leaf in leaves(settings):
            values = "; ".join(filter(None, (_default(leaf), _allowed(leaf))))
            yield f"- `{leaf.key}`{f' ({values})' if values else ''}: {leaf.metadata['help']}"


def _default(leaf: Leaf) -> str:
    """Return the default with its unit; nothing for an empty one."""
    value = str(leaf.default).lower() if isinstance(leaf.default, bool) else str(leaf.default)
    return "" if leaf.default in ("", []) else f"{value} {leaf.metadata['unit']}".strip()


def _allowed(leaf: Leaf) -> str:
    """Return the other choices, or the bounds that the setting names."""
    low, high, choices = (leaf.metadata[name] for name in ("low", "high", "choices"))
    if choices:
        return ", ".join(str(choice) for choice in choices if choice != leaf.default)
    if low is not None and high is None:
        return f"from {low:.12g}"
    return leaf.range_text if leaf.has_range else ""


if __name__ == "__main__":
    PAGE.write_text(with_lists(PAGE.read_text(encoding="utf-8")), encoding="utf-8")
