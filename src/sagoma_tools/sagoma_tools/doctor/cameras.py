"""Checks of a camera PC: a camera's parameter file, background, camera, and the network between them.

The camera is asked over GVCP by unicast, which disturbs no program that uses it; nothing is asked that needs control.
"""

from __future__ import annotations

import contextlib
import ipaddress
import socket
import time
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

from camera_client.background.model import BackgroundModel, load_background, read_background
from camera_client.configuration import Calibration, load_calibration
from camera_client.gige.discovery import ANSWER_TIMEOUT_S, ATTEMPTS, discover_at
from camera_client.settings import AravisSettings, CameraClientSettings
from camera_client.sources.aravis_source import AravisSource
from camera_client.sources.footage_reader import open_footage
from capture_rig.camera import CameraModel
from capture_rig.errors import InputError
from capture_rig.settings import build_settings
from capture_rig.visibility import of_shape
from gige_vision import bootstrap
from gige_vision.gvcp import (
    PORT,
    AcknowledgePacket,
    Command,
    CommandPacket,
    MalformedPacket,
    Status,
    decode_words,
    encode_words,
)
from gige_vision.gvsp import PixelFormat
from sagoma_bringup.graph import camera_from_file
from sagoma_ros.middleware import resolve_packages

from .findings import CheckResult, about, error, note, ok, result_of, warning
from .machine import Interface, check_buffer, interface_to

NODE_PARAMETERS = ("autostart", "tf_prefix")  # of every node, not of the camera client's settings
OLD_S = 12 * 3600.0  # daylight and lamps change from one day to the next
JUMBO_MTU, GIGABIT = 9000, 1000
PACKET_HEADERS = 36  # IP, UDP and GVSP, of every stream packet
ETHERNET_FRAME = 38  # preamble, header, checksum and gap around every packet
BUSY, FULL = 0.7, 0.95  # shares of the link


@dataclass(frozen=True)
class CameraFile:
    """A camera's parameter file that could be read, and the calibration that it names, or why that cannot be used."""

    path: Path
    name: str
    settings: CameraClientSettings
    calibration: Calibration | InputError

    @property
    def camera(self) -> CameraModel | None:
        """The calibrated camera, where it is known."""
        return None if isinstance(self.calibration, InputError) else self.calibration.camera


def examine_camera(path: Path, open_it: bool = False) -> Iterator[CheckResult]:
    """Findings on the parameter file at ``path``, and the camera it names.

    open_it : take control of the camera, set it up as the client would, and report its state.
    """
    file = read_file(path)
    subject, settings = f"camera {file.name}", file.settings.aravis
    yield from about(subject, check_calibration(file), check_background(file))
    if file.settings.source == "aravis":
        yield from about(subject, check_timing(settings), check_buffer(settings.socket_buffer_bytes))
        if settings.address:
            link = interface_to(settings.address)
            yield from about(subject, check_interface(settings, link), check_identity(settings))
            yield from about(subject, check_control(settings, link))
            if link is not None:
                yield from about(subject, check_bandwidth(sent_beside(file, link), link))
        if open_it:
            yield from about(subject, check_opened(file))


def read_file(path: Path) -> CameraFile:
    """Return the file's settings, validated. Raises InputError naming file, key, value and remedy."""
    spec = camera_from_file(path)
    values = {key: resolve_packages(value) for key, value in spec.parameters.items() if key not in NODE_PARAMETERS}
    settings, name = build_settings(CameraClientSettings, values, str(path)), spec.namespace.strip("/")
    try:
        calibration: Calibration | InputError = load_calibration(settings, settings.camera_name or name)
    except InputError as problem:
        calibration = problem
    return CameraFile(path, name, settings, calibration)


def check_calibration(file: CameraFile) -> Iterator[CheckResult]:
    """Whether the camera's lens and pose are known."""
    settings = file.settings
    yield ok("file", f"{file.path} describes camera {file.name}")
    calibration, camera = file.calibration, file.camera
    if isinstance(calibration, InputError):
        raise calibration
    if camera is None:
        remedy = f"sagoma calibrate intrinsics --topic /{calibration.name}/image_raw --board BOARD"
        yield note("rig.uncalibrated", "not calibrated yet: it sends images, no silhouettes", remedy)
        return
    text = f"{settings.rig_file or settings.camera_info_file}: {camera.name}, {camera.width} x {camera.height} pixels"
    remedy = "sagoma calibrate extrinsics, then name the rig file in rig_file."
    yield result_of("rig", text, (not calibration.placed, note, "lens_only", f"Its place is not known: {remedy}"))


