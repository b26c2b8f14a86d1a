"""Text files that are nothing but numbers in a known order."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from capture_rig.errors import InputError


def read_numbers(path: Path, count: int, meaning: str) -> np.ndarray:
    """The first ``count`` numbers (count,) of a file, separated by white space; InputError naming the file."""
    remedy = f"It reads {meaning}: copy it again from the data set."
    try:
        words = path.read_text(encoding="ascii").split()
        numbers = np.array([float(word) for word in words[:count]])
    except OSError as error:
        raise InputError(f"cannot be read ({error.strerror})", where=str(path), remedy=remedy) from None
    except ValueError as error:
        raise InputError(f"holds something else than numbers ({error})", where=str(path), remedy=remedy) from None
    if len(numbers) < count or not np.isfinite(numbers).all():
        found = f"{int(np.isfinite(numbers).sum())} finite numbers"
        raise InputError(f"holds {found} instead of {count}", where=str(path), remedy=remedy)
    return numbers
