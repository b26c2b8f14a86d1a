"""The one list of what can be wrong with a background, and with what its camera shows: figure, limits, words, remedy.

:data:`CAUSES` is the list, :func:`find_causes` the judge. The figures of a background that is learned are measured by
:mod:`.verdict`, those of one in use by :mod:`camera_client.condition`; a cause whose figure was not measured is silent.
Every code is stable, so that scripts may test it.
"""

from __future__ import annotations

import datetime
import json
import math
import re
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass
from typing import Any

from capture_rig.verdict import GOOD, REDO, USABLE, Finding

from .light import MOST_GAIN
from .model import Provenance

KEY = "findings"  # of the diagnostics: what speaks against the background in use, as JSON, the worst first
REMEDY = "clear the room and run sagoma background"
MAINS = "expose for whole periods of the mains: 10 ms at 50 Hz, 8.33 ms at 60 Hz"
GRADES = (GOOD, USABLE, REDO)
NEVER = math.inf


@dataclass(frozen=True)
class Cause:
    """One thing that may be wrong.

    code : "ABOUT.CONDITION". words : with figures in braces, shares as percents. figure : the name of the one that is
    judged. limits : beyond which it is worth knowing (GOOD), costs silhouettes (USABLE), makes the background useless
    (REDO); those that are missing are never reached. severe : the remedy from USABLE on, where that is another.
    """

    code: str
    words: str
    remedy: str
    figure: str
    limits: tuple[float, ...]
    severe: str = ""

    def judge(self, figures: Mapping[str, Any]) -> Finding | None:
        """Return the finding; None where the figure is within the limits, or was not measured."""
        value = figures.get(self.figure)
        if value is None or not value > min(self.limits):
            return None
        grade = max(grade for grade, limit in enumerate(self.limits) if value > limit)
        what = re.sub(r"(?<=\d)%", " %", self.words.format(**figures))
        return Finding(GRADES[grade], what, self.severe if self.severe and grade else self.remedy, self.code)


def cause(words: str, remedy: str, severe: str = "", **limits: tuple[float, ...]) -> Cause:
    """Return a row of the list: "CODE: words", and the limits of the figure that is judged under its name."""
    ((figure, beyond),) = limits.items()
    code, _, words = words.partition(": ")
    return Cause(code, words, remedy, figure, beyond, severe)


