"""Checks a take: every message readable, nothing changed since it was recorded, figures as they were measured."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

from capture_rig.errors import InputError
from capture_rig.rig import load_rig

from ..graph.topics import cameras_in
from ..recording.reader import SIDECAR_RIG, open_bag
from .measure import measure
from .take import Take, TakeState

OK, WARNING, ERROR = "ok", "warning", "error"


@dataclass(frozen=True)
class Check:
    """What one check found: ok, warning or error, and a sentence."""

    grade: str
    text: str


def verify(take: Take, progress: Callable[[int], None] = lambda messages: None) -> list[Check]:
    """Return what every check found; a take that cannot be read has one error."""
    if take.state is not TakeState.WHOLE:
        return [Check(ERROR, take.problem)]
    try:
        return [*_messages(take.path, progress), *_rig(take), *_summary(take)]
    except InputError as error:
        return [Check(ERROR, str(error))]
    except Exception as error:  # a broken file may break its reader in any way
        return [Check(ERROR, f"{take.path} cannot be read to its end ({type(error).__name__}: {error})")]


def _messages(bag: Path, progress: Callable[[int], None]) -> Iterator[Check]:
    with open_bag(bag) as reader:
        promised = Counter({connection.topic: connection.msgcount for connection in reader.connections})
        found: Counter[str] = Counter()
        last_ns = back = 0
        for number, (connection, log_ns, _) in enumerate(reader.messages()):
            found[connection.topic] += 1
            back += log_ns < last_ns
            last_ns = log_ns
            progress(number)
    missing = {topic: count - found[topic] for topic, count in promised.items() if count != found[topic]}
    for topic, count in missing.items():
        yield Check(ERROR, f"{topic}: {count} of the messages that the index promises are missing")
    if back:
        yield Check(ERROR, f"{back} messages are logged before their predecessors")
    if not missing and not back:
        yield Check(OK, f"all {found.total()} messages on {len(promised)} topics can be read, in order")


def _rig(take: Take) -> Iterator[Check]:
    if not (take.path / SIDECAR_RIG).is_file():
        yield Check(WARNING, f"has no {SIDECAR_RIG}: where its cameras stood is not known (record with --rig)")
        return
    unknown = set(cameras_in(take.topics)) - set(load_rig(take.path / SIDECAR_RIG).names)
    if unknown:
        yield Check(ERROR, f"{SIDECAR_RIG} does not know {', '.join(sorted(unknown))}")
    else:
        yield Check(OK, f"{SIDECAR_RIG} knows every camera")


def _summary(take: Take) -> Iterator[Check]:
    now = measure(take.path)
    stored = take.summary
    if stored is None:
        yield Check(WARNING, "has no figures: its recorder was killed (`sagoma takes measure` writes them)")
        return
    changed = [name for name in {*stored.files, *now.files} if stored.files.get(name) != now.files.get(name)]
    for name in sorted(changed):
        yield Check(ERROR, f"{name} is not what was recorded: its SHA-256 or its size differs")
    if not changed:
        yield Check(OK, f"{', '.join(now.files)} as recorded (SHA-256)")
    if now.same_figures(stored):
        yield Check(OK, "the figures are those of the messages")
    else:
        yield Check(ERROR if changed else WARNING, "the figures measured now differ: measured by " + stored.measured_by)
