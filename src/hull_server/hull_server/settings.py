"""The settings: the same names serve ROS parameters, YAML files and Python."""

from __future__ import annotations

from dataclasses import dataclass, field

from capture_rig.settings import setting

BACKENDS = ("auto", "gl", "sweep", "cpu")
# Thresholds: judgement.
PERSON_LITRES = 15.0  # a smaller hull is no person: cameras are not compared by it
MIN_FILL = 0.9  # of rendered bodies' limbs
SMOOTHING_VOXELS = 0.8  # standard deviation: half of a step between layers
RAY_SPACING_PX = 3.0  # least distance of neighbouring rays along an outline


@dataclass(frozen=True)
class BlobSettings:
    """Which blobs become centerline points (thesis 3.2; the limits were tuned on rendered bodies).

    max_elongation : largest ratio of a blob's principal axes. min_fill : smallest ratio of its area to its ellipse's:
    less is two limbs merged. max_growth : largest ratio of the areas a step to either side to its own, as a limb
    continues; 0: any.
    """

    min_area_m2: float = setting(0.002, "smallest blob that counts: a wrist has about this area", unit="m2", low=0.0)
    max_elongation: float = 3.0
    min_fill: float = MIN_FILL
    max_growth: float = 3.0


@dataclass(frozen=True)
class BodySettings:
    """Which parts of the hull are bodies."""

    min_litres: float = setting(PERSON_LITRES, "smallest separate part that is a body", unit="litres", low=0.0)


@dataclass(frozen=True)
class MeshSettings:
    """The hull's surface as a file, on request.

    smoothing_voxels : standard deviation of the smoothing of the voxels' steps; 0: none.
    """

    folder: str = setting("output/meshes", "folder that ~/save_mesh writes hull_STAMP.ply to")
    smoothing_voxels: float = SMOOTHING_VOXELS


@dataclass(frozen=True)
class CameraFaultSettings:
    """When a camera that contradicts the others is excluded, and after how long in agreement reinstated."""

    enabled: bool = setting(True, "leave out a camera that contradicts all others")
    reinstate_s: float = 2.0


@dataclass(frozen=True)
class ContourRaySettings:
    """Which rays along the silhouettes' contours are published."""

    per_camera: int = setting(200, "most rays of a camera; 0: no contour rays", low=0, high=100_000)
    spacing_px: float = RAY_SPACING_PX


@dataclass(frozen=True)
class HullSettings:
    """How silhouettes become a hull and its centerline."""

    voxel_size_m: float = setting(0.02, "edge of a voxel", unit="m", low=0.002, high=0.2)
    backend: str = setting(
        "auto", "what carves: gl (compute shaders), sweep (the thesis's, slow), cpu, or auto", choices=BACKENDS
    )
    min_seeing: int = setting(
        0, "cameras that must see a place before it can be occupied; 0: by the number of cameras", low=0, high=63
    )
    max_voxels: int = setting(3000, "size of the decimated voxel cloud, for each body", low=0, high=1_000_000)
    blob: BlobSettings = field(default_factory=BlobSettings)
    body: BodySettings = field(default_factory=BodySettings)
    contour: ContourRaySettings = field(default_factory=ContourRaySettings)
    camera_fault: CameraFaultSettings = field(default_factory=CameraFaultSettings)


@dataclass(frozen=True)
class NodeSettings(HullSettings):
    """The parameters of the hull node."""

    rig_file: str = setting("", "path of the rig YAML file: cameras, calibration, volume")
    mesh: MeshSettings = field(default_factory=MeshSettings)
    frame_id: str = setting("map", "frame of the published clouds: the rig file's world", is_name=True)
    publish_tf: bool = setting(True, "publish the cameras' places on /tf_static, where tf2_msgs is installed")
    tolerance_s: float = setting(
        0.008, "stamps of one frame set differ by at most this: half a frame period", unit="s", low=1e-6, high=1.0
    )
    deadline_s: float = setting(
        0.05, "how long a frame set waits for its last cameras after its first one came", unit="s", low=1e-3, high=600.0
    )
    queue_depth: int = setting(
        4, "closed frame sets that may wait for the carver; one more drops the oldest", low=1, high=1_000_000
    )
    thin_out: bool = setting(
        True, "leave out frame sets, the same ones in all cameras, while the graph cannot process them all"
    )
    resend: bool = setting(
        False,
        "have silhouettes sent again that the network lost; only with our DDS profile (docs/how-to/hosts.md): with "
        "ROS's own heartbeats one that is lost holds up all behind it for seconds",
    )
    reliable: bool = setting(
        False,
        "subscribe reliably, thin nothing out: for replay and lockstep; live, a lost silhouette should cost one view, "
        "not a wait",
    )
