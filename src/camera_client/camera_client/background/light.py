"""Estimates the light, frame by frame: gain and offset of each channel, and a smooth field where lamps differ.

A person in view covers some of the samples, a shadow darkens some: the fit is robust, and smooth. The gain is found
anew in every frame (mains flicker), the field follows within a third of a second, at once when the lights were
switched.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import numpy.typing as npt

from capture_rig.kernel import njit

from .kernels import BEYOND_NOISE, BIN_SIGMAS, F32, OPTIONS, USUAL_S, robust_weights

FIELD_DOWN, FIELD_ACROSS = 6, 8  # cells of the field: a lamp's light changes slowly over the picture
# Thresholds: measured by python bench/rooms.py.
FIELD_S = 0.3  # time constant of the field
STEPS = 3  # of the robust fit
OFFSET_PRIOR = 0.02  # holds the offset at zero as much as a fiftieth of the samples would
SWITCHED_SHARE = 0.15  # rise in the share of outliers that means that a lamp was switched, not that a person came
SWITCHED_S = 0.5  # for which the field is refitted after a switch
WEAK, WEAK_SIGMAS = 0.5, 6.0  # weight at least of foreground that differs by fewer sigmas
MOST_GAIN = 4.0  # beyond, nothing of the picture is left to compare
LIT_SPREAD, LIT_REACH = 0.05, 0.35  # relative: a cell's samples agree on their ratio; how far that departs at most
FIELD_PRIOR = 0.1  # holds a cell to its neighbours as a tenth of a typical cell's samples would
FEW_IN_CELL = 8
_CELLS = np.indices((FIELD_DOWN, FIELD_ACROSS)).reshape(2, -1)
NEARNESS = 1 / np.maximum(((_CELLS[:, :, None] - _CELLS[:, None]) ** 2).sum(axis=0), 1)
"""Weight (cells, cells) of one cell for another: one over their squared distance."""
SWITCHED_GAIN, SWITCHED_FLICKERS = 0.06, 5.0  # ... or is brighter or darker by so much, and so many times its flicker

Floats = npt.NDArray[np.float32]


@dataclass(frozen=True, eq=False)
class Light:
    """The light now, against that in which the background was learned: level = gain field learned + offset.

    gain, offset (C,) float32; field (FIELD_DOWN, FIELD_ACROSS, C) float32, 1 on average. switched : the light has just
    changed suddenly.
    """

    gain: Floats
    offset: Floats
    field: Floats
    switched: bool = False

    @classmethod
    def unchanged(cls, channels: int) -> Light:
        """Return the light that the background was learned in."""
        ones = np.ones(channels, np.float32)
        return cls(ones, np.zeros_like(ones), np.ones((FIELD_DOWN, FIELD_ACROSS, channels), np.float32))

    @cached_property
    def brightness(self) -> float:
        """How many times brighter than learned the scene is, all channels together."""
        return float(self.gain.mean())


class LightEstimator:
    """Estimates the light from samples of the picture.

    switches : sudden changes so far. flicker2 : variance of the gain from frame to frame, relative.
    """

    def __init__(self, cell: npt.NDArray[np.intp], channels: int) -> None:
        """``cell`` (n,) : the field's cell of each sample."""
        self._cell, self.light = cell, Light.unchanged(channels)
        self._outliers, self._switched_s = 0.0, math.inf
        self._usual_gain = self._last_gain = [1.0] * channels
        self._trust_before = np.ones(len(cell), np.float32)
        self._first, self.switches, self.flicker2 = True, 0, 0.0
        self._before: dict[str, Any] = {}

    def update(self, samples: Floats, trust: Floats, step_s: float) -> Floats:
        """Take the samples of a frame; return what is left of them (C, n): seen - gain expected - offset.

        samples (3, C, n) : grey levels seen, those of the background with the field of :attr:`light`, and 1 / variance.
        trust (n,) : 1, less where foreground is likely. step_s : since the frame before.
        """
        self._before = vars(self) | {"_before": {}}
        light, rest, usable = self.light, np.empty_like(samples[0]), np.empty_like(samples[0])
        if self._switched_s > SWITCHED_S:
            self._trust_before = trust  # what foreground is just after a switch is not known: it is as it was before
        now, field = np.stack([light.gain, light.offset]), np.empty_like(light.field)
        share = 1 - math.exp(-step_s / FIELD_S)
        given = samples, self._trust_before, self._cell, light.field, share
        outliers = fit_light(*given, now, usable, rest, field)
        gain, offset = now
        self._detect_switch(outliers, self._jumps(gain.tolist(), step_s), step_s)
        switched = self._switched_s < SWITCHED_S
        if switched and outliers > SWITCHED_SHARE:
            field = self._refit(samples[0] - offset[:, None], gain[:, None] * samples[1], usable, light.field)
            field = np.clip(field / field.mean(axis=(0, 1)), np.float32(1 / MOST_GAIN), np.float32(MOST_GAIN))
        self.light = Light(gain, offset, field, switched and not self._first)
        self._first = False
        return rest

    def rollback(self) -> None:
        """Forget the last frame: its samples were compared with a background that lay elsewhere."""
        vars(self).update(self._before)

    def _jumps(self, gain: list[float], step_s: float) -> bool:
        """Return whether the gain departs from its mean over the last second by more than it flickers."""
        if self._first:
            self._usual_gain = self._last_gain = gain
            return False
        usual, last = self._usual_gain, self._last_gain
        change, step = (max(abs(now / was - 1) for now, was in zip(gain, a, strict=True)) for a in (usual, last))
        least = max(SWITCHED_GAIN, SWITCHED_FLICKERS * math.sqrt(self.flicker2))
        share = 1 - math.exp(-step_s / USUAL_S)
        self._usual_gain = [was + share * (now - was) for now, was in zip(gain, usual, strict=True)]
        self._last_gain = gain
        if step < least:
            self.flicker2 += share * (0.5 * step * step - self.flicker2)
        return change > least

    def _detect_switch(self, outliers: float, jumps: bool, step_s: float) -> None:
        """Notice that the gain jumps, or that suddenly much more of the picture than before departs from it."""
        sudden = jumps or outliers > self._outliers + SWITCHED_SHARE
        self.switches += sudden and self._switched_s > SWITCHED_S and not self._first
        self._switched_s = 0.0 if sudden else self._switched_s + step_s
        share = 1 - math.exp(-step_s / USUAL_S)
        self._outliers += (1.0 if self._first else share) * (outliers - self._outliers)

    def _refit(self, seen: Floats, expected: Floats, usable: Floats, field: Floats) -> Floats:
        """Find the field anew: the median of a cell's ratios where its samples agree on it, as they do where a lamp
        lights it and not where something covers it; elsewhere from the cells around (Shepard 1968)."""
        factor, n = np.ones_like(field), FIELD_DOWN * FIELD_ACROSS
        for c in range(field.shape[2]):
            ratio, known = np.ones(n), np.zeros(n, bool)
            each = seen[c] / np.maximum(expected[c], 1.0)
            for cell in range(n):
                mine = each[(self._cell == cell) & (usable[c] >= 1)]
                if len(mine) >= FEW_IN_CELL:
                    ratio[cell] = np.clip(np.median(mine), 1 / MOST_GAIN, MOST_GAIN)
                    known[cell] = np.median(np.abs(mine / ratio[cell] - 1)) < LIT_SPREAD
            if known.any():  # else a lens that was covered: all was foreground just before, the field stays
                known &= np.abs(np.log(ratio / np.median(ratio[known]))) < LIT_REACH
                weight = NEARNESS * known
                factor[..., c] = np.where(known, ratio, weight @ ratio / weight.sum(axis=1)).reshape(field.shape[:2])
        return field * factor


