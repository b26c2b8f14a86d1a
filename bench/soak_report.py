"""What a soak has shown: tables, a plot, and the sum rule, from its rows; see bench/soak.py for the files."""

from __future__ import annotations

import csv
import json
from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from report import Table

import matplotlib
import numpy as np
from scipy.stats import theilslopes

from capture_rig.errors import InputError

matplotlib.use("Agg")
from matplotlib import pyplot as plt

HELD = {"rss_mib": "resident MiB", "uss_mib": "unshared MiB", "anon_mib": "anonymous MiB", "shm_mib": "shared MiB"}
HELD |= {"threads": "threads", "handles": "handles"}
EDGE_S = 2.0  # before a fault begins is noticed, and after it is over: sets under way
IN_FLIGHT = 16  # frames on their way between two counters, at most: some a camera
BIN_S = 60.0  # samples are reduced to medians of a minute: faults and motion come and go within it
BLOCK_S = 600.0  # longer than a fault, its recovery and the calm after it (docs/how-to/faults.md)
RESAMPLES, CONFIDENCE_PERCENT = 400, (2.5, 97.5)
WARM_UP_S = 600.0  # left out after a process's start: kernels are loaded, buffers and caches fill
LEAST_BINS = 10
FLAT_SHARE_PER_DAY = 0.1  # growth that is allowed: a tenth of what is held, in a day
CAMERA, SERVER = "camera_client", "hull_server"

Rows = dict[str, np.ndarray]


def read_rows(path: Path) -> Rows:
    """Return the columns of a CSV file: floats, NaN where a cell is empty; text where one is no number."""
    if not path.exists():
        raise InputError("is not there", where=str(path), remedy="Name the output folder of a soak.")
    with path.open(newline="", encoding="utf-8") as file:
        header, *rows = list(csv.reader(file))
    whole = [row for row in rows if len(row) == len(header)]  # the last one may be cut
    return {name: _column([row[k] for row in whole]) for k, name in enumerate(header)}


def report_on(out: Path) -> dict[str, Any]:
    """Print the tables of a soak, draw OUT/soak.png, and return the figures."""
    settings = json.loads((out / "soak.json").read_text())
    exposures, processes = read_rows(out / "exposures.csv"), read_rows(out / "processes.csv")
    faults, counters = read_rows(out / "faults.csv"), read_rows(out / "counters.csv")
    hours = (exposures["unix_s"][-1] - exposures["unix_s"][0]) / 3600.0
    print(
        f"{hours:.2f} h, {settings['hz']:g} exposures a second, {len(faults['kind'])} faults, seed {settings['seed']}"
    )
    figures: dict[str, Any] = {"hours": round(hours, 3), "faults": len(faults["kind"])}
    figures["exposures"] = print_exposures(exposures, faults)
    figures["thinned_percent"] = round(thinned_percent(counters), 2)
    print(f"left out by the rule of overload: {figures['thinned_percent']} % of the cameras' frames")
    figures["recovery_s"] = print_faults(faults, exposures, settings["hz"])
    figures["trends"] = print_trends(processes, exposures)
    figures["sum_rule"] = print_sum_rule(counters)
    draw(out / "soak.png", processes, exposures, faults)
    print(f"\npicture: {out / 'soak.png'}")
    return figures


def print_exposures(exposures: Rows, faults: Rows) -> dict[str, Any]:
    """Print what became of every exposure: in calm times, and from a fault's beginning to its recovery."""
    disturbed = during_faults(exposures["unix_s"], faults)
    shares = ("whole", "less a camera", "set, no answer", "no set", "tracked")
    columns = {"exposures": "<20", "number": ">7d"} | {f"{share} %": ">8.2f" for share in shares}
    table = Table(columns | {f"p{p} ms": ">7.1f" for p in (50, 95, 99)}, markdown=True)
    figures = {}
    for name, among in (("calm", ~disturbed), ("faults and recovery", disturbed), ("all", np.ones_like(disturbed))):
        figures[name] = _shares({key: column[among] for key, column in exposures.items()})
        table.row(name, *figures[name].values())
    return figures


def thinned_percent(counters: Rows) -> float:
    """Return the share of the frames delivered to camera clients that all of them left out on purpose; NaN without."""
    totals = {"frames_thinned": 0.0, "delivered": 0.0}
    for key in totals:
        for pid in np.unique(counters["pid"][np.isfinite(counters["delivered"])]):
            totals[key] += float(np.nan_to_num(counters[key][counters["pid"] == pid]).max())
    return 100.0 * totals["frames_thinned"] / totals["delivered"] if totals["delivered"] else float("nan")


