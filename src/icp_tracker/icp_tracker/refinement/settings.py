"""How a body's sizes are refined while it moves, as settings."""

from __future__ import annotations

from dataclasses import dataclass

from capture_rig.settings import setting


@dataclass(frozen=True)
class RefinementSettings:
    """The sizes of a body that was measured in a T-pose, from the rims of the poses that follow."""

    keyframes: int = setting(64, "different poses that are kept; 0 leaves the body as it was measured", low=0, high=500)
    turn: float = setting(
        0.2, "a pose is different when some joint turned by this much against every kept one", unit="rad", low=0.01
    )
    rays: int = setting(400, "rays of a kept pose that are looked at", low=50, high=100000)
    explained: float = setting(
        0.93, "share of the rays that the flesh must explain for a pose to count", low=0.0, high=1.0
    )
    explained_m: float = setting(0.06, "misfit up to which a ray is explained", unit="m", low=1e-3)
    gate_m: float = setting(0.04, "misfit at which a ray's weight has fallen to 1/4", unit="m", low=1e-3)
    slack_m: float = setting(
        0.05, "the flesh may touch a ray this far from the stretch where the ray touches the hull", unit="m", low=0.0
    )
    flesh_sd_m: float = setting(
        0.01,
        "distance of a body's surface from the capsules that stand for it, where they fit well",
        unit="m",
        low=1e-4,
    )
    independent_rays: float = setting(
        6.0,
        "independent rays that all rays of a pose are worth: one for head, trunk and each limb, for the misfit of "
        "the flesh is common to them",
        low=0.1,
        high=1e4,
    )
    thickness_sd: float = setting(
        0.12, "how people's limbs differ in thickness at equal stature, as a share of it", low=1e-3, high=1.0
    )
    farthest_sd: float = setting(
        3.0, "no size leaves what the T-pose said by more than this many standard deviations", low=0.1, high=10.0
    )
    least_change_m: float = setting(
        0.004, "the tracker takes over sizes when one of them has changed by so much", unit="m", low=0.0
    )
    pause_s: float = setting(1.0, "and not more often than this", unit="s", low=0.0)
