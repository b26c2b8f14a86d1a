"""What can be set: the same names serve ROS parameters, YAML files and Python."""

from __future__ import annotations

from dataclasses import dataclass

from capture_rig.mask_levels import FLOOR_REACH_M
from capture_rig.settings import setting

from .carve_backends import BACKENDS


@dataclass(frozen=True)
class BlobSettings:
    """Which blobs become centerline points (thesis 3.2; the limits were tuned on rendered bodies)."""

    min_area_m2: float = setting(0.002, "smallest blob that counts: a wrist has about this area", unit="m2", low=0.0)
    max_elongation: float = setting(3.0, "largest ratio of a blob's principal axes", low=1.0)
    min_fill: float = setting(
        0.9, "smallest ratio of a blob's area to its ellipse's: less is two limbs merged", low=0.0, high=1.5
    )
    erosion_voxels: int = setting(
        0, "times each slice is eroded before its blobs are found; costs thin limbs", unit="voxels", low=0, high=3
    )
    max_growth: float = setting(
        3.0, "a limb goes on: largest ratio of the areas a step to either side to the blob's; 0: not asked", low=0.0
    )
    growth_step_m: float = setting(0.02, "the step of max_growth, in whole voxels", unit="m", low=0.0, high=0.2)


@dataclass(frozen=True)
class BodySettings:
    """Which parts of the hull are somebody, and when somebody is still the same."""

    min_litres: float = setting(15.0, "smallest separate part of the hull that is a body", unit="litres", low=0.0)
    max_jump_m: float = setting(0.5, "farthest that a body's centroid moves between two sets", unit="m", low=0.0)
    forget_s: float = setting(1.0, "a body out of sight keeps its number for this long", unit="s", low=0.0)


@dataclass(frozen=True)
class MeshSettings:
    """The hull's surface as a file, on request."""

    folder: str = setting("output/meshes", "folder that ~/save_mesh writes hull_STAMP.ply to")
    smoothing_voxels: float = setting(
        0.8, "standard deviation of the smoothing of the voxels' steps; 0: none", unit="voxels", low=0.0, high=10.0
    )


@dataclass(frozen=True)
class CameraFaultSettings:
    """How a camera that lies is found, left out and taken back."""

    enabled: bool = setting(True, "leave out a camera that contradicts all others")
    voxel_size_m: float = setting(0.04, "voxels on which the cameras are compared", unit="m", low=0.02, high=0.2)
    period_s: float = setting(0.1, "how often the cameras are compared", unit="s", low=0.0, high=10.0)
    veto_allowance: float = setting(
        0.025, "share of the body, as the others show it, that an honest camera may deny", low=0.0, high=1.0
    )
    offset_allowance: float = setting(
        0.04, "share of an honest silhouette that may fit better elsewhere: calibrations err", low=0.0, high=1.0
    )
    ratio: float = setting(1.5, "a liar denies at least so many times as much as the next worst camera", low=1.0)
    saturation: float = setting(
        0.1, "denial beyond the allowance that is a gross lie; a smaller one weighs less", low=0.01, high=1.0
    )
    excess_limit: float = setting(
        0.15, "share of its view that may be foreground of which the others know nothing", low=0.01, high=1.0
    )
    patience_s: float = setting(0.3, "a gross lie is believed after this time", unit="s", low=0.0)
    reinstate_allowance: float = setting(
        0.02, "share of the body that a camera may deny and still agree again", low=0.0, high=1.0
    )
    reinstate_s: float = setting(2.0, "who has agreed for this long is taken back", unit="s", low=0.0)
    memory_s: float = setting(2.0, "length of the running means that are published", unit="s", low=0.01)
    min_body_litres: float = setting(
        15.0, "a hull smaller than this is nobody, and nothing can be told by it", unit="litres", low=0.0
    )
    warning_limit: float = setting(
        0.15, "share of all foreground outside the hull from which cameras contradict each other", low=0.01, high=1.0
    )
    conflict_limit: float = setting(
        0.6, "share of all foreground that no hull explains from which two liars are looked for", low=0.1, high=1.0
    )


