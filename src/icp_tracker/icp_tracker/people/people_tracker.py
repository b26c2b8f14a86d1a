"""From one frame set's hull to a fit of every person in it.

Every person has an :class:`~icp_tracker.tracker.IcpTracker`. The parts of the hull that do not touch are given to the
persons who are expected there; a part that nobody explains starts an acquisition of its own, which sees this part
alone. One person alone is followed as the tracker of one body follows it, to the last bit.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace

import numpy as np

from capture_rig.rig import Rig
from mocap_packets.fit import FIRST_PERSON, Fit
from mocap_packets.hull import HullProducts
from mocap_packets.state import Prediction
from stick_figure.body import Body

from ..acquisition.upright import reasons_of_bodies
from ..refinement.body_refiner import RefinedBody
from ..settings import MOST_PERSONS, IcpNodeSettings
from ..tracker import ACQUIRING, NS_PER_S, IcpTracker, make_tracker, sight_of

GONE_AFTER_S = 1.0  # a person other than the first who has not been seen for so long has left


class PeopleTracker:
    """Follows every person in the volume. Deterministic, as the tracker of one body is.

    Persons are numbered 1, 2, ... in the order in which they are found; a number belongs to its person for good, also
    while the person is away.
    """

    def __init__(self, make: Callable[[], IcpTracker], most: int = MOST_PERSONS) -> None:
        """``make`` : returns a tracker that looks for a first pose. ``most`` : persons that are followed at once."""
        self._make, self._most = make, most
        self._first = make()
        self.reset()

    def reset(self) -> None:
        """Forget everybody and look for first poses again."""
        self._first.reset()
        self._trackers: dict[int, IcpTracker] = {FIRST_PERSON: self._first}
        self._newcomers: dict[int, IcpTracker] = {}  # by the number of their part of the hull
        self._seen_ns: dict[int, int] = {}
        self.acquiring: tuple[str, ...] = ()
        """Of each body of the last set that is nobody's yet, while somebody is followed: why it has no first pose."""

    @property
    def persons(self) -> tuple[int, ...]:
        """The persons that are known, in order; the first one always is."""
        return tuple(sorted(self._trackers))

    def body_of(self, person: int) -> Body | None:
        """Return a person's body; None for one who is not known, or has no first pose yet."""
        return self._trackers[person].body if person in self._trackers else None

    def refined_body_of(self, person: int) -> RefinedBody | None:
        """Return how well the sizes of a measured body are known; None for a body whose sizes were given."""
        return self._trackers[person].refined_body if person in self._trackers else None

    @property
    def needs_voxels(self) -> bool:
        """Whether the next step uses the hull's voxels."""
        return any(tracker.needs_voxels for tracker in self._all)

    @property
    def needs_contour_rays(self) -> bool:
        """Whether the next step uses the contour rays."""
        return any(tracker.needs_contour_rays for tracker in self._all)

    def step(self, seen: HullProducts, predictions: Mapping[int, Prediction]) -> tuple[Fit, ...]:
        """Fit one frame set: one answer for each person that is there, in order, and always one for the first."""
        bodies = seen.numbers()
        if len(bodies) <= 1 and len(self._trackers) == 1:
            self._newcomers.clear()
            self.acquiring = ()
            return (self._first.step(seen, predictions.get(FIRST_PERSON)),)
        seen, dropped = seen.finite()
        owners = self._owners(seen, bodies)
        fits = self._follow(seen, owners, predictions)
        fits |= self._acquire(seen, [body for body in bodies if body not in owners], fits)
        return tuple(replace(fits[person], dropped_points=dropped) for person in sorted(fits))

    @property
    def _all(self) -> tuple[IcpTracker, ...]:
        return (*self._trackers.values(), *self._newcomers.values())

    def _owners(self, seen: HullProducts, bodies: list[int]) -> dict[int, int]:
        """Return the person of each part of the hull that somebody explains."""
        line, owners = seen.centerline, dict[int, int]()
        for person, tracker in sorted(self._trackers.items()):
            if tracker.expected_points is None:
                continue
            near = line.near(tracker.expected_points)
            counts = [0 if body in owners else int(np.count_nonzero(near & (line.body == body))) for body in bodies]
            if max(counts, default=0) > 0:
                owners[bodies[int(np.argmax(counts))]] = person
        return owners

    def _follow(
        self, seen: HullProducts, owners: Mapping[int, int], predictions: Mapping[int, Prediction]
    ) -> dict[int, Fit]:
        fits, nobody = dict[int, Fit](), seen.of_body(-2)
        part_of = {person: body for body, person in owners.items()}
        for person, tracker in sorted(self._trackers.items()):
            if tracker.body is None:
                continue
            there = person in part_of
            if there:
                self._seen_ns[person] = seen.stamp_ns
            away_s = (seen.stamp_ns - self._seen_ns.get(person, seen.stamp_ns)) / NS_PER_S
            if there or person == FIRST_PERSON or away_s < GONE_AFTER_S:
                own = seen.of_body(part_of[person]) if there else nobody
                fits[person] = replace(tracker.step(own, predictions.get(person)), person=person)
        return fits

    def _acquire(self, seen: HullProducts, unowned: list[int], fits: Mapping[int, Fit]) -> dict[int, Fit]:
        """Look for a first pose in every part of the hull that is nobody's."""
        found, reasons = dict[int, Fit](), dict[int, str]()
        self._newcomers = {body: t for body, t in self._newcomers.items() if body in unowned}
        for body in unowned:
            tracker = self._newcomers.setdefault(body, self._make())
            fit = tracker.step(seen.of_body(body))
            if fit.state == ACQUIRING:
                reasons[body] = fit.reason
                continue
            person = FIRST_PERSON if self._first.body is None else max(self._trackers) + 1
            if person > self._most:
                continue
            del self._newcomers[body]
            self._trackers[person], self._seen_ns[person] = tracker, seen.stamp_ns
            if person == FIRST_PERSON:
                self._first = tracker
            found[person] = replace(fit, person=person)
        self.acquiring = tuple(reasons.values())
        if FIRST_PERSON not in fits and FIRST_PERSON not in found:
            empty, self.acquiring = self._first.step(seen.of_body(-2)), ()
            found[FIRST_PERSON] = replace(empty, reason=reasons_of_bodies(reasons))
        return found


def make_people_tracker(settings: IcpNodeSettings, rig: Rig | None = None, min_seeing: int = 0) -> PeopleTracker:
    """Make a tracker of everybody; first poses come from where the settings say; rig, min_seeing as of `sight_of`.

    A pose from a file or a session is that of one person: then nobody else is followed. Raises InputError for files
    that cannot be used.
    """
    most = settings.people.max if settings.initial_pose.source == "t_pose" else 1
    sight = sight_of(settings, rig, min_seeing)
    return PeopleTracker(lambda: make_tracker(settings, sight), most)
