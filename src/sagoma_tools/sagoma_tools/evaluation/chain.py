"""Hull, ICP fit and filter as the graph's nodes call them, one frame set after another in this process."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from camera_client.settings import CameraClientSettings
from capture_rig.errors import InputError
from capture_rig.rig import Rig, Volume
from capture_rig.settings import build_settings
from ekf_tracker.filter import ArticulatedEkf
from ekf_tracker.settings import EkfSettings
from hull_server.hull_pipeline import HullPipeline
from hull_server.settings import HullSettings
from icp_tracker.acquisition.pose_source import make_pose_source
from icp_tracker.icp_node import IcpNodeSettings
from icp_tracker.tracker import TRACKING, IcpTracker
from mocap_packets.fit import Fit
from mocap_packets.frame_set import FrameSet
from mocap_packets.hull import NO_CENTERLINE, HullProducts
from mocap_packets.state import BodyState, NoState, Prediction
from stick_figure.kinematics import forward
from stick_figure.pose import Pose

Masks = dict[str, np.ndarray]


@dataclass(frozen=True, eq=False)
class Configuration:
    """The settings of every stage; :meth:`of` takes the parameters of the graph's nodes as one flat mapping.

    feedback : each fit starts from the filter's state, as in the graph; otherwise from the fit before (thesis 4.3).
    """

    camera: CameraClientSettings
    hull: HullSettings
    icp: IcpNodeSettings
    ekf: EkfSettings
    feedback: bool = True

    @classmethod
    def of(cls, settings: Mapping[str, Any], *, feedback: bool = True) -> Configuration:
        """From NODE.PARAMETER keys, as ``sagoma up --set`` takes them; InputError for a node that does not exist."""
        parts: dict[str, dict[str, Any]] = {"cameras": {}, "hull_server": {}, "icp_tracker": {}, "ekf_tracker": {}}
        for key, value in settings.items():
            node, _, parameter = key.partition(".")
            if node not in parts:
                raise InputError(f"'{key}' names no node", where="settings", remedy=f"Nodes: {', '.join(parts)}.")
            parts[node][parameter.removeprefix("filter.") if node == "ekf_tracker" else parameter] = value
        return cls(
            build_settings(CameraClientSettings, parts["cameras"], "cameras"),
            build_settings(HullSettings, parts["hull_server"], "hull_server"),
            build_settings(IcpNodeSettings, parts["icp_tracker"], "icp_tracker"),
            build_settings(EkfSettings, parts["ekf_tracker"], "ekf_tracker"),
            feedback,
        )


@dataclass(frozen=True, eq=False)
class ChainStep:
    """What one frame set gave: the fit, and the filter's answer (None before there is a body to filter)."""

    fit: Fit
    answer: BodyState | NoState | None

    @property
    def state(self) -> BodyState | None:
        """The filter's state, if it has one."""
        return self.answer if isinstance(self.answer, BodyState) else None


class TrackingChain:
    """ICP tracker and filter: each fit starts from the filter's state after the set before, where that is fed back."""

    def __init__(self, configuration: Configuration, volume: Volume | None = None) -> None:
        settings = configuration.icp
        self.icp = IcpTracker(make_pose_source(settings.initial_pose, settings.body_file, volume), settings)
        self.ekf: ArticulatedEkf | None = None
        self._ekf_settings, self._feeds_back = configuration.ekf, configuration.feedback
        self._feedback: Prediction | None = None

    def step(self, clouds: HullProducts) -> ChainStep:
        """Fit and filter one frame set; stamps must rise."""
        return self._filtered(self.icp.step(clouds, self._feedback))

    def mislead(self, stamp_ns: int, pose: Pose, sd_m: float = 0.02) -> ChainStep:
        """A frame set at which filter and tracker begin anew at this pose, wrong or not, sure of it to ``sd_m``.

        A drill, to see how they find back. Needs a body that is followed.
        """
        body = self.icp.body
        if body is None:
            raise ValueError("nobody is followed yet")
        if self.ekf is not None:
            self.ekf.reset()
        covariance = np.broadcast_to(sd_m**2 * np.eye(3), (15, 3, 3)).copy()
        visible = np.ones(15, dtype=bool)
        claim = Fit(stamp_ns, TRACKING, "drill", "", 0, forward(body, pose), covariance, visible, pose, None)
        step = self._filtered(claim)
        # a set without points leaves the tracker at the filter's prediction
        self.icp.step(HullProducts(stamp_ns, NO_CENTERLINE), self._feedback)
        return step

    def _filtered(self, fit: Fit) -> ChainStep:
        body = self.icp.body
        if body is not None and self.ekf is None:
            self.ekf = ArticulatedEkf(body, self._ekf_settings)
        if self.ekf is None:
            return ChainStep(fit, None)
        if body is not None and self.ekf.body is not body:
            self.ekf.change_body(body)
        answer = self.ekf.step(fit.stamp_ns, *fit.reference_points)
        if self._feeds_back and isinstance(answer, BodyState):
            self._feedback = answer.prediction
        return ChainStep(fit, answer)


class Chain:
    """The whole graph behind the cameras: silhouettes of a frame set in, fit and state out."""

    def __init__(self, rig: Rig, configuration: Configuration) -> None:
        self.hull = HullPipeline(rig, configuration.hull)
        self.tracking = TrackingChain(configuration, rig.volume)

    def carve(self, stamp_ns: int, masks: Masks, missing: tuple[str, ...] = ()) -> HullProducts:
        """The hull of canvas masks {camera: (h, w) uint8} of one instant; ``missing`` cameras delivered nothing."""
        return self.hull.run(FrameSet.of_instant(stamp_ns, masks, missing)).products.as_sent()

    def step(self, stamp_ns: int, masks: Masks, missing: tuple[str, ...] = ()) -> ChainStep:
        """Carve, fit and filter one frame set; stamps must rise."""
        return self.tracking.step(self.carve(stamp_ns, masks, missing))
