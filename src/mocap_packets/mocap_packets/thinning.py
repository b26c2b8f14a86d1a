"""Thinning: which exposures every camera client keeps while the graph cannot process them all.

All clients decide by the capture stamp alone, by one rule that the hull server tells them. So the frames that are kept
belong to the same instants, and their sets are complete. Of every ``of`` exposures ``keep`` are kept, as evenly as
whole exposures allow: exposure k is kept where k * keep mod of < keep (Bresenham's line).
"""

from __future__ import annotations

from dataclasses import dataclass

# Thresholds: chosen with the simulated graphs of test_hull_overload.py.
LARGEST_OF = 20  # neighbouring fractions near a half then differ by 5 % at most; a pattern takes a third of a second
LAPSE_NS = 3_000_000_000  # three refreshes: nobody thins for a hull server that is gone


@dataclass(frozen=True)
class FrameDecimation:
    """One rule, in force for stamps from ``from_ns`` on.

    resume_ns : frames of earlier stamps are not kept at all, so that the queues of clients and server run empty.
    phase_ns : the stamp of exposure 0, which is kept; period_ns : between exposures.
    keep, of : so many of so many exposures are kept, keep <= of.
    """

    from_ns: int
    resume_ns: int
    phase_ns: int
    period_ns: float
    keep: int
    of: int

    @property
    def fraction(self) -> float:
        """The share of the exposures that is kept."""
        return self.keep / self.of

    def exposure_of(self, stamp_ns: int) -> int:
        """Return the number of the exposure nearest to a stamp."""
        return round((stamp_ns - self.phase_ns) / self.period_ns)

    def keeps(self, stamp_ns: int) -> bool:
        """Return whether the frame of this stamp is kept."""
        if self.from_ns <= stamp_ns < self.resume_ns:
            return False
        return self.keep >= self.of or self.exposure_of(stamp_ns) * self.keep % self.of < self.keep


EVERY_FRAME = FrameDecimation(0, 0, 0, 1.0, 1, 1)


def nearest_fraction(share: float) -> tuple[int, int]:
    """Return (keep, of): the largest fraction up to ``share`` with ``of`` <= LARGEST_OF; at least 1 of LARGEST_OF."""
    if share >= 1.0:
        return 1, 1
    candidates = ((max(int(share * of + 1e-9), 0), of) for of in range(1, LARGEST_OF + 1))
    keep, of = max(candidates, key=lambda fraction: (fraction[0] / fraction[1], -fraction[1]))
    return (keep, of) if keep else (1, LARGEST_OF)


class FrameSelector:
    """Says which frames the rules in force keep; the rule before the newest one holds up to its ``from_ns``.

    lapse_ns : a rule that thins lapses when it was not published again for so long. Times are monotonic.
    newest : the rule published last.
    """

    def __init__(self, lapse_ns: float = LAPSE_NS) -> None:
        self._lapse_ns = lapse_ns
        self._before = self.newest = EVERY_FRAME
        self._published_ns = 0

    def update(self, rule: FrameDecimation, now_ns: int) -> None:
        """Use a rule from now on; the same one again is only refreshed."""
        if self._is_lapsed(now_ns):
            self.newest = EVERY_FRAME
        self._published_ns = now_ns
        if rule != self.newest:
            self._before, self.newest = self.newest, rule

    def keeps(self, stamp_ns: int, now_ns: int) -> bool:
        """Return whether the frame of this stamp is kept."""
        if self._is_lapsed(now_ns):
            return True
        return (self.newest if stamp_ns >= self.newest.from_ns else self._before).keeps(stamp_ns)

    def _is_lapsed(self, now_ns: int) -> bool:
        return now_ns - self._published_ns > self._lapse_ns
