"""How busy this machine's processors are, by /proc/stat: a figure for diagnostics and for what adapts to the load."""

from __future__ import annotations

from pathlib import Path

STAT = Path("/proc/stat")
IDLE_FIELDS = (3, 4)  # idle and iowait, of user nice system idle iowait irq softirq steal


class ProcessorUse:
    """Measures the busy share of all processors of this machine between two calls."""

    def __init__(self, stat: Path = STAT) -> None:
        self._stat = stat
        self._before = self._times()

    def share(self) -> float:
        """Return the busy share (0 to 1) since the last call; 0 where the system does not tell, or too soon."""
        before, self._before = self._before, self._times()
        total = self._before[1] - before[1]
        return min(max((self._before[0] - before[0]) / total, 0.0), 1.0) if total > 0 else 0.0

    def _times(self) -> tuple[int, int]:
        """Return busy time and all time of all processors since the machine started, in ticks."""
        try:
            ticks = [int(text) for text in self._stat.read_text().split("\n", 1)[0].split()[1:9]]
        except (OSError, ValueError):
            return 0, 0
        return sum(ticks) - sum(ticks[field] for field in IDLE_FIELDS if field < len(ticks)), sum(ticks)
