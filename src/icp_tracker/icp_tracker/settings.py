"""Settings of the tracker and of its node."""

from __future__ import annotations

from dataclasses import dataclass, field

from capture_rig.settings import setting

from .articulated_fit import ArticulatedSettings
from .extrinsic_monitor import CalibrationSettings
from .initialization.pose_source import InitialPoseSettings
from .monitor.track_monitor import RecoverySettings
from .refinement.body_refiner import RefinementSettings
from .thesis.hierarchical_icp import DESCENDANT_WEIGHT

FIRST_INLIERS = 0.4  # share of the points; judgement


@dataclass(frozen=True)
class TrackerSettings:
    """How the figure is fitted, set after set.

    acquire_inliers : share of the points that a first fit must explain, unless the person was watched.
    descendant_weight : of the hierarchical ICP, of a descendant's point against one of the stick's own.
    """

    method: str = setting(
        "articulated",
        "the fit: all joints at once, or the thesis's hierarchical ICP",
        choices=("articulated", "hierarchical"),
    )
    articulated: ArticulatedSettings = field(default_factory=ArticulatedSettings)
    refinement: RefinementSettings = field(default_factory=RefinementSettings)
    recovery: RecoverySettings = field(default_factory=RecoverySettings)
    acquire_inliers: float = FIRST_INLIERS
    descendant_weight: float = DESCENDANT_WEIGHT


MOST_PERSONS = 4  # in one volume: more hide each other from most cameras of a ring


@dataclass(frozen=True)
class PeopleSettings:
    """How many persons are tracked."""

    max: int = setting(MOST_PERSONS, "persons that are followed at most", low=1, high=MOST_PERSONS)


@dataclass(frozen=True)
class SaveBodySettings:
    """Where bodies are saved."""

    folder: str = setting("output/bodies", "folder that ~/save_body writes body_STAMP.yaml to, for each person")


@dataclass(frozen=True)
class IcpNodeSettings(TrackerSettings):
    """Parameters of the node."""

    body_file: str = setting("", "body (YAML); empty: the one that comes with the first pose")
    initial_pose: InitialPoseSettings = field(default_factory=InitialPoseSettings)
    people: PeopleSettings = field(default_factory=PeopleSettings)
    calibration: CalibrationSettings = field(default_factory=CalibrationSettings)
    bodies: SaveBodySettings = field(default_factory=SaveBodySettings)
    prediction_wait_s: float = setting(
        0.05, "a fit waits at most this long for the filter's state after the previous set", unit="s", low=0.0
    )
    keypoints_wait_s: float = setting(
        0.1, "a set waits at most this long for detectors that publish CAM/keypoints", unit="s", low=0.0
    )
    queue_depth: int = setting(4, "frame sets that may wait; one more drops the oldest", low=1, high=1000)
    stale_after_s: float = setting(
        0.75, "without frame sets for so long, silence is reported; 0: never", unit="s", low=0.0, high=60.0
    )
