"""What can be set: the same names serve ROS parameters, YAML files and Python."""

from __future__ import annotations

from dataclasses import dataclass

from capture_rig.settings import setting

from .backends import BACKENDS


@dataclass(frozen=True)
class BlobSettings:
    """Which blobs become centerline points (thesis 3.2; the limits were tuned on rendered bodies)."""

    min_area_m2: float = setting(0.002, "smallest blob that counts: a wrist has about this area", unit="m2", low=0.0)
    max_elongation: float = setting(2.0, "largest ratio of a blob's principal axes", low=1.0)
    min_fill: float = setting(
        0.9, "smallest ratio of a blob's area to its ellipse's: less is two limbs merged", low=0.0, high=1.5
    )
    erosion_voxels: int = setting(
        0, "times each slice is eroded before its blobs are found; costs thin limbs", unit="voxels", low=0, high=3
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


@dataclass(frozen=True)
class NodeSettings(HullSettings):
    """The parameters of the hull node."""

    rig_file: str = setting("", "path of the rig YAML file: cameras, calibration, volume")
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
