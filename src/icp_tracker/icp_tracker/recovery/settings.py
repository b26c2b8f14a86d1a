"""Settings of the watch over the track."""

from __future__ import annotations

from dataclasses import dataclass

from capture_rig.settings import setting


@dataclass(frozen=True)
class RecoverySettings:
    """How a lost track, or a lost limb, is noticed and found again."""

    search: bool = setting(True, "look for better poses of limbs and body; off: the track is judged, not repaired")
    limb_parts: int = setting(
        4, "a limb's library is searched in so many parts, one a frame set (a doubtful limb's at once)", low=1, high=64
    )
    turned_every: int = setting(16, "frame sets between two looks at the body turned round", low=1, high=100000)
    lead_rays: float = setting(
        2.0, "lead in rays that another pose must have, on average over the sets it is compared in", low=0.0, high=1e4
    )
    lead_sets: int = setting(6, "frame sets that it must be compared in", low=1, high=1000)
    clear_rays: float = setting(20.0, "lead in rays with which two frame sets are enough", low=0.0, high=1e4)
    patient_sets: int = setting(30, "frame sets after which another pose without that lead is forgotten", low=1)
