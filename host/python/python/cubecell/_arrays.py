"""Arrays for the native half and from it: bytes of little-endian doubles."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

Doubles = NDArray[np.float64]
LITTLE = np.dtype("<f8")


def to_bytes(values: ArrayLike) -> bytes:
    return np.ascontiguousarray(values, dtype=LITTLE).tobytes()


def to_array(data: bytearray, *shape: int) -> Doubles:
    """The same memory as an array: the native half gives each one away."""
    return np.frombuffer(data, dtype=LITTLE).reshape(shape).astype(np.float64, copy=False)


def to_point(values: ArrayLike, what: str) -> tuple[float, float, float]:
    array = np.asarray(values, dtype=np.float64)
    if array.shape != (3,):
        raise ValueError(f"{what} is three numbers, got an array of shape {array.shape}")
    return float(array[0]), float(array[1]), float(array[2])


def to_times(values: ArrayLike) -> Doubles:
    times = np.atleast_1d(np.asarray(values, dtype=np.float64))
    if times.ndim != 1 or not np.all(np.isfinite(times)):
        raise ValueError("times are a finite number or a row of them, in s")
    return times
