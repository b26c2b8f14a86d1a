"""Rigs of the virtual studio whose pictures cut people off, and people who stand where they do."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from capture_rig import Rig
from virtual_studio.rig import narrowed, ring, tilted, with_camera


@dataclass(frozen=True)
class CutCase:
    """Somebody in a T-pose in a rig that does not show all of them: place (2,) m and heading, rad."""

    name: str
    rig: Rig
    place: tuple[float, float] = (0.0, 0.0)
    heading: float = 0.4


def cut_cases(cameras: int = 3) -> list[CutCase]:
    """The same person in the middle and in places and rigs that cut a part off, by a ring of cameras."""
    rig = ring(cameras, ceiling=False)
    last = cameras - 1
    up, down = tilted(rig.cameras[last], 0.24), tilted(rig.cameras[last], -0.27)
    narrow = Rig(tuple(narrowed(camera, 1.45) for camera in rig.cameras), rig.volume)
    # the direction in which the last camera sees people from nearer: there its picture ends first
    way = rig.cameras[last].centre_world[:2] / np.linalg.norm(rig.cameras[last].centre_world[:2])
    near = (float(0.5 * way[0]), float(0.5 * way[1]))
    return [
        CutCase("in the middle", rig),
        CutCase("feet cut by one camera", with_camera(rig, last, up), near),
        CutCase("head cut by one camera", with_camera(rig, last, down), near),
        CutCase("an arm outside the volume", rig, (0.0, 0.95), 0.0),
        CutCase("at the volume's edge", rig, (1.25, 0.0), 0.0),
        CutCase("a lens too narrow", narrow),
    ]
