"""The Gray code of a pixel: the threshold, the number that the bits name, and what is left alone."""

from __future__ import annotations

import warnings

import numpy as np

from appliance.reconstruct.decode.gray_code import add_bit, number_half_periods, threshold


def test_the_threshold_is_the_middle_rounded_up_and_too_little_contrast_is_shadow() -> None:
    bright = np.array([255, 101, 100, 20, 19, 10, 9, 0, 255], np.uint8)
    dark = np.array([0, 100, 100, 10, 10, 20, 10, 0, 254], np.uint8)
    middle, mask = np.zeros(9, np.uint8), np.full(9, 9, np.uint8)
    with warnings.catch_warnings():
        warnings.simplefilter("error")  # no grey value may leave its range on the way
        threshold.py_func(bright, dark, np.uint8(10), middle, mask)
    assert middle.tolist() == [128, 101, 100, 15, 15, 15, 10, 0, 255]
    assert mask.tolist() == [0, 1, 1, 0, 1, 1, 1, 1, 1], (
        "ten grey values are enough, nine are not, and none is negative"
    )


def images(numbers: np.ndarray, bits: int, middle: int, low: int, high: int) -> list[np.ndarray]:
    """The images (n,) uint8 of the reflected binary code, most significant bit first."""
    gray = numbers ^ (numbers >> 1)
    return [np.where(gray >> (bits - 1 - k) & 1, high, low).astype(np.uint8) for k in range(bits)]


def test_seven_images_name_the_half_period_and_a_grey_value_at_the_threshold_is_light() -> None:
    numbers = np.arange(128)
    lit = np.array([[0, 128], [3, 100]], np.int32)
    for low, high in ((20, 200), (99, 100)):
        stack = [np.tile(one, (2, 1)) for one in images(numbers, 7, 100, low, high)]
        half_period = np.full((2, 128), 255, np.uint8)
        a, b, c, d, e, f, g = stack
        number_half_periods(a, b, c, d, e, f, g, np.full((2, 128), 100, np.uint8), lit, half_period)
        assert half_period[0].tolist() == numbers.tolist()
        assert half_period[1, 3:100].tolist() == numbers[3:100].tolist()
        assert set(half_period[1, :3]) | set(half_period[1, 100:]) == {255}, "what is not lit is left alone"


def test_one_image_more_is_one_bit_more() -> None:
    numbers = np.arange(256)
    for low, high in ((20, 200), (99, 100)):
        *_, last = images(numbers, 8, 100, low, high)
        half_period = (numbers >> 1).astype(np.uint8)
        add_bit.py_func(last, np.full(256, 100, np.uint8), half_period)
        assert half_period.tolist() == numbers.tolist()
