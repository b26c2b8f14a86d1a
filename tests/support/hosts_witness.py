"""What came of the exposures of bench/hosts.py, as its listener on the server tells (hosts_listener.py)."""

from __future__ import annotations

import itertools
import json
import subprocess
import threading
from dataclasses import dataclass
from typing import Any

import numpy as np

from capture_rig.session import Truth

WHOLE_IN_A_ROW = 6  # frame sets that are complete again after a fault: a tenth of a second at 60 Hz
EARLY_FRAMES = 0.2  # a frame's pictures are seen from its instant on: a clock some ms behind stamps them before that


@dataclass(frozen=True)
class Row:
    """Figures of a condition. complete : share of the exposures that became a set of all cameras; formed : of any.

    noticed_s : until the graph no longer knows the camera; recovered_s : from the fault's end until sets are whole.
    hull_cpu, sender_cpu : cores that the hull server and one camera host's sender used.
    """

    name: str
    complete: float
    formed: float
    p50_ms: float
    p95_ms: float
    spread_ms: float
    noticed_s: float | None = None
    recovered_s: float | None = None
    hull_cpu: float | None = None
    sender_cpu: float | None = None


class Witness:
    """What the listener on the server has told so far."""

    def __init__(self, process: subprocess.Popen[str]) -> None:
        self.sets: list[dict[str, Any]] = []
        self.known: list[dict[str, Any]] = []
        self.said: list[dict[str, Any]] = []
        self.answers: list[dict[str, Any]] = []
        self.points: list[dict[str, Any]] = []
        threading.Thread(target=self._read, args=(process.stdout,), daemon=True).start()

    def _read(self, lines: Any) -> None:
        for line in lines:
            told = json.loads(line)
            lists = {"missing": self.sets, "known": self.known, "says": self.said, "points": self.points}
            next((lists[key] for key in lists if key in told), self.answers).append(told)

    def figures(self, name: str, begin_ns: int, seconds: float, hz: float, **times: float | None) -> Row:
        """Return the figures of the exposures in ``seconds`` from ``begin_ns`` on."""
        sets = _between(self.sets, begin_ns, seconds)
        ages = [each["received_ms"] for each in sets] or [float("nan")]
        exposed = seconds * hz
        return Row(
            name,
            sum(not each["missing"] for each in sets) / exposed,
            len(sets) / exposed,
            float(np.percentile(ages, 50)),
            float(np.percentile(ages, 95)),
            max((each["spread_ms"] for each in sets), default=float("nan")),
            **times,
        )

    def whole_since(self, since_s: float) -> float | None:
        """Return when sets became whole, and stayed so for a moment, after ``since_s``; None when they have not."""
        row = 0
        for each in list(self.sets):
            row = row + 1 if each["at_s"] >= since_s and not each["missing"] else 0
            if row == 1:
                first_s = each["at_s"]
            if row == WHOLE_IN_A_ROW:
                return first_s
        return None

    def lost_since(self, camera: str, since_s: float) -> float | None:
        """Return when the graph no longer knew this camera."""
        gone = (told["at_s"] for told in list(self.known) if told["at_s"] >= since_s and camera not in told["known"])
        return next(gone, None)

    def known_since(self, camera: str, since_s: float) -> float | None:
        """Return when the graph knew this camera after ``since_s``, and knows it still."""
        seen = [told["at_s"] for told in list(self.known) if told["at_s"] >= since_s and camera in told["known"]]
        return seen[0] if seen and camera in self.known[-1]["known"] else None

    def said_mostly(self, begin_s: float, end_s: float) -> str:
        """Return the hull server's message that stood longest between two moments of the monotonic clock."""
        stood: dict[str, float] = {}
        said = [*list(self.said), {"at_s": end_s, "says": ""}]
        for now, after in itertools.pairwise(said):
            held_s = min(after["at_s"], end_s) - max(now["at_s"], begin_s)
            stood[now["says"]] = stood.get(now["says"], 0.0) + max(held_s, 0.0)
        return max(stood, key=lambda text: stood[text], default="")

    def answered(self, begin_ns: int, seconds: float) -> tuple[int, float, float]:
        """Return how many exposures of that time were answered by the filter, and their age then, p50 and p95 ms."""
        ages = [each["age_ms"] for each in _between(self.answers, begin_ns, seconds)]
        return len(ages), *map(float, np.percentile(ages or [float("nan")], (50, 95)))

    def errors_mm(self, truth: Truth, shown: tuple[int, float], begin_ns: int, seconds: float) -> np.ndarray:
        """(N, 15) how far the points tracked in that time are from a truth that is ``shown`` in a loop.

        shown : since when, ns, and how many of its frames a second.
        """
        rows, (since_ns, fps) = _between(self.points, begin_ns, seconds), shown
        played_s = 1e-9 * np.array([each["stamp_ns"] - since_ns for each in rows], float).reshape(-1)
        frames = np.floor(played_s * fps + EARLY_FRAMES).astype(int) % len(truth.frames)
        points = np.array([each["points"] for each in rows], float).reshape(-1, 15, 3)
        return 1e3 * np.linalg.norm(truth.comparable(points) - truth.points_world[frames], axis=-1)

    def tracked_since(self, since_s: float) -> float | None:
        """Return when the first body was tracked after ``since_s``."""
        return next((each["at_s"] for each in list(self.points) if each["at_s"] >= since_s), None)


def _between(rows: list[dict[str, Any]], begin_ns: int, seconds: float) -> list[dict[str, Any]]:
    return [each for each in list(rows) if begin_ns <= each["stamp_ns"] < begin_ns + seconds * 1e9]
