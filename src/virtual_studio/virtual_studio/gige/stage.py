"""What happens in the studio, for all its cameras alike: is somebody there, and how far is the play."""

from __future__ import annotations

import time
from fractions import Fraction

SECOND_NS = 1_000_000_000
SWITCH_AFTER_NS = 50_000_000
"""People come and go so long after they were told to, so that no camera is ahead of another."""


class Stage:
    """A play of ``frames`` frames at ``fps``, seen as a function of the instant: every camera sees the same frame.

    Until play() is called it runs for ever, from frame 0 at the start of 1970. The room can be emptied meanwhile.
    """

    def __init__(self, frames: int, fps: float) -> None:
        self.frames, self._fps = frames, Fraction(fps).limit_denominator(1000)
        self.epoch_ns, self.loop, self._held = 0, True, False
        self._occupied, self._before, self._since_ns = True, True, 0

    @property
    def fps(self) -> float:
        return float(self._fps)

    @property
    def occupied(self) -> bool:
        return self._occupied

    def play(self, at_ns: int | None = None, loop: bool = True) -> int:
        """Begin anew: frame 0 at ``at_ns`` (UTC; None: the next whole second but one), which is returned.

        It is rounded to a whole multiple of the frame period, where free-running cameras expose. Before, frame 0 is
        seen; without ``loop`` the last frame stays.
        """
        if at_ns is None:
            at_ns = (time.time_ns() // SECOND_NS + 2) * SECOND_NS
        period_ns = SECOND_NS / self._fps
        self.epoch_ns, self.loop, self._held = round(round(at_ns / period_ns) * period_ns), loop, False
        return self.epoch_ns

    def hold(self) -> None:
        """Stay at frame 0."""
        self._held = True

    def occupy(self, occupied: bool) -> None:
        """Let the person in, or out."""
        self._before, self._occupied = self._occupied, occupied
        self._since_ns = time.time_ns() + SWITCH_AFTER_NS

    def occupied_at(self, instant_ns: int) -> bool:
        return self._occupied if instant_ns >= self._since_ns else self._before

    def frame_at(self, instant_ns: int) -> int:
        """The number of the frame that is seen at an instant."""
        if self._held:
            return 0
        frame = (instant_ns - self.epoch_ns) * self._fps.numerator // (self._fps.denominator * SECOND_NS)
        if self.loop and frame >= 0:
            return frame % self.frames
        return min(max(frame, 0), self.frames - 1)
