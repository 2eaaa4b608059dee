"""What points are solved from: where stripes are lit, what of albedo is noise, when it is asked, what is shown."""

from __future__ import annotations

import numpy as np
import pytest

from appliance.measure.light.patterns import STEP_ORDERS, Direction, build_sequence
from appliance.measure.light.sine import PHASE_STEPS
from appliance.measure.motion.albedo import denoised, gray_images
from appliance.measure.motion.attempt import is_better
from appliance.measure.motion.displacement import FIRST_FRAME, FRAME_COEFFICIENTS, OF_PHASE, DisplacementField
from appliance.measure.motion.redecode import GOOD_VARIANCE, drop_new_borders, misfit_factor, phase_variance
from appliance.measure.motion.stripes import illuminated_at, stripes_of


@pytest.mark.parametrize("period_px", [16, 32, 64])
def test_stripes_are_lit_where_the_pattern_is(period_px: int) -> None:
    sequence = build_sequence(period_px)
    stripes = stripes_of(sequence)
    for frame, axis, width_px in zip(*stripes, strict=True):
        pattern = sequence.patterns[frame]
        assert pattern.direction is (Direction.X, Direction.Y)[axis]
        codes = pattern.codes()
        lit = np.array([illuminated_at(x + 0.5, width_px, 0.0) for x in range(len(codes))])
        assert (lit == (codes > 0)).all(), pattern.name


def test_even_albedo_loses_its_noise_and_borders_stay() -> None:
    rng = np.random.default_rng(5)
    truth = np.where(np.arange(80) < 40, 50.0, 150.0)[None, :].repeat(60, 0)
    grey, left = denoised(
        (truth + rng.normal(0.0, 2.0, truth.shape)).astype(np.float32), np.full(truth.shape, 4.0, np.float32), 5
    )
    away = np.abs(np.arange(80) - 39.5) > 4
    scatter = np.std((grey - truth)[3:-3][:, away][:, 3:-3])
    assert scatter < 1.0
    assert scatter == pytest.approx(float(np.sqrt(left[3:-3][:, away][:, 3:-3].mean())), rel=0.4)
    assert np.abs((grey - truth)[:, 38:42]).max() < 8.0


def field_with(turns_per_frame: float) -> DisplacementField:
    """Return the field of points that move by so much of a period in every sine frame."""
    nodes = np.zeros((3, 3, FIRST_FRAME + FRAME_COEFFICIENTS * PHASE_STEPS), np.float32)
    for k in range(PHASE_STEPS):
        nodes[..., FIRST_FRAME + FRAME_COEFFICIENTS * k + OF_PHASE] = turns_per_frame * k
    return DisplacementField(nodes, 20)


def test_albedo_is_asked_where_steps_shrink_or_grow() -> None:
    assert phase_variance(field_with(0.0)) == pytest.approx(1.0)
    assert phase_variance(field_with(-0.02)) < GOOD_VARIANCE
    assert phase_variance(field_with(-60.0 / 360.0)) > 15.0, "steps of 30° make four times the noise"
    assert phase_variance(field_with(85.0 / 360.0)) > GOOD_VARIANCE, "steps of 175° are hardly more than two values"


def test_a_variance_grows_by_half_of_what_the_frames_contradict_beyond_noise() -> None:
    misfit = np.full((60, 80), 1.0, np.float32)
    misfit[20:40, 20:40] = 9.3
    misfit[:, 70:] = np.nan
    found = misfit_factor(misfit, 0.3, 80)
    assert found[50, 50] == pytest.approx(1.09)
    assert found[30, 30] == pytest.approx(1.09 + 0.5 * (9.3 - 1.3))
    assert found[5, 78] == pytest.approx(1.09), "where nothing is known, nothing is known against it"
    everywhere = misfit_factor(np.full((60, 80), 4.0, np.float32), 0.0, 80)
    assert everywhere[30, 30] == pytest.approx(1.0), "the fringes' harmonics contradict everywhere alike"


@pytest.mark.parametrize(
    ("before", "after", "shown"),
    [
        (2.5, 0.99, True),
        (2.5, 1.01, False),
        (0.9, 0.99, False),
        (0.95, 0.99, True),
        (8.0, 2.0, False),
        (1.0, 0.5, True),
    ],
)
def test_what_errs_a_fifth_more_than_a_scan_at_rest_is_not_shown(before: float, after: float, shown: bool) -> None:
    assert is_better(before, after) is shown
    assert not is_better(before, after, 2.5)


def test_beside_nothing_only_what_was_decoded_as_well_stays() -> None:
    p_px, plain_px = np.full((20, 20), 300.0, np.float32), np.full((20, 20), np.nan, np.float32)
    q_px = p_px.copy()
    p_px[9, 9] = np.nan
    plain_px[:, 10:] = 299.0  # the right half is known of old
    plain_px[9, 10] = np.nan
    drop_new_borders(p_px, q_px, plain_px)
    gone = {(int(y), int(x)) for y, x in zip(*np.nonzero(np.isnan(p_px)), strict=True)}
    assert gone == {(y, x) for y in (8, 9, 10) for x in (8, 9)} | {(9, 10)}
    np.testing.assert_array_equal(np.isnan(q_px), np.isnan(p_px))


@pytest.mark.parametrize("steps", STEP_ORDERS)
def test_the_gray_images_nearest_to_the_x_sines_in_time_are_asked_first(steps: tuple[int, ...]) -> None:
    images = gray_images(build_sequence(16, steps=steps))
    # X has the frames 2 to 8, its sines 9 to 12, Y 13 to 19; the bright frame comes last.
    assert (images.near, sorted(images.stripes.frames[:8].tolist())) == (8, [5, 6, 7, 8, 13, 14, 15, 16])
    assert images.stripes.frames[-1] == 0
