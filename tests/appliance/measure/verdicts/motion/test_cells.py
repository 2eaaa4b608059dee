"""The drift of the fringes, cell by cell: its sign, and that sums made early are those that would be made late."""

from __future__ import annotations

import numpy as np
import pytest

from appliance.measure.decode.decoder import CameraDecoder
from appliance.measure.light.patterns import Direction, build_sequence
from appliance.measure.verdicts.motion.albedo import AlbedoShifts, albedo_shifts
from appliance.measure.verdicts.motion.cells import cell_sums

SEQUENCE = build_sequence(16, 320, 200)
ROWS, COLUMNS = 4, 5
VARIANCE_DN2 = (0.9, 0.06)


def drifting(width: int, height: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Fringes that drift, over paint; here and there coordinates are missing, and beyond the last cell."""
    rng = np.random.default_rng(5)
    v, u = np.mgrid[0:height, 0:width].astype(float)
    p, q = -20.0 + 380.0 * u / width + 10.0 * v / height, -15.0 + 300.0 * v / height
    p[rng.random(p.shape) < 0.05] = np.nan
    q[rng.random(q.shape) < 0.05] = np.nan
    light = 90.0 + 25.0 * np.sin(u / 3.0) * np.cos(v / 4.0) + 10.0 * rng.standard_normal(u.shape)
    frames = np.zeros((len(SEQUENCE), height, width), np.uint8)
    for step, k in enumerate(SEQUENCE.axis(Direction.X).sine):
        phase = 2.0 * np.pi * (np.nan_to_num(p) + 0.05 * step) / 16.0 + step * np.pi / 2.0
        noise = 1.5 * rng.standard_normal(u.shape)
        frames[k] = np.clip(np.rint(light * (1.0 + 0.6 * np.cos(phase)) + noise), 0, 255)
    return frames, p.astype(np.float32), q.astype(np.float32)


def terms(frames: np.ndarray) -> np.ndarray:
    """(9, h, w): what C is fitted by, and C."""
    a, b, c, d = (frames[k].astype(float) for k in SEQUENCE.axis(Direction.X).sine)
    z = 0.5 * (a - c) + 0.5j * (d - b)
    size = np.maximum(np.abs(z), 1.0)
    turn = z / size
    waves = [size, z.real, z.imag, size * (turn**2).real, size * (turn**2).imag, 0.25 * (a + b + c + d)]
    return np.stack([*waves, size * (turn**6).real, size * (turn**6).imag, a - b + c - d])


@pytest.mark.parametrize(("row", "column"), [(0, 0), (1, 2), (3, 4)])
def test_a_cell_has_the_sums_of_its_pixels(row: int, column: int) -> None:
    frames, p, q = drifting(180, 120)
    frames[:, 60:90:7] = 100  # without fringes
    found, x = cell_sums(frames, p, q, SEQUENCE, VARIANCE_DN2), terms(frames)
    mine = (np.floor(p / 64.0) == column) & (np.floor(q / 64.0) == row)
    mine[:, [0, -1]] = False
    fringes = x[1] ** 2 + x[2] ** 2 >= 4.0
    every, mine = mine, mine & fringes
    here = x[:, mine]
    np.testing.assert_allclose(found.products[row, column], here @ here.T, rtol=1e-9)
    means, square = found.means[row, column], here[1] ** 2 + here[2] ** 2
    v, u = np.nonzero(mine)
    for name, sums in (
        ("count", len(u)),
        ("u", u.sum()),
        ("v", v.sum()),
        ("light", here[5].sum()),
        ("inverse", (1.0 / square).sum()),
    ):
        assert means[name] == pytest.approx(sums), name
    below = every & np.roll(p >= 0.0, -1, 0)
    below[-1] = False
    v, u = np.nonzero(below)
    apart = x[:, v + 1, u] - x[:, v, u]
    np.testing.assert_allclose(found.apart[row, column], apart @ apart.T, rtol=1e-9)
    dark, per_dn = VARIANCE_DN2
    assert means["apart_noise"] == pytest.approx(4.0 * (2.0 * dark + per_dn * (x[5, v, u] + x[5, v + 1, u])).sum())
    assert means["apart_scale"] == pytest.approx(4.0 * (x[1, v, u] ** 2 + x[2, v, u] ** 2).sum())
    v, u = np.nonzero(mine & np.isfinite(np.roll(p, 1, 1) + np.roll(p, -1, 1)))
    slope = 0.5 * (p[v, u + 1] - p[v, u - 1]).astype(float)
    assert (means["slope"], means["sloped"]) == (pytest.approx(slope.sum(), rel=1e-5), len(u))
    gradient = 0.5 * (x[5, v, u + 1] - x[5, v, u - 1]) / slope
    own = 0.125 * (dark + per_dn * x[5, v, u]) / slope**2
    assert means["texture"] == pytest.approx((gradient**2 - own).sum(), rel=1e-4)
    assert means["steep"] == pytest.approx((x[1, v, u] ** 2 + x[2, v, u] ** 2).sum())


def test_of_a_large_picture_every_few_rows_and_columns_are_taken() -> None:
    frames, p, q = drifting(360, 320)
    assert cell_sums(frames, p, q, SEQUENCE, VARIANCE_DN2).means["count"].sum() < 0.3 * p.size


GRAY = (*SEQUENCE.axis(Direction.X).gray, *SEQUENCE.axis(Direction.Y).gray)


# --------------------------------------------------------------------------------------------------- paint


def painted(width: int, height: int) -> tuple[np.ndarray, CameraDecoder]:
    """Paint that lies somewhere else in every Gray image, under a light that grows; coordinates are anywhere."""
    rng = np.random.default_rng(3)
    v, u = np.mgrid[0:height, 0:width].astype(float)
    decoder = CameraDecoder(SEQUENCE, width, height)
    for coordinate, size in ((decoder.p_px, 320), (decoder.q_px, 200)):
        coordinate[:] = rng.integers(-2, 2 * size + 3, coordinate.shape) / 2.0
    frames = np.zeros((len(SEQUENCE), height, width), np.uint8)
    noise = rng.normal(0.0, 1.5, frames.shape)
    for k in range(len(SEQUENCE)):
        shift = k if k in GRAY else 0
        x, y = u - 0.05 * shift, v + 0.03 * shift
        light = 120.0 + 40.0 * np.sin(x / 4.0) * np.cos(y / 5.0) + 25.0 * np.sin(0.21 * x + 0.33 * y)
        frames[k] = np.clip(np.rint((1.0 + 0.01 * k) * light + noise[k]), 0, 254)
    frames[SEQUENCE.dark] = rng.integers(3, 30, u.shape)
    return frames, decoder


def test_paint_is_found_where_it_lies_in_every_gray_image_that_shows_enough_of_it() -> None:
    found = albedo_shifts(*painted(640, 300), SEQUENCE, (1.2, 0.04))
    known = np.flatnonzero(np.isfinite(found.sd_px))
    assert len(known) > 6
    assert set(known) <= set(GRAY)
    assert found.shift_px[known] == pytest.approx(np.outer(known, (0.05, -0.03)), rel=0.3, abs=0.1)


def test_the_mean_way_from_a_frame_to_the_next_but_one_is_without_its_noise() -> None:
    def double_step2(shift: list[tuple[float, float]], sd: list[float]) -> float | None:
        return AlbedoShifts(np.array(shift), np.array(sd)).mean_way2(2)

    nan = float("nan")
    # 3-4-5 to the right and down, then back; the last is not known.
    moved = double_step2([(0.0, 0.0), (1.0, 1.0), (0.3, 0.4), (1.0, 3.0), (nan, nan)], [0.1, 0.2, 0.3, 0.4, nan])
    first, second = 0.25 - 2.0 * (0.1**2 + 0.3**2), 4.0 - 2.0 * (0.2**2 + 0.4**2)
    assert moved == pytest.approx(0.5 * (first + second))
    assert double_step2([(0.0, 0.0), (nan, nan), (0.1, 0.0)], [0.5, nan, 0.5]) == 0.0, "less than its noise"
    assert double_step2([(0.0, 0.0), (0.5, 0.1), (nan, 0.0)], [0.1, 0.1, 0.1]) is None
