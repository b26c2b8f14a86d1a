"""All settings of the camera client; each is a ROS parameter of the node under the same (dotted) name."""

from __future__ import annotations

from dataclasses import dataclass, field

from capture_rig.settings import setting
from gige_vision.gvsp import PixelFormat


@dataclass(frozen=True)
class FootageSettings:
    """Playing a video file or stills as if it were a camera."""

    path: str = setting("", "Video file, still, folder of stills, or a pattern such as frames/*.png")
    fps: float = setting(0.0, "Frame rate of the footage; 0 takes the file's own", unit="Hz", low=0, high=1000)
    rate: float = setting(1.0, "Playing speed as a factor; 0 plays as fast as consumers keep up", low=0, high=100)
    epoch_ns: int = setting(
        0, "Stamp of frame 0, the same for all cameras; 0: a second after the first one starts", unit="ns", low=0
    )
    keep_up: bool = setting(
        False, "Begin at epoch_ns even if that is past: frames whose time has passed are left out, also after a pause"
    )
    loop: bool = setting(False, "Begin again after the last frame; stamps go on counting")
    wait_for_cameras: bool = setting(
        False, "Hold the first frame until every camera of the rig is active, so that none misses the beginning"
    )


@dataclass(frozen=True)
class AravisSettings:
    """A GigE Vision camera, opened through Aravis. A negative number leaves a feature as it is."""

    address: str = setting("", "IPv4 address of the camera; nothing is broadcast when it is given")
    serial: str = setting("", "Serial number: verified, or searched for on `interface` when no address is given")
    user_id: str = setting("", "User-defined name of the camera: verified, or searched for, like the serial number")
    interface: str = setting("", "Where to search by broadcast: name or own address of an interface")

    pixel_format: str = setting(
        "auto",
        "GenICam pixel format; auto prefers 8-bit Bayer, then YUV422, BGR8, RGB8, Mono8, deeper mono",
        choices=("auto", *PixelFormat.__members__),
    )
    exposure_us: float = setting(-1.0, "Exposure time", unit="us", low=-1, high=1e7)
    gain: float = setting(-1.0, "Gain in the camera's own unit (mostly dB)", low=-1, high=1e6)
    frame_rate: float = setting(-1.0, "Frame rate, also of the triggers that we send", unit="Hz", low=-1, high=10000)
    binning: int = setting(-1, "Pixels binned into one, in both directions", unit="px", low=-1, high=16)
    width: int = setting(-1, "Width of the region; 0: the whole sensor", unit="px", low=-1, high=100000)
    height: int = setting(-1, "Height of the region; 0: the whole sensor", unit="px", low=-1, high=100000)
    offset_x: int = setting(-1, "Left edge of the region; -1: in the middle", unit="px", low=-1, high=100000)
    offset_y: int = setting(-1, "Upper edge of the region; -1: in the middle", unit="px", low=-1, high=100000)
    features: list[str] = setting(
        [], "Any GenICam features, set in this order before all others: 'Name=value', or 'Name!' for a command"
    )

    sync: str = setting(
        "free_run",
        "What starts an exposure: the camera itself; its PTP clock; a trigger line; scheduled action "
        "commands (in PTP time); software triggers (in this host's time)",
        choices=("free_run", "ptp", "line", "action", "software"),
    )
    trigger_line: str = setting("Line1", "sync line: the input, a name of TriggerSource")
    trigger_activation: str = setting(
        "RisingEdge", "sync line: the edge", choices=("RisingEdge", "FallingEdge", "AnyEdge")
    )
    action_device_key: int = setting(
        1, "sync action: key of the cameras, another one for each rig of a network", low=0, high=0xFFFFFFFF
    )

    stamp_source: str = setting(
        "auto",
        "Whose clock stamps frames; auto: ptp when the camera is in step, else camera (its clock mapped onto "
        "the host's)",
        choices=("auto", "ptp", "camera"),
    )
    clock_speed: float = setting(
        1.0,
        "Of simulated cameras in slow motion (sagoma studio --speed, which writes it): the speed of their clock",
        unit="s a second",
        low=1 / 32,
        high=1,
    )
    camera_stamps: str = setting(
        "exposure_start",
        "Which instant the camera stamps; ours is always mid-exposure",
        choices=("exposure_start", "exposure_middle", "exposure_end"),
    )
    tai_utc_offset_s: int = setting(
        37,
        "By how much the PTP clock is ahead of UTC: 37 for TAI, 0 where the grandmaster gives UTC",
        unit="s",
        low=-1000,
        high=1000,
    )

    packet_size: int = setting(0, "Bytes of a stream packet; 0: the largest that gets through", low=0, high=16404)
    packet_delay_ns: int = setting(-1, "Pause between the packets of a frame", unit="ns", low=-1, high=10**9)
    frame_retention_ms: float = setting(40.0, "An incomplete frame is given up after this", unit="ms", low=5, high=5000)
    socket_buffer_bytes: int = setting(4 << 20, "Receive buffer of the stream's socket", unit="bytes", low=65536)

    action_lead_ms: float = 100.0  # sync action: commands are sent so long ahead
    ptp_wait_s: float = 10.0  # longest wait for the camera to be in step by PTP
    buffers: int = 16  # of frames, in the pool


