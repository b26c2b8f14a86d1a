"""The unknowns of the refinement: the sizes of a body and how thick its limbs are."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from stick_figure.body import Body

from ..acquisition.body_estimate import BodyEstimate
from ..acquisition.flesh_sizes import FleshSizes
from ..acquisition.proportions import SIZES, body_of_sizes
from ..figure_arrays import Figure
from ..flesh import Flesh

THICK = ("upper_arm", "forearm", "thigh", "calf", "trunk")
UNKNOWNS = len(SIZES) + len(THICK)
SIZE = slice(0, len(SIZES))
THICKNESS = slice(len(SIZES), UNKNOWNS)
STEP = 1e-4  # of the differences that stand for derivatives, m and per unit


class ShapeDerivatives(NamedTuple):
    """How figure and flesh change with the unknowns.

    capsules (k, 8, UNKNOWNS) : start (3), end (3) in the stick's frame and both radii. origins (10, 3, UNKNOWNS) and
    lengths (10, UNKNOWNS) : the sticks'.
    """

    capsules: np.ndarray
    origins: np.ndarray
    lengths: np.ndarray


class ShapeModel:
    """Figure and flesh as functions of the unknowns (UNKNOWNS,): sizes in metres, thickness over the average.

    Linear about ``centre``. Sizes alone enter linearly; a thickness times a size is taken at the centre, which costs
    half a per cent of a radius where both are far off.
    """

    def __init__(self, centre: np.ndarray) -> None:
        self.centre = centre
        self._stick = Flesh.of(body_of(centre)).stick
        self._parts, columns = _parts(centre), []
        for k in range(UNKNOWNS):
            values = centre.copy()
            values[k] += STEP
            columns.append([(there - here) / STEP for there, here in zip(_parts(values), self._parts, strict=True)])
        self.derivatives = ShapeDerivatives(
            *(np.ascontiguousarray(np.stack(part, axis=-1)) for part in zip(*columns, strict=True))
        )

    def at(self, values: np.ndarray) -> tuple[Figure, Flesh]:
        """The figure and its flesh for other values."""
        step = values - self.centre
        capsules, origins, lengths = (a + d @ step for a, d in zip(self._parts, self.derivatives, strict=True))
        start, end, radii = (np.ascontiguousarray(capsules[:, a:b]) for a, b in ((0, 3), (3, 6), (6, 8)))
        return Figure(lengths, origins), Flesh(self._stick, start, end, radii)


def body_of(values: np.ndarray) -> Body:
    """The stick figure of the unknowns' values (UNKNOWNS,)."""
    return body_of_sizes(values[SIZE])


def thickness_of(values: np.ndarray) -> FleshSizes:
    """The thicknesses among the unknowns' values (UNKNOWNS,)."""
    return FleshSizes.of(dict(zip(THICK, values[THICKNESS].tolist(), strict=True)))


def _parts(values: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    body = body_of(values)
    figure, flesh = Figure.of(body), thickness_of(values).on(Flesh.of(body))
    return np.concatenate([flesh.start, flesh.end, flesh.radii], axis=1), figure.origins, figure.lengths


@dataclass(frozen=True, eq=False)
class ShapePrior:
    """What is known before: mean (UNKNOWNS,) and covariance (UNKNOWNS, UNKNOWNS) of the unknowns."""

    mean: np.ndarray
    covariance: np.ndarray

    @classmethod
    def of(cls, estimate: BodyEstimate, thickness_sd: float) -> ShapePrior:
        """Sizes as the T-pose showed them, thickness as people have it."""
        covariance = np.diag(np.full(UNKNOWNS, thickness_sd**2))
        covariance[SIZE, SIZE] = estimate.covariance
        return cls(np.concatenate([estimate.sizes, np.ones(len(THICK))]), covariance)

    def clipped(self, values: np.ndarray, farthest_sd: float) -> np.ndarray:
        """The values, none farther from the mean than so many standard deviations."""
        reach = farthest_sd * np.sqrt(np.diag(self.covariance))
        return np.clip(values, self.mean - reach, self.mean + reach)
