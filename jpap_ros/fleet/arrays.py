"""Checked conversion of what callers pass to the fleet's functions."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

Floats = NDArray[np.float64]


def points(name: str, value: ArrayLike, dimensions: int) -> Floats:
    """Return an (n, dimensions) array of finite numbers; ValueError that names argument, index and value."""
    array = _numbers(name, value)
    if array.size == 0:
        array = array.reshape(0, dimensions)
    if array.ndim != 2 or array.shape[1] != dimensions:
        raise ValueError(f"{name} must have shape (n, {dimensions}), got {array.shape}")
    return _checked(name, array, np.isfinite(array), "finite")


def point(name: str, value: ArrayLike, dimensions: int) -> Floats:
    """Return a (dimensions,) array of finite numbers; ValueError that names argument, index and value."""
    array = _numbers(name, value)
    if array.shape != (dimensions,):
        raise ValueError(f"{name} must have shape ({dimensions},), got {array.shape}")
    return _checked(name, array, np.isfinite(array), "finite")


def vector(name: str, value: ArrayLike, count: int) -> Floats:
    """Return a (count,) array of numbers >= 0, infinity allowed; ValueError that names argument, index and value."""
    array = _numbers(name, value)
    if array.shape != (count,):
        raise ValueError(f"{name} must have shape ({count},), got {array.shape}")
    return _checked(name, array, array >= 0, ">= 0")


def _numbers(name: str, value: ArrayLike) -> Floats:
    try:
        return np.array(value, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise ValueError(f"{name} must be an array of numbers: {error}") from None


def _checked(name: str, array: Floats, good: NDArray[np.bool_], what: str) -> Floats:
    if not good.all():
        index = tuple(int(i) for i in np.argwhere(~good)[0])
        raise ValueError(f"{name}[{', '.join(map(str, index))}] must be {what}, got {array[index]}")
    return array