@njit(**OPTIONS)
def fit_light(samples, trust, cell, before, share, now, usable, rest, field):  # type: ignore[no-untyped-def]
    """Fit gain and offset ``now`` (2, C), and let the light's field follow; return the share of the samples that differ
    by more than BEYOND_NOISE.

    samples (3, C, n), trust (n,) : of :meth:`LightEstimator.update`; cell (n,) : of each sample; before (down, across,
    C) : the field until now, which moves by ``share``. Written: usable (C, n) : each sample's weight for the fit; rest
    (C, n) : seen - gain expected - offset; field.
    """
    seen, expected, precision = samples[0], samples[1], samples[2]
    weight = np.empty_like(rest)
    _weigh_samples(samples, trust, now, usable)
    for c in range(len(seen)):
        gain, offset = robust_gain(seen[c], expected[c], precision[c], usable[c], now[:, c], weight[c])
        if 1 / MOST_GAIN < gain < MOST_GAIN and np.isfinite(offset):
            now[0, c], now[1, c] = gain, offset
    beyond = 0
    for i in range(seen.shape[1]):
        most = F32(0)
        for c in range(len(seen)):
            left = seen[c, i] - now[0, c] * expected[c, i] - now[1, c]
            rest[c, i] = left
            if usable[c, i] >= 1:
                most = max(most, left * left * precision[c, i])
        if most > BEYOND_NOISE**2:
            beyond += 1
    for c in range(len(seen)):
        _update_cells(before[:, :, c], share, (cell, now[0, c], expected[c], weight[c], rest[c]), field[:, :, c])
    return beyond / seen.shape[1]


