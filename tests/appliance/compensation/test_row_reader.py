"""A row that is read at once shows what its pixels show that are read one by one."""

from __future__ import annotations

import numpy as np
import pytest

from appliance.compensation.displacement import (
    interpolate_pixel,
    interpolate_row,
    parabola_at,
    read_spline,
    spline_noise_share,
)
from appliance.compensation.row_reader import noise_row, parabola_row, place_row, read_row, shares_of

HEIGHT, WIDTH, STEP = 40, 200, 16
ROW, FIRST, STOP = 17, 3, 197
U, V = 6, 9


@pytest.mark.parametrize("depth_noise", [0.0, 2.0], ids=["long runs", "runs of a pixel"])
def test_a_row_is_read_to_the_last_bit_as_its_pixels_one_by_one(depth_noise: float) -> None:
    rng = np.random.default_rng(7)
    picture = rng.integers(0, 256, (2, HEIGHT, WIDTH)).astype(np.uint8)
    picture[1][rng.random((HEIGHT, WIDTH)) < 0.15] = 255
    pixels, start = picture.reshape(-1), HEIGHT * WIDTH
    nodes = rng.normal(0.0, 2.0, (4, WIDTH // STEP + 2, 12)).astype(np.float32)
    # Some points leave the picture to the left and upwards, some pixels have no depth.
    nodes[:, :3, U], nodes[:, 8:9, V] = -30.0, -40.0
    t = (0.3 + depth_noise * rng.normal(0.0, 1.0, WIDTH)).astype(np.float32)
    t[100:110] = np.nan

    at_row, shares = np.empty(nodes.shape[1:], np.float32), shares_of(STEP)
    interpolate_row(nodes, STEP, ROW, at_row)
    u, v, grey, share = (np.full(WIDTH, 7.0, np.float32) for _ in range(4))
    cell = np.empty(WIDTH, np.int32)
    parabola_row(at_row, shares, U, t, FIRST, STOP, u)
    parabola_row(at_row, shares, V, t, FIRST, STOP, v)
    place_row(ROW, FIRST, STOP, u, v)
    read_row(pixels, start, HEIGHT, WIDTH, u, v, FIRST, STOP, cell, grey)
    noise_row(u, v, cell, FIRST, STOP, share)

    c = np.empty(12, np.float32)
    expected, of_noise = np.full(WIDTH, 7.0, np.float32), np.full(WIDTH, 7.0, np.float32)
    for x in range(FIRST, STOP):
        interpolate_pixel(at_row, STEP, x, 0, c)
        at_u, at_v = np.float32(x) + parabola_at(c, U, t[x]), np.float32(ROW) + parabola_at(c, V, t[x])
        inside = at_u >= 1.0 and at_v >= 1.0 and at_u < WIDTH - 2.0 and at_v < HEIGHT - 2.0
        expected[x] = read_spline(pixels, start, WIDTH, at_u, at_v) if inside else np.nan
        of_noise[x] = spline_noise_share(at_u, at_v) if inside else np.nan
    np.testing.assert_array_equal(grey, expected)
    np.testing.assert_array_equal(share, of_noise)
    missing = np.isnan(expected)
    assert 30 < missing.sum() < 150, "the scene has points inside and outside of the picture"
    assert (missing & np.isfinite(of_noise)).any(), "and saturated ones"
