"""Kernels' views without reference counts, and asking for memory beforehand: values stay, counting goes."""

from __future__ import annotations

from typing import Any, NamedTuple

import numba
import numpy as np
from numpy.typing import NDArray

from appliance.reconstruct.borrowed import borrowed
from appliance.reconstruct.prefetch import prefetch


class Pair(NamedTuple):
    """Two maps and a number, as kernels are handed them."""

    first: NDArray[np.float32]
    second: NDArray[np.uint8]
    factor: np.float32


@numba.njit(error_model="numpy")
def _ends(values: NDArray[Any]) -> float:
    return float(values[0]) + 2.0 * float(values[-1])


@numba.njit(error_model="numpy")
def _counted(pair: Pair) -> float:
    total = 0.0
    for k in range(pair.first.size):
        total += float(pair.factor) * _ends(pair.first[k:]) + _ends(pair.second[: k + 1])
    return total


@numba.njit(error_model="numpy")
def _uncounted(pair: Pair) -> float:
    lent = borrowed(pair)
    total = 0.0
    for k in range(lent.first.size):
        total += float(lent.factor) * _ends(lent.first[k:]) + _ends(lent.second[: k + 1])
    return total


@numba.njit(error_model="numpy")
def _asks(values: NDArray[np.float32]) -> float:
    total = 0.0
    for k in range(values.size):
        prefetch(values, k + 100_000)
        total += values[k]
    return total


def _pair() -> Pair:
    return Pair(np.arange(1.0, 9.0, dtype=np.float32), np.arange(8, dtype=np.uint8), np.float32(3.0))


def _machine_code(kernel: Any) -> str:
    return "".join(kernel.inspect_asm().values())


def test_views_of_borrowed_arrays_have_the_same_values_and_count_no_references() -> None:
    # Σ 3 (k + 1 + 2 · 8) + (0 + 2 k) over k = 0 … 7.
    expected = sum(3.0 * (k + 17) + 2.0 * k for k in range(8))
    assert _counted(_pair()) == expected
    assert _uncounted(_pair()) == expected
    assert "NRT_incref" in _machine_code(_counted), "or the next line proves nothing"
    assert "NRT_incref" not in _machine_code(_uncounted)


def test_memory_is_asked_for_beyond_an_array_without_harm() -> None:
    assert _asks(np.ones(50, np.float32)) == 50.0
    assert "prefetch" in _machine_code(_asks) or "prfm" in _machine_code(_asks)
