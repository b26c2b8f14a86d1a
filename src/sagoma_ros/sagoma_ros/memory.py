"""Bounds of what a node's process keeps: large blocks go back to the system, the middleware's queues shrink again.

Without this, one message of 16 MiB on each topic costs a process hundreds of megabytes until it ends
(docs/faults.md): ROS has Fast DDS keep for each topic as many buffers as were ever in use at once, each as large as
the largest message that it ever held, and glibc learns from large blocks that are freed to keep such blocks.
"""

from __future__ import annotations

import ctypes
import os
from collections.abc import MutableMapping
from pathlib import Path

PROFILE = Path(__file__).with_name("fastdds_memory.xml")
PROFILE_VARIABLES = ("FASTRTPS_DEFAULT_PROFILES_FILE", "FASTDDS_DEFAULT_PROFILES_FILE")
QOS_FROM_PROFILE = "RMW_FASTRTPS_USE_QOS_FROM_XML"
MALLOC_VARIABLES = ("MALLOC_MMAP_THRESHOLD_", "MALLOC_TRIM_THRESHOLD_")  # glibc's own: a user's word goes before ours
_M_TRIM_THRESHOLD, _M_MMAP_THRESHOLD = -1, -3  # of malloc.h
_LARGE_BYTES = 1 << 20  # no message, mask or product of a frame set is as large; images are, and hostile messages
_SPARE_BYTES = 16 << 20  # a server's heap rises and falls by so much within a frame set: to trim that would cost time


def bound_memory(environment: MutableMapping[str, str] = os.environ) -> None:
    """Bound what this process keeps; to be called before it touches ROS, and before it has threads.

    A profile of Fast DDS or a malloc setting that the environment names is left as it is.
    """
    if not any(environment.get(name) for name in (*PROFILE_VARIABLES, QOS_FROM_PROFILE)):
        environment[PROFILE_VARIABLES[0]] = str(PROFILE)
        environment[QOS_FROM_PROFILE] = "1"
    if not any(environment.get(name) for name in MALLOC_VARIABLES):
        _call("mallopt", _M_MMAP_THRESHOLD, _LARGE_BYTES)
        _call("mallopt", _M_TRIM_THRESHOLD, _SPARE_BYTES)


def release_free_memory() -> None:
    """Ask the C library for what freed arrays left in its heap.

    Building maps and models takes tens of megabytes for a moment, and glibc keeps them as its own otherwise.
    """
    _call("malloc_trim", 0)


def _call(name: str, *arguments: int) -> None:
    function = getattr(ctypes.CDLL(None), name, None)
    if function is not None:  # glibc; elsewhere nothing happens
        function(*arguments)
