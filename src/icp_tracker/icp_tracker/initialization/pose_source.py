"""Settings of the first pose's source: a T-pose, somebody who moves, either, or a file."""

from __future__ import annotations

from dataclasses import dataclass, field

from capture_rig.errors import InputError
from capture_rig.settings import setting
from capture_rig.visibility import RigVisibility
from stick_figure.body import Body, load_body

from .hull_source import HullSource, MotionSettings, TPoseSettings
from .initial_pose import KnownPose, PoseSource, load_initial_pose, pose_from_reference

WHERE = "parameters of the ICP tracker"
AUTO, T_POSE = "auto", "t_pose"
HULL_SOURCES = (AUTO, T_POSE)
"""Sources that use the hull, of any number of persons."""


@dataclass(frozen=True)
class InitialPoseSettings:
    """Where the first pose comes from."""

    source: str = setting(
        "auto",
        "where the first pose comes from: the hull of whoever walks in or takes a T-pose, whichever is sure first; the "
        "hull of a T-pose alone; a pose file, or a session's reference",
        choices=("auto", "t_pose", "file", "session"),
    )
    file: str = setting("", "pose file (YAML), for source 'file'")
    session: str = setting("", "session folder with a reference, for source 'session'")
    frame: int = setting(0, "video frame of the reference, for source 'session'", low=0)
    rig_file: str = setting(
        "", "rig (YAML) of the hulls: where its cameras and volume can show a body; empty: taken as everywhere"
    )
    min_seeing: int = setting(0, "the hull server's parameter of this name, with rig_file", low=0, high=63)
    t_pose: TPoseSettings = field(default_factory=TPoseSettings)
    motion: MotionSettings = field(default_factory=MotionSettings)


def make_pose_source(
    settings: InitialPoseSettings, body_file: str = "", visibility: RigVisibility | None = None
) -> PoseSource:
    """Return the source that the settings choose; the body of ``body_file``, if given, replaces that of the source.

    ``visibility`` is that of the rig. Raises InputError naming parameter or file, value and remedy.
    """
    body = load_body(body_file) if body_file else None
    if settings.source in HULL_SOURCES:
        motion = None if settings.source == T_POSE else settings.motion
        return HullSource(settings.t_pose, motion, visibility, body)
    if settings.source == "file":
        return _from_file(settings.file, body)
    return _from_session(settings.session, settings.frame, body)


def _from_file(path: str, body: Body | None) -> KnownPose:
    if not path:
        raise InputError(
            "initial_pose.file is empty", where=WHERE, remedy="Name a pose file, or choose another initial_pose.source."
        )
    pose, own_body = load_initial_pose(path)
    chosen = body or own_body
    if chosen is None:
        raise InputError("names no body", where=path, remedy="Add 'body: FILE.yaml', or set the parameter body_file.")
    return KnownPose(pose, chosen)


def _from_session(folder: str, frame: int, body: Body | None) -> KnownPose:
    from capture_rig.session import load_session  # reads videos' headers: OpenCV is loaded only where it is needed

    if not folder:
        raise InputError(
            "initial_pose.session is empty",
            where=WHERE,
            remedy="Name a session folder, or choose another initial_pose.source.",
        )
    truth = load_session(folder).truth
    if truth is None:
        raise InputError("has no reference", where=folder, remedy="Add truth.csv, or choose another source.")
    return pose_from_reference(truth.frames, truth.stick_figure_points(), frame, str(truth.source), body)
