"""Examines a rig file, its calibration reports, and footage of the rig."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

import numpy as np

from camera_client.sources.footage_reader import open_footage
from capture_rig.camera import CameraModel
from capture_rig.camera_info_file import load_camera_info
from capture_rig.errors import InputError
from capture_rig.rig import Rig, load_rig
from capture_rig.session import STILL_SUFFIXES, VIDEO_SUFFIXES, find_footage, stated_rate
from capture_rig.verdict import GOOD, REDO, USABLE
from capture_rig.video_findings import examine_video, session_findings
from capture_rig.yaml_file import read_mapping
from rig_calibration.intrinsics.verdict import UNUSED_GOOD, UNUSED_USABLE

from .findings import Finding, error, graded, note, ok, on, warning
from .rig_facts import (
    SUFFIX,
    CameraGeometry,
    FootageFacts,
    ReportFacts,
    RigFacts,
    angle_deg,
    geometry,
    read_report,
    report_beside,
)

DAY_S = 86400.0
AGEING_DAYS, OLD_DAYS = 30, 180
CALIBRATE = "sagoma calibrate extrinsics"
CALIBRATE_LENS = "sagoma calibrate intrinsics"
OFF_CENTRE = 0.15  # of the image's width or height
UNEQUAL_FOCAL = 0.02
NARROW_DEG, WIDE_DEG = 15.0, 130.0
HIGH_M, LOW_M = 6.0, 0.3
SAME_PLACE_M = 0.05
SAME_OUTLINE_DEG = 15.0
COARSE_MM_PER_PX = 12.0
ENOUGH_CAMERAS = 3
POOR_SHARE, LITTLE_SHARE = 0.05, 0.5
SEES_NOTHING = 0.01


def check_rig(facts: RigFacts) -> Iterator[Finding]:
    """Check the rig as a whole: report, number of cameras, common view, pairs."""
    names = ", ".join(camera.name for camera in facts.cameras)
    yield ok("file", f"{facts.path}: {len(facts.cameras)} cameras ({names})")
    yield from check_report(facts.report, CALIBRATE)
    bare = [camera.name for camera in facts.cameras if camera.name not in facts.reports]
    if bare:
        remedy = f"{CALIBRATE_LENS}, or say with --intrinsics where they are."
        yield note("reports.no_lens", f"there is none of the lens of {', '.join(bare)}", remedy)
    yield from _check_number(facts)
    yield from _check_common_view(facts)
    yield from _check_pairs(facts)


def check_camera(camera: CameraGeometry, report: ReportFacts | None, differing: str = "") -> Iterator[Finding]:
    """Check one camera: its lens, its pose, its view of the volume."""
    if report is not None:  # cameras without one are named by check_rig
        yield from check_report(report, CALIBRATE_LENS)
    if differing:
        yield warning(
            "intrinsics.differ",
            f"its own camera_info differs from the rig file: {differing}",
            f"Where the lens was calibrated after the rig: {CALIBRATE} again, with the new intrinsics; "
            "else remove the old camera_info.",
        )
    yield from _check_lens(camera)
    yield from _check_place(camera)


def check_report(report: ReportFacts | None, again: str) -> Iterator[Finding]:
    """Check that the calibration has a report, its verdict, and its age."""
    if report is None:
        yield note("report.missing", "there is none: nothing is known of the calibration's accuracy", again)
        return
    if report.error:
        yield warning("report.unreadable", f"{report.path}: {report.error}", again)
        return
    findings = "; ".join(f"{what} ({remedy})" if remedy else what for what, remedy in report.findings)
    text = f"{report.path}: {report.grade}{': ' if findings else ''}{findings}"
    if report.grade == REDO:
        yield error("calibration.redo", text, f"{again}, after what the report says")
    elif report.grade == USABLE:
        yield warning("calibration.usable", text, f"{again}, after what the report says, when there is time")
    elif report.grade == GOOD:
        yield ok("calibration", f"{text}{'; ' if report.figures else ''}{report.figures}")
    else:
        yield note("calibration.no_verdict", f"{report.path} holds no verdict", again)
    yield from _check_age(report, again)


def check_footage(facts: FootageFacts, camera: CameraGeometry) -> Iterator[Finding]:
    """Check that footage and background can be read and have the calibrated size."""
    width, height = camera.size
    if facts.error:
        yield error("footage.unreadable", facts.error, "Record the session again, or mend the file.")
    elif facts.size != camera.size:
        text = f"is {facts.size[0]} x {facts.size[1]} pixels, the camera was calibrated at {width} x {height}"
        yield error("footage.size_differs", text, "Record at the calibrated size, or calibrate at the recorded one.")
    else:
        yield ok("footage", f"{facts.frames} frames of {width} x {height} pixels")
    if facts.background_size is not None and facts.background_size != camera.size:
        text = f"is {facts.background_size[0]} x {facts.background_size[1]} pixels, the camera {width} x {height}"
        yield error("background.size_differs", text, "Record the empty room at the camera's size.")


def check_session(footage: Sequence[FootageFacts], stated_fps: float | None = None) -> Iterator[Finding]:
    """Check that the videos can be read to their ends, have one rate and equally many frames, and a background each.

    ``stated_fps`` : the rate in session.yaml."""
    videos = {facts.camera: facts.video for facts in footage if facts.video is not None}
    rates = {camera: video.fps for camera, video in videos.items()}
    if stated_fps is None and rates and (min(rates.values()) <= 0 or len(set(rates.values())) > 1):
        listed = ", ".join(f"{camera} {rate:g}" if rate else f"{camera} unknown" for camera, rate in rates.items())
        remedy = "Give the true rate as 'fps' in session.yaml."
        yield error("footage.rate", f"the videos' headers give no one frame rate ({listed})", remedy)
    for found in session_findings(videos):
        yield warning("footage.doubtful", found.what, found.remedy)
    frames = {facts.camera: facts.frames for facts in footage if not facts.error}
    if len(set(frames.values())) > 1:
        lengths = ", ".join(f"{camera} {count}" for camera, count in frames.items())
        remedy = "Cut them so that frame k of all was taken at the same instant."
        yield warning("footage.lengths_differ", f"the videos have different numbers of frames ({lengths})", remedy)
    bare = [facts.camera for facts in footage if not facts.error and facts.background_size is None]
    if bare:
        yield error(
            "background.missing", f"there is none for {', '.join(bare)}", f"Add {bare[0]}_background.mp4 or .png."
        )


def _check_number(facts: RigFacts) -> Iterator[Finding]:
    number = len(facts.cameras)
    if number < ENOUGH_CAMERAS:
        yield error("cameras.too_few", f"{number} cannot carve a body", "Use four cameras or more; three at the least.")
    elif number == ENOUGH_CAMERAS:
        text = "three: a limb before the trunk has no outline of its own, and a faulty camera cannot be outvoted"
        yield note("cameras.three", text, "Add one or two where there is room.")
    sizes = {camera.size for camera in facts.cameras}
    if len(sizes) > 1:
        yield note(
            "cameras.sizes_differ",
            f"their images have {len(sizes)} sizes: "
            + ", ".join(f"{camera.name} {camera.size[0]} x {camera.size[1]}" for camera in facts.cameras),
        )


def _check_common_view(facts: RigFacts) -> Iterator[Finding]:
    enough = min(ENOUGH_CAMERAS, len(facts.cameras))
    share = facts.seen_by[enough - 1]
    text = f"{100 * share:.0f} % of the volume's floor lets {enough} cameras see a person from soles to head"
    remedy = f"Move cameras back or use shorter lenses, or make the volume smaller ({CALIBRATE} chooses it)."
    poor, little = (share < POOR_SHARE, error, "unseen", remedy), (share < LITTLE_SHARE, note, "little_seen", remedy)
    yield graded("volume", text, poor, little)


def _check_pairs(facts: RigFacts) -> Iterator[Finding]:
    for one, other in facts.pairs:
        apart_m = sum((a - b) ** 2 for a, b in zip(one.centre_world, other.centre_world, strict=True)) ** 0.5
        angle = angle_deg(one.direction_world, other.direction_world)
        pair = f"{one.name} and {other.name}"
        if apart_m < SAME_PLACE_M:
            text = f"{pair} are {100 * apart_m:.0f} cm apart: one calibration given to two cameras?"
            yield error("cameras.same_place", text, f"{CALIBRATE}; check which file is whose.")
        elif angle > 180.0 - SAME_OUTLINE_DEG:
            text = f"{pair} face each other ({angle:.0f} degrees): they see one outline, mirrored"
            yield warning("cameras.opposite", text, "Move one of them sideways by an eighth of the circle, or higher.")
        elif angle < SAME_OUTLINE_DEG:
            text = f"{pair} look from {angle:.0f} degrees apart: they see nearly the same outline"
            yield warning("cameras.parallel", text, "Spread the cameras around the volume.")


def _check_age(report: ReportFacts, again: str) -> Iterator[Finding]:
    if report.age_s is None:
        return
    days = report.age_s / DAY_S
    old = (days > OLD_DAYS, warning, "old", f"Stands and lenses creep: {again}.")
    ageing = (days > AGEING_DAYS, note, "ageing", "See whether sagoma doctor --live names a camera.")
    yield graded("age", f"calibrated {days:.0f} days ago", old, ageing)


def _check_lens(camera: CameraGeometry) -> Iterator[Finding]:
    (width, height), (fx, fy), (cx, cy) = camera.size, camera.focal_px, camera.centre_px
    off = max(abs(cx - (width - 1) / 2) / width, abs(cy - (height - 1) / 2) / height)
    again = f"{CALIBRATE_LENS}: boards in the corners of the image, and tilted; check that the file is this camera's."
    faults = []
    if off > OFF_CENTRE:
        faults.append(
            ("off_centre", f"principal point ({cx:.0f}, {cy:.0f}) lies {100 * off:.0f} % of the image off its middle")
        )
    if abs(fx / fy - 1) > UNEQUAL_FOCAL:
        faults.append(("unequal_focal", f"fx {fx:.0f} and fy {fy:.0f} px differ by {100 * abs(fx / fy - 1):.0f} %"))
    if not NARROW_DEG < camera.fov_deg < WIDE_DEG:
        faults.append(("field_of_view", f"it sees {camera.fov_deg:.0f} degrees across, which few lenses do"))
    holds = f"the lens model holds up to {camera.reach_deg:.0f} degrees: the outer {100 * camera.unused:.1f} % of the "
    holds += "image is not used"
    if camera.unused > UNUSED_USABLE:
        faults.append(("border", holds))
    elif camera.unused > UNUSED_GOOD:
        yield note(
            "lens.unused",
            holds,
            f"Keep people out of the image's corners, or {CALIBRATE_LENS} --model auto, with a ChArUco board in them.",
        )
    for condition, text in faults:
        yield warning(f"lens.{condition}", text, again)
    if not faults:
        yield ok("lens", f"f {fx:.0f} px, {camera.fov_deg:.0f} degrees across, principal point ({cx:.0f}, {cy:.0f})")


def _check_place(camera: CameraGeometry) -> Iterator[Finding]:
    height = camera.height_m
    again = f"{CALIBRATE}; the board upside down or a wrong field size does this. Check with a tape."
    if height < 0:
        yield error("place.below_floor", f"it lies {-height:.2f} m below the floor", again)
    elif height > HIGH_M:
        yield warning("place.high", f"it hangs {height:.1f} m above the floor", again)
    elif height < LOW_M:
        remedy = "Raise it to 1.2 to 2.5 m."
        yield note("place.low", f"it stands {height:.2f} m above the floor: feet and limbs hide each other", remedy)
    if camera.sees < SEES_NOTHING:
        remedy = f"Turn it, move it back, or {CALIBRATE}, if the rig file is of another set-up."
        yield error("view.empty", "it sees no person in the volume from soles to head", remedy)
    elif camera.mm_per_px > COARSE_MM_PER_PX:
        text = f"a pixel is {camera.mm_per_px:.0f} mm at the volume's centre, {camera.distance_m:.1f} m away"
        yield warning("view.coarse", text, "Use a longer lens, more pixels, or move it nearer.")
    else:
        yield ok(
            "view",
            f"{height:.2f} m above the floor, {camera.distance_m:.1f} m away, {camera.mm_per_px:.1f} mm a "
            f"pixel, sees a person from soles to head in {100 * camera.sees:.0f} % of the places",
        )


SUBJECT = "rig"
LENS_FOLDERS = (".", "intrinsics", "calibration/intrinsics", "../intrinsics")  # beside the rig file
SAME_LENS_PX = 0.5


def examine_rig(path: Path | None, session: Path | None, intrinsics: Path | None) -> Iterator[Finding]:
    """Examine the rig file at ``path`` (the session's own by default) and the session's footage."""
    path = path or Path(session or ".") / "rig.yaml"
    try:
        rig = load_rig(path)
    except InputError as problem:
        yield from on(SUBJECT, [error("file.invalid", f"{problem.where}: {problem.what}", problem.remedy)])
        return
    facts = collect_rig(rig, path, intrinsics)
    yield from on(SUBJECT, check_rig(facts))
    footage = {} if session is None else {name: collect_footage(session, name) for name in rig.names}
    yield from on(f"session {session}", check_session(list(footage.values()), _stated(session)))
    for camera in facts.cameras:
        subject = f"camera {camera.name}"
        report = facts.reports.get(camera.name)
        yield from on(subject, check_camera(camera, report, facts.differing.get(camera.name, "")))
        if camera.name in footage:
            yield from on(subject, check_footage(footage[camera.name], camera))


def _stated(session: Path | None) -> float | None:
    """Return the frame rate that the session states, None for none, or one that loading the session refuses."""
    try:
        return None if session is None else stated_rate(session / "session.yaml")
    except InputError:
        return None


def collect_rig(rig: Rig, path: Path, intrinsics: Path | None) -> RigFacts:
    """Return the rig's geometry, and the reports beside its file."""
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
    """Return the video and the background of camera ``name``."""
    video = find_footage(session, name, VIDEO_SUFFIXES)
    if video is None:
        return FootageFacts(name, f"there is no {session / name}.mp4")
    try:
        size, background = _size(video), find_footage(session, f"{name}_background", VIDEO_SUFFIXES + STILL_SUFFIXES)
        seen = examine_video(video)
        background_size = None if background is None else _size(background)
        return FootageFacts(name, "", size, seen.passed.frames, background_size, seen)
    except InputError as problem:
        return FootageFacts(name, f"{problem.where}: {problem.what}")


def _lens_folders(rig_file: Path) -> list[Path]:
    """Return where the cameras' own calibrations may be: where the rig's report says, or beside the rig file."""
    folders = [rig_file.parent / name for name in LENS_FOLDERS]
    report = rig_file.with_name(rig_file.stem + SUFFIX)
    if report.is_file():
        try:
            asked = read_mapping(report, "").get("asked")
        except InputError:  # read_report says so
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
    differences = [
        f"{name} {a:.1f}, in the rig {b:.1f}" for name, a, b in zip(names, mine, rigs, strict=True) if a != b
    ]
    return f"{path} says {', '.join(differences)}"


def _size(path: Path) -> tuple[int, int]:
    reader = open_footage(path)
    try:
        shape = reader.probe()
    finally:
        reader.close()
    return shape[1], shape[0]