@dataclass(frozen=True)
class TopicSettings:
    """Images that another ROS node publishes: a driver of USB, depth or industrial cameras, or a bag that is played."""

    name: str = setting("", "Topic of sensor_msgs/Image or CompressedImage, for instance /driver/cam01/image_raw")
    camera_info: str = setting("", "Topic of sensor_msgs/CameraInfo: its lens replaces the rig's; empty: the rig's")
    bits: int = setting(
        16, "Bits of a grey level in encodings of 16 bits: 10, 12 or 14 of many cameras", low=8, high=16
    )
    stamp_offset_ms: float = setting(
        0.0, "From the header's stamp to mid-exposure: what the driver's stamps lack", unit="ms", low=-1000, high=1000
    )

    stamp_uncertainty_ms: float = 2.0  # standard deviation of the stamps that way, of drivers that stamp the arrival


@dataclass(frozen=True)
class WebcamSettings:
    """A webcam of this machine, opened through Video4Linux2. Zero leaves a number as it is."""

    device: str = setting("0", "Number or path of the device: 0, /dev/video2, /dev/v4l/by-id/...")
    width: int = setting(0, "Width of the picture", unit="px", low=0, high=100000)
    height: int = setting(0, "Height of the picture", unit="px", low=0, high=100000)
    frame_rate: float = setting(0.0, "Frame rate", unit="Hz", low=0, high=1000)
    fourcc: str = setting("MJPG", "Pixel format: MJPG lets several webcams share a USB bus; empty: the driver's")
    exposure_100us: int = setting(0, "Exposure time; 0: the webcam's automatic", unit="100 us", low=0, high=100000)
    stamp_offset_ms: float = setting(
        -15.0, "From the driver's stamp (first byte) to mid-exposure", unit="ms", low=-1000, high=1000
    )

    stamp_uncertainty_ms: float = 8.0  # standard deviation of the stamps that way


@dataclass(frozen=True)
class PluginSettings:
    """A source of the user's: a class derived from camera_client.frame_source.FrameSource."""

    source: str = setting("", "MODULE:CLASS, to be found on PYTHONPATH")
    options: list[str] = setting([], "Keyword arguments of the class, 'name=value', as texts")


@dataclass(frozen=True)
class BackgroundSettings:
    """The background model of thesis 6.2-6.3."""

    rule: str = setting(
        "adaptive",
        "adaptive: follows light, noise and small movements, and calls a pixel foreground when its distance is less "
        "probable than risk; tail: the background stays as learned, the same test; pdf: the density is below risk "
        "(thesis)",
        choices=("adaptive", "tail", "pdf"),
    )
    risk: float = setting(
        1e-4, "A background pixel is called foreground this often (each channel)", low=1e-12, high=0.5
    )
    moved_things: bool = setting(
        True, "Things that moved or were taken away become background: what no other camera sees, and keeps still"
    )

    sigma_floor: float = 1.0  # smallest standard deviation of a pixel, grey levels


