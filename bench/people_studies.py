"""Studies of bench/people.py on its sets: fast hands and feet, the smoother."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from report import Table

import numpy as np
from clips import Recorded
from people_sets import follower_of

from ekf_tracker.smoother import Set, smooth
from mocap_packets.fit import FIRST_PERSON
from mocap_packets.state import BodyState, NoState
from mocap_pipeline.configuration import Configuration
from sagoma_tools.evaluation.scores import INSIDE_95, nees_of, share_below
from stick_figure.skeleton import POINT_NAMES

TIPS = [POINT_NAMES.index(name) for name in ("left_hand", "right_hand", "left_foot", "right_foot")]
BANDS = ((0.0, 1.0), (1.0, 3.0), (3.0, 5.0), (5.0, 8.0), (8.0, 30.0))  # speeds, m/s
FAST_M_S = 5.0
FEWEST = 10  # of a band that is shown
JUMP_M = 0.1  # a larger third difference is a limb that was found again, and no jitter
FIGURES = ("mean_mm", "jitter_mm", "inside_95", "worst_point_inside_95")


def fast_motion(sets: Iterable[Recorded], settings: dict[str, Any]) -> dict[str, Any]:
    """Hands and feet by how fast they move, in sets in which one is faster than FAST_M_S: error and lag.

    A row is a band of speeds: hands and feet in it, counted frame by frame; mean error of the fitted and of the
    filtered points, mm; lag of both: the median of how far the point is behind the truth along its velocity, divided by
    the speed, ms (below 1 m/s the error says nothing about time).
    """
    shown = Table(
        "set:<40 | m/s:>6 | tips:>6d | fit mm:>7.1f | filter mm:>9.1f | fit lag ms:>10.2f | filter lag ms:>13.2f"
    )
    table: dict[str, dict[str, list[float]]] = {}
    for what in sets:
        truth = what.truths[0][:, TIPS]
        velocity = np.gradient(truth, axis=0) * what.fps
        speed = np.linalg.norm(velocity, axis=2)
        if not (np.nan_to_num(speed) > FAST_M_S).any():
            continue
        tracks = tips_of(what, settings)
        known = np.isfinite(tracks[1]).all(axis=2) & np.isfinite(speed)
        for low, high in BANDS:
            band = known & (speed >= low) & (speed < high)
            if band.sum() < FEWEST:
                continue
            errors = [(track - truth)[band] for track in tracks]
            means = [1e3 * np.linalg.norm(error, axis=1).mean() for error in errors]
            behind = [-(error * velocity[band]).sum(axis=1) / speed[band] ** 2 for error in errors] if low else []
            row = [*means, *(1e3 * np.median(late) for late in behind)]
            shown.row(what.name, f"{low:g}-{high:g}", band.sum(), *row, *[None] * (4 - len(row)))
            table.setdefault(what.name, {})[f"{low:g}-{high:g}"] = [round(float(value), 3) for value in row]
    return table


def tips_of(what: Recorded, settings: dict[str, Any]) -> tuple[np.ndarray, np.ndarray]:
    """Fitted and filtered hands and feet (F, 4, 3) m of a set; NaN where there is no state."""
    follower = follower_of(what, settings)
    fitted = np.full((len(what.truths[0]), len(TIPS), 3), np.nan)
    filtered = fitted.copy()
    for frame, products in enumerate(what.products[: len(fitted)]):
        step = follower.step(products)
        if step.state is not None:
            fitted[frame] = step.fit.reference_points.points_world[TIPS]
            filtered[frame] = step.state.points_world[TIPS]
    return fitted, filtered


def smoothed(sets: Iterable[Recorded], settings: dict[str, Any]) -> dict[str, Any]:
    """What `sagoma smooth` makes of a set: the filter's figures and then (+) those of the smoother on the same fits.

    Mean error of the 15 points, mm; jitter: the rms of the error's third difference as white noise an axis, mm (of real
    motion it holds nothing that the truth does not); share of the errors inside the track's own 95 % ellipsoids, all
    and of the worst point.
    """
    columns = ("mean:>6.1f", "mean+:>6.1f", "jitter:>6.2f", "jitter+:>7.2f", "inside:>7.1%", "inside+:>7.1%")
    shown = Table(" | ".join(("set:<40", *columns, "worst:>6.0%", "worst+:>6.0%")))
    table: dict[str, dict[str, dict[str, float]]] = {}
    for what in sets:
        answers = both(what, settings)
        if not any(isinstance(answer, BodyState) for answer in answers[0]):
            continue
        before, after = (smooth_figures(one, what.truths[0]) for one in answers)
        shown.row(what.name, *[value for name in FIGURES for value in (before[name], after[name])])
        table[what.name] = {"filter": before, "smoother": after}
    return table


def both(what: Recorded, settings: dict[str, Any]) -> tuple[list[BodyState | NoState], list[BodyState | NoState]]:
    """The filter's answers, and the smoother's to the same fits."""
    follower, configuration = follower_of(what, settings), Configuration.of({**what.start, **settings})
    filtered, sets = [], []
    for products in what.products:
        step = follower.step(products)
        filtered.append(step.answer)
        sets.append(Set(products.stamp_ns, step.fit.reference_points, follower.tracker.body_of(FIRST_PERSON)))
    return filtered, smooth(sets, configuration.ekf)


def smooth_figures(answers: list[BodyState | NoState], truth: np.ndarray) -> dict[str, float]:
    """The columns of one track."""
    errors, covariances = np.full((len(truth), 15, 3), np.nan), np.full((len(truth), 15, 3, 3), np.nan)
    for frame, answer in enumerate(answers[: len(truth)]):
        if isinstance(answer, BodyState):
            errors[frame], covariances[frame] = answer.points_world - truth[frame], answer.point_covariance
    nees = nees_of(errors, covariances)
    third = np.minimum((np.diff(errors, 3, axis=0) ** 2).sum(-1), JUMP_M**2)
    values = (
        1e3 * np.nanmean(np.linalg.norm(errors, axis=2)),
        1e3 * np.sqrt(np.nanmean(third) / 60.0),  # white noise of variance v an axis: 3 (1 + 9 + 9 + 1) v
        share_below(INSIDE_95, nees),
        np.nanmin(share_below(INSIDE_95, nees, 0)),
    )
    return {name: round(float(value), 4) for name, value in zip(FIGURES, values, strict=True)}
