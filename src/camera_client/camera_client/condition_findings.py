"""Names the cause of doubtful silhouettes, and its remedy, from the figures of :mod:`.condition`.

:func:`condition_findings` is the list; every finding has a stable code that scripts may test. Grade GOOD is worth
knowing and needs nothing, USABLE costs silhouettes.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator
from dataclasses import asdict

from capture_rig.verdict import GOOD, REDO, USABLE, Finding

from .background.verdict import FLICKER, HIGH_NOISE, LIGHT_CHANGED, NOISE_GREW, WHITE_MUCH_SHARE, WHITE_SHARE
from .background.watch import REMEDY
from .condition import Condition

KEY = "findings"  # of the diagnostics: what speaks against the background in use, as JSON, the worst first

# Thresholds: LIGHT_WARN from what is exposed to 200 of 255 grey levels and turns white; DISPLACED_NOTICE_PX from an
# edge of 50 grey levels; OUTSIDE_NOTICE, OUTSIDE_WARN from a person's share of the picture; else judgement (which
# sessions stay below: test_camera_condition.py).
LIGHT_WARN = 0.25  # relative: what was exposed to 200 of 255 grey levels is white from there on
COLOUR_NOTICE = 0.05  # by how much a channel's gain departs from the others'
UNEVEN_NOTICE = 0.10  # standard deviation over the picture: another lamp, not the same one brighter
FLICKER_WARN = 0.05  # the step that counts as a switch
SWITCHES_WARN = 3  # in half a minute: nobody switches lamps so often
DISPLACED_NOTICE_PX = 0.3  # an edge of 50 grey levels would differ by 15
LEFT_WARN_PX = 0.5  # every edge of the room is as uncertain as the person's own
THINGS_WARN = 0.2  # share of the picture that no longer is as it was learned: the room is another one
OUTSIDE_NOTICE = 0.005  # share of the picture: a quarter of a person who fills a fiftieth
OUTSIDE_WARN = 0.02  # ... and as much as the person herself
FAINT_WARN = 0.25  # a quarter of the person is found by its surroundings only
SHADOW_NOTICE = 0.6  # of the foreground, or of the person: more shadow than person

MAINS = "expose for whole periods of the mains: 10 ms at 50 Hz, 8.33 ms at 60 Hz"
CHANNELS = ("blue", "green", "red")


def condition_findings(condition: Condition) -> tuple[Finding, ...]:
    """Return what the figures say against the background in use, the worst first; () when nothing does."""
    found = [
        *_room_findings(condition),
        *_light_findings(condition),
        *_noise_findings(condition),
        *_displacement_findings(condition),
        *_person_findings(condition),
    ]
    return worst_first(found)


def worst_first(findings: Iterable[Finding]) -> tuple[Finding, ...]:
    """Return the findings by their grade; those of one grade stay in their order."""
    return tuple(sorted(findings, key=lambda finding: (REDO, USABLE, GOOD).index(finding.grade)))


def findings_text(findings: Iterable[Finding]) -> str:
    """Return the findings as one line of JSON, for programs."""
    return json.dumps([asdict(finding) for finding in findings])


def read_findings(text: str) -> tuple[Finding, ...]:
    """Return what :func:`findings_text` wrote; nothing of any other text."""
    try:
        return tuple(Finding(**values) for values in json.loads(text))
    except (TypeError, ValueError):
        return ()


# --- each cause


def _light_findings(c: Condition) -> Iterator[Finding]:
    if c.light_gain is None:
        return
    change, unlike = 100 * (c.light_gain - 1), max(c.light_gain, 1 / max(c.light_gain, 1e-3)) - 1
    if unlike > LIGHT_CHANGED:
        kind = "brighter" if change > 0 else "darker"
        what = f"the light is {abs(change):.0f} % {kind} than when the background was learned"
        remedy = "it is followed: nothing is to be done"
        if unlike > LIGHT_WARN:
            remedy = f"it is followed, but white and black places are lost, and noise grows: {REMEDY}"
        yield Finding(USABLE if unlike > LIGHT_WARN else GOOD, what, remedy, f"light.{kind}")
    gains = [float(gain) for gain in c.light_gains.split()]
    mean = sum(gains) / max(len(gains), 1)
    if any(abs(gain - mean) > COLOUR_NOTICE * mean for gain in gains):
        changes = ", ".join(f"{name} {100 * (gain - 1):+.0f} %" for name, gain in zip(CHANNELS, gains, strict=True))
        what = f"the light has another colour than when the background was learned: {changes}"
        yield Finding(GOOD, what, "it is followed; switch automatic white balance off", "light.colour")
    if (c.light_unevenness or 0.0) > UNEVEN_NOTICE:
        what = f"the light changed by {100 * (c.light_unevenness or 0.0):.0f} % more in some places than in others"
        remedy = "it is followed as far as it is smooth: a lamp was moved or switched, or the sun came in"
        yield Finding(GOOD, what, remedy, "light.uneven")
    yield from _unsteady_light(c)


def _unsteady_light(c: Condition) -> Iterator[Finding]:
    recent, flicker = c.light_switches_recent or 0, c.light_flicker or 0.0
    if recent >= SWITCHES_WARN:
        what = f"the light changed suddenly {recent} times in half a minute"
        remedy = "switch automatic exposure off, and lamps with a loose contact; draw the curtains against clouds"
        yield Finding(USABLE, what, remedy, "light.unsteady")
    elif recent:
        yield Finding(GOOD, "the lights were switched just now", "it is followed", "light.switched")
    if flicker > FLICKER:
        grade, what = USABLE if flicker > FLICKER_WARN else GOOD, f"the light flickers by {100 * flicker:.1f} %"
        yield Finding(grade, what, f"it is followed; better {MAINS}", "light.flicker")


def _noise_findings(c: Condition) -> Iterator[Finding]:
    if c.noise_levels is None:
        return
    learned = c.noise_learned_levels or c.noise_levels
    times = c.noise_levels / learned
    if times > NOISE_GREW:
        what = f"the noise is {c.noise_levels:.1f} grey levels, {times:.1f} times what was learned"
        remedy = "a higher bit rate, less gain, more light"
        yield Finding(USABLE if c.noise_levels > HIGH_NOISE else GOOD, what, remedy, "noise.higher")
    elif c.noise_levels > HIGH_NOISE:
        what = f"the noise is high, {c.noise_levels:.1f} grey levels"
        yield Finding(USABLE, what, "lower the gain and add light; a higher bit rate", "noise.high")
    if (c.background_doubtful or 0.0) > WHITE_SHARE:
        share = c.background_doubtful or 0.0
        what = f"{100 * share:.0f} % of the background is white or black: a person as bright is not seen there"
        remedy = "shorten the exposure where it is white, lengthen it or add light where it is black; learn again"
        yield Finding(USABLE if share > WHITE_MUCH_SHARE else GOOD, what, remedy, "levels.clipped")


def _displacement_findings(c: Condition) -> Iterator[Finding]:
    if (c.displacement_px or 0.0) > DISPLACED_NOTICE_PX:
        what = f"the camera was touched: its picture lies {c.displacement_px:.1f} px beside the background"
        remedy = "it is followed; fasten the mount, and see whether its calibration still holds"
        yield Finding(GOOD, what, remedy, "moved.followed")
    if (c.displacement_left_px or 0.0) > LEFT_WARN_PX:
        what = (
            f"edges of the room lie {c.displacement_left_px:.1f} px beside the background's, which cannot be followed"
        )
        remedy = "fasten the mount, keep fans and doors off its wall; when it stands firm, learn the background again"
        yield Finding(USABLE, what, remedy, "moved.unfollowed")


def _room_findings(c: Condition) -> Iterator[Finding]:
    if c.things_endless:
        what = "more of the room has changed than may become background"
        yield Finding(USABLE, what, f"{REMEDY}; is another room before the camera?", "room.endless")
    if (c.restless_foreground or 0.0) > OUTSIDE_NOTICE:
        share = 100 * (c.restless_foreground or 0.0)
        what = f"{share:.1f} % of the picture keeps changing where no other camera sees anybody"
        remedy = "switch screens and fans off, draw curtains, close doors, or turn the camera: it is never learned"
        yield Finding(USABLE, what, remedy, "room.restless")
    elif (c.unexplained_foreground or 0.0) > OUTSIDE_NOTICE:
        share = c.unexplained_foreground or 0.0
        what = f"{100 * share:.1f} % of the picture differs from the background and is not the person"
        remedy = f"other people out of the picture; for things that moved {REMEDY}"
        yield Finding(USABLE if share > OUTSIDE_WARN else GOOD, what, remedy, "room.unexplained")
    if c.things_places:
        what = f"things were moved or taken away, and are background now: {c.things_places}"
        much = (c.things_share or 0.0) > THINGS_WARN
        remedy = (
            REMEDY if much else "nothing is to be done; when the room is empty, the background may be learned again"
        )
        yield Finding(USABLE if much else GOOD, what, remedy, "room.things_moved")


def _person_findings(c: Condition) -> Iterator[Finding]:
    if (c.person_faint or 0.0) > FAINT_WARN:
        what = f"{100 * (c.person_faint or 0.0):.0f} % of the person hardly differs from the background"
        remedy = "other clothes, more light, or a cloth of another brightness behind"
        yield Finding(USABLE, what, remedy, "clothes.like_background")
    shadow, maybe = c.shadow_share or 0.0, c.person_maybe_shadow or 0.0
    if max(shadow, maybe) > SHADOW_NOTICE:
        what = f"{100 * shadow:.0f} % of the foreground was taken for shadow, {100 * maybe:.0f} % of the person may be"
        remedy = (
            "softer light from more sides, or a paler floor; see whether legs are in the mask (docs/silhouettes.md)"
        )
        yield Finding(GOOD, what, remedy, "shadow.large")
