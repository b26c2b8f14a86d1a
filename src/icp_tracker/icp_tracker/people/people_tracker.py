"""From one frame set's hull to a fit of every person in it.

Every person has an :class:`~icp_tracker.tracker.IcpTracker`, which fits the rows of the hull that data association
gives it (``association.py``). A part that nobody explains belongs to somebody who comes back, or to a newcomer, whose
first pose is sought in this part alone; a newcomer with the sizes of a person who is away is that person. With one
person alone the result equals that of the tracker of one body, to the last bit.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from capture_rig.rig import Rig, load_rig
from capture_rig.visibility import RigVisibility
from mocap_packets.fit import FIRST_PERSON, GONE_AFTER_S, LOST, Fit
from mocap_packets.hull import HullProducts
from mocap_packets.state import Prediction
from stick_figure.body import Body
from stick_figure.least_squares.keypoint_factor import NO_KEYPOINTS, Keypoints

from ..extrinsic_monitor import ExtrinsicErrors, ExtrinsicMonitor
from ..initialization.body_sizes import BodyEstimate
from ..initialization.pose_source import HULL_SOURCES
from ..settings import MOST_PERSONS, IcpNodeSettings
from ..tracker import ACQUIRING, NS_PER_S, TRACKING, IcpTracker, fits_nothing, make_tracker
from .association import Association, Expected, associate_parts, associate_rows, associate_skeletons

AWAY_AFTER_S = 0.3  # after which a person is no longer expected where they were seen last
BACK_S = 0.2  # of good fits before somebody is taken for a person who was away: fits of phantoms do not last
LOOK_PERIOD_S = 0.045  # between newcomers' fits while somebody is tracked, so that their work is spread
SIZES_ERR_M = 0.01  # between two measurements of one person, beside their covariances: clothes, posture
ALIKE = 25.0  # 99.5 % quantile of the squared Mahalanobis distance of ten sizes of one person
NO_PART = -2  # the number of no part of a hull


@dataclass
class _Person:
    """A known person. seen_ns : seen last. away : not expected anywhere. good_ns : since when, while away, a part is
    fitted well."""

    tracker: IcpTracker
    seen_ns: int
    away: bool = False
    good_ns: int | None = None

    def is_back(self, stamp_ns: int, state: str) -> bool:
        """Whether fits while away, this one included, have been good for BACK_S."""
        self.good_ns = (stamp_ns if self.good_ns is None else self.good_ns) if state == TRACKING else None
        return self.good_ns is not None and stamp_ns - self.good_ns >= BACK_S * NS_PER_S


class PeopleTracker:
    """Tracks every person in the volume. Deterministic, as the tracker of one body is.

    Persons are numbered 1, 2, ... in the order in which they are found; a number belongs to its person for good, also
    while the person is away.
    """

    def __init__(
        self, make: Callable[[], IcpTracker], most: int = MOST_PERSONS, extrinsics: ExtrinsicMonitor | None = None
    ) -> None:
        """``make`` : returns a tracker without a body. ``most`` : largest number of persons. ``extrinsics`` : the rig's
        monitor, if the rig is known."""
        self._make, self._most, self._extrinsics = make, most, extrinsics
        self.reset()

    def reset(self) -> None:
        """Forget everybody and start again with first poses."""
        if self._extrinsics is not None:
            self._extrinsics.reset()
        self._persons: dict[int, _Person] = {}
        self._newcomers: dict[int, IcpTracker] = {NO_PART: self._make()}  # by the number of their part of the hull
        self._reasons: dict[int, str] = {}
        self._newcomer_ns: dict[int, int] = {}  # when each was there last
        self._looked_ns, self._turn = 0, 0
        self._keypoints: dict[int, Keypoints] = {}  # of the set that is fitted, by person

    @property
    def persons(self) -> tuple[int, ...]:
        """The persons that are known, in order."""
        return tuple(sorted(self._persons))

    @property
    def acquiring(self) -> tuple[str, ...]:
        """Why each unassigned part of the last hull has no first pose yet, while somebody is tracked."""
        return tuple(self._reasons.values()) if self._persons else ()

    @property
    def extrinsic_errors(self) -> ExtrinsicErrors:
        """Errors of the cameras' calibration, as measured on the tracked bodies."""
        return ExtrinsicErrors() if self._extrinsics is None else self._extrinsics.errors

    def body_of(self, person: int, bent: bool = False) -> Body | None:
        """Return a person's body at rest, or with its present bend (``bent``); None for an unknown person."""
        if person not in self._persons:
            return None
        tracker = self._persons[person].tracker
        return tracker.bent_body if bent else tracker.body

    def step(self, seen: HullProducts, predictions: Mapping[int, Prediction]) -> tuple[Fit, ...]:
        """Fit one frame set: a fit of each person that is there, in order, and always one of the first."""
        fits = self._fits(seen, predictions)
        if self._extrinsics is not None and self._extrinsics.is_due(seen.stamp_ns):
            trackers = {fit.person: self._persons[fit.person].tracker for fit in fits if fit.person in self._persons}
            measured = [(person, tracker.residuals) for person, tracker in trackers.items()]
            self._extrinsics.update(seen.stamp_ns, [(person, body) for person, body in measured if body is not None])
        return fits

    def _fits(self, seen: HullProducts, predictions: Mapping[int, Prediction]) -> tuple[Fit, ...]:
        """Associate the set's rows with persons, fit the known ones, and find newcomers."""
        parts = seen.numbers()
        keypoints, seen = seen.keypoints, replace(seen, keypoints=NO_KEYPOINTS)
        is_alone = len(parts) <= 1 and len(self._persons) + len(self._newcomers) <= 1
        has_keypoints = len(keypoints.score) > 0
        expected = [] if is_alone and not has_keypoints else self._expected(seen.stamp_ns, predictions)
        self._keypoints = associate_skeletons(keypoints, expected) if has_keypoints else {}
        seen, dropped = seen.finite()
        if is_alone:
            return (replace(self._step_alone(seen, predictions.get(FIRST_PERSON)), dropped_points=dropped),)
        association = associate_parts(seen, parts, expected)
        there = [one for one in expected if one.person in association.parts]
        free = [part for part in parts if part not in association.claimed]
        back = self._reassign_lost_tracks(seen, association, free)
        fits = self._track(seen, associate_rows(seen, association, there), back, association, predictions)
        fits |= self._acquire(seen, [part for part in free if not self._is_just_away(back, part, seen)], fits)
        return tuple(replace(fits[person], dropped_points=dropped) for person in sorted(fits))

    def _step_alone(self, seen: HullProducts, prediction: Prediction | None) -> Fit:
        """Fit the only person, or find the first one."""
        if self._persons:
            person = self._persons[FIRST_PERSON]
            fit = person.tracker.step(self._with_keypoints(FIRST_PERSON, seen), prediction)
            person.seen_ns = person.seen_ns if fit.state == LOST else seen.stamp_ns
            return fit
        ((part, newcomer),) = self._newcomers.items()
        fit = newcomer.step(seen)
        self._reasons = {part: fit.reason}
        return fit if fit.state == ACQUIRING else self._admit(part, fit)

    # --- known persons -----------------------------------------------------------------------------------------------

    def _expected(self, stamp_ns: int, predictions: Mapping[int, Prediction]) -> list[Expected]:
        """Return the expected pose of everybody who is not away."""
        expected = []
        for number, person in sorted(self._persons.items()):
            pose, body = person.tracker.expected(stamp_ns, predictions.get(number)), person.tracker.body
            if pose is not None and body is not None and not person.away:
                expected.append(Expected(number, body, pose))
        return expected

    def _with_keypoints(self, person: int, seen: HullProducts) -> HullProducts:
        """Return a person's rows with the person's keypoints."""
        return replace(seen, keypoints=self._keypoints.get(person, NO_KEYPOINTS))

    def _reassign_lost_tracks(
        self, seen: HullProducts, association: Association, free: Sequence[int]
    ) -> dict[int, int]:
        """Return, for each person who is not where expected, the unassigned part of the hull to fit."""
        missed = {number: p for number, p in sorted(self._persons.items()) if number not in association.parts}
        back: dict[int, int] = {}
        for part in sorted(free, key=lambda part: (-_size_of(seen, part), part)):  # phantoms are small
            apart = {
                number: float(np.linalg.norm(person.tracker.pose.position_world[:2] - _place_of(seen, part)))
                for number, person in missed.items()
                if number not in back and person.tracker.pose is not None
            }
            if apart:
                back[min(apart, key=lambda number: (apart[number], number))] = part
        for number, person in missed.items():
            person.away |= number in back or seen.stamp_ns - person.seen_ns >= AWAY_AFTER_S * NS_PER_S
        return back

    def _track(
        self,
        seen: HullProducts,
        rows: Mapping[int, HullProducts],
        back: Mapping[int, int],
        association: Association,
        predictions: Mapping[int, Prediction],
    ) -> dict[int, Fit]:
        """Fit everybody to their rows, and those who are away to the part that may be theirs."""
        fits = dict[int, Fit]()
        for number, person in sorted(self._persons.items()):
            if number in rows:
                own = rows[number]
            else:
                own = seen.of_body(back.get(number, NO_PART)).as_one_body()
            gone = number != FIRST_PERSON and seen.stamp_ns - person.seen_ns >= GONE_AFTER_S * NS_PER_S
            if gone and number not in rows and number not in back:
                continue
            learn = not person.away and not association.sharers(number)
            fit = person.tracker.step(self._with_keypoints(number, own), predictions.get(number), learn)
            if number in rows:
                person.seen_ns = seen.stamp_ns
            elif number in back and person.is_back(seen.stamp_ns, fit.state):
                person.away, person.seen_ns, person.good_ns = False, seen.stamp_ns, None
            elif gone:
                continue
            elif number in back and fit.state != LOST:  # perhaps a phantom
                reason = fit.reason or "perhaps back: it has to fit a little longer"
                fit = replace(fit, state=LOST, reason=reason, visible=np.zeros(15, dtype=bool))
            fits[number] = replace(fit, person=number)
        return fits

    # --- newcomers ---------------------------------------------------------------------------------------------------

    def _is_just_away(self, back: Mapping[int, int], part: int, seen: HullProducts) -> bool:
        """Whether a part of the hull is fitted for somebody who was here a moment ago."""
        numbers = [number for number, given in back.items() if given == part]
        gone_ns = GONE_AFTER_S * NS_PER_S
        return any(not self._persons[n].away or seen.stamp_ns - self._persons[n].seen_ns < gone_ns for n in numbers)

    def _acquire(self, seen: HullProducts, free: Sequence[int], fits: Mapping[int, Fit]) -> dict[int, Fit]:
        """Find first poses in the unassigned parts of the hull."""
        found = dict[int, Fit]()
        self._newcomers = self._newcomers_of(free, seen.stamp_ns)
        self._reasons = {part: reason for part, reason in self._reasons.items() if part in free}
        for part, tracker in self._newcomers_due(free, seen.stamp_ns):
            fit = tracker.step(seen.of_body(part).as_one_body())
            self._reasons[part] = fit.reason
            present = sum(not person.away for person in self._persons.values())
            if fit.state != ACQUIRING and present < self._most:
                fit = self._admit(part, fit)
                found[fit.person] = fit
        if FIRST_PERSON not in fits and FIRST_PERSON not in found:
            found[FIRST_PERSON] = fits_nothing(seen.stamp_ns, _reason_of_all(self._reasons))
        if not self._persons and not self._newcomers:
            self._newcomers = {NO_PART: self._make()}
        return found

    def _newcomers_due(self, free: Sequence[int], stamp_ns: int) -> list[tuple[int, IcpTracker]]:
        """Return the newcomers to fit in this set, in turn: two; while somebody is tracked one every LOOK_PERIOD_S, as
        a first pose takes as long as several fits."""
        if not free or (self._persons and 0 <= stamp_ns - self._looked_ns < LOOK_PERIOD_S * NS_PER_S):
            return []
        self._looked_ns, here = stamp_ns, sorted(free)
        chosen = [here[(self._turn + k) % len(here)] for k in range(min(1 if self._persons else 2, len(here)))]
        self._turn += len(chosen)
        return [(part, self._newcomers[part]) for part in chosen]

    def _newcomers_of(self, free: Sequence[int], stamp_ns: int) -> dict[int, IcpTracker]:
        """Return the newcomer of each free part, the same as before even where the part's number has changed, and those
        whose part is missing for a moment."""
        self._newcomer_ns |= dict.fromkeys(free, stamp_ns)
        newcomers = {
            part: tracker
            for part, tracker in self._newcomers.items()
            if 0 <= stamp_ns - self._newcomer_ns.get(part, stamp_ns) < GONE_AFTER_S * NS_PER_S
        }
        spare = [part for part in newcomers if part not in free]
        for part in free:
            if part not in newcomers:
                newcomers[part] = newcomers.pop(spare.pop(0)) if spare and not self._persons else self._make()
        return newcomers

    def _admit(self, part: int, fit: Fit) -> Fit:
        """Make the newcomer of a part a person: one who was away and has these sizes, or a new one."""
        tracker = self._newcomers.pop(part)
        self._reasons.pop(part, None)
        for number in self._away_like(tracker):
            known = self._persons[number]
            assert tracker.pose is not None
            known.tracker.move_to(tracker.pose)
            known.away, known.seen_ns = False, fit.stamp_ns
            return replace(fit, person=number, recovered="somebody of this person's sizes")
        number = max(self._persons, default=0) + 1
        self._persons[number] = _Person(tracker, fit.stamp_ns)
        return replace(fit, person=number)

    def _away_like(self, newcomer: IcpTracker) -> list[int]:
        """Return the persons who are away and have the newcomer's sizes, the most similar first."""
        measured, likeness = newcomer.refined_sizes, list[tuple[float, int]]()
        for number, person in sorted(self._persons.items()):
            known = person.tracker.refined_sizes
            if person.away and known is not None and measured is not None:
                likeness.append((sizes_apart(known, measured), number))
        return [number for apart, number in sorted(likeness) if apart < ALIKE]