def check_background(file: CameraFile) -> Iterator[CheckResult]:
    """Whether the background can be read, has the camera's size, and is recent."""
    learn = f"sagoma background --cameras {file.name}, while the room is empty"
    settings, camera = file.settings, file.camera
    path = settings.background or (settings.background_file if Path(settings.background_file).is_file() else "")
    if camera is None:  # reported by another check
        return
    if not path:
        yield note("background.none_named", "none is named: no silhouettes until one is learned", learn)
        return
    shape, model = _read_background(path, settings)
    age_s = time.time() - Path(path).stat().st_mtime
    size = f"{path} is {shape[1]} x {shape[0]}, the camera {camera.width} x {camera.height} pixels"
    given = of_shape(camera, shape) if len(shape) == 3 else camera  # of a mosaic's tiles
    if shape[:2] != (given.height, given.width):
        yield error("background.size_differs", size, learn)
        return
    text = f"{path}, {age_s / 3600:.0f} h old; {model.provenance.frames} frames of {model.provenance.source}"
    yield result_of("background", text, (age_s > OLD_S, warning, "old", f"The light has changed since: {learn}"))


def check_timing(settings: AravisSettings) -> Iterator[CheckResult]:
    """Whether the exposure fits the frame rate, and whether the camera can be asked."""
    exposure_us, rate = settings.exposure_us, settings.frame_rate
    if exposure_us > 0 and rate > 0:
        text = f"{exposure_us:g} us at {rate:g} frames a second (at most {1e6 / rate:.0f} us)"
        remedy = "Shorten aravis.exposure_us or lower aravis.frame_rate."
        yield result_of("exposure", text, (exposure_us * 1e-6 * rate >= 1, error, "longer_than_frame", remedy))
    if not settings.address:
        text = "found by broadcast when the client starts; not asked here"
        yield note("camera.no_address", text, "Give aravis.address to have it examined.")


def check_interface(settings: AravisSettings, link: Interface | None) -> Iterator[CheckResult]:
    """Whether an interface leads to the camera and carries large packets."""
    if link is None:
        remedy = f"Give an interface an address in the camera's subnet; see: ip route get {settings.address}"
        yield error("interface.none", f"there is no way to {settings.address} from this machine", remedy)
        return
    plug = f"Plug the cable in, or: sudo ip link set {link.name} up"
    text = f"{link.name}, {link.address}, MTU {link.mtu}"
    yield result_of("interface", text, (not link.up, error, "down", plug))
    jumbo = f"sudo ip link set {link.name} mtu {JUMBO_MTU} (and the same on the switch)"
    if settings.packet_size > link.mtu:
        text = f"aravis.packet_size = {settings.packet_size}, but the MTU of {link.name} is {link.mtu}"
        yield error("mtu.packet_too_large", text, f"{jumbo}, or a smaller packet_size, or 0: the largest that passes")
    elif link.mtu < JUMBO_MTU and not link.loopback:
        text = f"{link.name} carries packets of {link.mtu} bytes: six times the interrupts"
        yield warning("mtu.no_jumbo_frames", text, jumbo)


def check_identity(settings: AravisSettings) -> Iterator[CheckResult]:
    """Whether the camera answers, and is the configured one."""
    try:
        record = discover_at(settings.address).device
    except InputError as problem:
        yield error("camera.silent", problem.what, "Check power, cable, address and subnet (ping it).")
        return
    yield ok("camera", f"{record.manufacturer} {record.model}, serial {record.serial}, answers at {settings.address}")
    for key, wanted, got in (("serial", settings.serial, record.serial), ("user_id", settings.user_id, record.user_id)):
        if wanted and wanted != got:
            text = f"the camera at {settings.address} has {key} '{got}', aravis.{key} asks for '{wanted}'"
            yield error(f"{key}.differs", text, f"Correct aravis.address or aravis.{key}.")


def check_control(settings: AravisSettings, link: Interface | None) -> CheckResult | None:
    """Whether the camera is free."""
    privilege = read_register(settings.address, bootstrap.CONTROL_PRIVILEGE)
    if privilege is None:
        return None
    if not privilege:
        return ok("control", "no program controls the camera: it can be opened")
    owner = read_register(settings.address, bootstrap.PRIMARY_ADDRESS)  # None where the camera does not answer
    controller = str(ipaddress.IPv4Address(owner)) if owner else "another program"
    if link is not None and controller == link.address:
        text = f"a program on this machine ({controller}) controls the camera"
        return note("control.local", text, "Nothing, if that is the camera client; else stop it.")
    text = f"{controller} controls the camera"
    return warning("control.taken", text, "Stop the program there; a camera has one controller.")


