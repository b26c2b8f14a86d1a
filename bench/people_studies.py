"""Studies of bench/people.py on its sets: doubt, other makers' people, fast hands and feet, the smoother."""

from __future__ import annotations

import time
from collections import defaultdict
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, fields
from typing import Any, NamedTuple

from report import Table

import numpy as np
from clips import Recorded
from people_sets import States, follower_of, states_of

from ekf_tracker.smoother import Set, smooth
from mocap_packets.fit import FIRST_PERSON, PART_NAMES, PART_POINTS
from mocap_packets.state import BodyState, NoState
from mocap_pipeline.configuration import Configuration
from sagoma_tools.evaluation.scores import INSIDE_95, LARGE_ERROR_MM, PartCalls, nees_of, number, share, share_below
from sagoma_tools.evaluation.track import Track
from stick_figure import metrics
from stick_figure.skeleton import POINT_NAMES

SHOWN_CALLS = (
    *("wrong_frames", "wrong_parts", "wrong_called", "wrong_inside"),
    *("clear_frames", "clear_called", "called_inside", "ms"),
)
PROBABILITIES = (0.03, 0.06, 0.1, 0.15, 0.2, 0.25, 0.3, 0.4, 0.5, 0.7)
TIPS = [POINT_NAMES.index(name) for name in ("left_hand", "right_hand", "left_foot", "right_foot")]
BANDS = ((0.0, 1.0), (1.0, 3.0), (3.0, 5.0), (5.0, 8.0), (8.0, 30.0))  # speeds, m/s
FAST_M_S = 5.0
SHOWN_ERRORS = ("mean_mm", "without_offset_mm", "over_200mm", "tracked", "inside_95", "worst_point_inside_95")
FEWEST = 10  # of a band that is shown
JUMP_M = 0.1  # a larger third difference is a limb that was found again, and no jitter
FIGURES = ("mean_mm", "jitter_mm", "inside_95", "worst_point_inside_95")


@dataclass(frozen=True, eq=False)
class Calls(PartCalls):
    """What is said of the parts of the body in the frames that have a truth and a track.

    inside : (F, 5) bool, all points of the part lie inside their own ellipsoids. log_odds : (F, 5), that the
    part is elsewhere or unseen.
    """

    inside: np.ndarray
    log_odds: np.ndarray

    def figures(self) -> dict[str, Any]:
        """Shares, None where there is nothing of the kind."""
        return {
            "frames": len(self.clear),
            "wrong_frames": number(share(self.wrong.any(axis=1))),
            "wrong_parts": int(self.wrong.sum()),
            "wrong_called": number(self.flagged_of_bad),
            "wrong_inside": number(share(self.inside[self.wrong])),
            "clear_frames": int(self.clear.sum()),
            "clear_called": number(self.false_alarms),
            "called_inside": number(share(self.inside[self.called])),
            "parts_inside": number(share(self.inside)),
        }

    @classmethod
    def of_states(cls, what: Recorded, states: States) -> Calls:
        """Compare what was published of the first person with the truth."""
        truth = what.truths[0]
        known = [row for row in states if np.isfinite(truth[row[0]]).all()]
        track = Track.of_states([(frame, state) for frame, state, _ in known])
        errors = track.points_world - truth[track.frames]
        inside = nees_of(errors, track.covariance) <= INSIDE_95
        of_parts = np.stack([inside[:, list(points)].all(axis=1) for points in PART_POINTS], axis=1)
        log_odds = np.array([odds for *_, odds in known]).reshape(-1, len(PART_NAMES))
        said = PartCalls.of(1e3 * np.linalg.norm(errors, axis=2), track.parts)
        return cls(said.wrong, said.called, said.clear, of_parts, log_odds)

    @classmethod
    def together(cls, several: Sequence[Calls]) -> Calls:
        """The frames of several sets as one."""
        return cls(*(np.concatenate([getattr(one, field.name) for one in several]) for field in fields(cls)))


def curve(calls: Calls) -> list[dict[str, float | None]]:
    """What these probabilities alone would call."""
    return [
        {
            "probability": p,
            "wrong_called": number(share((calls.log_odds > np.log(p / (1.0 - p)))[calls.wrong])),
            "clear_called": number(share((calls.log_odds > np.log(p / (1.0 - p)))[calls.clear].any(axis=1))),
        }
        for p in PROBABILITIES
    ]


