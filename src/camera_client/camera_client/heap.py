"""Gives memory that is free inside the process back to the system (glibc; elsewhere nothing happens)."""

from __future__ import annotations

import ctypes

_M_MMAP_THRESHOLD = -3  # of malloc.h
_LARGE_BYTES = 1 << 20


def return_large_blocks() -> None:
    """Let blocks of a megabyte and more, such as images, go back to the system as soon as they are freed.

    Otherwise glibc learns to keep them: images decoded on one thread and freed on another pile up in its heaps.
    """
    _call("mallopt", _M_MMAP_THRESHOLD, _LARGE_BYTES)


def release_free_memory() -> None:
    """Ask the C library for what freed arrays left in its heap.

    Building maps and models takes tens of megabytes for a moment, and glibc keeps them as its own otherwise.
    """
    _call("malloc_trim", 0)


def _call(name: str, *arguments: int) -> None:
    function = getattr(ctypes.CDLL(None), name, None)
    if function is not None:
        function(*arguments)
