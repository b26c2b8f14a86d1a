"""The settings of every stage, from the parameters of the graph's nodes."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from camera_client.settings import CameraClientSettings
from capture_rig.errors import InputError
from capture_rig.settings import build_settings
from ekf_tracker.settings import EkfNodeSettings, EkfSettings
from hull_server.settings import HullSettings
from icp_tracker.settings import IcpNodeSettings


@dataclass(frozen=True, eq=False)
class Configuration:
    """The settings of every stage.

    feedback : each fit starts from the filter's state, as in the graph; otherwise from the fit before (thesis 4.3).
    """

    camera: CameraClientSettings
    hull: HullSettings
    icp: IcpNodeSettings
    ekf: EkfSettings
    feedback: bool = True

    @classmethod
    def of(cls, settings: Mapping[str, Any], *, feedback: bool = True) -> Configuration:
        """Build from NODE.PARAMETER keys, as ``sagoma up --set`` takes; InputError for a node that does not exist."""
        parts: dict[str, dict[str, Any]] = {"cameras": {}, "hull_server": {}, "icp_tracker": {}, "ekf_tracker": {}}
        for key, value in settings.items():
            node, _, parameter = key.partition(".")
            if node not in parts:
                raise InputError(f"'{key}' names no node", where="settings", remedy=f"Nodes: {', '.join(parts)}.")
            parts[node][parameter] = value
        return cls(
            build_settings(CameraClientSettings, parts["cameras"], "cameras"),
            build_settings(HullSettings, parts["hull_server"], "hull_server"),
            build_settings(IcpNodeSettings, parts["icp_tracker"], "icp_tracker"),
            build_settings(EkfNodeSettings, parts["ekf_tracker"], "ekf_tracker").filter,
            feedback,
        )
