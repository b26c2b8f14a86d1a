"""The summary beside a bag, ``take.yaml``: written when the recording closes, and whenever a take is measured anew."""

from __future__ import annotations

import logging
from collections.abc import Callable
from pathlib import Path

import yaml

from capture_rig.files import write_text
from capture_rig.yaml_file import read_mapping

from .measure import measure
from .take import REMEDY, Summary

SIDECAR_TAKE = "take.yaml"
_log = logging.getLogger("sagoma.takes")


def finish_take(bag: Path, progress: Callable[[int], None] = lambda messages: None) -> Summary | None:
    """Measure a bag that was just closed, and write its summary; None where that fails.

    The recording is whole without it: a summary that cannot be made is made later, by `sagoma takes measure`.
    """
    try:
        summary = measure(bag, progress)
        write_summary(bag, summary)
    except Exception as error:  # a full disk, a foreign message: the bag itself is closed, and must be reported so
        _log.warning("%s is recorded, but its figures cannot be measured: %s", bag, error)
        return None
    return summary


def write_summary(bag: Path, summary: Summary) -> None:
    """Write (or replace) take.yaml, whole or not at all."""
    write_text(bag / SIDECAR_TAKE, yaml.safe_dump(summary.document(), sort_keys=False, allow_unicode=True))


def read_summary(bag: Path) -> Summary | None:
    """Return the summary beside a bag, None where there is none. Raises InputError for one that cannot be read."""
    path = bag / SIDECAR_TAKE
    return Summary.parse(read_mapping(path, REMEDY), str(path)) if path.is_file() else None
