"""Examines a camera's parameter file and the camera that it names, as far as the file allows."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from camera_client.configuration import Calibration, load_calibration
from camera_client.settings import CameraClientSettings
from camera_client.sources.aravis_source import AravisSource
from capture_rig.camera import CameraModel
from capture_rig.errors import InputError
from capture_rig.settings import build_settings
from gige_vision.pixel_formats import PixelFormat
from sagoma_bringup.graph import camera_from_file
from sagoma_ros.names import resolve_packages

from .camera_network import ask_camera, check_bandwidth, check_device, check_interface, check_receive_buffer
from .collect import collect_background, collect_host, collect_interface
from .facts import BackgroundFacts, HostFacts, InterfaceFacts, Stream
from .findings import Finding, error, note, ok, on, warning
from .machine.checks import check_host
from .machine.collect import SUBJECT

OLD_S = 12 * 3600.0  # daylight and lamps change from one day to the next
EXPOSURE_TOLERANCE = 0.02
LEARN = "sagoma background --cameras {name}, while the room is empty"


def check_calibration(calibration: Calibration, settings: CameraClientSettings) -> Finding:
    """Report whether the camera's lens and pose are known."""
    camera = calibration.camera
    if camera is None:
        remedy = f"sagoma calibrate intrinsics --topic /{calibration.name}/image_raw --board BOARD"
        return note("rig.uncalibrated", "not calibrated yet: it sends images, no silhouettes", remedy)
    size = f"{camera.name}, {camera.width} x {camera.height} pixels"
    if calibration.placed:
        return ok("rig", f"{settings.rig_file}: {size}")
    remedy = "sagoma calibrate extrinsics, then name the rig file in rig_file."
    return note("rig.lens_only", f"{settings.camera_info_file}: {size}; its lens is known, its place is not", remedy)


def check_background(
    facts: BackgroundFacts | None, camera: CameraModel, settings: CameraClientSettings
) -> Iterator[Finding]:
    """Check that the background can be read, has the camera's size, and is recent."""
    learn = LEARN.format(name=camera.name)
    if facts is None:
        yield note("background.none_named", "none is named: no silhouettes until one is learned", learn)
        return
    if facts.error:
        yield error("background.unusable", facts.error, f"Name the right file, or empty the parameter, and {learn}")
        return
    if facts.shape[:2] != (camera.height, camera.width):
        yield error(
            "background.size_differs",
            f"{facts.path} is {facts.shape[1]} x {facts.shape[0]}, the camera {camera.width} x {camera.height} pixels",
            learn,
        )
        return
    age = f"{facts.age_s / 3600:.0f} h old"
    if facts.age_s > OLD_S:
        yield warning("background.old", f"{facts.path} is {age}; the light has changed since", learn)
    else:
        yield ok("background", f"{facts.path}, {age}{'; ' if facts.summary else ''}{facts.summary}")
    yield from _check_learned_exposure(facts, settings, learn)


def _check_learned_exposure(facts: BackgroundFacts, settings: CameraClientSettings, learn: str) -> Iterator[Finding]:
    wanted = settings.aravis.exposure_us
    try:
        learned = float(facts.exposure_us)
    except ValueError:  # it is not written in the file
        return
    if wanted > 0 and abs(learned - wanted) > EXPOSURE_TOLERANCE * wanted:
        text = f"learned at {learned:g} us of exposure, aravis.exposure_us = {wanted:g}"
        yield warning("background.exposure_differs", text, learn)


def check_timing(settings: CameraClientSettings) -> Iterator[Finding]:
    """Check that the exposure fits the frame rate, and name settings that are left to the camera."""
    exposure_us, rate = settings.aravis.exposure_us, settings.aravis.frame_rate
    if exposure_us > 0 and rate > 0 and exposure_us * 1e-6 * rate >= 1:
        text = f"{exposure_us:g} us do not fit {rate:g} frames a second (at most {1e6 / rate:.0f} us)"
        yield error("exposure.longer_than_frame", text, "Shorten aravis.exposure_us or lower aravis.frame_rate.")
    elif exposure_us > 0 and rate > 0:
        yield ok("exposure", f"{exposure_us:g} us at {rate:g} frames a second")
    for key, value in (("exposure_us", exposure_us), ("gain", settings.aravis.gain), ("frame_rate", rate)):
        if value < 0:
            remedy = "Set it: cameras lose their settings when they lose power."
            yield note("settings.left_to_camera", f"aravis.{key} is left as the camera has it", remedy)


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
        yield from on(
            f"camera file {path}", [error("file.invalid", f"{problem.where}: {problem.what}", problem.remedy)]
        )
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
        yield error("rig.invalid", f"{problem.where}: {problem.what}", problem.remedy)
    if file.settings.camera_name not in ("", file.name):
        text = f"its key names {file.name}, camera_name says '{file.settings.camera_name}'"
        yield warning("file.names_differ", text, "Give both the same name.")
    if camera is not None:
        shape = (camera.height, camera.width)
        yield from check_background(collect_background(file.settings, shape), camera, file.settings)
    if file.settings.source == "aravis":
        yield from _examine_live(file, host, open_it)
    else:
        yield note("camera.not_gige", f"source: {file.settings.source}; network and camera are not examined")


def read_file(path: Path) -> CameraFile:
    """Return the file's settings, validated. Raises InputError naming file, key, value and remedy."""
    spec = camera_from_file(path)
    values = {key: resolve_packages(value) for key, value in spec.parameters.items() if key not in NODE_PARAMETERS}
    settings = build_settings(CameraClientSettings, values, str(path))
    return CameraFile(path, spec.namespace.strip("/"), settings)


def siblings(file: CameraFile, interface: InterfaceFacts) -> list[CameraFile]:
    """Return the other cameras of the folder whose packets come through the same interface."""
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
    """Return what the camera sends, from its calibrated size and pixel format; None when the size is unknown."""
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
        remedy = "Give aravis.address to have it examined."
        yield note("camera.no_address", "found by broadcast when the client starts; not asked here", remedy)
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
                yield warning("opened.warning", text, "See docs/camera_pcs.md.")
            details = ", ".join(f"{key} {value}" for key, value in source.details.items())
            yield ok("opened", f"{source.shape[1]} x {source.shape[0]}; {details}")
    except InputError as problem:
        yield error("opened.failed", f"{problem.where}: {problem.what}", problem.remedy)


def _unopened(file: CameraFile) -> Iterator[Finding]:
    text = "PTP, temperature and features are known only to the program that controls the camera"
    yield note("opened.not_tried", text, "Run again with --open while no client runs.")


def _camera_info(settings: CameraClientSettings) -> Iterator[Finding]:
    path = settings.camera_info_file
    if path and not Path(path).exists():
        remedy = "Calibrate the camera: set_camera_info writes it."
        yield note("camera_info.missing", f"{path} does not exist yet: the rig's intrinsics are in use", remedy)
    elif path:
        yield ok("camera_info", f"intrinsics of {path}")