@dataclass(frozen=True)
class CalibrationSettings:
    """When a camera stands badly, as the planes that touch the body tell."""

    enabled: bool = setting(True, "compare the cameras' silhouettes with the calibration all the time")
    period_s: float = setting(0.2, "how often a frame set is looked at", unit="s", low=0.01, high=10.0)
    memory_s: float = setting(
        4.0, "length of the recent evidence; that of the lasting evidence is two minutes", unit="s", low=0.5, high=600.0
    )
    limit_deg: float = setting(
        0.3, "a camera stands badly when it is certain to stand off by more than this", unit="deg", low=0.05, high=10.0
    )


@dataclass(frozen=True)
class ShadowSettings:
    """How dark pixels that may be floor in shadow are judged by all cameras."""

    enabled: bool = setting(True, "judge dark pixels; else they are the person, as far as their camera knows")
    min_height_m: float = setting(
        0.08, "whatever the silhouettes agree on above this height is no shadow", unit="m", low=0.01, high=1.0
    )
    tolerance: int = setting(
        1, "two cameras see a place equally dark when they differ by so many degrees, of a tenth each", low=0, high=8
    )
    reach_m: float = setting(
        FLOOR_REACH_M,
        "floor is judged within the volume and so far around it; cameras send no more",
        unit="m",
        low=0.0,
        high=FLOOR_REACH_M,
    )


@dataclass(frozen=True)
class ContourSettings:
    """Which rays along the silhouettes' rims are published."""

    per_camera: int = setting(200, "most rays a camera; 0: no rims", low=0, high=100_000)
    spacing_px: float = setting(3.0, "least distance of neighbouring rays along an outline", unit="px", low=1.0)
    min_outline_px: float = setting(30.0, "shorter outlines, of holes or specks, have no rims", unit="px", low=4.0)
    sigma_px: float = setting(
        0.5, "standard deviation of a silhouette's rim across itself", unit="px", low=0.01, high=10.0
    )
    shadow_sigma_px: float = setting(
        4.0,
        "and what is added to it, in squares, where all pixels around are doubtful; less where fewer are",
        unit="px",
        low=0.0,
        high=100.0,
    )


@dataclass(frozen=True)
class HullSettings:
    """How silhouettes become a hull and its centerline."""

    voxel_size_m: float = setting(0.02, "edge of a voxel", unit="m", low=0.002, high=0.2)
    backend: str = setting(
        "auto", "who carves: gl (compute shaders), sweep (the thesis's, slow), cpu, or auto", choices=BACKENDS
    )
    min_seeing: int = setting(
        0, "cameras that must see a place before it can be occupied; 0: by the number of cameras", low=0, high=63
    )
    max_voxels: int = setting(3000, "size of the decimated voxel cloud", low=0, high=1_000_000)
    blob: BlobSettings = setting(BlobSettings, "blob filters")
    body: BodySettings = setting(BodySettings, "separate bodies")
    contour: ContourSettings = setting(ContourSettings, "rays along the silhouettes' rims")
    camera_fault: CameraFaultSettings = setting(CameraFaultSettings, "cameras that contradict the others")
    calibration: CalibrationSettings = setting(CalibrationSettings, "cameras that stand badly")
    shadow: ShadowSettings = setting(ShadowSettings, "dark pixels that may be floor in shadow")


@dataclass(frozen=True)
class NodeSettings(HullSettings):
    """The parameters of the hull node."""

    rig_file: str = setting("", "path of the rig YAML file: cameras, calibration, volume")
    mesh: MeshSettings = setting(MeshSettings, "the hull's mesh")
    frame_id: str = setting("map", "frame of the published clouds: the rig file's world")
    tolerance_s: float = setting(
        0.008, "stamps of one frame set differ by at most this: half a frame period", unit="s", low=1e-6, high=1.0
    )
    deadline_s: float = setting(
        0.05, "how long a frame set waits for its last cameras after its first one came", unit="s", low=1e-3, high=600.0
    )
    max_open_sets: int = setting(8, "frame sets that may wait for cameras at once", low=1, high=1000)
    queue_depth: int = setting(
        4, "closed frame sets that may wait for the carver; one more drops the oldest", low=1, high=1_000_000
    )
    reliable: bool = setting(
        False, "subscribe reliably: for replay and lockstep; live, a lost silhouette should cost one view, not a wait"
    )
