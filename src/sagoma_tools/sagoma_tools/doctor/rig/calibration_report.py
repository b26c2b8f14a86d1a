"""Reads the report that ``sagoma calibrate`` leaves beside its result: verdict, findings, age."""

from __future__ import annotations

import datetime
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from capture_rig.errors import InputError
from capture_rig.verdict import GOOD, REDO, USABLE
from capture_rig.yaml_file import read_mapping

from .facts import ReportFacts

SUFFIX = ".report.yaml"


def report_beside(result: Path) -> ReportFacts | None:
    """The report of ``result`` (rig.yaml: rig.report.yaml); None when there is none."""
    path = result.with_name(result.stem + SUFFIX)
    return read_report(path) if path.is_file() else None


def read_report(path: Path) -> ReportFacts:
    """Verdict, findings and age of the report at ``path``."""
    try:
        document = read_mapping(path, "Calibrate again.")
    except InputError as error:
        return ReportFacts(str(path), error.what)
    verdict = document.get("verdict")
    grade = verdict if verdict in (GOOD, USABLE, REDO) else ""
    findings = _findings(document.get("findings"))
    return ReportFacts(str(path), "", grade, findings, _age_s(document, path), _figures(document))


def _findings(entries: Any) -> tuple[tuple[str, str], ...]:
    """Those that are not merely good, as (what, remedy)."""
    found = []
    for entry in entries if isinstance(entries, list) else []:
        if isinstance(entry, Mapping):
            found.append((str(entry.get("what", "")), str(entry.get("remedy", ""))))
        else:
            found.append((str(entry), ""))
    return tuple(found)


def _age_s(document: Mapping[str, Any], path: Path) -> float:
    """From the date in the report; from the file's, where there is none."""
    try:
        return time.time() - datetime.datetime.fromisoformat(str(document.get("date"))).timestamp()
    except ValueError:
        return time.time() - path.stat().st_mtime


def _figures(document: Mapping[str, Any]) -> str:
    of_rig = document.get("rig")
    rms = (of_rig if isinstance(of_rig, Mapping) else document).get("rms_px")
    return f"rms {rms:.2f} px" if isinstance(rms, int | float) else ""