def _shares(exposures: Rows) -> dict[str, Any]:
    answered, has_set = ~np.isnan(exposures["age_ms"]), exposures["cameras"] > 0
    whole = exposures["missing"] == 0
    count = max(len(answered), 1)
    groups = {
        "whole": answered & has_set & whole,
        "less_a_camera": answered & ~(has_set & whole),
        "no_answer": has_set & ~answered,
        "no_set": ~has_set & ~answered,
        "tracked": exposures["tracked"] > 0,
    }
    ages = exposures["age_ms"][answered]
    percentiles = np.percentile(ages, (50, 95, 99)) if len(ages) else np.full(3, np.nan)
    shares = {key: round(100.0 * float(among.sum()) / count, 3) for key, among in groups.items()}
    return {"number": len(answered), **shares} | {
        f"p{p}_ms": round(float(age), 1) for p, age in zip((50, 95, 99), percentiles, strict=True)
    }


def during_faults(unix_s: np.ndarray, faults: Rows) -> np.ndarray:
    """Return (N,) whether each instant lies between a fault's beginning and its recovery."""
    among = np.zeros(len(unix_s), bool)
    for begun_s, ended_s, recovered_s in zip(*(faults[k] for k in ("begun_s", "ended_s", "recovered_s")), strict=True):
        over_s = recovered_s if np.isfinite(recovered_s) else ended_s + 120.0
        among |= (unix_s >= begun_s - EDGE_S) & (unix_s <= over_s + EDGE_S)
    return among


def print_faults(faults: Rows, exposures: Rows, hz: float) -> dict[str, Any]:
    """Print for each kind of fault how often it came, how long all was whole again after it, what was lost."""
    columns = {"fault": "<18", "times": ">5d", "seconds each": ">6.1f", "whole again after s, median": ">6.1f"}
    columns |= {"worst": ">6.1f", "not within 120 s": ">4d", "exposures without answer, each": ">6.1f"}
    table = Table(columns | {"without joint state": ">6.1f"}, markdown=True)
    figures = {}
    for kind in sorted(set(faults["kind"])):
        of = faults["kind"] == kind
        after_s = faults["recovered_s"][of] - faults["ended_s"][of]
        lost = [
            lost_between(exposures, *span)
            for span in zip(faults["begun_s"][of], faults["recovered_s"][of], strict=True)
        ]
        came = after_s[np.isfinite(after_s)]
        row = {
            "times": int(of.sum()),
            "seconds": round(float(np.mean(faults["ended_s"][of] - faults["begun_s"][of])), 1),
            "median_s": round(float(np.median(came)), 2) if len(came) else None,
            "worst_s": round(float(came.max()), 2) if len(came) else None,
            "not_recovered": int(np.isnan(after_s).sum()),
            "unanswered": round(float(np.mean([unanswered for unanswered, _ in lost])), 1),
            "untracked": round(float(np.mean([untracked for _, untracked in lost])), 1),
        }
        table.row(kind, *row.values())
        figures[kind] = row
    return figures


def lost_between(exposures: Rows, begun_s: float, over_s: float) -> tuple[int, int]:
    """Return how many exposures of a time had no answer, and how many no joint state."""
    among = (exposures["unix_s"] >= begun_s) & (exposures["unix_s"] <= over_s)
    return int((among & np.isnan(exposures["age_ms"])).sum()), int((among & (exposures["tracked"] == 0)).sum())


def print_trends(processes: Rows, exposures: Rows) -> dict[str, Any]:
    """Print the slope of what each process holds over its longest life, the first minutes left out."""
    columns = {"process": "<14", "of": "<14", "typical": ">8.1f", "per hour": ">9.3f", "95 % low": ">9.3f"}
    table = Table(columns | {"high": ">9.3f", "hours": ">6.2f", "verdict": "<14"}, markdown=True)
    figures: dict[str, Any] = {}

    def add(label: str, what: str, found: Trend) -> None:
        table.row(label, what, found.typical, found.per_hour, found.low, found.high, found.hours, found.verdict)
        figures[f"{label} {what}"] = {key: round(value, 4) for key, value in vars(found).items()} | {
            "verdict": found.verdict
        }

    for label in sorted(set(processes["process"])):
        among = longest_life(processes, label)
        since = among & (processes["unix_s"] > processes["unix_s"][among].min() + WARM_UP_S)
        for key, what in HELD.items():
            add(label, what, trend(processes["unix_s"][since], processes[key][since]))
    answered = ~np.isnan(exposures["age_ms"]) & (exposures["unix_s"] > exposures["unix_s"][0] + WARM_UP_S)
    add("graph", "latency ms", trend(exposures["unix_s"][answered], exposures["age_ms"][answered]))
    return figures


