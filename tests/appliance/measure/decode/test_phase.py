"""Why a pixel has no coordinate: each limit from both sides, and which reason is told first."""

from __future__ import annotations

import numpy as np
import pytest

from appliance.measure.decode.decoder import CameraDecoder, Mask
from appliance.measure.decode.gray_code import threshold
from appliance.measure.decode.phase import AxisDecoding, close_row
from appliance.measure.decode.scratch import COORDINATE, DECODING_SIZE
from appliance.measure.light.patterns import build_sequence

f = np.float32
PERIOD_PX, SIZE_PX = 16.0, 64.0
AXIS = AxisDecoding(f(PERIOD_PX), f(SIZE_PX), f(20.0), f(0.375), False)


class Row:
    """Sine images of given coordinates, the half periods that belong to them, and what became of each pixel."""

    def __init__(self, p_px: list[float], amplitude: float = 80.0) -> None:
        p = np.array(p_px) + 0.5
        angle = 2 * np.pi * p / PERIOD_PX
        self.images = [np.rint(110.0 + amplitude * np.cos(angle + k * np.pi / 2)).astype(np.uint8) for k in range(4)]
        self.half_period = np.floor(p / (PERIOD_PX / 2)).astype(np.int64).astype(np.uint8)
        self.mask, self.half_dn = np.zeros((2, len(p_px)), np.uint8)
        self.s = np.full(DECODING_SIZE, np.nan, np.float32)

    def close(self, axis: AxisDecoding = AXIS) -> bool:
        i0, i1, i2, i3 = self.images
        return bool(close_row(i0, i1, i2, i3, self.half_period, axis, self.s, self.half_dn, self.mask))

    @property
    def found_px(self) -> np.ndarray:
        return self.s[COORDINATE : COORDINATE + len(self.mask)].astype(float)


@pytest.mark.parametrize("wrong", [1, -1])
def test_a_gray_code_off_by_less_than_its_margin_is_mended_by_the_phase(wrong: int) -> None:
    """3/8 of a period from the middle of its half period: an eighth of a period beyond its edge."""
    beyond = [31.5 + wrong * 1.9, 31.5 + wrong * 2.1]
    row = Row(beyond)
    row.half_period[:] = 3 if wrong == 1 else 4
    assert row.close() is True
    assert row.mask.tolist() == [Mask.VALID, Mask.CONTRADICTION]
    np.testing.assert_allclose(row.found_px, [beyond[0], np.nan], atol=0.03)


def test_what_would_lie_beside_the_pattern_is_no_coordinate() -> None:
    row = Row([-0.9, -1.1, 63.9, 64.1, 65.0])
    row.half_period[:] = [0, 0, 7, 7, 7]
    assert row.close() is True
    assert row.mask.tolist() == [Mask.VALID, Mask.CONTRADICTION, Mask.VALID, Mask.CONTRADICTION, Mask.CONTRADICTION]
    assert np.isnan(row.found_px).tolist() == [False, True, False, True, True]


def test_ten_grey_values_between_bright_and_dark_are_enough_and_the_threshold_is_the_middle_rounded_up() -> None:
    bright = np.array([255, 101, 20, 19, 10, 9, 0], np.uint8)
    dark = np.array([0, 100, 10, 10, 20, 10, 0], np.uint8)
    middle, mask = np.zeros((2, 7), np.uint8)
    threshold.py_func(bright, dark, np.uint8(10), middle, mask)
    assert middle.tolist() == [128, 101, 15, 15, 15, 10, 0]
    assert mask.tolist() == [0, 1, 0, 1, 1, 1, 1]


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
    row.half_dn[:], row.mask[1] = [90, 200, 130], Mask.WEAK
    assert row.close(AXIS._replace(second=True)) is False
    assert row.half_dn[[0, 2]].tolist() == pytest.approx([90, 120], abs=1)


def test_half_periods_beyond_those_that_a_byte_counts_are_refused() -> None:
    CameraDecoder(build_sequence(8, 1024), 4, 4)  # 256
    with pytest.raises(ValueError, match="9 Gray images"):
        CameraDecoder(build_sequence(8, 1028), 4, 4)
