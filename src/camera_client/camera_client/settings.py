"""All settings of the camera client; each is a ROS parameter of the node under the same (dotted) name."""

from __future__ import annotations

from dataclasses import dataclass

from capture_rig.settings import setting


@dataclass(frozen=True)
class FootageSettings:
    """Playing a video file or stills as if it were a camera."""

    path: str = setting("", "Video file, still, folder of stills, or a pattern such as frames/*.png")
    fps: float = setting(0.0, "Frame rate of the footage; 0 takes the file's own", unit="Hz", low=0, high=1000)
    rate: float = setting(1.0, "Playing speed as a factor; 0 plays as fast as consumers keep up", low=0, high=100)
    epoch_ns: int = setting(
        0, "Stamp of frame 0, the same for all cameras; 0: the next whole 5 s of the system clock", unit="ns", low=0
    )
    loop: bool = setting(False, "Begin again after the last frame; stamps go on counting")
    window: int = setting(3, "At rate 0: frames under way before an acknowledgement is awaited", low=1, high=1000)
    pace_topic: str = setting("/ekf/prediction", "At rate 0: the JointState topic whose stamps acknowledge frames")
    pace_timeout_s: float = setting(
        2.0, "At rate 0: go on (and count it) when no acknowledgement came for so long", unit="s", low=0.01, high=600
    )
    wait_for_consumer_s: float = setting(
        5.0,
        "Hold the first frame until a consumer listens (at rate 0: and acknowledges), but no longer",
        unit="s",
        low=0,
        high=600,
    )


@dataclass(frozen=True)
class AravisSettings:
    """A GigE Vision camera, opened through Aravis by its IP address. A negative number leaves a feature as it is."""

    address: str = setting("", "IPv4 address of the camera; nothing is ever broadcast")
    pixel_format: str = setting(
        "auto", "GenICam pixel format; auto prefers 8-bit Bayer, then BGR8, RGB8, Mono8",
        choices=("auto", "Mono8", "BGR8", "RGB8", "BayerRG8", "BayerGR8", "BayerGB8", "BayerBG8"),
    )  # fmt: skip
    exposure_us: float = setting(-1.0, "Exposure time", unit="us", low=-1, high=1e7)
    gain: float = setting(-1.0, "Gain in the camera's own unit (mostly dB)", low=-1, high=1000)
    frame_rate: float = setting(-1.0, "Frame rate", unit="Hz", low=-1, high=10000)
    packet_size: int = setting(0, "Bytes of a stream packet; 0 lets Aravis find the largest", low=0, high=16000)
    stamp_source: str = setting(
        "arrival", "arrival: host clock at the frame's first packet; camera: camera clock mapped onto the host's",
        choices=("arrival", "camera"),
    )  # fmt: skip
    buffers: int = setting(16, "Frame buffers in the pool", low=2, high=256)
    socket_buffer_bytes: int = setting(4 << 20, "Receive buffer of the stream's socket", unit="bytes", low=65536)
    packet_timeout_ms: float = setting(5.0, "A packet is asked for again after this", unit="ms", low=1, high=1000)
    frame_retention_ms: float = setting(40.0, "An incomplete frame is given up after this", unit="ms", low=5, high=5000)


@dataclass(frozen=True)
class BackgroundSettings:
    """The background model of thesis 6.2-6.3."""

    rule: str = setting(
        "tail", "tail: foreground when the two-sided tail probability is below risk; pdf: when the density is (thesis)",
        choices=("tail", "pdf"),
    )  # fmt: skip
    risk: float = setting(
        1e-4, "A background pixel is called foreground this often (each channel)", low=1e-12, high=0.5
    )
    sigma_floor: float = setting(1.0, "Smallest standard deviation of a pixel", unit="grey levels", low=0.1, high=64)
    still_sigma: float = setting(
        4.0, "Standard deviation assumed for a background that is a single still", unit="grey levels", low=0.1, high=64
    )


