"""A tape measure against the calibration: it alone can tell that the board's fields have another size than stated."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from capture_rig.errors import InputError
from capture_rig.rig import Rig

FEWEST_M = 0.2
"""A shorter length tells nothing: a tape at a lens errs by a centimetre."""


@dataclass(frozen=True)
class TapeCheck:
    """What was measured (text), by tape and in the calibration, metres."""

    what: str
    tape_m: float
    calibrated_m: float

    @property
    def ratio(self) -> float:
        """Calibrated over measured: 1.04 means that every length came out 4 % too long."""
        return self.calibrated_m / self.tape_m

    def __str__(self) -> str:
        return f"{self.what}: {self.tape_m:.3f} m by tape, {self.calibrated_m:.3f} m calibrated ({self.ratio - 1:+.1%})"


@dataclass(frozen=True)
class TapeMeasure:
    """A length that a person measured: between two lenses, or (``other`` None) of a lens above the floor."""

    one: str
    other: str | None
    tape_m: float

    def check(self, rig: Rig) -> TapeCheck:
        """The same length in the calibration. Raises InputError for an unknown camera and a useless length."""
        what = f"height of {self.one}" if self.other is None else f"{self.one} to {self.other}"
        if not np.isfinite(self.tape_m) or self.tape_m < FEWEST_M:
            raise InputError(
                f"{self.tape_m} m is no length to check with",
                where=what,
                remedy=f"Measure {FEWEST_M} m or more, to the middle of the lens.",
            )
        centre = rig.camera(self.one).centre_world
        length = centre[2] if self.other is None else np.linalg.norm(centre - rig.camera(self.other).centre_world)
        return TapeCheck(what, self.tape_m, float(length))
