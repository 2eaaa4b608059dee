"""In milk, pixels tell each other what their own Gray bits leave open, and never against a bit that is sure."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from appliance.measure.decode.pieces import decide_by_neighbours, decide_pieces, find_pieces

IMAGES, COARSE = 7, 4
OPEN = 2
COLUMNS = np.arange(60) * 0.15


def bits_of(number: NDArray[np.int64]) -> NDArray[np.uint8]:
    """Gray bits (images, …) of half periods, the most significant first."""
    gray = number ^ (number >> 1)
    return np.stack([(gray >> k) & 1 for k in reversed(range(IMAGES))]).astype(np.uint8)


def sheet(first: float, rows: int = 30) -> NDArray[np.float64]:
    """Coordinates (rows, 60), in periods, of a slanted plane."""
    return first + COLUMNS[None, :] + 0.004 * np.arange(rows)[:, None]


def numbers(c: NDArray[np.float64]) -> NDArray[np.int64]:
    return np.floor(2.0 * c).astype(np.int64)


def told(c: NDArray[np.float64], states: NDArray[np.uint8]) -> int:
    ahead, members, ends = find_pieces(np.asarray(c - np.floor(c + 0.5), np.float32))
    return decide_pieces(ahead, members, ends, np.zeros(ends.size, np.bool_), states, COARSE)


def test_bits_of_different_pixels_and_images_tell_a_piece_together() -> None:
    """No pixel is sure in all images; each coarse image is sure somewhere."""
    c = sheet(17.3)
    truth = bits_of(numbers(c))
    states = truth.copy()
    for k in range(COARSE):
        states[k] = OPEN
        states[k, :, 10 * k : 10 * k + 8] = truth[k, :, 10 * k : 10 * k + 8]
    assert told(c, states) == 1
    known = states <= 1
    assert np.mean(known) > 0.5
    np.testing.assert_array_equal(states[known], truth[known])
    states[:COARSE] = OPEN
    assert told(c, states) == 0
    assert np.all(states[:COARSE] == OPEN), "where no coarse bit is sure it stays open"


def test_pieces_at_a_step_of_the_surface_are_told_apart() -> None:
    """The step is no whole number of periods: phases do not go on across it."""
    c = np.concatenate([sheet(17.3), sheet(29.8)])
    truth = bits_of(numbers(c))
    states = truth.copy()
    states[:COARSE, :, 20:] = OPEN
    assert told(c, states) == 2
    known = states <= 1
    np.testing.assert_array_equal(states[known], truth[known])


def test_a_part_that_contradicts_its_piece_is_not_told_by_it() -> None:
    """A step of exactly one period: the phases go on, the fine bits do not."""
    c = np.concatenate([sheet(17.3, 40), sheet(18.46, 6)])
    truth = bits_of(numbers(c))
    states = truth.copy()
    states[:COARSE, :, 30:] = OPEN
    assert told(c, states) == 1
    assert np.mean(states[COARSE:, :40] <= 1) > 0.5
    assert np.all(states[COARSE:, 40:] == OPEN)


def fringes(c: NDArray[np.float64]) -> NDArray[np.uint8]:
    return np.rint([100.0 + 50.0 * np.cos(2.0 * np.pi * c + 0.5 * np.pi * k) for k in range(4)]).astype(np.uint8)


@pytest.mark.parametrize("column", [7, 26, 41])
def test_a_pixel_in_doubt_takes_the_period_in_which_its_phase_continues_its_neighbours(column: int) -> None:
    c = sheet(17.3)
    half = numbers(c).astype(np.uint8)
    true = int(half[12, column])
    gray = true ^ (true >> 1) ^ 0b0100000
    number = gray ^ (gray >> 1) ^ (gray >> 2) ^ (gray >> 3) ^ (gray >> 4) ^ (gray >> 5) ^ (gray >> 6)
    # Neighbours do not overrule a bit that is beyond doubt.
    for open_bit, asked in ((0b0100000, 1), (0b0001000, 0)):
        doubtful, soft = np.zeros_like(half), np.zeros_like(half)
        half[12, column], doubtful[12, column], soft[12, column] = number, 1, open_bit
        assert decide_by_neighbours(fringes(c), np.arange(4), soft, half, doubtful) == asked
        assert (half[12, column], doubtful[12, column]) == ((true, 0) if asked else (number, 1))


def test_neighbours_that_contradict_each_other_tell_nothing() -> None:
    """Beside a step of a whole period both surfaces continue the phase."""
    c = np.concatenate([sheet(17.3, 10), sheet(18.34, 10)])
    half = numbers(c).astype(np.uint8)
    doubtful, soft = np.zeros_like(half), np.zeros_like(half)
    doubtful[9:11, 20:30], soft[9:11, 20:30] = 1, 127
    half[9, 20:30] = 0
    decide_by_neighbours(fringes(c), np.arange(4), soft, half, doubtful)
    wrong = (doubtful[9:11, 20:30] == 0) & (half[9:11, 20:30] != numbers(c)[9:11, 20:30])
    assert not wrong.any()