def check_bandwidth(sent: Mapping[str, float], link: Interface) -> CheckResult | None:
    """Whether the data of all cameras on this interface, bytes a second, fit its link."""
    if not sent or not all(sent.values()):  # some rate is left to its camera
        return None
    needed = sum(sent.values())
    text = f"{needed / 1e6:.0f} MB/s of {f'{len(sent)} cameras' if len(sent) > 1 else next(iter(sent))}"
    if link.loopback or not link.speed_mbit:
        return ok("bandwidth", f"{text}; the speed of {link.name} is unknown")
    share = needed / (link.speed_mbit * 1e6 / 8)
    text = f"{text} take {100 * share:.0f} % of the {link.speed_mbit} Mbit/s of {link.name}"
    remedy = "Lower frame rate, region or bit depth, give some cameras another interface, or space packets out with "
    remedy += "aravis.packet_delay_ns."
    full, busy = (share > FULL, error, "exceeded", remedy), (share > BUSY, warning, "tight", remedy)
    return result_of("bandwidth", text, full, busy)


def check_opened(file: CameraFile) -> Iterator[CheckResult]:
    """The camera's state under its client's settings: features, PTP, temperature."""
    with AravisSource(file.settings.aravis, file.settings.channels) as source:
        for text in source.warnings:
            yield warning("opened.warning", text, "See docs/how-to/camera_pcs.md.")
        details = ", ".join(f"{key} {value}" for key, value in source.details.items())
        yield ok("opened", f"{source.shape[1]} x {source.shape[0]}; {details}")


def _read_background(path: str, settings: CameraClientSettings) -> tuple[tuple[int, ...], BackgroundModel]:
    """Return the size (H, W, ...) and the model of a background file, a saved model or footage."""
    if path.endswith(".npz"):
        model = load_background(path)
        return model.shape, model
    with contextlib.closing(open_footage(path)) as reader:
        shape = reader.probe()
    return shape, read_background(path, shape)


def sent_beside(file: CameraFile, link: Interface) -> dict[str, float]:
    """Return the bytes a second that each camera of the file's folder sends through this interface, if its size is
    known, this camera first; 0 where the settings leave the rate open."""
    found = {file.name: file}
    for path in sorted(file.path.parent.glob("*.yaml")):
        with contextlib.suppress(InputError):  # examined when it is that file's turn
            other = read_file(path)
            found.setdefault(other.name, other)
    sent = {}
    for name, each in found.items():
        settings, camera = each.settings.aravis, each.camera
        theirs = interface_to(settings.address) if each.settings.source == "aravis" and settings.address else None
        if camera is not None and theirs is not None and theirs.name == link.name:
            wanted = settings.pixel_format  # "auto" prefers formats of 8 bits a pixel
            pixel_format = PixelFormat[wanted] if wanted in PixelFormat.__members__ else PixelFormat.Mono8
            payload = pixel_format.image_bytes(camera.width, camera.height)
            packet = settings.packet_size or min(link.mtu, JUMBO_MTU)
            sent[name] = max(settings.frame_rate, 0.0) * wire_bytes(payload, packet)
    return sent


def wire_bytes(payload: int, packet_size: int) -> int:
    """Return the bytes of a frame on the wire, headers of every packet, leader and trailer included (GVSP 2.0).

    payload : bytes of the image; packet_size : bytes of a packet with its headers.
    """
    packets = -(-payload // max(packet_size - PACKET_HEADERS, 1)) + 2
    return payload + packets * (PACKET_HEADERS + ETHERNET_FRAME)


def read_register(address: str, register: int) -> int | None:
    """Read one register of a camera, by unicast only; None when it does not answer or has none there."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as link:
        link.settimeout(ANSWER_TIMEOUT_S)
        for request in range(1, ATTEMPTS + 1):
            with contextlib.suppress(OSError, MalformedPacket):
                link.connect((address, PORT))
                link.send(CommandPacket(Command.READ_REGISTER, encode_words([register]), request).encode())
                answer = AcknowledgePacket.decode(link.recv(2048))
                if answer.acknowledge == Command.READ_REGISTER.acknowledge and answer.request_id == request:
                    return decode_words(answer.payload)[0] if answer.status == Status.SUCCESS else None
    return None
