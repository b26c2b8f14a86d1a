"""What is wrong with one camera of a calibrated rig."""

from __future__ import annotations

from collections.abc import Iterator

from capture_rig.verdict import REDO, USABLE, Finding

from .evidence import Evidence
from .figures import CameraFigures

GRAZING_DEG = 75.0
"""From the board's normal; beyond, its fields are too thin to find them well."""
SD_USABLE_MM, SD_REDO_MM = 10.0, 40.0
SD_USABLE_DEG, SD_REDO_DEG = 0.2, 1.0
RMS_USABLE_PX, RMS_REDO_PX = 1.0, 3.0
RMS_WIDTH_PX = 1000
"""Wider images may have residuals in proportion."""
LOWEST_M, HIGHEST_M = 0.0, 6.0
LEFT_OUT_SHARE = 0.2
STRAY_SHARE = 0.2


def findings_of_camera(camera: CameraFigures, evidence: Evidence) -> Iterator[Finding]:
    """All that is wrong with one camera, the worst causes first."""
    yield from _of_view(camera, evidence)
    yield from _of_precision(camera, evidence)
    yield from _of_height(camera, evidence)
    yield from _of_sightings(camera, evidence)


def _of_view(camera: CameraFigures, evidence: Evidence) -> Iterator[Finding]:
    view = evidence.floor.get(camera.name)
    if view is None or camera.floor_angle_deg is None:
        return
    alone = camera.name in evidence.by_floor_alone
    if view.other is not None and alone:
        yield Finding(
            REDO,
            f"two poses of {camera.name} fit the floor board equally well",
            "Use a larger board, lay it nearer to the camera, or carry a board through the room (--moving).",
        )
    if camera.floor_angle_deg > GRAZING_DEG and alone:
        yield Finding(
            USABLE,
            f"{camera.name} sees the board at {camera.floor_angle_deg:.0f} degrees from its normal",
            "Raise the camera, move the board nearer to it, or carry a board through the room (--moving).",
        )


def _of_precision(camera: CameraFigures, evidence: Evidence) -> Iterator[Finding]:
    widening = max(1.0, evidence.widths_px[camera.name] / RMS_WIDTH_PX)
    if camera.rms_px > RMS_USABLE_PX * widening:
        grade = REDO if camera.rms_px > RMS_REDO_PX * widening else USABLE
        yield Finding(
            grade,
            f"{camera.name}: the corners miss their places by {camera.rms_px:.2f} px (rms)",
            "Check that the intrinsics are this camera's, at this focus and image size, that the board is "
            "flat and specified as printed, and that it was held still.",
        )
    if camera.sd_centre_mm > SD_USABLE_MM:
        grade = REDO if camera.sd_centre_mm > SD_REDO_MM else USABLE
        yield Finding(grade, f"the place of {camera.name} is known to {camera.sd_centre_mm:.0f} mm only (sd)", _NEARER)
    if camera.sd_rotation_deg > SD_USABLE_DEG:
        grade = REDO if camera.sd_rotation_deg > SD_REDO_DEG else USABLE
        what = f"the direction of {camera.name} is known to {camera.sd_rotation_deg:.2f} degrees only (sd)"
        yield Finding(grade, what, _NEARER)


_NEARER = "Show it the board larger, nearer, more from above, and at more places of its image (--moving)."


def _of_height(camera: CameraFigures, evidence: Evidence) -> Iterator[Finding]:
    if not evidence.floor_known:
        return
    if camera.height_m < LOWEST_M:
        yield Finding(
            REDO,
            f"{camera.name} comes to lie {-camera.height_m:.2f} m below the floor",
            "Lay the board on the floor, print upwards; where corners are given by hand, give them in reading order.",
        )
    elif camera.height_m > HIGHEST_M:
        yield Finding(
            USABLE,
            f"{camera.name} comes to lie {camera.height_m:.1f} m above the floor",
            "If it hangs lower, the board's size is wrong: measure a field of the print.",
        )


def _of_sightings(camera: CameraFigures, evidence: Evidence) -> Iterator[Finding]:
    if (reason := evidence.floor_left_out.get(camera.name)) is not None:
        yield Finding(
            REDO,
            f"{camera.name} sees the floor board otherwise than the rest of the rig does: {reason}",
            "Was the board, or the camera, moved in between, or are its outer corners given the wrong way "
            "round? Take the pictures of the floor board again.",
        )
    reasons = evidence.left_out.get(camera.name, ())
    total = len(reasons) + camera.sightings
    if len(reasons) > LEFT_OUT_SHARE * total:
        yield Finding(
            USABLE,
            f"{len(reasons)} of {total} sightings of {camera.name} contradict the rest: {reasons[0]}",
            "Check that the cameras are synchronised, that the board was carried slowly, and that nobody "
            "touched the camera.",
        )
    strays, frames = evidence.strays.get(camera.name, (0, 0))
    if strays > STRAY_SHARE * frames:
        yield Finding(
            USABLE,
            f"in {strays} of {frames} frames of {camera.name} the floor board lies elsewhere",
            "Film it lying still, and start when everybody has left it.",
        )
