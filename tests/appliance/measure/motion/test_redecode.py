"""What points are solved from: where stripes are lit, what of albedo is noise, when it is asked, what is shown."""

from __future__ import annotations

import numpy as np
import pytest

from appliance.measure.light.patterns import Direction, build_sequence
from appliance.measure.motion.redecode import drop_new_borders, misfit_factor
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
