"""Settings of the filter and of its node, with their defaults and units."""

from __future__ import annotations

from dataclasses import dataclass, field

from capture_rig.settings import setting
from mocap_packets.fit import GONE_AFTER_S
from stick_figure.joint_limits import LIMIT_SD_RAD

from .motion_model import DampedVelocity, Identity, MotionModel

BIAS_SHARE = 0.95  # of a point's error, that the next set has too
NO_FRAMES, TORSO_FRAME, LINK_FRAMES = TF_CHOICES = ("none", "torso", "links")


@dataclass(frozen=True)
class MeasurementBiasSettings:
    """Time-correlated bias of the measured points; see `bias`.

    share : of a measured point's covariance (0: independent noise in every set). joints : distances of a person's
    joints from the figure's, over the usual ones (0: none).
    """

    share: float = BIAS_SHARE
    joints: float = 1.0


@dataclass(frozen=True)
class EkfSettings:
    """All settings of the filter; those that are not parameters are for Python code.

    bend : of the trunk, standard deviations over those of daily movement (0: a rigid torso). limit_sd_rad : of an angle
    outside its joint's range, as a soft cost beyond the range alone (0: no limits).
    """

    motion_model: str = setting(
        "constant_velocity", "how the body moves between two sets", choices=("constant_velocity", "identity")
    )
    measurement_bias: MeasurementBiasSettings = field(default_factory=MeasurementBiasSettings)
    bend: float = 1.0
    limit_sd_rad: float = LIMIT_SD_RAD
    lost_after_s: float = setting(
        GONE_AFTER_S,
        "without measurements for longer than this, the body is lost; the next good set starts anew",
        unit="s",
        low=0.01,
    )

    @classmethod
    def of_ideal_figure(cls) -> EkfSettings:
        """Return the settings for a body that is the stick figure: its torso is rigid, its joints are the figure's, and
        the errors of its points are new in every set."""
        return cls(measurement_bias=MeasurementBiasSettings(share=0.0, joints=0.0), bend=0.0)


@dataclass(frozen=True)
class EkfNodeSettings:
    """Parameters of the node; those of the filter under ``filter.``."""

    frame_id: str = setting("map", "frame of the points that come in and of all that goes out", is_name=True)
    skeleton_rate_hz: float = setting(30.0, "rate of mocap/skeleton at most; 0: every set", unit="Hz", low=0.0)
    publish_tf: str = setting(
        "links",
        "frames on /tf, where tf2_msgs is installed; torso: leaves the links to a robot_state_publisher",
        choices=TF_CHOICES,
    )
    publish_humans: bool = setting(False, "publish REP-155 topics under /humans/bodies")
    body_id: str = setting("b0001", "REP-155 id of the first person; the others count on from it", is_name=True)
    stale_after_s: float = setting(
        0.75, "without frame sets for so long, everybody is reported lost; 0: never", unit="s", low=0.0, high=60.0
    )
    filter: EkfSettings = field(default_factory=EkfSettings)


def motion_model(settings: EkfSettings) -> MotionModel:
    """Return the motion model that the settings choose."""
    return Identity() if settings.motion_model == "identity" else DampedVelocity()
