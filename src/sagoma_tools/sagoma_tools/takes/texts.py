"""What is known of a take in words and short figures, for the command and the page alike."""

from __future__ import annotations

import time
from collections.abc import Iterator

from .take import Background, CameraRecord, PersonRecord, Summary, Take, TakeState

MIB = 1 << 20
FIGURES = ("seconds", "sets/s", "persons", "tracked", "doubtful", "± mm", "dropped", "MB")
NOT_MEASURED = "not measured"


def figures(take: Take) -> tuple[str, ...]:
    """Return the columns FIGURES of a take; a dash where a figure is unknown.

    tracked : of the person followed worst; doubtful, ± mm (median standard deviation of a point) : of all poses.
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
    """Return what sets a take apart: unfinished, damaged, not measured, or of which take it is a part."""
    if take.state is not TakeState.WHOLE:
        return str(take.state)
    return origin(take) if take.summary is not None else NOT_MEASURED


def origin(take: Take) -> str:
    """Say of which take it is a part; empty for a whole one."""
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
        yield f"{name}: {_person(person)}"
    for name, camera in summary.cameras.items():
        yield f"{name}: {_camera(camera)}"
        for background in camera.backgrounds:
            yield f"    background: {_background(background)}"


def _person(person: PersonRecord) -> str:
    return (
        f"{person.rows} poses, tracked in {100 * person.coverage:.1f} % of its time, doubtful in "
        f"{100 * person.doubtful:.1f} %, lost in {100 * person.lost:.1f} %; standard deviation of a point "
        f"{person.sd_mm:.0f} mm (median), {person.sd_95_mm:.0f} mm (95 %)"
    )


def _camera(camera: CameraRecord) -> str:
    lost = f", lost {camera.lost} of {camera.expected} frames" if camera.lost is not None else ""
    what = " ".join(filter(None, (camera.model, camera.serial))) or "model and serial unknown"
    return f"{camera.frames} silhouettes{lost}; {what}"


def _background(background: Background) -> str:
    learned = f"; learned {background.learned}" if background.learned else ""
    serial = f" of {background.serial}" if background.serial else ""
    return f"{background.description}{learned}{serial}"