def sizes_apart(first: BodyEstimate, second: BodyEstimate) -> float:
    """Return the squared Mahalanobis distance of two measurements of sizes."""
    difference = first.sizes - second.sizes
    covariance = first.covariance + second.covariance + SIZES_ERR_M**2 * np.eye(len(difference))
    return float(difference @ np.linalg.solve(covariance, difference))


def _reason_of_all(reasons: Mapping[int, str]) -> str:
    """Return one sentence of the reasons why bodies, by number, have no first pose yet."""
    if len(reasons) == 1:
        return next(iter(reasons.values()))
    return "; ".join(f"body {number}: {reason}" for number, reason in sorted(reasons.items())) or "no hull"


def _size_of(seen: HullProducts, part: int) -> int:
    """Return the number of samples of a part of the hull."""
    return int(np.count_nonzero(seen.voxels.body == part)) or int(np.count_nonzero(seen.centerline.body == part))


def _place_of(seen: HullProducts, part: int) -> np.ndarray:
    """Return where a part of the hull stands (2,), m."""
    packet = seen.voxels if len(seen.voxels) else seen.centerline
    place: np.ndarray = np.median(packet.points_world[packet.body == part, :2], axis=0)
    return place


def make_people_tracker(settings: IcpNodeSettings, rig: Rig | None = None, min_seeing: int = 0) -> PeopleTracker:
    """Make a tracker of everybody by the settings.

    ``rig``, ``min_seeing`` : the cameras, and how many of them a hull needs, where the settings name no rig file.
    Without either, hulls are taken to show all, and no camera is monitored. A pose from a file or a session is that of
    one person: then nobody else is tracked. Raises InputError for files that cannot be used.
    """
    start = settings.initial_pose
    if start.rig_file:
        rig, min_seeing = load_rig(start.rig_file), start.min_seeing
    most = settings.people.max if start.source in HULL_SOURCES else 1
    visibility = None if rig is None else RigVisibility(rig, min_seeing)
    extrinsics = None if rig is None else ExtrinsicMonitor(rig, settings.calibration)
    return PeopleTracker(lambda: make_tracker(settings, visibility), most, extrinsics)
