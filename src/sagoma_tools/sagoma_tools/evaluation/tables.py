"""Scores and runs as tables for people, with rich."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from rich.console import Console
from rich.table import Table

from stick_figure.skeleton import ANGLE_NAMES, POINT_NAMES

from ..processes import Usage
from .scores import Scores


def print_scores(console: Console, scores: Scores) -> None:
    """Point errors (mean, and without constant offsets) and angle errors, one row each."""
    table = Table(title="error against the truth", title_justify="left", box=None, pad_edge=False)
    for title in ("point", "mean mm", "without offset mm"):
        table.add_column(title, justify="left" if title == "point" else "right")
    for name, plain, centred in zip(POINT_NAMES, scores.point_mm, scores.point_mm_without_offset, strict=True):
        table.add_row(name.replace("_", " "), f"{plain:.1f}", f"{centred:.1f}")
    table.add_row("mean of all", f"{scores.mean_mm:.1f}", f"{scores.mean_mm_without_offset:.1f}", style="bold")
    console.print(table)
    console.print(
        f"{scores.tracked} of {scores.frames} frames tracked; 95 % of errors below {scores.p95_mm:.0f} mm; "
        f"{100 * scores.over_200mm:.1f} % of frames with a point over 200 mm; "
        f"{100 * scores.inside_95:.0f} % of errors inside their 95 % ellipsoid"
    )
    if scores.angle_rmse_deg is not None:
        _print_angles(console, scores.angle_rmse_deg)


def _print_angles(console: Console, rmse_deg: np.ndarray) -> None:
    table = Table(title="RMSE of the angles, degrees", title_justify="left", box=None, pad_edge=False)
    for _ in range(3):
        table.add_column("angle")
        table.add_column("RMSE", justify="right")
    cells = [(name.replace("_", " "), f"{value:.1f}") for name, value in zip(ANGLE_NAMES, rmse_deg, strict=True)]
    for row in range(0, len(cells), 3):
        table.add_row(*(text for cell in cells[row : row + 3] for text in cell))
    console.print(table)


def print_latency(console: Console, latency_ms: Mapping[str, np.ndarray]) -> None:
    """One row a stage: median, 95th percentile, largest."""
    table = Table(title="time of each stage", title_justify="left", box=None, pad_edge=False)
    for title in ("stage", "p50 ms", "p95 ms", "max ms"):
        table.add_column(title, justify="left" if title == "stage" else "right")
    for stage, values in latency_ms.items():
        p50, p95 = np.percentile(values, [50, 95])
        table.add_row(stage.removesuffix("_ms"), f"{p50:.2f}", f"{p95:.2f}", f"{values.max():.2f}")
    console.print(table)


def print_nodes(
    console: Console,
    usage: Mapping[str, Usage],
    cpu_ms_per_set: Mapping[str, float],
    diagnostics: Mapping[str, Mapping[str, str]],
) -> None:
    """One row a node: resident memory and its peak, processor time a frame set, results, latency."""
    table = Table(title="nodes", title_justify="left", box=None, pad_edge=False)
    for title in ("node", "resident MiB", "peak MiB", "cpu ms a set", "results", "latency p50 ms", "p95 ms"):
        table.add_column(title, justify="left" if title == "node" else "right")
    values = {_label(name): report for name, report in diagnostics.items()}
    for label, used in usage.items():
        memory = f"{used.resident_mib:.0f}", f"{used.peak_mib:.0f}"
        cpu = f"{cpu_ms_per_set[label]:.1f}" if label in cpu_ms_per_set else ""
        report = values.get(label, {})
        keys = ("results", "latency_p50_ms", "latency_p95_ms")
        table.add_row(label, *memory, cpu, *(report.get(key, "") for key in keys))
    console.print(table)


def _label(full_name: str) -> str:
    namespace, _, name = full_name.rpartition("/")
    return namespace.strip("/") or name
