"""Examines this machine: software, graphics, compiled kernels, disk, shared memory, limits, network."""

from __future__ import annotations

import hashlib
import os
import platform
import resource
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

import psutil

import hull_server

from ...graph.processes import owned_shared_memory
from ..collect import collect_host
from ..facts import DiskFacts, KernelFacts, LimitFacts, MachineFacts, SharedMemoryFacts, SoftwareFacts
from ..findings import Finding, on
from .ask_gl import collect_graphics
from .checks import check_machine
from .network import collect_network

SHARED_MEMORY = Path("/dev/shm")
FINGERPRINT = ".sagoma-kernels"  # of the sources that the set-up compiled, in the virtual environment
WRITE_BYTES, CHUNK_BYTES = 32 << 20, 4 << 20


def collect_machine(bags: Path) -> MachineFacts:
    """Facts about this machine and the folder for bags."""
    return MachineFacts(
        host=collect_host(),
        software=collect_software(),
        graphics=collect_graphics(),
        kernels=collect_kernels(),
        disk=collect_disk(bags),
        shared_memory=collect_shared_memory(),
        limits=collect_limits(),
        network=collect_network(),
        total_bytes=psutil.virtual_memory().total,
    )


def collect_software() -> SoftwareFacts:
    """Versions of distribution, Python and ROS."""
    try:
        release = platform.freedesktop_os_release()
    except OSError:
        release = {}
    rmw, error = _middleware()
    return SoftwareFacts(
        release.get("ID", platform.system().lower()),
        release.get("VERSION_ID", platform.release()),
        sys.version_info[:2],
        os.environ.get("ROS_DISTRO", ""),
        rmw,
        error,
    )


def collect_kernels() -> KernelFacts:
    """numba's cache beside the sources (or where NUMBA_CACHE_DIR says)."""
    elsewhere = os.environ.get("NUMBA_CACHE_DIR")
    packages = Path(hull_server.__file__).parents[2]
    folder = Path(elsewhere) if elsewhere else packages
    indices = list(folder.rglob("*.nbi"))
    home = indices[0].parent if indices else folder
    return KernelFacts(str(folder), len(indices), os.access(home, os.W_OK), _fresh(packages))


def collect_disk(folder: Path) -> DiskFacts:
    """Free space and speed of the disk below ``folder``, or below its nearest parent that exists."""
    place = folder.absolute()
    while not place.exists():
        place = place.parent
    if not place.is_dir():
        return DiskFacts(str(folder), f"{place} is not a folder")
    if not os.access(place, os.W_OK):
        return DiskFacts(str(folder), f"{place} may not be written")
    free = psutil.disk_usage(str(place)).free
    return DiskFacts(str(folder), "", free, _write_speed(place) if free > 4 * WRITE_BYTES else None)


def collect_shared_memory() -> SharedMemoryFacts:
    """Size of /dev/shm, and the Fast DDS segments there that no living process holds."""
    usage = psutil.disk_usage(str(SHARED_MEMORY))
    segments = {path.name.removesuffix("_el") for path in SHARED_MEMORY.glob("fastrtps_*_el")}
    living = owned_shared_memory(process.pid for process in psutil.process_iter()) if segments else set()
    return SharedMemoryFacts(usage.total, usage.free, len(segments - living))


def collect_limits() -> LimitFacts:
    """Return the soft limits of this process, which those it starts inherit."""
    soft = [
        resource.getrlimit(kind)[0]
        for kind in (resource.RLIMIT_NOFILE, resource.RLIMIT_RTPRIO, resource.RLIMIT_MEMLOCK)
    ]
    return LimitFacts(*soft)


def _middleware() -> tuple[str, str]:
    try:
        from rclpy.utilities import get_rmw_implementation_identifier

        return get_rmw_implementation_identifier(), ""
    except Exception as error:  # whatever the loader of the middleware's library throws
        return "", f"{type(error).__name__}: {error}"


def _fresh(packages: Path) -> bool | None:
    """Return whether the sources are those that the set-up compiled; None where it does not say."""
    recorded = Path(sys.prefix) / FINGERPRINT
    if packages.name != "src" or not recorded.is_file():
        return None
    return recorded.read_text().split()[:1] == [fingerprint_of(packages)]


def fingerprint_of(packages: Path) -> str:
    """SHA-256 of all sources under ``packages`` in the order of their paths' bytes, as scripts/setup.sh computes it."""
    paths = [path for path in packages.rglob("*.py") if "test" not in path.relative_to(packages).parts[:-1]]
    ordered = sorted(paths, key=lambda path: os.fsencode(path.as_posix()))
    return hashlib.sha256(b"".join(path.read_bytes() for path in ordered)).hexdigest()


def _write_speed(folder: Path) -> float | None:
    chunk = os.urandom(CHUNK_BYTES)
    try:
        with tempfile.TemporaryFile(dir=folder) as file:
            began = time.perf_counter()
            for _ in range(WRITE_BYTES // CHUNK_BYTES):
                file.write(chunk)
            file.flush()
            os.fsync(file.fileno())
            return WRITE_BYTES / (time.perf_counter() - began)
    except OSError:
        return None


SUBJECT = "this machine"


def examine_machine(bags: Path) -> Iterator[Finding]:
    """Examine this machine; ``bags`` is the folder for recordings."""
    yield from on(SUBJECT, check_machine(collect_machine(bags)))