def doubt(sets: Iterable[Recorded], settings: dict[str, Any]) -> dict[str, Any]:
    """Track the sets with one person in them. A part of the body (trunk, arms, legs) is wrong in a frame with one of
    its points more than 200 mm off; a frame is clear with all points under 100 mm. A part is called when its published
    state is doubtful or lost.

    Columns: frames with a part over 200 mm, %; parts wrong, of them called, %; of them with all points inside their own
    95 % ellipsoids, %; clear frames, and those with any part called, %; parts called with all points inside, %;
    processor time of fit and filter, ms a set. The second table is the curve behind the choice of
    limb_filter.UNFOUND_LOG_PRIOR: what would be called if the probability of another place of a limb, or of none, alone
    decided, at that probability.
    """
    table = Table(
        "set:<40 | > 200:>7.1% | wrong:>6d | called:>7.0% | inside:>7.0% | clear:>6d | also called:>12.2%"
        " | called inside:>14.0% | ms:>5.2f"
    )
    every, found = list[Calls](), dict[str, dict[str, Any]]()
    for what in sets:
        if len(what.truths) != 1:
            continue
        follower, began = follower_of(what, settings), time.process_time()
        states = states_of(what, follower)
        ms = 1e3 * (time.process_time() - began) / max(len(what.products), 1)
        every.append(Calls.of_states(what, states))
        found[what.name] = {**every[-1].figures(), "ms": round(ms, 2)}
        table.row(what.name, *[found[what.name][key] for key in SHOWN_CALLS])
    if not every:
        return {}
    whole = Calls.together(every)
    figures = {**whole.figures(), "ms": round(float(np.mean([one["ms"] for one in found.values()])), 2)}
    table.row("all", *[figures[key] for key in SHOWN_CALLS])
    points, shown = curve(whole), Table("probability:>12.2f | wrong called:>12.0% | clear called:>12.2%")
    for point in points:
        shown.row(*point.values())
    return {"all": figures, "curve": points, "sets": found}


# --- people of several makers


class Errors(NamedTuple):
    """Of one set's frames with a truth (F): mm of each point (F, 15) as it is and without offsets, whether inside its
    ellipsoid (F, 15) without offsets; NaN where not tracked. offsets (15, 3) m."""

    mm: np.ndarray
    centred_mm: np.ndarray
    inside: np.ndarray
    offsets: np.ndarray

    @classmethod
    def of_states(cls, what: Recorded, states: States) -> Errors:
        """Compare the first person's states with the truth."""
        known = np.flatnonzero(np.isfinite(what.truths[0]).any(axis=(1, 2)))
        truth, none = what.truths[0][known], np.full((len(known), 15), np.nan)
        track = Track.of_states([(frame, state) for frame, state, _ in states]).at(known)
        if not np.isfinite(track.points_world).any():
            return cls(none, none, none, np.full((15, 3), np.nan))
        centred = metrics.without_offsets(track.points_world, truth)
        squared = nees_of(centred - truth, track.covariance)
        return cls(
            1e3 * metrics.point_errors(track.points_world, truth),
            1e3 * metrics.point_errors(centred, truth),
            np.where(np.isfinite(squared), squared <= INSIDE_95, np.nan),
            metrics.joint_offsets(track.points_world, truth),
        )


def figures(several: list[Errors]) -> dict[str, float]:
    """What a row says of the sets' errors."""
    mm, centred, inside = (np.concatenate([getattr(e, name) for e in several]) for name in Errors._fields[:3])
    tracked = np.isfinite(centred).any(axis=1)
    if not tracked.any():
        return {**dict.fromkeys(SHOWN_ERRORS, np.nan), "tracked": 0.0}
    return {
        "mean_mm": float(np.nanmean(mm)),
        "without_offset_mm": float(np.nanmean(centred)),
        "over_200mm": float((np.nanmax(centred[tracked], axis=1) > LARGE_ERROR_MM).mean()),
        "tracked": float(tracked.mean()),
        "inside_95": float(np.nanmean(inside)),
        "worst_point_inside_95": float(np.nanmin(np.nanmean(inside, axis=0))),
    }


def makers(sets: Iterable[Recorded], settings: dict[str, Any], offsets: bool) -> dict[str, dict[str, float]]:
    """Track the sets avatar_MAKER_BODY_CLIP_RIG and avatar_held_... of `models/avatar_people.py`. Makers put joints to
    different places: the constant offset of each point in the pelvis's frame says what they mean by it, and is taken
    out of all columns but the first.

    Columns: mean error of the 15 points, mm; without offsets; share of the tracked frames with a point over 200 mm;
    share tracked; errors inside the track's own 95 % ellipsoids, all and of the worst point of a row. ``offsets`` :
    print them, too: ahead, left and up, mm, mean over a maker's sets.
    """
    columns = "mean:>6.1f | -offset:>7.1f | > 200:>6.1% | tracked:>7.0% | inside:>6.1% | worst:>6.0%"
    by_row, by_maker = defaultdict[str, list[Errors]](list), defaultdict[str, list[Errors]](list)
    each = Table(f"set:<48 | {columns}")
    for what in sets:
        words = what.name.removesuffix("_own").split("_")
        if words[0] != "avatar":
            continue
        errors = Errors.of_states(what, states_of(what, follower_of(what, settings)))
        maker = f"{words[2]}, held out" if words[1] == "held" else words[1]
        each.row(what.name, *figures([errors]).values())
        own = ", own silhouettes" if what.name.endswith("_own") else ""
        by_row[f"{maker}, {len(what.rig.cameras)} cameras{own}"].append(errors)
        by_maker[maker].append(errors)
    shown, table = Table(f"maker:<31 | {columns}"), {}
    for name, several in by_row.items():
        table[name] = figures(several)
        shown.row(name, *table[name].values())
    if offsets:
        heads = Table("point:<15" + "".join(f" | {maker}:>18s" for maker in by_maker))
        means = [np.nanmean([e.offsets for e in several], axis=0) for several in by_maker.values()]
        for i, point in enumerate(POINT_NAMES):
            heads.row(point, *(" ".join(f"{1e3 * v:.0f}" for v in mean[i]) for mean in means))
    return table


# --- movement


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