@dataclass(frozen=True)
class ColourShadowSettings:
    """Colour cameras: what is darker than the background by one factor in all channels is taken for its shadow."""

    enabled: bool = setting(True, "Remove shadows from the masks of colour cameras")
    darkest: float = setting(0.6, "A shadow leaves at least this share of the brightness", low=0.05, high=1)
    lightest: float = setting(0.97, "... and at most this share", low=0.5, high=1.2)
    chromaticity: float = setting(
        3.0, "A shadow's colour departs from the darkened background by at most this many sigma", low=0.1, high=100
    )
    min_brightness: float = setting(
        60.0, "Backgrounds darker than this cannot be told from dark clothes: no shadow there", unit="grey levels",
        low=0, high=255,
    )  # fmt: skip


@dataclass(frozen=True)
class FloorShadowSettings:
    """Mono cameras: floor that is darkened by a locally constant factor, its texture unchanged, is in shadow."""

    enabled: bool = setting(True, "Remove shadows on the floor (z = 0) from the masks of mono cameras")
    darkest: float = setting(0.5, "A shadow leaves at least this share of the brightness", low=0.05, high=1)
    lightest: float = setting(0.97, "... and at most this share", low=0.5, high=1.2)
    window: float = setting(
        0.0105, "Side of the window that compares textures", unit="share of height", low=0.004, high=0.2
    )
    residual: float = setting(
        1.75, "In a shadow, window and darkened background differ by at most this many sigma", low=0.1, high=100
    )
    min_area: float = setting(
        0.006, "Smaller patches are not taken for shadow", unit="share of height^2", low=0, high=1
    )


@dataclass(frozen=True)
class SilhouetteSettings:
    """From a frame to a clean silhouette. Lengths are shares of the image height, areas of its square."""

    median_px: int = setting(5, "Side of the median filter", unit="px", choices=(1, 3, 5, 7))
    closing: float = setting(
        0.0085, "Cracks in the silhouette up to about this width are closed", unit="share of height", low=0, high=0.1
    )
    min_area: float = setting(2e-4, "Components smaller than this are dropped", unit="share of height^2", low=0, high=1)
    near: float = setting(
        0.08, "Components are kept within this gap of the largest one (or of one kept)", unit="share of height",
        low=0, high=10,
    )  # fmt: skip
    max_hole: float = setting(1e-3, "Holes smaller than this are filled", unit="share of height^2", low=0, high=1)
    empty_below: float = setting(2e-4, "A mask with a smaller share of foreground is flagged empty", low=0, high=1)
    full_above: float = setting(0.6, "A mask with a larger share of foreground is flagged full", low=0, high=1)
    colour_shadow: ColourShadowSettings = setting(ColourShadowSettings, "Shadow removal of colour cameras")
    floor_shadow: FloorShadowSettings = setting(FloorShadowSettings, "Shadow removal of mono cameras")


@dataclass(frozen=True)
class CameraClientSettings:
    """Everything one camera client needs."""

    rig_file: str = setting("", "Rig YAML with the calibration of all cameras")
    camera_name: str = setting("", "Which camera of the rig this is; empty takes the node's namespace")
    source: str = setting("footage", "Where frames come from", choices=("footage", "aravis"))
    channels: str = setting(
        "auto",
        "Work in mono or colour; auto follows the footage, or takes what the camera has",
        choices=("auto", "mono", "colour"),
    )
    background: str = setting(
        "", "Background: saved model (.npz), still, or video of the empty scene; empty: learn it by service"
    )
    background_frames: int = setting(100, "Frames taken by ~/learn_background", low=2, high=100000)
    background_file: str = setting("", "Where ~/learn_background saves the model (.npz); empty: nowhere")
    publish_raw: bool = setting(False, "Publish image_raw")
    publish_preview: bool = setting(False, "Publish preview/compressed: the image with the silhouette's outline")
    preview_rate: float = setting(5.0, "At most so many previews", unit="Hz", low=0.1, high=1000)
    footage: FootageSettings = setting(FootageSettings, "Footage source")
    aravis: AravisSettings = setting(AravisSettings, "GigE Vision source")
    background_model: BackgroundSettings = setting(BackgroundSettings, "Background model")
    silhouette: SilhouetteSettings = setting(SilhouetteSettings, "Silhouette")