@njit(**OPTIONS)
def robust_gain(seen, expected, precision, trust, start, weight):  # type: ignore[no-untyped-def]
    """Fit seen = gain expected + offset by iteratively reweighted least squares; return gain and offset.

    seen, expected, precision, trust (n,) float32; trust : of :func:`robust_weights`. start (2,) : gain and offset to
    begin with. weight (n,) is written: each sample's at the end.
    """
    gain, offset = start[0], start[1]
    distance, robust = np.empty(len(seen), np.float32), np.empty(len(seen))
    for step in range(STEPS + 1):
        for i in range(len(seen)):
            rest = seen[i] - (gain * expected[i] + offset)
            distance[i] = abs(rest) * np.sqrt(precision[i])
        robust_weights(distance, trust, BIN_SIGMAS * (1.0 if step else 4.0), robust)
        see = sxe = sx = se = sw = 0.0
        for i in range(len(seen)):
            weight[i] = w = robust[i] * precision[i]
            sw += w
            se += w * expected[i]
            see += w * expected[i] * expected[i]
            sx += w * seen[i]
            sxe += w * seen[i] * expected[i]
        if step == STEPS:
            break
        held = sw * (1.0 + OFFSET_PRIOR)
        det = see * held - se * se
        if sw <= 0.0 or det <= 1e-9 * see * held:
            break
        gain, offset = (sxe * held - sx * se) / det, (see * sx - se * sxe) / det
    return gain, offset


@njit(**OPTIONS)
def _weigh_samples(samples, trust, now, usable):  # type: ignore[no-untyped-def]
    """Write each sample's weight for the fit: at least WEAK if its residual is small, 0 if it is saturated."""
    seen, expected, precision = samples[0], samples[1], samples[2]
    for i in range(len(trust)):
        most = F32(0)
        for c in range(len(seen)):
            rest = seen[c, i] - now[0, c] * expected[c, i] - now[1, c]
            most = max(most, rest * rest * precision[c, i])
        share = max(trust[i], F32(WEAK)) if most < WEAK_SIGMAS**2 else trust[i]
        for c in range(len(seen)):
            bounded = seen[c, i] < 250 and 3 < expected[c, i] < 245
            usable[c, i] = share if bounded else F32(0)


@njit(**OPTIONS)
def _update_cells(before, share, samples, field):  # type: ignore[no-untyped-def]
    """Move each cell of one channel's field (down, across) by a ``share`` towards what its own samples say; where they
    say little, towards the mean of the 3 x 3 cells around it. The whole stays 1 on average.

    What neighbours lack is not added up in a cell without samples: it would drift away behind a person.
    """
    cell, gain, expected, weight, rest = samples
    down, across = before.shape
    change, known = np.zeros(down * across), np.zeros(down * across)
    for i in range(len(cell)):
        level = gain * expected[i]
        power = weight[i] * level
        change[cell[i]] += power * rest[i]
        known[cell[i]] += power * level
    held, total = FIELD_PRIOR * np.median(known) + 1e-9, 0.0
    for y in range(down):
        for x in range(across):
            around = 0.0
            for v in range(y - 1, y + 2):
                for u in range(x - 1, x + 2):
                    around += before[min(max(v, 0), down - 1), min(max(u, 0), across - 1)]
            own, k = before[y, x], y * across + x
            found = (own * change[k] + held * (around / 9.0 - own)) / (known[k] + held)
            field[y, x] = own + share * found
            total += field[y, x]
    for y in range(down):
        for x in range(across):
            field[y, x] = min(max(field[y, x] * down * across / total, 1 / MOST_GAIN), MOST_GAIN)
