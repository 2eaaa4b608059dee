"""The sequence has the paper's length, one change per Gray step, and a phase that counts pixels."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from appliance.patterns.gray import inverse_gray
from appliance.patterns.sequence import PERIODS_PX, Direction, Kind, Pattern, PatternSequence, build_sequence


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


def test_each_period_that_is_offered_saves_an_image_in_either_direction_and_steps_by_whole_pixels() -> None:
    assert [len(build_sequence(period_px)) for period_px in PERIODS_PX] == [24, 22, 20]
    assert [period_px % 4 for period_px in PERIODS_PX] == [0, 0, 0], (
        "90 degrees are whole pixels: no pattern is a copy of two"
    )


def test_a_wider_projector_needs_one_image_more_and_its_codes_still_number_every_pixel() -> None:
    """1280 × 720, as DLP3010: 160 and 90 half periods of 16 px need 8 and 7 bits."""
    sequences = [build_sequence(period_px, 1280, 720) for period_px in PERIODS_PX]
    assert [len(sequence) for sequence in sequences] == [25, 23, 21]
    for sequence in sequences:
        for direction in Direction:
            axis = sequence.axis(direction)
            bits = np.stack([sequence.patterns[k].codes() > 128 for k in axis.gray]).astype(np.int64)
            half = inverse_gray(len(axis.gray))[(bits << np.arange(len(axis.gray))[::-1, None]).sum(axis=0)]
            np.testing.assert_array_equal(half, 2 * np.arange(axis.size_px) // sequence.period_px)


def test_every_frame_is_named_once_and_references_come_first() -> None:
    sequence = build_sequence(16)
    names = [pattern.name for pattern in sequence.patterns]
    assert len(set(names)) == len(names)
    assert (sequence.bright, sequence.dark) == (0, 1)
    assert sequence.patterns[0].kind is Kind.BRIGHT


def test_a_period_out_of_range_names_itself_and_the_range() -> None:
    with pytest.raises(ValueError, match=r"fringe period 3 px; allowed are 4\.\.768 px"):
        build_sequence(3)


def changed(change: str) -> list[Pattern]:
    """The patterns of a sequence with a period of 64 px (bright, dark, 5 + 4 of X, 5 + 4 of Y) with one thing wrong."""
    patterns = list(build_sequence(64).patterns)
    match change:
        case "two steps exchanged":
            patterns[8], patterns[9] = patterns[9], patterns[8]
        case "three steps":
            del patterns[10]
        case "five steps":
            patterns.insert(11, replace(patterns[10], index=4))
        case "one direction":
            del patterns[11:]
        case "Y before X":
            patterns[2:] = patterns[11:] + patterns[2:11]
        case "least significant bit first":
            patterns[2:7] = patterns[6:1:-1]
        case "sines before Gray":
            patterns[2:11] = patterns[7:11] + patterns[2:7]
        case "no dark":
            del patterns[1]
        case "dark at the end":
            patterns.append(patterns.pop(1))
        case "another period":
            patterns[9] = replace(patterns[9], period_px=32)
        case "another size":
            patterns[16] = replace(patterns[16], size_px=1024)
        case "one frame more":
            patterns.append(patterns[-1])
        case _:
            raise ValueError(change)
    return patterns


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ("two steps exchanged", r"frame 8 .* sine-x-180 .*; sine-x-90 .* belongs there"),
        ("three steps", r"frame 10 .* gray-y-0 .*; sine-x-270"),
        ("five steps", r"frame 11 .* sine-x-360 .*; gray-y-0"),
        ("one direction", r"frame 11 .* nothing; gray-y-0"),
        ("Y before X", r"frame 2 .* gray-y-0 .*; gray-x-0"),
        ("least significant bit first", r"frame 2 .* gray-x-4 .*; gray-x-0"),
        ("sines before Gray", r"frame 2 .* sine-x-0 .*; gray-x-0"),
        ("no dark", r"frame 1 .* gray-x-0 .*; dark"),
        ("dark at the end", r"frame 1 .* gray-x-0 .*; dark"),
        ("another period", r"frame 9 .* sine-x-180 \(1024 px, period 32 px\); sine-x-180 \(1024 px, period 64 px\)"),
        ("another size", r"frame 16 .* sine-y-0 \(1024 px, .*; sine-y-0 \(768 px"),
        ("one frame more", r"frame 20 .* sine-y-270 .*; nothing belongs there"),
    ],
)
def test_a_sequence_that_breaks_what_its_judges_rely_on_cannot_be_made(change: str, said: str) -> None:
    with pytest.raises(ValueError, match=said):
        PatternSequence(64, 1024, 768, tuple(changed(change)))


def test_dark_may_come_before_bright() -> None:
    bright, dark, *rest = build_sequence(32).patterns
    sequence = PatternSequence(32, 1024, 768, (dark, bright, *rest))
    assert (sequence.bright, sequence.dark) == (1, 0)


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
