"""Tracks sessions in this process, without ROS: the same results as lockstep; the rows of an ablation."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any

from capture_rig.session import Session
from mocap_packets.fit import FIRST_PERSON
from mocap_packets.frame_set import FrameSet
from mocap_packets.keypoints import Detections, keypoints_of
from mocap_packets.state import BodyState
from mocap_pipeline.configuration import Configuration
from mocap_pipeline.pipeline import MocapPipeline, TrackingStage
from mocap_pipeline.session_footage import EPOCH_NS, FootageEnded, exact_silhouettes, ignore_end, pipeline_of, segmented

from .track import Track, nobody_tracked, reasons_of_step
from .track_evaluation import main_track


def track_session(session: Session, configuration: Configuration, *, exact_masks: bool = False) -> Track:
    """Footage in, track out: silhouettes, hull, ICP fit started from the EKF's state, EKF update, frame by frame.

    Returns the track of the person that the first truth is of. exact_masks : take the session's exact silhouettes
    instead of segmenting its footage. Raises InputError when no body was found in any frame.
    """
    (people,) = track_people(session, {"": configuration}, exact_masks=exact_masks).values()
    return main_track(people, session.truths, session.fps)


def track_people(
    session: Session,
    variants: Mapping[str, Configuration],
    *,
    exact_masks: bool = False,
    progress: Callable[[int], None] = lambda frame: None,
    ended: FootageEnded = ignore_end,
    detections: Mapping[int, Sequence[Detections]] | None = None,
    warned: Callable[[str], None] = lambda text: None,
) -> dict[str, dict[int, Track]]:
    """Track everybody with several configurations over the same hulls: every frame is segmented and carved once.

    Returns each configuration's tracks by the person's number; the first person's is always there. Cameras and hull are
    set by the first one, from which the others may differ in fit and filter only; it is also the one that must find a
    body (InputError): another's tracks may be empty. ``ended`` : called with the videos' facts at the end of the
    shortest. ``detections`` : joints that a detector found in the images of a frame. ``warned`` : called once with a
    warning of cameras that are not at their place in the rig.
    """
    first, *others = variants.values()
    pipeline = MocapPipeline(session.rig, first) if exact_masks else pipeline_of(session, first)
    masks = exact_silhouettes(session, ended) if exact_masks else segmented(session, pipeline, ended)
    followers = [pipeline.body, *(TrackingStage.of(other, session.rig) for other in others)]
    rows: list[dict[int, list[tuple[int, BodyState]]]] = [{FIRST_PERSON: []} for _ in followers]
    reasons: list[tuple[str, ...]] = []
    suspects: Mapping[str, str] = {}
    for frame, frame_masks in enumerate(masks):
        progress(frame)
        stamps_ns = session.stamps_ns(EPOCH_NS, frame)
        products = pipeline.carve_set(FrameSet.of_stamps(stamps_ns, dict(frame_masks)))
        products = replace(products, keypoints=keypoints_of(session.rig, (detections or {}).get(frame, ())))
        steps = [follower.step(products) for follower in followers]
        reasons.append(reasons_of_step(steps[0]))
        suspects = pipeline.body.tracker.extrinsic_errors.suspects or suspects
        for step, states in zip(steps, rows, strict=True):
            for person in step.people:
                if person.state is not None:
                    states.setdefault(person.person, []).append((frame, person.state))
    for text in dict.fromkeys(suspects.values()):
        warned(text)
    if not rows[0][FIRST_PERSON]:
        raise nobody_tracked("no body was found in any frame", str(session.folder), reasons)
    return {
        name: {person: Track.of_states(of_person) for person, of_person in sorted(states.items())}
        for name, states in zip(variants, rows, strict=True)
    }


# ablation: from the thesis's method to ours, one part of the tracker more in every row

SOLVE = "icp_tracker.articulated."
THESIS = "thesis: hierarchical ICP, identity model"
FEEDBACK = "feedback"  # no node's setting: where it is off, each fit starts from the fit before, not the filter's state
PARTS: Mapping[str, Mapping[str, Any]] = {
    "all joints at once": {"icp_tracker.method": "hierarchical"},
    "the hull's surface on the body surface": {SOLVE + "volume.weight": 0.0},
    "contour rays tangent to the body surface": {SOLVE + "contour.weight": 0.0},
    "fits start from the filter's state": {FEEDBACK: False},
    "constant velocity": {"ekf_tracker.filter.motion_model": "identity"},
}
"""The parts of the tracker in the order in which the rows add them, and the settings that switch each off."""
ROWS = (THESIS, *(f"+ {part}" for part in PARTS))
"""Each row's name; the last one is all of it."""
OURS = ROWS[-1]


def ablation_rows(settings: Mapping[str, Any]) -> dict[str, Configuration]:
    """Name to configuration: the thesis's method first, which is hierarchical ICP started from its own last pose (4.3),
    then the filter without a motion model (5.2); each row adds one part; the last one is the settings' own."""
    rows = {}
    for count, name in enumerate(ROWS):
        changed = dict(settings)
        for without in list(PARTS.values())[count:]:
            changed |= without
        feedback = changed.pop(FEEDBACK, True)
        rows[name] = Configuration.of(changed, feedback=feedback)
    return rows
