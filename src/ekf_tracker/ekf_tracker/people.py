"""One filter a person: each comes with the person's first fit, and goes with the last one."""

from __future__ import annotations

from collections.abc import Mapping

from mocap_packets.fit import FIRST_PERSON, ReferencePoints
from mocap_packets.state import BodyState, NoState
from stick_figure.body import Body

from .filter import ArticulatedEkf
from .settings import EkfSettings


class PeopleFilter:
    """Follows every person that is measured. Deterministic: equal calls give equal bytes.

    The first person's filter is always there. Another's is made with the first measurement of that person and dropped
    with the first set that holds none.
    """

    def __init__(self, settings: EkfSettings | None = None) -> None:
        self._settings = settings or EkfSettings()
        self.reset()

    def reset(self) -> None:
        """Forget everybody's state; bodies that come with the measurements are taken again."""
        self._filters = {FIRST_PERSON: ArticulatedEkf(None, self._settings)}

    def of(self, person: int) -> ArticulatedEkf:
        """Return the filter of a person that is followed; KeyError for anybody else."""
        return self._filters[person]

    def follow(self, person: int, body: Body) -> None:
        """Take a person's body, known better now; it makes the filter of a person that has none."""
        self._filters.setdefault(person, ArticulatedEkf(None, self._settings)).follow(body)

    def step(self, stamp_ns: int, measured: Mapping[int, ReferencePoints]) -> dict[int, BodyState | NoState]:
        """Answer one frame set: predict everybody, update with their points; persons that are not measured go."""
        for person in [person for person in self._filters if person not in measured and person != FIRST_PERSON]:
            del self._filters[person]
        answers: dict[int, BodyState | NoState] = {}
        for person, points in sorted(measured.items()):
            ekf = self._filters.setdefault(person, ArticulatedEkf(None, self._settings))
            answers[person] = ekf.step(stamp_ns, *points)
        return answers
