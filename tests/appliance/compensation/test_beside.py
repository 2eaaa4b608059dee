"""What is read beside a point's way: where stripes are lit, what paint is noise, how far is followed, what is shown."""

from __future__ import annotations

import numpy as np
import pytest

from appliance.compensation.attempt import worth_it
from appliance.compensation.beside import choose_shares, near_stripes
from appliance.compensation.grays import lit_there, stripes_of
from appliance.compensation.paint import evened
from appliance.compensation.ways import FIRST_WAY, PER_FRAME, Ways
from appliance.patterns.sequence import Direction, build_sequence
from bench.verdict.compensation_bound import all_frames, four_sines, shrunk_steps


@pytest.mark.parametrize("period_px", [16, 32, 64])
def test_stripes_are_lit_where_the_pattern_is(period_px: int) -> None:
    sequence = build_sequence(period_px)
    stripes = stripes_of(sequence, 0.0)
    for frame, axis, width_px in zip(*stripes, strict=True):
        pattern = sequence.patterns[frame]
        assert pattern.direction is (Direction.X, Direction.Y)[axis]
        codes = pattern.codes()
        told = np.array([lit_there(x + 0.5, width_px, 0.0) for x in range(len(codes))])
        assert (told == (codes > 0)).all(), pattern.name


def test_paint_is_taken_from_the_images_around_the_sines_that_make_the_depth() -> None:
    sequence = build_sequence(16)
    stripes, places = near_stripes(sequence)
    x, y = sequence.axis(Direction.X), sequence.axis(Direction.Y)
    assert set(stripes.frames) == {*x.gray[-4:], *y.gray[:4]}
    followed = (*x.sine, *y.sine, sequence.bright, *x.gray, *y.gray)
    assert [followed[k] for k in places] == list(stripes.frames)


def test_even_paint_loses_its_noise_and_borders_stay() -> None:
    rng = np.random.default_rng(5)
    truth = np.where(np.arange(80) < 40, 50.0, 150.0)[None, :].repeat(60, 0)
    grey, left = evened(
        (truth + rng.normal(0.0, 2.0, truth.shape)).astype(np.float32), np.full(truth.shape, 4.0, np.float32), 5
    )
    away = np.abs(np.arange(80) - 39.5) > 4
    scatter = np.std((grey - truth)[3:-3][:, away][:, 3:-3])
    assert scatter < 1.0
    assert scatter == pytest.approx(float(np.sqrt(left[3:-3][:, away][:, 3:-3].mean())), rel=0.4)
    assert np.abs((grey - truth)[:, 38:42]).max() < 8.0


def ways_with(turns_per_frame: float) -> Ways:
    """Points that move by so much of a period in every frame of both blocks."""
    nodes = np.zeros((3, 3, FIRST_WAY + PER_FRAME * 8), np.float32)
    for k in range(8):
        nodes[..., FIRST_WAY + PER_FRAME * k + 6] = turns_per_frame * k
    return Ways(nodes, 20)


def test_points_are_followed_as_far_as_their_steps_stay_apart() -> None:
    assert choose_shares(ways_with(0.0)) == (1.0, 1.0)
    assert choose_shares(ways_with(-0.02)) == (1.0, 1.0)
    shrunk = choose_shares(ways_with(-60.0 / 360.0))
    assert max(shrunk) < 1.0, "steps of 30° make four times the noise"
    grown = choose_shares(ways_with(85.0 / 360.0))
    assert max(grown) < 1.0, "steps of 175° are hardly more than two values"


@pytest.mark.parametrize(
    ("before", "after", "shown"),
    [(2.5, 1.1, True), (1.0, 1.1, False), (1.2, 1.25, True), (8.0, 2.0, True), (2.0, 1.8, False), (40.0, 4.0, False)],
)
def test_what_is_shown_is_clearly_better_or_as_good_as_at_rest(before: float, after: float, shown: bool) -> None:
    assert worth_it(before, after) is shown


def test_no_method_can_do_better_than_the_bound_and_four_sines_alone_do_far_worse() -> None:
    still, along = shrunk_steps(0.0, 16), shrunk_steps(40.0, 16)
    assert four_sines(still) == pytest.approx(1.0)
    assert all_frames(still, 14) <= 1.0
    assert all_frames(along, 14) < 1.2 < 3.5 < four_sines(along)
    # Monte Carlo of the four sines' least squares.
    rng, phase = np.random.default_rng(7), 0.7
    A = np.stack([np.ones(4), np.cos(along), -np.sin(along)], -1)
    seen = 100.0 + 80.0 * np.cos(phase + along) + rng.normal(0.0, 0.02, (20_000, 4))
    _, c, s = np.linalg.lstsq(A, seen.T, rcond=None)[0]
    scatter = np.std(np.unwrap(np.arctan2(s, c)))
    cos, sin = np.cos(phase), np.sin(phase)
    N = np.linalg.inv(A.T @ A)[1:, 1:]
    assert scatter == pytest.approx(0.02 / 80.0 * np.sqrt(np.array([-sin, cos]) @ N @ np.array([-sin, cos])), rel=0.03)
