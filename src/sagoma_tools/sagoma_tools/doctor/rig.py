"""Checks of a rig file and its calibration reports."""

from __future__ import annotations

import itertools
import time
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from capture_rig.camera import CameraModel
from capture_rig.lens import is_fisheye
from capture_rig.rig import Rig, load_rig
from capture_rig.verdict import GOOD, REDO, USABLE
from capture_rig.visibility import MOST_PIXEL_M, needed_region, of_region, pixel_width_m
from capture_rig.yaml_file import read_mapping
from rig_calibration.intrinsics.lens_model import ASPECT_PRIOR, CENTRE_PRIOR
from rig_calibration.intrinsics.result import UNUSED_GOOD, UNUSED_USABLE, unused_text

from .cameras import BUSY, GIGABIT, JUMBO_MTU, wire_bytes
from .findings import CheckResult, about, error, note, result_of, warning

Array = npt.NDArray[np.float64]

SUBJECT, SUFFIX = "rig", ".report.yaml"  # of the report that sagoma calibrate writes beside its result
CALIBRATE, CALIBRATE_LENS = "sagoma calibrate extrinsics", "sagoma calibrate intrinsics"
STEP_M, BREAST_M = 0.2, 1.0
BODY_LEVELS_M = np.arange(0.1, 1.8, 0.2)  # soles to head
OLD_S = 180 * 86400.0
NARROW_DEG, WIDE_DEG = 15.0, 130.0
HIGH_M, LOW_M = 6.0, 0.3
FACING_DEG, CLOSE_DEG, SAME_PLACE_M = 170.0, 12.0, 0.05  # cameras face to face see the same outline, mirrored
MIN_CAMERAS = 3
POOR_SHARE, LITTLE_SHARE = 0.05, 0.5  # of the places where a person may stand


@dataclass(frozen=True)
class RigView:
    """A rig, the file it is from, and its cameras' views.

    sees (cameras, places) : whether a camera sees a person from soles to head at a standing place of the volume.
    middle (3,) : the volume's centre at breast height, m.
    """

    rig: Rig
    path: Path
    sees: npt.NDArray[np.bool_]
    middle: Array

    @classmethod
    def of(cls, rig: Rig, path: Path) -> RigView:
        """Compute every camera's view of the volume's standing places."""
        low, high = rig.volume.low, rig.volume.high
        x, y = (np.arange(low[i] + STEP_M / 2, high[i], STEP_M) for i in range(2))
        places = np.stack(np.meshgrid(x, y, BODY_LEVELS_M, indexing="ij"), axis=-1).reshape(-1, len(BODY_LEVELS_M), 3)
        sees = np.array([_sees(camera, places) for camera in rig.cameras])
        return cls(rig, path, sees, np.array([*(low + high)[:2] / 2, BREAST_M]))


def examine_rig(path: Path) -> Iterator[CheckResult]:
    """Examine the rig file at ``path``."""
    view = RigView.of(load_rig(path), path)
    yield from about(SUBJECT, check_rig_report(view), check_coverage(view), check_regions(view), check_pairs(view))
    for camera in view.rig.cameras:
        yield from about(f"camera {camera.name}", check_lens(camera), check_place(view, camera))


def check_rig_report(view: RigView) -> Iterator[CheckResult]:
    """The verdict, the findings and the age of the report that the calibration left beside the rig file."""
    path = view.path.with_name(view.path.stem + SUFFIX)
    if not path.is_file():
        yield note("report.missing", "there is none: nothing is known of the calibration's accuracy", CALIBRATE)
        return
    report = read_mapping(path, f"{CALIBRATE}.")
    grade, listed = report.get("verdict"), report.get("findings")
    reasons = [f"{why['what']} ({why['remedy']})" for why in listed] if isinstance(listed, list) else []
    text = f"{path}: {'; '.join([str(grade), *reasons])}"
    remedy = f"{CALIBRATE}, after what the report says"
    later = (grade == USABLE, warning, "usable", f"{remedy}, when there is time")
    none = (grade != GOOD, note, "no_verdict", CALIBRATE)
    yield result_of("calibration", text, (grade == REDO, error, "redo", remedy), later, none)
    age_s = time.time() - path.stat().st_mtime
    remedy = f"Stands and lenses creep: {CALIBRATE}."
    yield result_of("age", f"calibrated {age_s / 86400:.0f} days ago", (age_s > OLD_S, warning, "old", remedy))


def check_coverage(view: RigView) -> Iterator[CheckResult]:
    """Whether the cameras are enough to carve a body, and the share of the volume that enough of them see."""
    number = len(view.rig.cameras)
    few = "Use four cameras or more; three at the least: two cannot carve a body."
    three = "Add one or two: a limb before the trunk has no outline of its own, and a faulty camera cannot be outvoted."
    cases = (number < MIN_CAMERAS, error, "too_few", few), (number == MIN_CAMERAS, note, "three", three)
    yield result_of("cameras", f"{view.path}: {number} ({', '.join(view.rig.names)})", *cases)
    enough = min(MIN_CAMERAS, number)
    share = float((view.sees.sum(axis=0) >= enough).mean())
    text = f"{100 * share:.0f} % of the volume's floor lets {enough} cameras see a person from soles to head"
    remedy = f"Move cameras back or use shorter lenses, or make the volume smaller ({CALIBRATE} chooses it)."
    poor, little = (share < POOR_SHARE, error, "unseen", remedy), (share < LITTLE_SHARE, note, "little_seen", remedy)
    yield result_of("volume", text, poor, little)


