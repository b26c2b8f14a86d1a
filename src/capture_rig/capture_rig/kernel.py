"""Compiles functions that only compute on arrays (numba), cached and without the interpreter lock."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from numba import njit

OPTIONS: dict[str, Any] = {"cache": True, "nogil": True, "error_model": "numpy", "forceinline": True, "_nrt": False}


def kernel(function: Callable[..., Any]) -> Any:
    """Compile a function that only computes on the arrays that it is given: it may neither make arrays nor raise.

    Such functions need no reference counts, which would cost more here than all arithmetic (``_nrt``), and those that
    they call become part of them, so that passing a dozen arrays on costs nothing (``forceinline``). Slices are free
    too, and often better than an offset: their indices are known not to be negative, so that loops vectorise. Other
    Python threads run meanwhile (``nogil``).
    """
    return njit(**OPTIONS)(function)
