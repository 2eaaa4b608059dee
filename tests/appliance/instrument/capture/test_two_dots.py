"""Two pointers whose dots lie in nearly the same rows of both pictures: which spot is whose."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.appliance.instrument.ranging.test_spots_in_pictures import BEAMS, HEIGHT_DN, Bench, on

DRAWN = tuple(tuple(row) for row in np.diag([0.5, 0.5, 3e-5, 3e-5]).tolist())
"""Covariance of a beam that nobody has measured."""


@pytest.fixture(scope="module")
def bench() -> Bench:
    return Bench(400)


@pytest.mark.parametrize(("pointer", "z_mm"), [(0, 380.0), (1, 490.0), (0, 640.0)])
def test_the_dot_of_one_pointer_is_not_told_as_the_other_pointers(bench: Bench, pointer: int, z_mm: float) -> None:
    found = bench.ranger().find(bench.pair((on(pointer, z_mm), HEIGHT_DN, HEIGHT_DN)))
    own, other = (found.left, found.right) if pointer == 0 else (found.right, found.left)
    assert own is not None
    assert own.position_mm == pytest.approx(tuple(on(pointer, z_mm)), abs=0.3)
    assert other is None


@pytest.mark.parametrize(("measured", "left_mm", "right_mm"), [(True, 440.0, 450.0), (False, 610.0, 620.0)])
def test_each_pointer_gets_its_own_of_two_dots(bench: Bench, measured: bool, left_mm: float, right_mm: float) -> None:
    left, right = (one if measured else replace(one, covariance=DRAWN) for one in BEAMS)
    ranger = bench.ranger(beams=(left, right), measured=measured)
    a, b = on(0, left_mm), on(1, right_mm)
    found = ranger.find(bench.pair((a, 180.0, 180.0), (b, HEIGHT_DN, HEIGHT_DN)))
    for dot, place in ((found.left, a), (found.right, b)):
        assert dot is not None
        assert dot.position_mm == pytest.approx(tuple(place), abs=0.5)
    told = ranger.range_of(found)
    assert told is not None
    assert told.distance_mm == pytest.approx(a[2] - a[0] * (b[2] - a[2]) / (b[0] - a[0]), abs=0.5)
    own_mm = 0.0 if measured else 0.015 * told.distance_mm
    assert own_mm < told.sigma_mm < own_mm + 1.0


def test_a_larger_picture_of_the_same_dot_tells_its_depth_no_better(bench: Bench) -> None:
    """Texture and grain move its centre by a part of the dot, not of a px."""
    small, large = (
        one.ranger().find(one.pair((on(0, 430.0), HEIGHT_DN, HEIGHT_DN))).left for one in (bench, Bench(1600))
    )
    assert small is not None
    assert large is not None
    assert large.sigma_mm == pytest.approx(small.sigma_mm, rel=0.1)


def test_what_was_measured_once_is_measured_again_with_what_was_learned(bench: Bench) -> None:
    """The beam is drawn 1 mm beside where it is; after some dots it is known to a quarter of that."""
    off = replace(BEAMS[1], line=(61.0, 11.0, -0.085, -0.01), covariance=DRAWN)
    ranger = bench.ranger(beams=(BEAMS[0], off))
    for z_mm in (440.0, 470.0, 500.0, 530.0, 560.0):
        measured = ranger.measure(bench.pair((on(1, z_mm), HEIGHT_DN, HEIGHT_DN)))
        assert measured is not None
        assert measured.distance_mm == pytest.approx(z_mm, abs=0.3)
    left, right = ranger.beams
    assert left == BEAMS[0], "nobody saw its dot"
    for z_mm in (440.0, 500.0, 560.0):
        assert np.linalg.norm(right.at(np.array(z_mm)) - on(1, z_mm)) < 0.35
    assert float(right.sd_mm(np.array(500.0))) < 0.5 < float(off.sd_mm(np.array(500.0)))
