"""Whom the hull should believe, and what to tell the user about the others."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from ..settings import DissentSettings
from .dissent_record import Record

STILL_S = 0.25  # a silhouette that does not change for so long, while the others do, is frozen


@dataclass(frozen=True)
class Verdict:
    """Whom to believe. Shares are 0 to 1, running means over the last seconds.

    judged : whether this frame set told anything; if not, everything else is as it was.
    left_out : cameras whose masks the hull should do without. suspects : cameras that would be left out if enough
    others remained. reasons : why, of both, in words a user can act on.
    denied : share of the body, as the others show it, that each camera denies: how far it is from fitting the rig.
    excess : share of each camera's view that is foreground of which the others know nothing.
    misfit : share of each silhouette that would lie inside the hull of the others if it were pushed to where it fits
    best, and push_px : by how many pixels, to the right and down: (0, 0) where the rig's calibration holds.
    consistency : how well each silhouette and the hull of the others, reprojected, agree: 1 when nothing that it shows
    is uncovered, and nothing that they agree on is denied.
    conflict : share of the foreground of all who are believed that their common hull leaves unexplained.
    warning : that they contradict each other when nobody is to blame; empty otherwise.
    """

    left_out: tuple[str, ...] = ()
    suspects: tuple[str, ...] = ()
    reasons: Mapping[str, str] = field(default_factory=dict)
    denied: Mapping[str, float] = field(default_factory=dict)
    excess: Mapping[str, float] = field(default_factory=dict)
    misfit: Mapping[str, float] = field(default_factory=dict)
    push_px: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    consistency: Mapping[str, float] = field(default_factory=dict)
    conflict: float = 0.0
    warning: str = ""
    judged: bool = False


def reason(name: str, record: Record, rest: list[Record], settings: DissentSettings, focal_px: float) -> str:
    """Why a camera is not believed, in words a user can act on. ``rest`` are the cameras that are believed."""
    seen, others = record.accused, f"the other {len(rest)}"
    if seen.excess > settings.excess_limit:
        return (
            f"{name}: {seen.excess:.0%} of its view is foreground that {others} know nothing of: has the light "
            "changed, is its background old, or does something stand before it?"
        )
    if seen.coverage == 0.0:
        return (
            f"{name}: its silhouette is empty where {others} see somebody: is its lens covered, or its exposure wrong?"
        )
    denies = f"{name} denies {seen.denied:.0%} of the body that {others} agree on"
    if record.still_s >= STILL_S and rest and sum(r.still_s == 0.0 for r in rest) > len(rest) / 2:
        return f"{denies}, and its silhouette has not changed for {record.still_s:.1f} s: are its images frozen?"
    if record.lasting_misfit > settings.misfit_allowance:
        push_px = float(np.hypot(*record.latest_push_px))
        turned_deg = np.degrees(np.arctan2(push_px, focal_px))
        return (
            f"{denies}, and its silhouette fits better when it is pushed by {push_px:.0f} pixels ({turned_deg:.1f} "
            "degrees): was it moved or turned? Then calibrate it again."
        )
    return f"{denies}: is something before it, or is its background old?"
