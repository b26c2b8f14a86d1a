#!/usr/bin/env python3
"""Writes the table of every node parameter into docs/parameters.md: ``scripts/reference.py``."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path

from camera_client.settings import CameraClientSettings
from capture_rig.settings import Leaf, leaves
from ekf_tracker.settings import EkfNodeSettings
from hull_server.settings import NodeSettings as HullNodeSettings
from icp_tracker.settings import IcpNodeSettings

PAGE = Path(__file__).resolve().parents[1] / "docs" / "parameters.md"
SETTINGS = {
    "camera_client": CameraClientSettings,
    "hull_server": HullNodeSettings,
    "icp_tracker": IcpNodeSettings,
    "ekf_tracker": EkfNodeSettings,
}
GENERATED = re.compile(r"(<!-- parameters -->\n).*(<!-- /parameters -->)", re.S)


def with_tables(page: str) -> str:
    """Return the page with the tables of today's settings between its marks."""
    return GENERATED.sub(lambda marks: marks[1] + "\n".join(tables()) + "\n" + marks[2], page)


def tables() -> Iterator[str]:
    """Yield the lines of one table a node, parameters in the order of its settings class."""
    for node, settings in SETTINGS.items():
        yield from ("", f"### {node}", "| parameter | default | allowed | meaning |", "|---|---|---|---|")
        for leaf in leaves(settings):
            yield f"| `{leaf.key}` | {_default(leaf)} | {_allowed(leaf)} | {_cell(leaf.metadata['help'])} |"


def _default(leaf: Leaf) -> str:
    value = str(leaf.default).lower() if isinstance(leaf.default, bool) else leaf.default
    if value in ("", []):
        return ""
    return f"{_cell(str(value))} {leaf.metadata['unit']}".strip()


def _allowed(leaf: Leaf) -> str:
    if leaf.metadata["choices"]:
        return ", ".join(map(str, leaf.metadata["choices"]))
    return leaf.range_text if leaf.has_range else ""


def _cell(text: str) -> str:
    return text.replace("|", "\\|")


if __name__ == "__main__":
    PAGE.write_text(with_tables(PAGE.read_text(encoding="utf-8")), encoding="utf-8")
