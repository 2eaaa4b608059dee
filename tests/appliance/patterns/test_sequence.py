"""The sequence has the paper's length, one change per Gray step, and a phase that counts pixels."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from appliance.patterns.gray import inverse_gray
from appliance.patterns.sequence import PERIODS_PX, Direction, Kind, Pattern, PatternSequence, build_sequence


@pytest.mark.parametrize(
    ("period_px", "size_px", "frames"),
    [
        (16, (1024, 768), 24),
        (32, (1024, 768), 22),
        (64, (1024, 768), 20),
        (21, (1024, 768), 24),
        (16, (1280, 720), 25),
        (64, (1280, 720), 21),
    ],
)
def test_neighbouring_half_periods_differ_in_one_image_and_codes_and_phase_give_back_every_pixel(
    period_px: int, size_px: tuple[int, int], frames: int
) -> None:
    """Lengths are those of the paper; 1280 × 720, as DLP3010: 160 and 90 half periods of 16 px need 8 and 7 bits."""
    sequence = build_sequence(period_px, *size_px)
    assert len(sequence) == frames
    for axis in map(sequence.axis, Direction):
        lit = np.array([sequence.patterns[i].codes() > 128 for i in axis.gray]).astype(np.int64)
        half = 2 * np.arange(axis.size_px) // period_px
        assert (np.abs(np.diff(lit, axis=1)).sum(axis=0) == np.diff(half)).all()
        code = (lit << np.arange(len(lit))[::-1, None]).sum(axis=0)
        np.testing.assert_array_equal(inverse_gray(len(lit))[code], half)
        i0, i1, i2, i3 = (sequence.patterns[i].codes().astype(float) for i in axis.sine)
        turn = np.arctan2(i3 - i1, i0 - i2) / (2 * np.pi) % 1.0
        p = period_px * (np.rint((half + 0.5) / 2 - turn) + turn) - 0.5
        np.testing.assert_allclose(p, np.arange(axis.size_px), atol=0.005 * period_px)


def test_steps_of_each_period_that_is_offered_are_whole_pixels() -> None:
    """No pattern is a copy of two."""
    assert [period_px % 4 for period_px in PERIODS_PX] == [0, 0, 0]


def test_a_period_out_of_range_names_itself_and_the_range() -> None:
    with pytest.raises(ValueError, match=r"fringe period 3 px; allowed are 4\.\.768 px"):
        build_sequence(3)


P = list(build_sequence(64).patterns)
"""Bright, dark, 5 + 4 of X, 5 + 4 of Y."""


@pytest.mark.parametrize(
    ("patterns", "said"),
    [
        ([*P[:8], P[9], P[8], *P[10:]], r"frame 8 .* sine-x-180 .*; sine-x-90 .* belongs there"),
        (P[:10] + P[11:], r"frame 10 .* gray-y-0 .*; sine-x-270"),
        ([*P[:11], replace(P[10], index=4), *P[11:]], r"frame 11 .* sine-x-360 .*; gray-y-0"),
        (P[:11], r"frame 11 .* nothing; gray-y-0"),
        (P[:2] + P[11:] + P[2:11], r"frame 2 .* gray-y-0 .*; gray-x-0"),
        (P[:2] + P[6:1:-1] + P[7:], r"frame 2 .* gray-x-4 .*; gray-x-0"),
        (P[:2] + P[7:11] + P[2:7] + P[11:], r"frame 2 .* sine-x-0 .*; gray-x-0"),
        ([P[0], *P[2:]], r"frame 1 .* gray-x-0 .*; dark"),
        ([P[0], *P[2:], P[1]], r"frame 1 .* gray-x-0 .*; dark"),
        ([*P[:9], replace(P[9], period_px=32), *P[10:]], r"frame 9 .* sine-x-180 \(1024 px, period 32 px\); sine-x-180 \(1024"),
        ([*P[:16], replace(P[16], size_px=1024), *P[17:]], r"frame 16 .* sine-y-0 \(1024 px, .*; sine-y-0 \(768 px"),
        ([*P, P[-1]], r"frame 20 .* sine-y-270 .*; nothing belongs there"),
    ],
)  # fmt: skip
def test_a_sequence_that_breaks_what_its_judges_rely_on_cannot_be_made(patterns: list[Pattern], said: str) -> None:
    with pytest.raises(ValueError, match=said):
        PatternSequence(64, 1024, 768, tuple(patterns))


def test_sequences_that_are_equal_are_one_key_and_the_frames_of_an_axis_are_those_that_vary_along_it() -> None:
    for period_px, width_px, height_px in ((16, 1024, 768), (64, 1024, 768), (12, 400, 300)):
        one = build_sequence(period_px, width_px, height_px)
        bright, dark, *rest = one.patterns
        other = PatternSequence(period_px, width_px, height_px, (dark, bright, *rest))
        assert len({one, build_sequence(period_px, width_px, height_px), other}) == 2
        assert (other.bright, other.dark) == (1, 0)
        for axis in map(one.axis, Direction):
            named = {k: one.patterns[k] for k in (*axis.gray, *axis.sine)}
            assert {p.direction for p in named.values()} == {axis.direction}
            assert [named[k].kind for k in sorted(named)] == [Kind.GRAY] * len(axis.gray) + [Kind.SINE] * 4
            assert sum(p.direction is axis.direction for p in rest) == len(named)
