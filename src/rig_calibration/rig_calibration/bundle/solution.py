"""What the solver found, and how good it is."""

from __future__ import annotations

from dataclasses import dataclass

from capture_rig.camera import CameraModel

from ..boards.sighting import Sighting
from .outliers import LeftOut
from .rigid import Array
from .view_graph import Key


@dataclass(frozen=True, eq=False)
class RigSolution:
    """The poses of all cameras and targets, in the frame of the ``reference``.

    reference : a camera's name, or (target, moment): the target's own frame at that moment.
    cameras : the cameras, with these poses as their ``T_camera_world`` (and refined lenses, if asked for).
    T_camera_reference : (4, 4) by camera. T_reference_target : (4, 4) by (target, moment).
    sightings, residuals_px : what was used, ids as they proved right, and seen minus predicted pixels (n, 2) of each.
    rms_px : by camera, root mean square distance of its corners (sqrt(2) times the noise of one coordinate, as OpenCV
    reports it); rms_all_px of all of them.
    covariance : (6, 6) by camera, relative to the reference: rotation vector (rad, in the camera's frame), centre (m,
    in the reference's frame). inflation : by how much it exceeds what independent errors of corners would leave (1: not
    at all), because the cameras contradict one another: a target that moved between the exposures or is bent, a lens.
    noise : standard deviation of the corners over the one that their sightings claim. displacement_m : by how much (sd)
    the targets seem to have moved between the cameras' exposures, 0 where nothing says that they did.
    left_out : sightings that took no part, with the reason (not those of a wand that no other camera saw, which tell
    nothing). turned : sightings whose numbering was turned.
    undecided : cameras whose way round (half turn) nothing tells. scale_of : by target, the size that it has beside
    the most seen one (``scale_base``) over the size given, and its standard deviation; believed when consistent with
    1, else the solution uses the ratio. focal_of : by camera, the focal length that all views together ask for over the
    one given (or refined), and its standard deviation: far from 1, the intrinsics are not this camera's.
    """

    reference: str | Key
    cameras: dict[str, CameraModel]
    T_camera_reference: dict[str, Array]
    T_reference_target: dict[Key, Array]
    sightings: tuple[Sighting, ...]
    residuals_px: tuple[Array, ...]
    rms_px: dict[str, float]
    rms_all_px: float
    covariance: dict[str, Array]
    inflation: float
    noise: float
    displacement_m: float
    left_out: tuple[LeftOut, ...]
    turned: tuple[Sighting, ...]
    undecided: tuple[str, ...]
    scale_base: str
    scale_of: dict[str, tuple[float, float]]
    focal_of: dict[str, tuple[float, float]]
    iterations: int
