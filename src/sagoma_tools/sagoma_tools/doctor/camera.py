"""The examination of one camera's parameter file: collect, judge, step by step, as far as the file allows."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from camera_client.aravis_source import AravisSource
from camera_client.assembly import load_calibration
from camera_client.settings import CameraClientSettings
from capture_rig.errors import InputError
from capture_rig.settings import build_settings
from gige_vision.pixel_formats import PixelFormat
from sagoma_bringup.graph import camera_from_file
from sagoma_bringup.node_spec import NodeSpec

from .ask_camera import ask_camera
from .camera_checks import check_background, check_calibration, check_timing
from .collect import collect_background, collect_host, collect_interface
from .facts import HostFacts, InterfaceFacts, Stream
from .findings import Finding, error, note, ok, on, warning
from .host_checks import check_host
from .machine.examination import SUBJECT
from .network_checks import check_bandwidth, check_device, check_interface, check_receive_buffer

NODE_PARAMETERS = ("autostart",)  # of every node, not of the camera client's settings


@dataclass(frozen=True)
class CameraFile:
    """A camera's parameter file that could be read."""

    path: Path
    name: str
    settings: CameraClientSettings


def examine(path: Path, open_it: bool = False, *, host_too: bool = True) -> Iterator[Finding]:
    """Findings on the parameter file at ``path``, the camera it names, and (``host_too``) this machine.

    open_it : take control of the camera, set it up as the client would, and report what it says.
    """
    try:
        file = read_file(path)
    except InputError as problem:
        yield from on(f"camera file {path}", [error("file", f"{problem.where}: {problem.what}", problem.remedy)])
        return
    host = collect_host()
    yield from on(f"camera {file.name}", _examine_file(path, file, host, open_it))
    if host_too:
        yield from on(SUBJECT, check_host(host))


def _examine_file(path: Path, file: CameraFile, host: HostFacts, open_it: bool) -> Iterator[Finding]:
    yield ok("file", f"{path} describes camera {file.name}")
    camera = None
    try:
        calibration = load_calibration(file.settings, file.settings.camera_name or file.name)
        camera = calibration.camera
        yield check_calibration(calibration, file.settings)
        yield from _camera_info(file.settings)
    except InputError as problem:
        yield error("rig", f"{problem.where}: {problem.what}", problem.remedy)
    if file.settings.camera_name not in ("", file.name):
        yield warning(
            "file",
            f"its key names {file.name}, camera_name says '{file.settings.camera_name}'",
            "Give both the same name.",
        )
    if camera is not None:
        shape = (camera.height, camera.width)
        yield from check_background(collect_background(file.settings, shape), camera, file.settings)
    if file.settings.source == "aravis":
        yield from _examine_live(file, host, open_it)
    else:
        yield note("camera", f"source: {file.settings.source}; network and camera are not looked at")


def read_file(path: Path) -> CameraFile:
    """The file's settings, validated. Raises InputError naming file, key, value and remedy."""
    spec = camera_from_file(path)
    values = {key: value for key, value in spec.parameters.items() if key not in NODE_PARAMETERS}
    settings = build_settings(CameraClientSettings, values, str(path))
    return CameraFile(path, _key_name(spec), settings)


def siblings(file: CameraFile, interface: InterfaceFacts) -> list[CameraFile]:
    """The other cameras of the folder whose packets come through the same interface."""
    found = []
    for path in sorted(file.path.parent.glob("*.yaml")):
        try:
            other = read_file(path)
        except InputError:  # examined when it is that file's turn
            continue
        address = other.settings.aravis.address
        if other.name == file.name or other.settings.source != "aravis" or not address:
            continue
        theirs = collect_interface(address)
        if theirs is not None and theirs.name == interface.name:
            found.append(other)
    return found


def stream_of(file: CameraFile) -> Stream | None:
    """What the camera sends, from its calibrated size and pixel format; None when the size is unknown."""
    try:
        camera = load_calibration(file.settings, file.settings.camera_name or file.name).camera
    except InputError:
        return None
    if camera is None:
        return None
    wanted = file.settings.aravis.pixel_format
    # "auto" prefers formats of 8 bits a pixel
    pixel_format = PixelFormat[wanted] if wanted in PixelFormat.__members__ else PixelFormat.Mono8
    payload = pixel_format.image_bytes(camera.width, camera.height)
    return Stream(file.name, payload, max(file.settings.aravis.frame_rate, 0.0))


def _examine_live(file: CameraFile, host: HostFacts, open_it: bool) -> Iterator[Finding]:
    settings = file.settings.aravis
    yield from check_timing(file.settings)
    yield from check_receive_buffer(host, settings)
    if not settings.address:
        yield note(
            "camera",
            "found by broadcast when the client starts; not asked here",
            "Give aravis.address to have it examined.",
        )
    else:
        interface = collect_interface(settings.address)
        yield from check_interface(interface, settings.address, settings)
        yield from check_device(ask_camera(settings.address), settings, interface)
        if interface is not None:
            streams = [stream_of(one) for one in (file, *siblings(file, interface))]
            known = [stream for stream in streams if stream is not None]
            yield from check_bandwidth(known, interface, settings.packet_size) if known else ()
    yield from _opened(file) if open_it else _unopened(file)


def _opened(file: CameraFile) -> Iterator[Finding]:
    source = AravisSource(file.settings.aravis, file.settings.channels)
    try:
        with source:
            for text in source.warnings:
                yield warning("opened", text, "See docs/camera_pcs.md.")
            told = ", ".join(f"{key} {value}" for key, value in source.details.items())
            yield ok("opened", f"{source.shape[1]} x {source.shape[0]}; {told}")
    except InputError as problem:
        yield error("opened", f"{problem.where}: {problem.what}", problem.remedy)


def _unopened(file: CameraFile) -> Iterator[Finding]:
    yield note(
        "opened",
        "PTP, temperature and features are known only to who controls the camera",
        "Run again with --open while no client runs.",
    )


def _camera_info(settings: CameraClientSettings) -> Iterator[Finding]:
    path = settings.camera_info_file
    if path and not Path(path).exists():
        yield note(
            "camera_info",
            f"{path} does not exist yet: the rig's intrinsics are in use",
            "Calibrate the camera: set_camera_info writes it.",
        )
    elif path:
        yield ok("camera_info", f"intrinsics of {path}")


def _key_name(spec: NodeSpec) -> str:
    return spec.namespace.strip("/")