@dataclass(frozen=True)
class SilhouetteSettings:
    """How a frame becomes a clean silhouette. Lengths are shares of the image height, areas of its square."""

    shadow: str = setting(
        "mark",
        "Shadows: mark them, and what might be one, for the hull server to resolve; remove them; or keep them",
        choices=("mark", "remove", "keep"),
    )
    closing: float = setting(
        0.0085, "Cracks in the silhouette up to about this width are closed", unit="share of height", low=0, high=0.1
    )
    near: float = setting(
        0.12,
        "Components too small for a person are kept within this gap of one that is kept",
        unit="share of height",
        low=0,
        high=10,
    )
    outline_contrast: float = setting(
        0.3,
        "A pixel of the outline stays if it differs from the background by this share of what its neighbours do; "
        "0 keeps all",
        low=0,
        high=0.9,
    )
    max_hole: float = setting(1e-3, "Holes smaller than this are filled", unit="share of height^2", low=0, high=1)


@dataclass(frozen=True)
class SupervisionSettings:
    """When a live camera counts as gone, and how it is brought back."""

    stall_timeout_s: float = setting(
        0.5, "Connect anew when nothing came for so long (and for five frame periods)", unit="s", low=0.05, high=3600
    )
    triggered_stall_timeout_s: float = setting(
        10.0, "The same while frames wait for an external trigger; 0: never", unit="s", low=0, high=86400
    )


@dataclass(frozen=True)
class CameraMovedSettings:
    """When a camera counts as moved since it was calibrated, by its picture."""

    limit_deg: float = setting(
        0.2,
        "The camera was moved when its picture is shifted or turned by more; 0: not looked at",
        unit="deg",
        low=0,
        high=10,
    )


@dataclass(frozen=True)
class CameraClientSettings:
    """All settings of one camera client."""

    rig_file: str = setting(
        "", "Rig YAML with the calibration of all cameras; empty: not calibrated yet, images instead of silhouettes"
    )
    camera_name: str = setting("", "Which camera of the rig this is; empty takes the node's namespace")
    source: str = setting(
        "footage", "Where frames come from", choices=("footage", "aravis", "topic", "webcam", "plugin")
    )
    channels: str = setting(
        "auto",
        "Work in mono or colour; auto follows the footage, or takes what the camera has",
        choices=("auto", "mono", "colour"),
    )
    camera_info_file: str = setting(
        "", "ROS camera_info YAML: its intrinsics replace the rig's, and set_camera_info writes it; empty: the rig's"
    )
    background: str = setting(
        "",
        "Background: saved model (.npz), still, or video of the empty scene; empty: background_file if it is there, "
        "else learn it by service",
    )
    background_frames: int = setting(100, "Frames taken by ~/learn_background", low=2, high=100000)
    background_file: str = setting("", "Where ~/learn_background saves the model (.npz); empty: nowhere")
    background_age_h: float = setting(12.0, "A background is old after this; 0: never", unit="h", low=0, high=1e5)
    publish_raw: bool = setting(False, "Publish image_raw (without a rig it is there in any case, for calibration)")
    publish_preview: bool = setting(
        True, "Offer preview/compressed: the image with the silhouette's outline, sent while somebody subscribes"
    )
    footage: FootageSettings = field(default_factory=FootageSettings)
    aravis: AravisSettings = field(default_factory=AravisSettings)
    topic: TopicSettings = field(default_factory=TopicSettings)
    webcam: WebcamSettings = field(default_factory=WebcamSettings)
    plugin: PluginSettings = field(default_factory=PluginSettings)
    supervision: SupervisionSettings = field(default_factory=SupervisionSettings)
    background_model: BackgroundSettings = field(default_factory=BackgroundSettings)
    silhouette: SilhouetteSettings = field(default_factory=SilhouetteSettings)
    camera_moved: CameraMovedSettings = field(default_factory=CameraMovedSettings)
