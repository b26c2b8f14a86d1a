"""What is wrong with a background that was good once: it is old, of another camera or setting, or the light changed."""

from __future__ import annotations

import datetime
from collections.abc import Mapping

from .background_model import Provenance
from .background_watch import Watched
from .places import tell_places
from .settings import BackgroundWatchSettings

REMEDY = "clear the room and run sagoma background"
SAME_NUMBER = 0.01  # cameras give back what was set with so much error, relative
UNITS = {"exposure_us": "us", "gain": ""}


def age_h(provenance: Provenance, now_s: float) -> float | None:
    """Hours since a background was learned, None where it does not tell; ``now_s`` is the system's clock."""
    try:
        created = datetime.datetime.fromisoformat(provenance.created)
    except ValueError:
        return None
    return max(now_s - created.timestamp(), 0.0) / 3600


def concerns(
    provenance: Provenance,
    camera: Mapping[str, str],
    watched: Watched,
    settings: BackgroundWatchSettings,
    shape: tuple[int, ...],
    now_s: float | None = None,
    followed: bool = False,
) -> tuple[str, ...]:
    """What speaks against the background in use, the gravest first, each with its remedy; () when nothing does.

    camera : what the connected camera tells of itself. shape : of its images.
    now_s : the system's clock, s; None for footage, whose background is as old as itself.
    followed : slow drift is followed already, so that what is left is more than that.
    """
    found = [
        *other_camera(provenance, camera),
        *_drifted(watched, settings, followed),
        *_static(watched, settings, shape),
    ]
    age = None if now_s is None else age_h(provenance, now_s)
    if age is not None and 0 < settings.age_h < age:
        found.append(f"the background is {age:.0f} h old: {REMEDY}")
    return tuple(found)


def other_camera(learned: Provenance, camera: Mapping[str, str]) -> list[str]:
    """A camera or setting that the background was not learned with; what either does not tell is not compared."""
    serial = camera.get("camera_serial", "")
    if learned.camera_serial and serial and serial != learned.camera_serial:
        return [f"the background was learned with camera {learned.camera_serial}, this is {serial}: {REMEDY}"]
    found = []
    for key, unit in UNITS.items():
        then, now = getattr(learned, key), camera.get(key, "")
        if then and now and not _same(then, now):
            name, unit = key.partition("_")[0], f" {unit}".rstrip()
            found.append(
                f"the {name} is {now}{unit}, the background was learned at {then}{unit}: {REMEDY}, "
                f"or set the {name} back"
            )
    return found


def _drifted(watched: Watched, settings: BackgroundWatchSettings, followed: bool) -> list[str]:
    drift, limit = watched.gain_drift, settings.drift * watched.tolerance
    if drift is None or not settings.drift or abs(drift) <= limit:
        return []
    slow = "" if followed else ", or let it follow slow changes (background_model.drift.mode: slow)"
    beyond = " beyond what is followed" if followed else ""
    return [
        f"the light changed by {100 * drift:+.1f} %{beyond}, the background bears "
        f"{100 * watched.tolerance:.1f} %: {REMEDY}{slow}"
    ]


def _static(watched: Watched, settings: BackgroundWatchSettings, shape: tuple[int, ...]) -> list[str]:
    if watched.static_share <= settings.static_share or not watched.static_places:
        return []
    where = tell_places(watched.static_places, shape)
    return [
        f"something has been in the picture for {settings.static_s / 60:.0f} minutes without moving: {where}; "
        f"take it away, or {REMEDY}"
    ]


def _same(then: str, now: str) -> bool:
    try:
        a, b = float(then), float(now)
    except ValueError:
        return then == now
    return abs(a - b) <= SAME_NUMBER * max(abs(a), abs(b), 1.0)
