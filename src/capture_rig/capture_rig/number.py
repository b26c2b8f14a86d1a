"""Numbers on a command line: finite, whole where they must be, within a range, and of a unit that the message names."""

from __future__ import annotations

import argparse
from collections.abc import Callable

from .errors import shortened


def number(unit: str, low: float, high: float, *, whole: bool = False) -> Callable[[str], float]:
    """Return a ``type`` for argparse: the number from ``low`` to ``high`` that a text says, an int where ``whole``.

    unit : as it stands behind the number ("s", "Hz", "cameras"), "" for none. What is no such number, NaN and infinity
    among it, is an argparse error that names what is allowed.
    """

    def read(text: str) -> float:
        try:
            value = int(text) if whole else float(text)
            if low <= value <= high:  # NaN is in no range
                return value
        except ValueError:
            pass
        allowed = f"{'a whole number' if whole else 'a number'} from {low:.12g} to {high:.12g} {unit}".rstrip()
        raise argparse.ArgumentTypeError(f"'{shortened(text, 40)}' cannot be used; give {allowed}")

    return read


SECONDS, FRAME_RATE = number("s", 0, 1e7), number("Hz", 0.1, 1000)
PLAYING_SPEED = number("times real time", 0, 100)  # of footage
