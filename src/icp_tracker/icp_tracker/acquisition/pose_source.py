"""Which first pose to start from, as settings."""

from __future__ import annotations

from dataclasses import dataclass

from capture_rig.errors import InputError
from capture_rig.settings import setting
from capture_rig.sight import Sight
from stick_figure.body import Body
from stick_figure.body_file import load_body, load_thickness

from .body_sizes import LimbGirths
from .initial_pose import KnownPose, PoseSource, load_initial_pose, pose_from_reference
from .known_body_source import KnownBodySource
from .t_pose_measures import TPoseSettings
from .t_pose_source import TPoseSource

WHERE = "parameters of the ICP tracker"


@dataclass(frozen=True)
class InitialPoseSettings:
    """Where the first pose comes from."""

    source: str = setting(
        "t_pose",
        "where the first pose comes from: the hull of a T-pose (with body_file: anything near one), a pose "
        "file, or a session's reference",
        choices=("t_pose", "file", "session"),
    )
    file: str = setting("", "pose file (YAML), for source 'file'")
    session: str = setting("", "session folder with a reference, for source 'session'")
    frame: int = setting(0, "video frame of the reference, for source 'session'", low=0)
    rig_file: str = setting(
        "", "rig (YAML) of the hulls: where its cameras and volume can show a body; empty: taken as everywhere"
    )
    min_seeing: int = setting(0, "the hull server's parameter of this name, with rig_file", low=0, high=63)
    t_pose: TPoseSettings = setting(TPoseSettings, "what counts as a T-pose")


def make_pose_source(settings: InitialPoseSettings, body_file: str = "", sight: Sight | None = None) -> PoseSource:
    """Return the source the settings choose; the body of ``body_file``, when given, replaces the one the source brings.

    A known body needs no T-pose: anything near one will do. ``sight`` is where hulls show a body. Raises InputError
    naming parameter or file, value and remedy.
    """
    body = load_body(body_file) if body_file else None
    if settings.source == "t_pose":
        if body is None:
            return TPoseSource(settings.t_pose, sight)
        return KnownBodySource(settings.t_pose, body, sight, LimbGirths.of(load_thickness(body_file)))
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
