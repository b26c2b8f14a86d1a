"""Packets between tracker and filter on everybody in one frame set: one each way.

One packet a set, not one a person: its receiver knows that it is complete and waits for no other message.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from capture_rig.errors import InputError
from capture_rig.yaml_file import format_mapping, parse_mapping
from stick_figure.body import BUILD_NUMBERS, Body, format_body, parse_body
from stick_figure.skeleton import STICK_NAMES

from .fit import FIRST_PERSON, Fit, ReferencePoints
from .state import Prediction
from .table import NO_AGES, SetAges, fill, layout

POINTS = 15
MOST_BODIES_BYTES = 256 << 10  # of some 250 persons
_RATIOS = ("half_shoulder_width", "shoulder_height_ratio", "hip_width_ratio")
BODY_LAYOUT = layout(
    "person", *(f"half_{name}" for name in STICK_NAMES), *_RATIOS, *(f"build_{k}" for k in range(BUILD_NUMBERS))
)
"""A row a person: the numbers of `stick_figure.body.Body`, at rest."""


@dataclass(frozen=True, eq=False)
class PeoplePoints:
    """The reference points of every person who is there, by number, in order.

    As a table: 15 rows a person, of `ReferencePoints.LAYOUT` and the person's number; those of the first person alone
    are a table of `ReferencePoints`.
    """

    LAYOUT: ClassVar[np.dtype] = layout(*(ReferencePoints.LAYOUT.names or ()), "person")

    of: Mapping[int, ReferencePoints]

    @classmethod
    def of_fits(cls, fits: tuple[Fit, ...]) -> PeoplePoints:
        """Return the points of one frame set's fits."""
        return cls({fit.person: fit.reference_points for fit in fits})

    def to_table(self) -> np.ndarray:
        """Return the rows of everybody as a structured array."""
        tables = [points.to_table() for points in self.of.values()]
        if list(self.of) == [FIRST_PERSON]:
            return tables[0]
        rows = [table.view(np.float64).reshape(POINTS, -1) for table in tables]
        return fill(self.LAYOUT, np.concatenate(rows), np.repeat(list(self.of), POINTS))

    @classmethod
    def from_table(cls, table: np.ndarray) -> PeoplePoints:
        """Return the inverse of :meth:`to_table`, of rows that have a person.

        Raises InputError unless each person has 15 rows on end, in the order of their numbers, the first one first.
        """
        persons = [int(person) for person in table["person"][::POINTS]]
        whole = len(table) > 0 and np.array_equal(table["person"], np.repeat(persons, POINTS))
        if not whole or persons != sorted({*persons}) or persons[0] != FIRST_PERSON:
            what = f"{len(table)} rows are not {POINTS} points of each person"
            raise InputError(what, remedy="Publish the 15 reference points of each person, one after another.")
        return cls(
            {p: ReferencePoints.from_table(own) for p, own in zip(persons, table.reshape(-1, POINTS), strict=True)}
        )


@dataclass(frozen=True, eq=False)
class FittedPeople:
    """The tracker's answer to a frame set: everybody's points, the body of each who has one, and how old the set is."""

    LAYOUTS: ClassVar[dict[str, np.dtype]] = {
        "points": PeoplePoints.LAYOUT,
        "bodies": BODY_LAYOUT,
        "ages": SetAges.LAYOUT,
    }

    stamp_ns: int
    points: PeoplePoints
    bodies: Mapping[int, Body]
    ages: SetAges = NO_AGES

    def to_tables(self) -> dict[str, np.ndarray]:
        """Return the tables of :data:`LAYOUTS`."""
        points = self.points.to_table()
        if points.dtype != PeoplePoints.LAYOUT:
            points = fill(PeoplePoints.LAYOUT, points.view(np.float64).reshape(POINTS, -1), np.ones(POINTS))
        bodies = [(person, *body_numbers(body)) for person, body in self.bodies.items()]
        return {"points": points, "bodies": np.array(bodies, BODY_LAYOUT), "ages": self.ages.to_table()}

    @classmethod
    def from_tables(cls, stamp_ns: int, tables: Mapping[str, np.ndarray]) -> FittedPeople:
        """Return the inverse of :meth:`to_tables`. Raises InputError for rows that are no person's."""
        bodies = {int(row["person"]): _body_of(row) for row in tables["bodies"]}
        return cls(stamp_ns, PeoplePoints.from_table(tables["points"]), bodies, SetAges.from_table(tables["ages"]))


def body_numbers(body: Body) -> tuple[float, ...]:
    """Return the numbers of a body at rest, in the order of `BODY_LAYOUT` behind the person."""
    rest = body.straight
    return (*rest.half_lengths.tolist(), *(getattr(rest, name) for name in _RATIOS), *rest.build.tolist())


def _body_of(row: np.void) -> Body:
    numbers, sticks, build = row.tolist()[1:], len(STICK_NAMES), len(STICK_NAMES) + len(_RATIOS)
    width, shoulders, hips = numbers[sticks:build]
    return Body(np.array(numbers[:sticks]), width, shoulders, hips, np.array(numbers[build:]))


@dataclass(frozen=True, eq=False)
class Predictions:
    """The filter's answer to a frame set, by the person's number, in order: where the next fits start."""

    stamp_ns: int
    of: Mapping[int, Prediction]


@dataclass(frozen=True)
class AnsweredSet:
    """A frame set that the filter has answered, and how old it was at each stage; NO_AGES where that is not known."""

    stamp_ns: int
    ages: SetAges = NO_AGES


def format_bodies(bodies: Mapping[int, Body], source: str = "") -> str:
    """Return the bodies of several persons as YAML: under each person's number the keys of a body file."""
    texts = {person: format_body(body, source) for person, body in sorted(bodies.items())}
    return format_mapping({person: parse_mapping(text, "body", "") for person, text in texts.items()})


def parse_bodies(text: str, where: str) -> dict[int, Body]:
    """Return the inverse of :func:`format_bodies`. Raises InputError naming ``where``, person, key and remedy."""
    remedy = "Give a body for each person, by number."
    bodies = dict[int, Body]()
    if len(text) > MOST_BODIES_BYTES:
        raise InputError(f"has {len(text)} characters, too many for bodies", where=where, remedy=remedy)
    for person, document in parse_mapping(text, where, remedy).items():
        if not isinstance(person, int) or person < FIRST_PERSON:
            raise InputError(f"{person!r} is no person's number", where=where, remedy=remedy)
        bodies[person] = parse_body(format_mapping(document), f"{where}: person {person}")
    return bodies
