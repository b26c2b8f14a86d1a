"""A process's environment: memory bounds of the middleware, its discovery peers, and files of packages.

Environment variables are read when a process first touches ROS, and its children inherit them. Without the bounds, one
message of 16 MiB on each topic costs a process hundreds of megabytes until it ends (docs/how-to/faults.md): ROS has
Fast DDS keep for each topic as many buffers as were ever in use at once, each as large as the largest message that it
ever held, and glibc learns from large blocks that are freed to keep such blocks.
"""

from __future__ import annotations

import ctypes
import importlib.util
import ipaddress
import os
from collections.abc import MutableMapping
from pathlib import Path
from typing import Any

from capture_rig.errors import InputError

PROFILE = Path(__file__).with_name("fastdds_memory.xml")
PROFILE_VARIABLES = ("FASTRTPS_DEFAULT_PROFILES_FILE", "FASTDDS_DEFAULT_PROFILES_FILE")
QOS_FROM_PROFILE = "RMW_FASTRTPS_USE_QOS_FROM_XML"
MALLOC_VARIABLES = ("MALLOC_MMAP_THRESHOLD_", "MALLOC_TRIM_THRESHOLD_")  # glibc's own: a user's word goes before ours
_M_TRIM_THRESHOLD, _M_MMAP_THRESHOLD = -1, -3  # of malloc.h
_LARGE_BYTES = 1 << 20  # no message, mask or product of a frame set is as large; images are, and hostile messages
_SPARE_BYTES = 16 << 20  # a server's heap varies by this within a frame set: trimming less would cost time


def bound_memory(environment: MutableMapping[str, str] = os.environ) -> None:
    """Bound this process's memory, and let its nodes be found at once; to be called before it touches ROS.

    A profile of Fast DDS or a malloc setting that the environment names is kept.
    """
    if not any(environment.get(name) for name in (*PROFILE_VARIABLES, QOS_FROM_PROFILE)):
        environment[PROFILE_VARIABLES[0]] = str(PROFILE)
        environment[QOS_FROM_PROFILE] = "1"
    if not any(environment.get(name) for name in MALLOC_VARIABLES):
        _call("mallopt", _M_MMAP_THRESHOLD, _LARGE_BYTES)
        _call("mallopt", _M_TRIM_THRESHOLD, _SPARE_BYTES)


def release_free_memory() -> None:
    """Return freed memory of the C library's heap to the system.

    Building maps and models takes tens of megabytes for a moment, and glibc keeps them as its own otherwise.
    """
    _call("malloc_trim", 0)


def _call(name: str, *arguments: int) -> None:
    function = getattr(ctypes.CDLL(None), name, None)
    if function is not None:  # glibc; elsewhere nothing happens
        function(*arguments)


# a graph on several machines ------------------------------------------------------------------------------------------


PROFILE_VARIABLE = PROFILE_VARIABLES[0]
PEERS_VARIABLE, RANGE_VARIABLE = "ROS_STATIC_PEERS", "ROS_AUTOMATIC_DISCOVERY_RANGE"
ALONE = "LOCALHOST"  # with peers: unicast to them alone


def use_peers(text: str, environment: MutableMapping[str, str] = os.environ) -> None:
    """Let this process and its children find these machines by unicast, ``ADDRESS,ADDRESS,...``, and no others.

    The profile of :func:`profile_file` is used, unless the environment names another one. Every machine names at least
    the server; the server, all of them. Raises InputError for an invalid address.
    """
    addresses = [_address(word.strip()) for word in text.split(",")]
    environment[PEERS_VARIABLE] = ";".join(addresses)
    environment[RANGE_VARIABLE] = ALONE
    if not environment.get(PROFILE_VARIABLE):
        environment[PROFILE_VARIABLE] = str(profile_file())
        environment[QOS_FROM_PROFILE] = "1"  # its memory policies are taken with this alone


def profile_file() -> Path:
    """Return our Fast DDS profile, in the share folder of an installed sagoma_bringup, or in the tree."""
    return package_path("package://sagoma_bringup/config/dds/fastdds.xml").resolve()


def _address(word: str) -> str:
    try:
        return str(ipaddress.IPv4Address(word))
    except ValueError:
        remedy = "Write --peers ADDRESS,ADDRESS with the machines' IPv4 addresses, as 192.168.1.7."
        raise InputError(f"'{word}' is no IPv4 address", where="--peers", remedy=remedy) from None


# files in the share folder of a package -------------------------------------------------------------------------------

SCHEME = "package://"


def resolve_packages(value: Any) -> Any:
    """Return texts that begin with ``package://`` as paths (also those of a list), everything else as it is."""
    if isinstance(value, list):
        return [resolve_packages(one) for one in value]
    return str(package_path(value)) if isinstance(value, str) and value.startswith(SCHEME) else value


def package_path(uri: str) -> Path:
    """Return the path of ``package://PACKAGE/FILE``: in the share folder of an installed package, else in its sources.

    Raises InputError for a package that is not there.
    """
    from ament_index_python.packages import PackageNotFoundError, get_package_share_directory  # loads ROS

    package, _, file = uri.removeprefix(SCHEME).partition("/")
    try:
        return Path(get_package_share_directory(package)) / file
    except (PackageNotFoundError, OSError, ValueError):  # not there, nothing sourced at all, no name of a package
        found = importlib.util.find_spec(package) if package.isidentifier() else None
    if found is None or found.origin is None:
        remedy = "Source the workspace that has it, or give the file's path."
        raise InputError(f"there is no package '{package}'", where=uri, remedy=remedy)
    return Path(found.origin).parents[1] / file
