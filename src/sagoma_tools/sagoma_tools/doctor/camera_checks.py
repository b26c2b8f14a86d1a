"""The camera's own settings: calibration, background, and whether exposure and rate go together."""

from __future__ import annotations

from collections.abc import Iterator

from camera_client.calibration import Calibration
from camera_client.settings import CameraClientSettings
from capture_rig.camera import CameraModel

from .facts import BackgroundFacts
from .findings import Finding, error, note, ok, warning

OLD_S = 12 * 3600.0  # daylight and lamps change from one day to the next
EXPOSURE_TOLERANCE = 0.02
LEARN = "sagoma background --cameras {name}, while the room is empty"


def check_calibration(calibration: Calibration, settings: CameraClientSettings) -> Finding:
    """How much is known of the camera."""
    camera = calibration.camera
    if camera is None:
        return note(
            "rig",
            "not calibrated yet: it sends images, no silhouettes",
            f"sagoma calibrate intrinsics --topic /{calibration.name}/image_raw --board BOARD",
        )
    size = f"{camera.name}, {camera.width} x {camera.height} pixels"
    if calibration.placed:
        return ok("rig", f"{settings.rig_file}: {size}")
    return note(
        "rig",
        f"{settings.camera_info_file}: {size}; its lens is known, its place is not",
        "sagoma calibrate extrinsics, then name the rig file in rig_file.",
    )


def check_background(
    facts: BackgroundFacts | None, camera: CameraModel, settings: CameraClientSettings
) -> Iterator[Finding]:
    """Is it there, does it fit, is it fresh?"""
    learn = LEARN.format(name=camera.name)
    if facts is None:
        yield note("background", "none is named: no silhouettes until one is learned", learn)
        return
    if facts.error:
        yield error("background", facts.error, f"Name the right file, or empty the parameter, and {learn}")
        return
    if facts.shape[:2] != (camera.height, camera.width):
        yield error(
            "background",
            f"{facts.path} is {facts.shape[1]} x {facts.shape[0]}, the camera {camera.width} x {camera.height} pixels",
            learn,
        )
        return
    age = f"{facts.age_s / 3600:.0f} h old"
    if facts.age_s > OLD_S:
        yield warning("background", f"{facts.path} is {age}; the light has changed since", learn)
    else:
        yield ok("background", f"{facts.path}, {age}{'; ' if facts.summary else ''}{facts.summary}")
    yield from _check_learned_exposure(facts, settings, learn)


def _check_learned_exposure(facts: BackgroundFacts, settings: CameraClientSettings, learn: str) -> Iterator[Finding]:
    wanted = settings.aravis.exposure_us
    try:
        learned = float(facts.exposure_us)
    except ValueError:  # it is not written in the file
        return
    if wanted > 0 and abs(learned - wanted) > EXPOSURE_TOLERANCE * wanted:
        yield warning("background", f"learned at {learned:g} us of exposure, aravis.exposure_us = {wanted:g}", learn)


def check_timing(settings: CameraClientSettings) -> Iterator[Finding]:
    """Do exposure and frame rate go together, and is anything left to the camera?"""
    exposure_us, rate = settings.aravis.exposure_us, settings.aravis.frame_rate
    if exposure_us > 0 and rate > 0 and exposure_us * 1e-6 * rate >= 1:
        yield error(
            "exposure",
            f"{exposure_us:g} us do not fit {rate:g} frames a second (at most {1e6 / rate:.0f} us)",
            "Shorten aravis.exposure_us or lower aravis.frame_rate.",
        )
    elif exposure_us > 0 and rate > 0:
        yield ok("exposure", f"{exposure_us:g} us at {rate:g} frames a second")
    for key, value in (("exposure_us", exposure_us), ("gain", settings.aravis.gain), ("frame_rate", rate)):
        if value < 0:
            yield note("settings", f"aravis.{key} is left as the camera has it", "Set it: cameras forget.")
