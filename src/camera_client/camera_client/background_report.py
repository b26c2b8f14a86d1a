"""What a camera client says of its background: whether it still fits, and the figures behind that."""

from __future__ import annotations

from .background_age import age_h, concerns, other_camera
from .camera_chain import CameraChain
from .frame_source import FrameSource
from .settings import CameraClientSettings


def background_concerns(
    chain: CameraChain, source: FrameSource, settings: CameraClientSettings, now_s: float
) -> tuple[str, ...]:
    """What speaks against the background in use, the gravest first; ``now_s`` is the system's clock.

    Footage is as old as its background, whatever the clock says.
    """
    background, watch = chain.background, chain.watch
    if background is None or watch is None:
        return ()
    return concerns(
        background.provenance,
        source.details,
        watch.found,
        settings.background_watch,
        background.shape,
        now_s=None if source.link is None else now_s,
        followed=settings.background_model.drift.mode == "slow",
    )


def background_misfit(chain: CameraChain, source: FrameSource) -> str:
    """Why the picture must look unlike the background in use: another camera or setting than it was learned with."""
    if chain.background is None:
        return ""
    return next(iter(other_camera(chain.background.provenance, source.details)), "")


def background_values(chain: CameraChain, now_s: float) -> dict[str, object]:
    """How well the background still fits: its age, the drift of the light, and what stands in the room."""
    background, watch = chain.background, chain.watch
    if background is None or watch is None:
        return {}
    found, age = watch.found, age_h(background.provenance, now_s)
    values: dict[str, object] = {"background_static_foreground": round(found.static_share, 4)}
    if age is not None:
        values["background_age_h"] = round(age, 2)
    if found.gain_drift is not None:
        values["background_gain_drift"] = round(found.gain_drift, 4)
    return values
