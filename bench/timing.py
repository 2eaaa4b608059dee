"""Owns how time is taken: CPU milliseconds of the whole process, threads included, as medians with their spread."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence

import numpy as np

from bench.result import Measured


def cpu_ms(action: Callable[[], object]) -> float:
    """What ``action`` costs all threads of this process."""
    begun_s = time.process_time()
    action()
    return (time.process_time() - begun_s) * 1e3


def median_of(
    name: str,
    values: Sequence[float],
    unit: str,
    key: str | None = None,
    at_most: float | None = None,
    at_least: float | None = None,
) -> Measured:
    """The median, with the first and the ninth tenth beside it. Raises ValueError without values."""
    if not len(values):
        raise ValueError(f"{name} was never measured; measure it at least once")
    low, middle, high = (float(value) for value in np.quantile(values, [0.1, 0.5, 0.9]))
    return Measured(name, middle, unit, at_most, at_least, key, spread=(low, high))