def check_regions(view: RigView) -> CheckResult:
    """What of the pictures the volume needs, and how fast one link carries that."""
    whole, parts = view.rig, needed_parts(view.rig)
    smaller = any((a.width, a.height) != (b.width, b.height) for a, b in zip(whole.cameras, parts.cameras, strict=True))
    remedy = "Where the rate matters: those aravis settings, the rig file of --regions, and backgrounds anew."
    return result_of("regions", carried(whole), (smaller, note, "smaller", remedy))


def needed_parts(rig: Rig) -> Rig:
    """Return the rig of the regions that its volume needs."""
    return Rig(tuple(of_region(each, needed_region(each, rig.volume)) for each in rig.cameras), rig.volume)


def carried(rig: Rig) -> str:
    """Return the frame rates at which a link carries whole pictures, and the regions that the volume needs, as settings
    of the clients."""
    regions = {each.name: asdict(needed_region(each, rig.volume)) for each in rig.cameras}
    named = (f"{name} {', '.join(f'{key} {px}' for key, px in region.items())}" for name, region in regions.items())
    return (
        f"a link of {GIGABIT} Mbit/s carries all cameras at {most_hz(rig):.0f} Hz, at {most_hz(needed_parts(rig)):.0f} "
        f"Hz what the volume needs ({'; '.join(named)})"
    )


def most_hz(rig: Rig) -> float:
    """Return the rate that a Gigabit link carries with some room, of pictures of 8 bits a pixel in large packets."""
    frame_bytes = sum(wire_bytes(each.width * each.height, JUMBO_MTU) for each in rig.cameras)
    return BUSY * GIGABIT * 1e6 / 8 / frame_bytes


def check_pairs(view: RigView) -> Iterator[CheckResult]:
    """Pairs of cameras that show one outline."""
    for one, other in itertools.combinations(view.rig.cameras, 2):
        pair, apart_m = f"{one.name} and {other.name}", float(np.linalg.norm(one.centre_world - other.centre_world))
        a, b = (camera.centre_world - view.middle for camera in (one, other))
        angle = float(np.degrees(np.arctan2(np.linalg.norm(np.cross(a, b)), a @ b)))
        if apart_m < SAME_PLACE_M:
            text = f"{pair} are {100 * apart_m:.0f} cm apart: one calibration given to two cameras?"
            yield error("cameras.same_place", text, f"{CALIBRATE}; check which file is whose.")
        elif angle > FACING_DEG:
            text = f"{pair} face each other ({angle:.0f} degrees): they see one outline, mirrored"
            yield warning("cameras.opposite", text, "Move one of them sideways by an eighth of the circle, or higher.")
        elif angle < CLOSE_DEG:
            text = f"{pair} look from {angle:.0f} degrees apart: they see nearly the same outline"
            yield warning("cameras.parallel", text, "Spread the cameras around the volume.")


def check_lens(camera: CameraModel) -> Iterator[CheckResult]:
    """Whether the lens is one that exists, and holds over the image."""
    fx, fy, cx, cy = camera.K[[0, 1, 0, 1], [0, 1, 2, 2]].tolist()
    width, height, fisheye = camera.width, camera.height, is_fisheye(camera.D)
    off = np.hypot(cx - (width - 1) / 2, cy - (height - 1) / 2) / max(width, height)
    across = 2 * np.degrees(np.arctan(width / (2 * fx)))
    again = f"{CALIBRATE_LENS}: boards in the corners of the image, and tilted; check that the file is this camera's."
    yield result_of(
        "lens",
        f"f {fx:.0f} x {fy:.0f} px, as a pinhole {across:.0f} degrees across, principal point ({cx:.0f}, {cy:.0f})",
        (off > CENTRE_PRIOR, warning, "off_centre", again),
        (abs(fx / fy - 1) > ASPECT_PRIOR, warning, "unequal_focal", again),
        (not NARROW_DEG < across < WIDE_DEG, warning, "field_of_view", again),
    )
    share = camera.unused_share
    if share > UNUSED_GOOD:
        remedy = "Keep people out of the image's corners"
        remedy += "." if fisheye else f", or {CALIBRATE_LENS} --model auto, with a ChArUco board in them."
        much = share > UNUSED_USABLE and not fisheye
        yield (warning if much else note)("lens.unused", unused_text(camera), remedy)


def check_place(view: RigView, camera: CameraModel) -> Iterator[CheckResult]:
    """The camera's place, and its view of the volume."""
    height, distance = float(camera.centre_world[2]), float(np.linalg.norm(camera.centre_world - view.middle))
    share = float(view.sees[view.rig.names.index(camera.name)].mean())
    mm_per_px = 1e3 * pixel_width_m(camera, view.rig.volume)
    again = f"{CALIBRATE}; the board upside down or a wrong field size does this. Check with a tape."
    yield result_of(
        "place",
        f"it is {height:.2f} m above the floor" if height >= 0 else f"it lies {-height:.2f} m below the floor",
        (height < 0, error, "below_floor", again),
        (height > HIGH_M, warning, "high", again),
        (height < LOW_M, note, "low", "Raise it to 1.2 to 2.5 m: feet and limbs hide each other."),
    )
    yield result_of(
        "view",
        f"{distance:.1f} m from the volume's centre, {mm_per_px:.1f} mm a pixel, sees a person from soles to head in "
        f"{100 * share:.0f} % of the places",
        (share < POOR_SHARE, error, "empty", f"Turn it, move it back, or {CALIBRATE}: a rig file of another set-up?"),
        (mm_per_px > 1e3 * MOST_PIXEL_M, warning, "coarse", "Use a longer lens, more pixels, or move it nearer."),
    )


def _sees(camera: CameraModel, places: Array) -> npt.NDArray[np.bool_]:
    pixels = camera.project(places)
    with np.errstate(invalid="ignore"):
        inside = (pixels >= -0.5) & (pixels < np.array([camera.width, camera.height]) - 0.5)
    return np.asarray(inside.all(axis=(1, 2)))
