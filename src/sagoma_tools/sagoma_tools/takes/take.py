"""Figures of a take, as plain data: its persons, cameras and backgrounds, and their quality."""

from __future__ import annotations

import re
import time
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from enum import StrEnum
from pathlib import Path
from typing import Any

import msgspec

from capture_rig.errors import InputError

FORMAT = 1
NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9 _.-]{0,79}")
"""A take's name: a folder's name on every system that does not lead out of the folder of takes."""
REMEDY = "Measure the take anew: `sagoma takes measure TAKE`."


def check_name(name: str) -> str:
    """Return the name without blanks around it. Raises InputError for one that no take can have."""
    name = name.strip()
    if not NAME.fullmatch(name) or name.endswith("."):
        remedy = "Use up to 80 letters, digits, blanks, points, dashes and underscores, a letter or digit first."
        raise InputError(f"'{name[:100]}' is no name for a take", where="name", remedy=remedy)
    return name


class TakeState(StrEnum):
    """Whether a take can be used."""

    WHOLE = "whole"
    UNFINISHED = "unfinished"
    """it is being recorded, or its recorder was killed"""
    DAMAGED = "damaged"


@dataclass(frozen=True)
class Background:
    """A background that a camera used. learned : when (ISO 8601), "" if unknown; serial : of the camera it is of."""

    description: str
    learned: str = ""
    serial: str = ""


@dataclass(frozen=True)
class CameraRecord:
    """One camera of a take: its description, its backgrounds in the order of their use, and its lost frames.

    frames : silhouettes in the bag. lost : frames that the camera client did not get whole, of those ``expected``
    meanwhile; None where the bag has no diagnostics of it.
    """

    frames: int
    serial: str = ""
    model: str = ""
    backgrounds: tuple[Background, ...] = ()
    lost: int | None = None
    expected: int | None = None


@dataclass(frozen=True)
class PersonRecord:
    """Figures of one tracked person.

    rows : frame sets with a pose. coverage : share of the frame sets from the person's first to the last one that have
    a pose which is not lost. doubtful, lost : share of the poses in that state. sd_mm, sd_95_mm : standard deviation
    of a point in one direction, median and 95th percentile over all points of all rows.
    """

    rows: int
    coverage: float
    doubtful: float
    lost: float
    sd_mm: float
    sd_95_mm: float


@dataclass(frozen=True)
class Quality:
    """Figures of a take, by the stamps of its frame sets.

    begins_ns, ends_ns : stamps of the first and last frame set. sets : frame sets. rate_hz : by their median interval.
    incomplete : sets in which a camera was missing. unanswered : sets that the tracker left out. stamps_back : how
    often stamps went back (footage played again).
    """

    begins_ns: int
    ends_ns: int
    sets: int
    rate_hz: float
    incomplete: int
    unanswered: int
    stamps_back: int = 0

    @property
    def seconds(self) -> float:
        """Seconds from the first frame set to the last."""
        return (self.ends_ns - self.begins_ns) / 1e9

    @property
    def sets_per_s(self) -> float:
        """Frame sets a second, on average."""
        return (self.sets - 1) / self.seconds if self.ends_ns > self.begins_ns else 0.0


@dataclass(frozen=True)
class Summary:
    """Figures from a take's messages; ``body`` : the first person's sizes last published, as a body file's text.

    files : name -> size and SHA-256 of the recorded files. measured_by : the software that measured the figures.
    """

    quality: Quality
    cameras: Mapping[str, CameraRecord] = field(default_factory=dict)
    persons: Mapping[str, PersonRecord] = field(default_factory=dict)
    body: str = ""
    files: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    measured_by: str = ""

    def document(self) -> dict[str, Any]:
        """Return the summary as plain data, which :meth:`parse` reads."""
        return {"format": FORMAT, **msgspec.to_builtins(self)}

    @classmethod
    def parse(cls, document: Mapping[str, Any], where: str) -> Summary:
        """Read :meth:`document`. Raises InputError for anything else."""
        if document.get("format") != FORMAT:
            raise InputError(f"has format {document.get('format')!r}, not {FORMAT}", where=where, remedy=REMEDY)
        try:
            return msgspec.convert(document, cls)
        except msgspec.ValidationError as error:
            raise InputError(f"is no summary of a take ({error})", where=where, remedy=REMEDY) from error