@dataclass(frozen=True)
class Trend:
    """Growth per hour with its 95 % interval, of a quantity with this typical size; ``hours`` were looked at."""

    per_hour: float
    low: float
    high: float
    typical: float
    hours: float

    @property
    def verdict(self) -> str:
        """ "flat" when the interval has zero in it, else which way it goes; "slight" below FLAT_SHARE_PER_DAY."""
        if not np.isfinite(self.per_hour):
            return "too short"
        if self.low <= 0.0 <= self.high:
            return "flat"
        slight = 24.0 * max(abs(self.low), abs(self.high)) <= FLAT_SHARE_PER_DAY * self.typical
        return f"{'slight ' if slight else ''}{'growth' if self.per_hour > 0 else 'fall'}"


def trend(unix_s: np.ndarray, values: np.ndarray, seed: int = 0) -> Trend:
    """Return the trend of values (N,) at instants (N,), s; NaN where there are fewer than LEAST_BINS minutes.

    The slope is Theil and Sen's (the median of all pairs' slopes), which a few leaps do not move. Its 95 % confidence
    interval comes from a block bootstrap of the residuals (Kuensch, Annals of Statistics 1989): whole blocks are drawn,
    so that what lasts for minutes in the samples lasts for minutes in the resamples, too.
    """
    bins = ((unix_s - unix_s[0]) // BIN_S).astype(int) if len(unix_s) else np.zeros(0, int)
    minutes = np.unique(bins)
    if len(minutes) < LEAST_BINS:
        typical = float(np.median(values)) if len(values) else np.nan
        return Trend(np.nan, np.nan, np.nan, typical, len(minutes) * BIN_S / 3600.0)
    hours = minutes * BIN_S / 3600.0
    medians = np.array([np.median(values[bins == minute]) for minute in minutes])
    slope, intercept = theilslopes(medians, hours)[:2]
    residuals = medians - intercept - slope * hours
    rng, block = np.random.default_rng(seed), min(round(BLOCK_S / BIN_S), len(minutes) // 2)
    slopes = []
    for _ in range(RESAMPLES):
        starts = rng.integers(0, len(minutes) - block + 1, -(-len(minutes) // block))
        drawn = np.concatenate([residuals[start : start + block] for start in starts])[: len(minutes)]
        slopes.append(theilslopes(slope * hours + drawn, hours)[0])
    low, high = np.percentile(slopes, CONFIDENCE_PERCENT)
    return Trend(float(slope), float(low), float(high), float(np.median(medians)), float(hours[-1] - hours[0]))


def longest_life(processes: Rows, label: str) -> np.ndarray:
    """Return which rows are of the process with this label that lived longest: between two restarts."""
    of = processes["process"] == label
    (pid, _), *_ = Counter(processes["pid"][of]).most_common(1)
    return of & (processes["pid"] == pid)


def print_sum_rule(counters: Rows) -> dict[str, Any]:
    """Print, over all lives of each node, the largest difference between what went in and what came out."""
    table = Table("node:<22 | rule:<58 | lives:>5d | largest:>8.0f | last:>6.0f | verdict:<9", markdown=True)
    figures: dict[str, Any] = {}
    cameras = len({name for name in counters["node"] if CAMERA in name}) or np.nan
    for rule in RULES:
        for node in sorted({name for name in counters["node"] if rule.node in name}):
            of = counters["node"] == node
            residual = rule.residual({key: column[of] for key, column in counters.items()}, cameras)
            residual = residual[np.isfinite(residual)]
            if not len(residual):
                continue
            worst = float(residual[np.abs(residual).argmax()])
            verdict = "holds" if abs(worst) <= IN_FLIGHT else "violated"
            table.row(node, rule.text, len(set(counters["pid"][of])), worst, float(residual[-1]), verdict)
            figures[f"{node}: {rule.text}"] = {"largest": worst, "verdict": verdict}
    return figures


@dataclass(frozen=True)
class SumRule:
    """What went into a node is what came out of it, by its own counters, but for what is under way."""

    text: str
    node: str
    into: tuple[str, ...]
    out: tuple[str, ...]

    def residual(self, rows: Rows, cameras: float) -> np.ndarray:
        """Return (N,) what went in less what came out; NaN where the counters are not known."""
        closed = rows["sets_complete"] + rows["sets_incomplete"]
        known = rows | {"in_sets": cameras * closed - rows["frames_missing"]}
        into = sum(known[key] for key in self.into)
        out = sum(known[key] if key == "in_sets" else np.nan_to_num(known[key]) for key in self.out)
        return np.asarray(into - out)


_REFUSED = ("frames_late", "frames_duplicate", "frames_backwards", "frames_ahead")
RULES = (
    SumRule("expected = delivered + incomplete + lost", CAMERA, ("expected",), ("delivered", "incomplete", "lost")),
    SumRule("frames = in sets + late + duplicate + backwards + ahead", SERVER, ("frames",), ("in_sets", *_REFUSED)),
    SumRule(
        "sets closed = results + dropped", SERVER, ("sets_complete", "sets_incomplete"), ("results", "sets_dropped")
    ),
)
"""A replay has no camera clients: there the second one cannot be told."""


def draw(path: Path, processes: Rows, exposures: Rows, faults: Rows) -> None:
    """Draw memory, handles and threads, latency, and the share of exposures that were answered, over the hours."""
    began_s = exposures["unix_s"][0]
    figure, axes = plt.subplots(4, 1, figsize=(10, 10), sharex=True, constrained_layout=True)
    labels = sorted(set(processes["process"]))
    for k, label in enumerate(labels):
        of = processes["process"] == label
        hours = (processes["unix_s"][of] - began_s) / 3600.0
        axes[0].plot(hours, processes["anon_mib"][of], label=label, color=f"C{k}", linewidth=1)
        axes[1].plot(hours, processes["handles"][of], color=f"C{k}", linewidth=1)
        axes[1].plot(hours, processes["threads"][of], color=f"C{k}", linewidth=1, linestyle=":")
    axes[0].set(ylabel="anonymous memory, MiB", ylim=(0, None))
    axes[0].legend(ncol=len(labels), fontsize=8, loc="upper right")
    axes[1].set(ylabel="file handles, threads (dotted)")
    minutes = per_minute(exposures, began_s)
    for key, label in (("p50", "median of a minute"), ("p95", "95 % of a minute")):
        axes[2].plot(minutes["hours"], minutes[key], label=label, linewidth=1)
    axes[2].set(ylabel="exposure to answer, ms", yscale="log")
    for key, label in (("answered", "answered"), ("tracked", "with a joint state")):
        axes[3].plot(minutes["hours"], minutes[key], label=label, linewidth=1)
    axes[3].set(ylabel="of the exposures, %")
    axes[3].set_xlabel("hours (grey: a fault until all was whole again; red: a process was killed)")
    for axis in axes[2:]:
        axis.legend(fontsize=8)
    columns = (faults[key] for key in ("kind", "begun_s", "ended_s", "recovered_s"))
    for kind, begun_s, ended_s, recovered_s in zip(*columns, strict=True):
        over_s = recovered_s if np.isfinite(recovered_s) else ended_s
        colour = "red" if kind.endswith("killed") else "grey"
        for axis in axes:
            span = (begun_s - began_s) / 3600.0, (over_s - began_s) / 3600.0
            axis.axvspan(*span, color=colour, alpha=0.3, linewidth=1 if colour == "red" else 0)
    figure.savefig(path, dpi=100)
    plt.close(figure)


def per_minute(exposures: Rows, began_s: float) -> Rows:
    """Return hours, latency percentiles (ms), answered and tracked (%) of each minute."""
    minutes = ((exposures["unix_s"] - began_s) // 60).astype(int)
    rows = list[tuple[float, ...]]()
    for minute in np.unique(minutes):
        of = minutes == minute
        ages = exposures["age_ms"][of]
        ages = ages[np.isfinite(ages)]
        p50, p95 = np.percentile(ages, (50, 95)) if len(ages) else (np.nan, np.nan)
        answered, tracked = 100.0 * len(ages) / of.sum(), 100.0 * exposures["tracked"][of].mean()
        rows.append(((minute + 0.5) / 60.0, p50, p95, answered, tracked))
    return dict(zip(("hours", "p50", "p95", "answered", "tracked"), np.array(rows).T, strict=True))


def _column(cells: list[str]) -> np.ndarray:
    try:
        return np.array([float(cell) if cell else np.nan for cell in cells])
    except ValueError:
        return np.array(cells)
