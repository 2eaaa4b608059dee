"""The drift of the fringes, cell by cell: its sign, and that sums made early are those that would be made late."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest

from appliance.measure.decode.decoder import CameraDecoder
from appliance.measure.light.patterns import Direction, build_sequence
from appliance.measure.verdicts.motion import drift as motion_drift
from appliance.measure.verdicts.motion.albedo import AlbedoShifts, albedo_shifts
from appliance.measure.verdicts.motion.cells import COLUMNS as SUMS
from appliance.measure.verdicts.motion.cells import COUNT, RunSums, _collect, cell_sums, run_sums
from appliance.measure.verdicts.motion.drift import edge_shifts

SEQUENCE = build_sequence(16, 320, 200)
ROWS, COLUMNS = 4, 5
DARK_DN2, PER_DN = 0.9, 0.06


@dataclass(frozen=True)
class Scene:
    frames: np.ndarray
    p: np.ndarray
    q: np.ndarray

    def sums(self, runs: RunSums | None) -> np.ndarray:
        return cell_sums(self.frames, self.p, self.q, SEQUENCE, (DARK_DN2, PER_DN), runs).ones

    def early(self) -> RunSums:
        return run_sums(self.frames, self.p, SEQUENCE, (DARK_DN2, PER_DN))


def scene(width: int, height: int) -> Scene:
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
    return Scene(frames, p.astype(np.float32), q.astype(np.float32))


def test_what_lies_below_the_last_row_of_cells_is_added_nowhere() -> None:
    """Compiled code would write beyond the end of the sums and say nothing."""
    given = scene(160, 120)
    given.q[100:] = 230.0
    images = tuple(given.frames[k] for k in SEQUENCE.axis(Direction.X).sine)
    variance, runs = (np.float32(DARK_DN2), np.float32(PER_DN)), given.early()
    for code in (runs.code, np.zeros_like(runs.code)):  # of runs that are kept, and of pixels that are summed anew
        sums = np.zeros((ROWS, COLUMNS, SUMS))
        _collect(images, given.p, given.q, 1, variance, code, runs.sums, sums[: ROWS - 1])
        assert (sums[: ROWS - 1] != 0.0).any()
        assert (sums[ROWS - 1] == 0.0).all()


def test_runs_summed_before_y_are_the_pixels_that_are_left_when_y_has_taken_some() -> None:
    """Pixels that lost their coordinates, whose neighbour lost its own, or the one below them; and a row read anew in another column."""
    given = scene(600, 450)
    early = given.early()
    before = given.sums(early)
    np.testing.assert_array_equal(before, given.sums(None))
    given.p[101, 200:240] = np.nan  # looked at
    given.p[141, 303:343:2] = np.nan  # beside one that is
    given.p[182, 400:440] = np.nan  # below one that is
    given.p[221, 300:400] += 64.0
    after, wanted = given.sums(early), given.sums(None)
    np.testing.assert_allclose(after, wanted, rtol=1e-6, atol=1e-3)
    assert before[..., COUNT].sum() > after[..., COUNT].sum()
    assert (np.abs(before - wanted) > 1.0).any()


def test_cells_hold_what_runs_hold_where_all_rows_are_known_in_a_picture_taller_than_wide_too() -> None:
    given = scene(90, 120)
    given.q[:] = np.linspace(1.0, 199.0, 120)[:, None]
    early = given.early()
    np.testing.assert_allclose(given.sums(early).sum((0, 1)), early.sums.sum(0, dtype=float), rtol=1e-5, atol=1e-2)


GRAY_X = SEQUENCE.axis(Direction.X).gray
GRAY = (*GRAY_X, *SEQUENCE.axis(Direction.Y).gray)


# --------------------------------------------------------------------------------------------------- edges


def striped(width: int, height: int, veil: float = 0.0) -> tuple[np.ndarray, CameraDecoder]:
    """Gray stripes with soft edges, moved by 0.4 px, over pixels whose coordinates are halves of px; ``veil``: share of bright less
    dark that lies over dark stripes, too."""
    rng = np.random.default_rng(7)
    v, u = np.mgrid[0:height, 0:width].astype(float)
    p = np.round(2.0 * (-15.0 + 350.0 * u / width)) / 2.0
    q = -12.0 + 280.0 * v / height
    p[rng.random(p.shape) < 0.05] = np.nan
    dark = rng.integers(5, 40, p.shape)
    bright = dark + rng.choice([7, 8, 9, 60, 150], p.shape)
    frames = np.zeros((len(SEQUENCE), height, width), np.uint8)
    frames[SEQUENCE.bright], frames[SEQUENCE.dark] = bright, dark
    for k in GRAY_X:
        codes = SEQUENCE.patterns[k].codes() / 247.0
        soft = np.interp(np.nan_to_num(p) + 0.4 + np.array([[[-1.5]], [[0.0]], [[1.5]]]), np.arange(320), codes).mean(0)
        soft = veil + (1.0 - veil) * soft
        frames[k] = np.clip(np.rint(dark + (bright - dark) * soft + rng.normal(0.0, 1.0, p.shape)), 0, 255)
    decoder = CameraDecoder(SEQUENCE, width, height)
    decoder.p_px[:], decoder.q_px[:] = p, q
    return frames, decoder


@pytest.mark.parametrize("veil", [0.0, 0.3])
def test_every_edge_takes_as_much_light_with_it_as_it_has_moved(veil: float) -> None:
    found = edge_shifts(*striped(450, 340, veil), SEQUENCE).shift_px
    assert np.isfinite(found).sum() > 30
    assert np.isnan(found).any()
    assert np.nanmedian(found) == pytest.approx(0.4, abs=0.15)
    assert np.nanmedian(np.abs(found - 0.4)) < 0.3


def added(inner: float = 20.0, low: float = 12.0, high: float = 12.0, height: float = 0.8) -> np.ndarray:
    """Sums of an edge at which light begins, that has moved by 0.9 px: of 20 pixels over 9 px, two more are lit."""
    lit = inner * (0.1 + 0.6 * height)
    return np.array([[inner, lit, 0.5 * inner, inner, low, 0.1 * low, high, (0.1 + height) * high]])


def test_an_edge_that_moved_is_known_from_ten_pixels_of_each_part_and_from_enough_contrast() -> None:
    def shift(**parts: float) -> float:
        return float(motion_drift._shifts_of_sums(added(**parts))[0])

    assert shift() == pytest.approx(0.9)
    for part in ("inner", "low", "high"):
        assert shift(**{part: 10.0}) == pytest.approx(0.9)
        assert np.isnan(shift(**{part: 9.0}))
        assert np.isnan(shift(**{part: 0.0}))
    assert shift(height=0.31) == pytest.approx(0.9)
    assert np.isnan(shift(height=0.29))


def test_edges_of_what_lies_below_the_last_row_of_cells_are_added_nowhere() -> None:
    frames, decoder = striped(160, 120)
    edges_px, rises = motion_drift.edges_of(SEQUENCE)
    gray = np.array(GRAY_X, np.int64)
    sums = np.zeros((len(GRAY_X), ROWS + 1, COLUMNS, 8))
    motion_drift._accumulate(frames, (0, 1), gray, decoder.p_px, decoder.q_px, edges_px, rises, 1, 64.0, sums[:, :ROWS])
    assert (decoder.q_px > 256.0).any()
    assert (sums[:, :ROWS] > 0.0).any()
    assert (sums[:, ROWS] == 0.0).all()


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