@dataclass(frozen=True)
class Take:
    """A take in a folder.

    state : whether it can be used; problem : why not, with the remedy. began_ns : log time of its first message;
    seconds : of log time; bytes : on disk; topics : messages by topic. software : that recorded it, "" if unknown.
    trimmed_from : the take that it is a part of, with first and last second. summary : None where the figures were not
    measured, or the recorder was killed.
    """

    path: Path
    state: TakeState = TakeState.WHOLE
    problem: str = ""
    began_ns: int = 0
    seconds: float = 0.0
    bytes: int = 0
    topics: Mapping[str, int] = field(default_factory=dict)
    software: str = ""
    trimmed_from: Mapping[str, Any] | None = None
    summary: Summary | None = None

    @property
    def name(self) -> str:
        """The folder's name."""
        return self.path.name

    def document(self) -> dict[str, Any]:
        """Return everything as plain data."""
        summary = None if self.summary is None else self.summary.document()
        return {"name": self.name, **msgspec.to_builtins(replace(self, summary=None), enc_hook=str), "summary": summary}


# words and short figures, for the command and the page alike ----------------------------------------------------------


MIB = 1 << 20
FIGURES = ("seconds", "sets/s", "persons", "tracked", "doubtful", "± mm", "dropped", "MB")
NOT_MEASURED = "not measured"


def figures(take: Take) -> tuple[str, ...]:
    """Return the columns FIGURES of a take; a dash where a figure is unknown.

    tracked : of the person tracked worst; doubtful, ± mm (median standard deviation of a point) : of all poses.
    """
    size = f"{take.bytes / MIB:.1f}"
    if take.summary is None:
        return (f"{take.seconds:.1f}" if take.topics else "-", *"-" * 6, size)
    quality, persons = take.summary.quality, take.summary.persons.values()
    seconds, rate, dropped = f"{quality.seconds:.1f}", f"{quality.sets_per_s:.1f}", str(quality.unanswered)
    if not persons:
        return (seconds, rate, "0", "-", "-", "-", dropped, size)
    rows = sum(person.rows for person in persons)
    return (
        seconds,
        rate,
        str(len(persons)),
        f"{100 * min(person.coverage for person in persons):.0f} %",
        f"{100 * sum(person.doubtful * person.rows for person in persons) / rows:.0f} %",
        f"{sum(person.sd_mm * person.rows for person in persons) / rows:.0f}",
        dropped,
        size,
    )


def date(take: Take) -> str:
    """Return when a take was recorded, in local time."""
    return time.strftime("%Y-%m-%d %H:%M:%S", time.localtime(take.began_ns / 1e9)) if take.began_ns else "-"


def remark(take: Take) -> str:
    """Return a take's remark: unfinished, damaged, not measured, or a part of another."""
    if take.state is not TakeState.WHOLE:
        return str(take.state)
    return origin(take) if take.summary is not None else NOT_MEASURED


def origin(take: Take) -> str:
    """Return in words the take that it is a part of; empty for a whole one."""
    part = take.trimmed_from
    if part is None:
        return ""
    to_s = "its end" if part.get("to_s") is None else f"{part['to_s']:g} s"
    return f"trimmed from {part.get('take')}, {part.get('from_s'):g} s to {to_s}"


def summary_lines(summary: Summary) -> Iterator[str]:
    """Yield a line for the frame sets, for each person, each camera, and, moved in, each background."""
    quality = summary.quality
    back = f", stamps went back {quality.stamps_back} times" if quality.stamps_back else ""
    yield (
        f"{quality.sets} frame sets in {quality.seconds:.2f} s ({quality.sets_per_s:.1f} a second, mostly at "
        f"{quality.rate_hz:g} Hz); {quality.incomplete} incomplete, {quality.unanswered} dropped{back}"
    )
    for name, person in summary.persons.items():
        yield (
            f"{name}: {person.rows} poses, tracked in {100 * person.coverage:.1f} % of its time, doubtful in "
            f"{100 * person.doubtful:.1f} %, lost in {100 * person.lost:.1f} %; standard deviation of a point "
            f"{person.sd_mm:.0f} mm (median), {person.sd_95_mm:.0f} mm (95 %)"
        )
    for name, camera in summary.cameras.items():
        lost = f", lost {camera.lost} of {camera.expected} frames" if camera.lost is not None else ""
        what = " ".join(filter(None, (camera.model, camera.serial))) or "model and serial unknown"
        yield f"{name}: {camera.frames} silhouettes{lost}; {what}"
        for background in camera.backgrounds:
            learned = f"; learned {background.learned}" if background.learned else ""
            serial = f" of {background.serial}" if background.serial else ""
            yield f"    background: {background.description}{learned}{serial}"
