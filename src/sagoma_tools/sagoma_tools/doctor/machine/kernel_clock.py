"""What the kernel itself knows of its clock (adjtimex, NTP's kernel model): readable by anybody, in containers too."""

from __future__ import annotations

import ctypes

from ..facts import ClockFacts

TIME_ERROR = 5  # adjtimex: the clock is not synchronised
KNOWN_US = 10_000_000  # an estimated error this large is the kernel's way to say that nobody told it
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
    """In step or not, and the estimated error, whoever keeps it."""
    state = _Timex(modes=0)  # reads, changes nothing
    answer = ctypes.CDLL(None, use_errno=True).adjtimex(ctypes.byref(state))
    if answer < 0:
        return ClockFacts(unknown_because=f"adjtimex is not allowed here (errno {ctypes.get_errno()})")
    return judge_kernel_clock(answer, state.esterror)


def judge_kernel_clock(answer: int, estimated_error_us: int) -> ClockFacts:
    """From what adjtimex returns and ``esterror``."""
    if answer == TIME_ERROR:
        return ClockFacts("nobody, says the kernel", False)
    known = 0 < estimated_error_us < KNOWN_US
    return ClockFacts(KEEPER, True, 1e-6 * estimated_error_us if known else None)
