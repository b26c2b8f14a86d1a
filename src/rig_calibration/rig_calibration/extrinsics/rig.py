"""From poses in the solver's reference frame to the rig: cameras in the world, and their common volume."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from capture_rig.camera import CameraModel
from capture_rig.rig import Rig

from ..bundle.rigid import inverse
from .volume import CommonVolume, common_volume

Array = npt.NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class PlacedRig:
    """The rig in the world, and what its cameras see in common (its box is the rig's volume)."""

    rig: Rig
    common: CommonVolume


def place_rig(
    cameras: Mapping[str, CameraModel], T_camera_reference: Mapping[str, Array], T_world_reference: Array
) -> PlacedRig:
    """The cameras whose poses are known, placed in the world; their intrinsics are those of ``cameras``."""
    T_reference_world = inverse(T_world_reference)
    placed = tuple(
        replace(cameras[name], T_camera_world=T_camera_reference[name] @ T_reference_world)
        for name in sorted(T_camera_reference)
    )
    common = common_volume(placed)
    return PlacedRig(Rig(placed, common.box), common)
