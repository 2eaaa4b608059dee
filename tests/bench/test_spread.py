"""Measurements come back in the order they were asked for, and one that fails is not passed over."""

from __future__ import annotations

import math

import pytest

from bench.spread import spread


def test_results_come_in_the_order_of_the_items() -> None:
    assert list(spread(math.isqrt, [100, 9, 64, 1])) == [10, 3, 8, 1]


def test_an_error_in_one_ends_them_all() -> None:
    found = spread(math.isqrt, [4, -1, 9])
    assert next(found) == 2
    with pytest.raises(ValueError, match="nonnegative"):
        list(found)
