"""The sequence has the paper's length, one change per Gray step, and a phase that counts pixels."""

from __future__ import annotations

import numpy as np
import pytest

from appliance.patterns.gray import inverse_gray
from appliance.patterns.sequence import Direction, Kind, build_sequence


@pytest.mark.parametrize(("period_px", "frames", "bits"), [(16, 24, 7), (32, 22, 6), (64, 20, 5)])
def test_lengths_are_those_of_the_paper(period_px: int, frames: int, bits: int) -> None:
    sequence = build_sequence(period_px)
    assert len(sequence) == frames
    for direction in Direction:
        assert len(sequence.axis(direction).gray) == bits


@pytest.mark.parametrize("period_px", [16, 32, 64, 18, 21])
@pytest.mark.parametrize("direction", list(Direction))
def test_neighbouring_half_periods_differ_in_one_image(period_px: int, direction: Direction) -> None:
    sequence = build_sequence(period_px)
    axis = sequence.axis(direction)
    lit = np.array([sequence.patterns[i].codes() > 128 for i in axis.gray])
    changes = (lit[:, 1:] != lit[:, :-1]).sum(axis=0)
    half_period = 2 * np.arange(axis.size_px) // period_px
    assert (changes == np.diff(half_period)).all()


@pytest.mark.parametrize("period_px", [16, 32, 64, 21])
@pytest.mark.parametrize("direction", list(Direction))
def test_codes_and_phase_together_give_back_every_pixel(period_px: int, direction: Direction) -> None:
    sequence = build_sequence(period_px)
    axis = sequence.axis(direction)
    bits = [sequence.patterns[i].codes() > 128 for i in axis.gray]
    code = np.zeros(axis.size_px, np.int64)
    for bit in bits:
        code = 2 * code + bit
    half = inverse_gray(len(bits))[code]
    i0, i1, i2, i3 = (sequence.patterns[i].codes().astype(float) for i in axis.sine)
    turn = np.arctan2(i3 - i1, i0 - i2) / (2 * np.pi) % 1.0
    order = np.rint((half + 0.5) / 2 - turn)
    p = period_px * (order + turn) - 0.5
    np.testing.assert_allclose(p, np.arange(axis.size_px), atol=0.005 * period_px)


def test_every_frame_is_named_once_and_references_come_first() -> None:
    sequence = build_sequence(16)
    names = [pattern.name for pattern in sequence.patterns]
    assert len(set(names)) == len(names)
    assert (sequence.bright, sequence.dark) == (0, 1)
    assert sequence.patterns[0].kind is Kind.BRIGHT


def test_a_period_out_of_range_names_itself_and_the_range() -> None:
    with pytest.raises(ValueError, match=r"fringe period 3 px; allowed are 4\.\.768 px"):
        build_sequence(3)
