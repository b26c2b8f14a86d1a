"""Collects facts about this machine (cores, clock, interface) and about a camera's background file."""

from __future__ import annotations

import ctypes
import os
import shutil
import socket
import subprocess
import time
from pathlib import Path

import numpy as np
import psutil

from camera_client.background.model import BackgroundModel, load_background, read_background
from camera_client.settings import CameraClientSettings
from camera_client.sources.aravis_source import import_aravis
from camera_client.sources.footage_reader import open_footage
from capture_rig.errors import InputError

from .facts import BackgroundFacts, ClockFacts, HostFacts, InterfaceFacts

TIME_ERROR = 5  # adjtimex: the clock is not synchronised
KNOWN_US = 10_000_000  # with an estimated error this large the kernel marks an unknown one
KEEPER = "a service that the kernel knows of"

_long, _int = ctypes.c_long, ctypes.c_int


class _Timex(ctypes.Structure):
    """struct timex of <sys/timex.h>; what is behind ``status`` is not looked at."""

    _fields_ = (
        ("modes", ctypes.c_uint),
        ("offset", _long),
        ("freq", _long),
        ("maxerror", _long),
        ("esterror", _long),
        ("status", _int),
        ("rest", ctypes.c_char * 256),
    )


def kernel_clock() -> ClockFacts:
    """Synchronisation from the kernel's own clock model (adjtimex), which any user may read, in containers too."""
    state = _Timex(modes=0)  # reads, changes nothing
    answer = ctypes.CDLL(None, use_errno=True).adjtimex(ctypes.byref(state))
    if answer < 0:
        return ClockFacts(unknown_because=f"adjtimex is not allowed here (errno {ctypes.get_errno()})")
    return judge_kernel_clock(answer, state.esterror)


def judge_kernel_clock(answer: int, estimated_error_us: int) -> ClockFacts:
    """Judge the clock by what adjtimex returns and ``esterror``."""
    if answer == TIME_ERROR:
        return ClockFacts("no service, by the kernel's account", False)
    known = 0 < estimated_error_us < KNOWN_US
    return ClockFacts(KEEPER, True, 1e-6 * estimated_error_us if known else None)


RMEM_MAX = Path("/proc/sys/net/core/rmem_max")
GOVERNORS = "/sys/devices/system/cpu"
ANY_PORT = 9  # discard; connecting a UDP socket sends nothing
ANSWER_S = 3.0
ROS_VARIABLES = ("ROS_DOMAIN_ID", "ROS_AUTOMATIC_DISCOVERY_RANGE", "ROS_LOCALHOST_ONLY", "RMW_IMPLEMENTATION")


def collect_host() -> HostFacts:
    """Facts about this machine."""
    governors = sorted(Path(GOVERNORS).glob("cpu[0-9]*/cpufreq/scaling_governor"))
    return HostFacts(
        rmem_max=read_number(RMEM_MAX),
        cores=len(os.sched_getaffinity(0)),
        load=os.getloadavg()[0],
        available_bytes=psutil.virtual_memory().available,
        governors=tuple(path.read_text().strip() for path in governors),
        clock=collect_clock(),
        environment={name: os.environ[name] for name in ROS_VARIABLES if name in os.environ},
        aravis_error=_aravis_error(),
    )


def read_number(path: Path) -> int | None:
    """Return a number that the kernel publishes in a file; None where it does not, as in some containers."""
    try:
        return int(path.read_text())
    except OSError:
        return None


def collect_interface(address: str) -> InterfaceFacts | None:
    """Return the interface that packets to ``address`` leave through; None when there is no way."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as way:
        try:
            way.connect((address, ANY_PORT))
        except OSError:
            return None
        ours = way.getsockname()[0]
    loopback = ours.startswith("127.")
    for name, addresses in psutil.net_if_addrs().items():
        for entry in addresses:
            if entry.family == socket.AF_INET and (
                entry.address == ours or (loopback and entry.address.startswith("127."))
            ):
                state = psutil.net_if_stats()[name]
                return InterfaceFacts(
                    name,
                    ours,
                    entry.netmask or "255.255.255.255",
                    state.mtu,
                    state.speed,
                    state.isup,
                    loopback=loopback,
                )
    return None


def collect_background(settings: CameraClientSettings, shape: tuple[int, int]) -> BackgroundFacts | None:
    """Return the background that the client would take for images of ``shape`` (H, W); None when there is none."""
    path = settings.background
    if not path and settings.background_file and Path(settings.background_file).exists():
        path = settings.background_file
    if not path:
        return None
    try:
        model = _read(path, shape, settings)
        age_s = time.time() - Path(path).stat().st_mtime
    except InputError as error:
        return BackgroundFacts(path, str(error))
    except OSError as error:
        return BackgroundFacts(path, f"{path}: {error.strerror}")
    about = model.provenance
    summary = f"{about.frames} frames of {about.source}, noise {about.mean_noise:.2f} grey levels"
    return BackgroundFacts(path, "", age_s, model.shape, summary, about.exposure_us)


def collect_clock() -> ClockFacts:
    """Synchronisation of the clock: from chrony, systemd, linuxptp's processes or, if there is none, the kernel."""
    if shutil.which("chronyc"):
        text = _output(["chronyc", "-c", "tracking"])
        fields = text.strip().split(",")
        if len(fields) > 4:
            return chrony_clock(fields)
    if shutil.which("timedatectl"):
        text = _output(["timedatectl", "show", "--property=NTPSynchronized", "--value"])
        if text.strip() in ("yes", "no"):
            return ClockFacts("systemd-timesyncd or another service", text.strip() == "yes")
    ptp = [process.name() for process in psutil.process_iter(["name"]) if process.name() in ("ptp4l", "phc2sys")]
    if ptp:
        return ClockFacts(" and ".join(sorted(set(ptp))), True)
    return kernel_clock()


def chrony_clock(fields: list[str]) -> ClockFacts:
    """Read the fields of ``chronyc -c tracking``: 0 reference, 2 stratum, 4 the clock's offset in seconds."""
    return ClockFacts("chrony", fields[2] not in ("0", "16"), float(fields[4]))


def _read(path: str, shape: tuple[int, int], settings: CameraClientSettings) -> BackgroundModel:
    if path.endswith(".npz"):
        return load_background(path)
    reader = open_footage(path)
    try:
        seen = reader.probe()
    finally:
        reader.close()
    if seen[:2] != shape:
        raise InputError(f"is {seen[1]} x {seen[0]}, the camera {shape[1]} x {shape[0]} pixels", where=path)
    return read_background(path, tuple(np.asarray(seen).tolist()), settings.background_model)


def _aravis_error() -> str:
    try:
        import_aravis()
    except InputError as error:
        return error.what
    return ""


def _output(command: list[str]) -> str:
    try:
        return subprocess.run(command, capture_output=True, text=True, timeout=ANSWER_S, check=False).stdout
    except (OSError, subprocess.TimeoutExpired):
        return ""
