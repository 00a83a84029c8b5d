"""Power allocation that maximises the sum rate above every device's floor, for a given position."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from jpap_ros.planning.link_budget import Floats


def water_fill(noise: ArrayLike, floor: ArrayLike, total: ArrayLike) -> Floats:
    """Maximise sum log2(1 + P_k / noise_k) with P_k >= floor_k and sum P_k = total.

    The optimum is P_k = max(floor_k, level - noise_k), with the water level that spends the total: the objective
    is concave, and the Karush-Kuhn-Tucker conditions say that every device above its floor has the same
    1 / (noise_k + P_k), and none at its floor a larger one.

    Parameters
    ----------
    noise : (..., m) array_like
        Noise over channel gain of each device [W]; infinite for a place to be left empty.
    floor : (..., m) array_like
        Least power of each device [W]; 0 for a place to be left empty.
    total : (...) array_like
        Power to spend [W].

    Returns
    -------
    (..., m) ndarray
        Powers [W]. Where the floors alone exceed the total they are scaled down to it, so that the sum holds; it
        is the caller's to see that they exceed it by no more than rounding.

    Notes
    -----
    sum_k max(floor_k, level - noise_k) rises with the level, piecewise linear, with a kink where the water reaches
    noise_k + floor_k. The kinks are sorted and the level is found on its piece in closed form.
    """
    noise, floor = np.broadcast_arrays(np.asarray(noise, float), np.asarray(floor, float))
    total = np.asarray(total, float)
    kink = noise + floor
    order = np.argsort(kink, axis=-1)
    kinks = np.take_along_axis(kink, order, axis=-1)
    noises = np.where(np.isinf(kinks), 0.0, np.take_along_axis(noise, order, axis=-1))
    floors = np.take_along_axis(floor, order, axis=-1)
    wet = np.arange(1, kinks.shape[-1] + 1)
    dry_floor = floors.sum(axis=-1, keepdims=True) - np.cumsum(floors, axis=-1)
    # The level if exactly the first `wet` devices stand above their floor.
    level = (total[..., None] - dry_floor + np.cumsum(noises, axis=-1)) / wet
    count = np.maximum((level >= kinks).sum(axis=-1, keepdims=True), 1)
    level = np.take_along_axis(level, count - 1, axis=-1)
    power = np.maximum(floor, np.where(np.isinf(noise), 0.0, level - noise))
    spent = power.sum(axis=-1, keepdims=True)
    scaled: Floats = power * (total[..., None] / spent)
    return scaled
