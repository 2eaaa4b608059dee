"""The phase of a pixel against the arc tangent, and why a pixel has no coordinate."""

from __future__ import annotations

import math

import numpy as np
import pytest

from appliance.reconstruct.decode.decoder import Mask
from appliance.reconstruct.decode.phase import AxisDecoding, close_row, phase
from appliance.reconstruct.scratch import COORDINATE, DECODING_SIZE, MODULATION_HALF_DN

f = np.float32
PERIOD_PX, SIZE_PX = 16.0, 64.0
LEAST_HALF_DN = 20.0
AXIS = AxisDecoding(f(PERIOD_PX), f(SIZE_PX), f(LEAST_HALF_DN), f(0.375), False)


def test_the_phase_is_the_arc_tangent_in_every_direction() -> None:
    sine, cosine = (a.ravel() for a in np.meshgrid(np.arange(-254, 256, 27), np.arange(-254, 256, 27)))
    i0, i2 = np.where(cosine > 0, cosine, 0), np.where(cosine < 0, -cosine, 0)
    i3, i1 = np.where(sine > 0, sine, 0), np.where(sine < 0, -sine, 0)
    s = np.full(DECODING_SIZE, np.nan, np.float32)
    phase(i0.astype(np.uint8), i1.astype(np.uint8), i2.astype(np.uint8), i3.astype(np.uint8), s)
    n = len(sine)
    turns = np.arctan2(sine, cosine) / (2.0 * np.pi)
    away = s[COORDINATE : COORDINATE + n] - turns
    np.testing.assert_allclose(away - np.rint(away), 0.0, atol=2e-7)
    np.testing.assert_allclose(s[MODULATION_HALF_DN : MODULATION_HALF_DN + n], np.hypot(sine, cosine), rtol=1e-6)
    flat = np.full(1, 77, np.uint8)
    phase(flat, flat, flat, flat, s)
    assert (s[COORDINATE], s[MODULATION_HALF_DN]) == (0.0, 0.0)


class Row:
    """Sine images of given coordinates, the half periods that belong to them, and what became of each pixel."""

    def __init__(self, p_px: list[float], amplitude: float = 80.0, mean: float = 110.0) -> None:
        self.p_px = np.array(p_px)
        angle = 2 * np.pi * (self.p_px + 0.5) / PERIOD_PX
        self.images = [np.rint(mean + amplitude * np.cos(angle + k * np.pi / 2)).astype(np.uint8) for k in range(4)]
        self.half_period = np.floor((self.p_px + 0.5) / (PERIOD_PX / 2)).astype(np.int64).astype(np.uint8)
        self.mask = np.zeros(len(p_px), np.uint8)
        self.half_dn = np.zeros(len(p_px), np.uint8)
        self.s = np.full(DECODING_SIZE, np.nan, np.float32)

    def close(self, axis: AxisDecoding = AXIS) -> bool:
        i0, i1, i2, i3 = self.images
        return bool(close_row(i0, i1, i2, i3, self.half_period, axis, self.s, self.half_dn, self.mask))

    @property
    def found_px(self) -> np.ndarray:
        return self.s[COORDINATE : COORDINATE + len(self.p_px)].astype(float)


ANYWHERE = [0.0, 3.3, 7.4, 7.6, 8.0, 15.4, 15.6, 31.5, 40.2, 47.49, 47.51, 63.0]


def test_coordinates_come_back_wherever_they_lie_in_their_period() -> None:
    row = Row(ANYWHERE)
    assert row.close() is False
    np.testing.assert_allclose(row.found_px, ANYWHERE, atol=0.03)
    assert row.mask.tolist() == [Mask.VALID] * len(ANYWHERE)
    assert np.abs(row.half_dn.astype(int) - 160).max() <= 1


@pytest.mark.parametrize("wrong", [1, -1])
def test_a_gray_code_that_is_off_by_less_than_its_margin_is_mended_by_the_phase_and_one_further_off_is_not(
    wrong: int,
) -> None:
    """3/8 of a period from the middle of its half period: an eighth of a period beyond its edge."""
    edge_px = 32.0 - 0.5
    beyond = [edge_px + wrong * 1.9, edge_px + wrong * 2.1]
    row = Row(beyond)
    row.half_period[:] = 3 if wrong == 1 else 4
    assert row.close() is True
    assert row.mask.tolist() == [Mask.VALID, Mask.CONTRADICTION]
    assert row.found_px[0] == pytest.approx(beyond[0], abs=0.03)
    assert math.isnan(row.found_px[1])


def test_what_would_lie_beside_the_pattern_is_no_coordinate() -> None:
    row = Row([-0.9, -1.1, 63.9, 64.1, 65.0])
    row.half_period[:] = [0, 0, 7, 7, 7]
    assert row.close() is True
    assert row.mask.tolist() == [Mask.VALID, Mask.CONTRADICTION, Mask.VALID, Mask.CONTRADICTION, Mask.CONTRADICTION]
    assert np.isnan(row.found_px).tolist() == [False, True, False, True, True]


def test_a_saturated_image_a_weak_one_and_an_older_reason_are_told_in_that_order() -> None:
    row = Row([10.0] * 6)
    for k in range(4):
        row.images[k][0] = (254, 100, 100, 100)[k]
        row.images[k][1] = (255, 100, 100, 100)[k]
        row.images[k][2] = (100, 100, 100, 255)[k]
        row.images[k][3] = (100, 100, 119, 100)[k]
        row.images[k][4] = (100, 255, 100, 100)[k]
    row.half_period[0] = 0
    row.mask[4] = Mask.SHADOW
    row.close()
    assert row.mask[1:].tolist() == [Mask.SATURATED, Mask.SATURATED, Mask.WEAK, Mask.SHADOW, Mask.VALID]
    assert row.mask[0] != Mask.SATURATED
    assert np.isnan(row.found_px[1:]).tolist() == [True, True, True, True, False]


def test_as_much_modulation_as_asked_for_is_enough() -> None:
    row = Row([0.0, 0.0])
    row.half_period[:] = 0
    row.images = [np.array(one, np.uint8) for one in ([120, 119], [100, 100], [100, 100], [100, 100])]
    row.close()
    assert row.mask.tolist() == [Mask.VALID, Mask.WEAK]


def test_of_two_directions_the_smaller_modulation_counts_and_nothing_new_is_told_of_what_was_masked() -> None:
    row = Row([10.0, 20.0, 30.0], amplitude=60.0)
    row.half_dn[:] = [90, 200, 130]
    row.mask[1] = Mask.WEAK
    assert row.close(AXIS._replace(second=True)) is False
    assert row.half_dn[0] == 90
    assert row.half_dn[2] == pytest.approx(120, abs=1)
    first = Row([10.0], amplitude=60.0)
    first.half_dn[:] = 3
    first.close()
    assert first.half_dn[0] == pytest.approx(120, abs=1), "of the first direction there is none before"