# Limits: noise_error from the noise of a standard deviation, 1/sqrt(2 (n - 1)) of 25 frames; light_times from
# what is exposed to 200 of 255 grey levels and turns white; displacement_px from an edge of 50 grey levels;
# unexplained_foreground from a person's share of the picture; turn_deg as camera_moved.limit_deg;
# else chosen with the rooms of test_camera_background_verdict.py, test_camera_condition.py.
CAUSES = (
    # a background that was learned
    cause("levels.black: the image is black", "take the lens cap off, or switch the light on", black=(NEVER, NEVER, 0)),
    cause(
        "levels.white: {white_share:.0%} of the image is white",
        "shorten the exposure or lower the gain",
        white_share=(NEVER, 0.02, 0.3),
    ),
    cause(
        "levels.dim: the image is dim, {level:.0f} grey levels on the median",
        "lengthen the exposure, open the iris, or add light",
        dim_by=(NEVER, 0),
    ),
    cause(
        "training.few_frames: too few pictures to measure the noise: {frames}",
        "set background_frames to 100",
        noise_error=(NEVER, 0.1444),
    ),
    cause(
        "training.movement: something moved: {moved_places}",
        "clear the scene, see that the camera stands firm, and call again",
        moved_share=(NEVER, 0.001, 0.02),
    ),
    cause(
        "training.something_else: something else than in the background{since}: {changed_places}",
        "if a person stood there, clear the room and learn again; moved furniture is all right",
        changed_share=(NEVER, 0),
    ),
    cause("light.flicker: the brightness flickers by {flicker:.1%}", MAINS, flicker=(NEVER, 0.01)),
    cause(
        "light.drift: the brightness changed by {drift:+.1%} while it was learned",
        "wait until lamps are warm and automatic exposure is off",
        drifted=(NEVER, 0.03),
    ),
    cause(
        "moved.turned: since it was calibrated the camera has turned by {turn_deg:.1f} degrees",
        "calibrate it again",
        turn_deg=(NEVER, 0.2),
    ),
    # a background in use: the room
    cause(
        "room.unexplained: {unexplained_foreground:.1%} of the picture differs from the background and is not the "
        "person",
        f"switch screens and fans off; other people out of the picture; for things that moved {REMEDY}",
        unexplained_foreground=(0.005, 0.02),
    ),
    cause(
        "room.things_moved: things were moved or taken away, and are background now: {things_places}",
        "nothing is to be done; when the room is empty, the background may be learned again",
        severe=REMEDY,
        things_share=(0, 0.2),
    ),
    cause("background.old: the background is {age_h:.0f} h old", REMEDY, age_over_h=(NEVER, 0)),
    # ... its light
    cause(
        "light.level: the light has changed by {light_change:+.0%} since the background was learned",
        "it is followed: nothing is to be done",
        severe=f"it is followed, but white and black places are lost, and noise grows: {REMEDY}",
        light_times=(0.05, 0.25),
    ),
    cause(
        "light.unsteady: the light changed suddenly {light_switches_recent} times in half a minute",
        "switch automatic exposure off, and lamps with a loose contact; draw the curtains against clouds",
        light_switches_recent=(NEVER, 2),
    ),
    cause(
        "light.flicker: the light flickers by {light_flicker:.1%}",
        f"it is followed; better {MAINS}",
        light_flicker=(0.01, 0.05),
    ),
    # ... noise, place, and the person
    cause(
        "noise.high: the noise is high, {noise_levels:.1f} grey levels on the median",
        "lower the gain and add light; a higher bit rate; check that the camera stands firm",
        noise_levels=(NEVER, 6.0),
    ),
    cause(
        "levels.clipped: {background_doubtful:.0%} of the background is white or black: a person as bright is not seen "
        "there",
        "shorten the exposure where it is white, lengthen it or add light where it is black; learn again",
        background_doubtful=(0.02, 0.3),
    ),
    cause(
        "moved.followed: the camera was touched: its picture lies {displacement_px:.1f} px beside the background",
        "it is followed; fasten the mount, and see whether its calibration still holds",
        displacement_px=(0.3,),
    ),
    cause(
        "moved.unfollowed: edges of the room lie {displacement_left_px:.1f} px beside the background's, which cannot "
        "be followed",
        "fasten the mount, keep fans and doors off its wall; when it stands firm, learn the background again",
        displacement_left_px=(NEVER, 0.5),
    ),
    cause(
        "clothes.like_background: {person_faint:.0%} of the person hardly differs from the background",
        "other clothes, more light, or a cloth of another brightness behind",
        person_faint=(NEVER, 0.25),
    ),
)


def find_causes(figures: Mapping[str, Any]) -> tuple[Finding, ...]:
    """Return what the figures say, the worst first; () when nothing is wrong."""
    found = [finding for each in CAUSES if (finding := each.judge(figures)) is not None]
    return tuple(sorted(found, key=lambda finding: -GRADES.index(finding.grade)))


def findings_text(findings: Iterable[Finding]) -> str:
    """Return the findings as one line of JSON, for programs."""
    return json.dumps([asdict(finding) for finding in findings])


def read_findings(text: str) -> tuple[Finding, ...]:
    """Return what :func:`findings_text` wrote; nothing of any other text."""
    try:
        return tuple(Finding(**values) for values in json.loads(text))
    except (TypeError, ValueError):
        return ()


# --- where a background comes from: another camera or exposure, long ago


def age_h(provenance: Provenance, now_s: float) -> float | None:
    """Hours since a background was learned, None where that is unknown; ``now_s`` is the system's clock."""
    try:
        created = datetime.datetime.fromisoformat(provenance.created)
    except ValueError:
        return None
    return max(now_s - created.timestamp(), 0.0) / 3600


def unfit(provenance: Provenance, camera: Mapping[str, str]) -> Finding | None:
    """Return why a background cannot serve a camera: learned with another one, or at quite another exposure.

    What is unknown of either is not compared; None when nothing speaks against it.
    """
    learned, serial = provenance.camera_serial, camera.get("camera_serial", "")
    if learned and serial and learned != serial:
        what = f"the background was learned with camera {learned}, this is {serial}"
        return Finding(REDO, what, REMEDY, "background.other_camera")
    then, now = _number(provenance.exposure_us), _number(camera.get("exposure_us", ""))
    if then > 0 and now > 0 and not 1 / MOST_GAIN < now / then < MOST_GAIN:
        what = f"the exposure is {now:g} us, the background was learned at {then:g} us: that cannot be corrected"
        return Finding(REDO, what, f"{REMEDY}, or set the exposure back", "background.other_exposure")
    return None


def _number(text: str) -> float:
    try:
        return float(text)
    except ValueError:
        return math.nan
