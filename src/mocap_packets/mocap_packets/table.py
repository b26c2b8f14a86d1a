"""Tables of float64 fields, one row a point, ray or person: the form in which packets go into messages."""

from __future__ import annotations

import numpy as np


def layout(*names: str) -> np.dtype:
    """Structured dtype of float64 fields in this order."""
    return np.dtype([(name, np.float64) for name in names])


def fill(dtype: np.dtype, *columns: np.ndarray) -> np.ndarray:
    """Structured array (n,) of a :func:`layout` from columns (n,) or (n, k) in the order of its fields."""
    flat = np.column_stack(columns).astype(np.float64)
    return np.ascontiguousarray(flat).view(dtype).reshape(-1)


def column(table: np.ndarray, name: str) -> np.ndarray:
    """Return one field (n,) as float64."""
    return table[name].astype(np.float64)


def columns(table: np.ndarray, *names: str) -> np.ndarray:
    """Several fields as (n, k) float64."""
    return np.stack([table[name] for name in names], axis=1).astype(np.float64)
