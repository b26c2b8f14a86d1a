"""The examination of a rig file, its calibration and footage of it: collect, judge."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path

import cv2
import numpy as np

from camera_client.footage_reader import open_footage
from capture_rig.camera import CameraModel
from capture_rig.camera_info_file import load_camera_info
from capture_rig.errors import InputError
from capture_rig.rig import Rig, load_rig
from capture_rig.session import STILL_SUFFIXES, VIDEO_SUFFIXES
from capture_rig.yaml_file import read_mapping

from ..findings import Finding, error, on
from .calibration_report import SUFFIX, read_report, report_beside
from .checks import check_camera, check_footage, check_rig, check_session
from .facts import FootageFacts, ReportFacts, RigFacts, geometry

SUBJECT = "rig"
LENS_FOLDERS = (".", "intrinsics", "calibration/intrinsics", "../intrinsics")  # beside the rig file
SAME_LENS_PX = 0.5


def examine_rig(path: Path | None, session: Path | None, intrinsics: Path | None) -> Iterator[Finding]:
    """Findings on the rig file at ``path`` (the session's own by default) and on the session's footage."""
    path = path or Path(session or ".") / "rig.yaml"
    try:
        rig = load_rig(path)
    except InputError as problem:
        yield from on(SUBJECT, [error("file", f"{problem.where}: {problem.what}", problem.remedy)])
        return
    facts = collect_rig(rig, path, intrinsics)
    yield from on(SUBJECT, check_rig(facts))
    footage = {} if session is None else {name: collect_footage(session, name) for name in rig.names}
    yield from on(f"session {session}", check_session(list(footage.values())))
    for camera in facts.cameras:
        subject = f"camera {camera.name}"
        report = facts.reports.get(camera.name)
        yield from on(subject, check_camera(camera, report, facts.differing.get(camera.name, "")))
        if camera.name in footage:
            yield from on(subject, check_footage(footage[camera.name], camera))


def collect_rig(rig: Rig, path: Path, intrinsics: Path | None) -> RigFacts:
    """Geometry, and the reports that lie beside the file."""
    cameras, seen_by = geometry(rig)
    folders = [intrinsics] if intrinsics is not None else _lens_folders(path)
    reports: dict[str, ReportFacts] = {}
    differing: dict[str, str] = {}
    for camera in rig.cameras:
        for folder in folders:
            if camera.name not in reports and (folder / f"{camera.name}{SUFFIX}").is_file():
                reports[camera.name] = read_report(folder / f"{camera.name}{SUFFIX}")
                differing[camera.name] = _difference(folder / f"{camera.name}.yaml", camera)
    return RigFacts(str(path), cameras, seen_by, report_beside(path), reports, differing)


def collect_footage(session: Path, name: str) -> FootageFacts:
    """The video and the background of camera ``name``."""
    video = _first(session, name, VIDEO_SUFFIXES)
    if video is None:
        return FootageFacts(name, f"there is no {session / name}.mp4")
    try:
        size, background = _size(video), _first(session, f"{name}_background", STILL_SUFFIXES + VIDEO_SUFFIXES)
        return FootageFacts(name, "", size, _frames(video), None if background is None else _size(background))
    except InputError as problem:
        return FootageFacts(name, f"{problem.where}: {problem.what}")


def _lens_folders(rig_file: Path) -> list[Path]:
    """Where the cameras' own calibrations may be: where the rig's report says, or beside the rig file."""
    folders = [rig_file.parent / name for name in LENS_FOLDERS]
    report = rig_file.with_name(rig_file.stem + SUFFIX)
    if report.is_file():
        try:
            asked = read_mapping(report, "").get("asked")
        except InputError:  # told by whoever judges the report
            return folders
        if isinstance(asked, Mapping) and isinstance(asked.get("intrinsics"), str):
            folders.insert(0, Path(asked["intrinsics"]))
    return folders


def _difference(path: Path, camera: CameraModel) -> str:
    """How the camera_info at ``path`` differs from the rig's intrinsics; empty when it does not, or is not there."""
    if not path.is_file():
        return ""
    try:
        own = load_camera_info(path, camera)
    except InputError as problem:
        return f"{path}: {problem.what}"
    names = ("fx", "fy", "cx", "cy")
    mine, rigs = (np.array([c.K[0, 0], c.K[1, 1], c.K[0, 2], c.K[1, 2]]) for c in (own, camera))
    off = np.abs(mine - rigs)
    if off.max() <= SAME_LENS_PX:
        return ""
    told = [f"{name} {a:.1f}, in the rig {b:.1f}" for name, a, b in zip(names, mine, rigs, strict=True) if a != b]
    return f"{path} says {', '.join(told)}"


def _first(folder: Path, stem: str, suffixes: tuple[str, ...]) -> Path | None:
    return next((folder / (stem + end) for end in suffixes if (folder / (stem + end)).is_file()), None)


def _size(path: Path) -> tuple[int, int]:
    reader = open_footage(path)
    try:
        shape = reader.probe()
    finally:
        reader.close()
    return shape[1], shape[0]


def _frames(video: Path) -> int:
    capture = cv2.VideoCapture(str(video))
    try:
        return int(capture.get(cv2.CAP_PROP_FRAME_COUNT))
    finally:
        capture.release()
