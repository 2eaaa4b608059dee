"""Cell by cell the drift map is what NumPy's least squares find among the pixels that count, and no other pixel counts."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest

from appliance.patterns.sequence import Direction, build_sequence
from appliance.reconstruct.decode.decoder import CameraDecoder
from appliance.verdict.motion.cells import COLUMNS as SUMS
from appliance.verdict.motion.cells import COUNT, RunSums, _collect, cell_sums, run_sums
from appliance.verdict.motion.drift import DriftMap, drift_map

SEQUENCE = build_sequence(16, 320, 200)
ROWS, COLUMNS = 4, 5
DARK_DN2, PER_DN = 0.9, 0.06
FEW, ENOUGH = (3, 0), (3, 1)
"""Cells of 39 pixels and of 40."""


@dataclass(frozen=True)
class Scene:
    frames: np.ndarray
    decoder: CameraDecoder
    stride: int


def scene(width: int, height: int, stride: int, second: float) -> Scene:
    """Fringes that drift, over paint, of a light with a second harmonic of ``second`` and a sixth; here and there next to no light."""
    rng = np.random.default_rng(5)
    v, u = np.mgrid[0:height, 0:width].astype(float)
    p = -20.0 + 380.0 * u / width + 10.0 * v / height
    p = np.where((v // 12) % 5 == 1, 330.0 - p, p)  # seen in a mirror
    p = np.where((v // 12) % 5 == 2, 0.07 * u + 100.0, p)  # nearly along the fringes, where gradients say nothing
    p = np.where((v // 12) % 5 == 3, 0.15 * u + 160.0, p)
    q = -15.0 + 300.0 * v / height
    p[40:44, 20:40], q[40:44, 20:40] = 0.0, 0.0
    p[44:48, 20:40] = 0.5
    q[48:50, 20:60] = 0.0
    q[52:54, 20:60] = -0.5
    p[rng.random(p.shape) < 0.05] = np.nan
    q[rng.random(q.shape) < 0.05] = np.nan
    q[q >= 192.0] += 1000.0
    light = 90.0 + 25.0 * np.sin(u / 3.0) * np.cos(v / 4.0) + 10.0 * rng.standard_normal(u.shape)
    modulation = 0.6 * light * np.where(rng.random(u.shape) < 0.15, 0.01, 1.0)
    where = [(y, x) for y in range(80 + stride // 2, height, stride) for x in range(stride // 2 + 1, width - 1, stride)]
    for number, at in enumerate(rng.permutation(len(where))[:79]):
        y, x = where[at]
        q[y, x], p[y, x], modulation[y, x] = 200.0, 1.5 * number + 5.5, 50.0
    frames = np.zeros((len(SEQUENCE), height, width), np.uint8)
    for step, k in enumerate(SEQUENCE.axis(Direction.X).sine):
        phase = 2.0 * np.pi * (np.nan_to_num(p) + 0.3 * step) / 16.0 + step * np.pi / 2.0
        image = light * (1.0 + 0.01 * step) + modulation * (
            np.cos(phase) + second * np.cos(2.0 * phase + 0.4) + 0.05 * np.cos(6.0 * phase + 1.0)
        )
        frames[k] = np.clip(np.rint(image + 1.5 * rng.standard_normal(u.shape)), 0, 255)
    # Of modulation 2 exactly, which counts, and of 0, which is in no way dividable by.
    for step, value in enumerate((102, 100, 98, 100)):
        frames[SEQUENCE.axis(Direction.X).sine[step], 60:70] = value
        frames[SEQUENCE.axis(Direction.X).sine[step], 70:74] = 100
    decoder = CameraDecoder(SEQUENCE, width, height)
    decoder.p_px[:], decoder.q_px[:] = p, q
    return Scene(frames, decoder, stride)


def expected(given: Scene) -> dict[str, np.ndarray]:
    """The same with whole images, cell by cell."""
    a, b, c, d = (given.frames[k].astype(float) for k in SEQUENCE.axis(Direction.X).sine)
    p, q = given.decoder.p_px.astype(float), given.decoder.q_px.astype(float)
    height, width = p.shape
    v, u = np.mgrid[0:height, 0:width]
    s = given.stride
    asked = ((v - s // 2) % s == 0) & (v >= s // 2) & ((u - s // 2 - 1) % s == 0) & (u > s // 2) & (u < width - 1)
    asked &= (p >= 0.0) & (q >= 0.0) & (p < 320.0) & (q < 256.0)
    cosine, sine, light, left = (a - c) / 2.0, (d - b) / 2.0, (a + b + c + d) / 4.0, a - b + c - d
    modulation = np.hypot(cosine, sine)
    with np.errstate(invalid="ignore", divide="ignore"):
        at_least = np.maximum(modulation, 1.0)
        second = (cosine**2 - sine**2) / at_least, 2.0 * cosine * sine / at_least
        sixth = at_least * ((cosine + 1j * sine) / at_least) ** 6
        terms = np.stack([at_least, cosine, sine, *second, light, sixth.real, sixth.imag], -1)
        before, after = np.roll(p, 1, 1), np.roll(p, -1, 1)
        slope = (after - before) / 2.0
        gradient = (np.roll(light, -1, 1) - np.roll(light, 1, 1)) / 2.0 / slope
        own = (DARK_DN2 + PER_DN * light) / 8.0 / slope**2
    names = ("drift_px", "early_px", "late_px", "sd_px", "u_px", "v_px", "slope_per_px", "noise_rad2")
    out = {n: np.full((ROWS, COLUMNS), np.nan) for n in (*names, "texture_per_px2", "uneven_rad2", "second2")}
    for row in range(ROWS):
        for column in range(COLUMNS):
            here = asked & (q // 64 == row) & (p // 64 == column)
            good = here & (modulation >= 2.0)
            n = np.count_nonzero(good)
            if n < 40:
                continue
            x, y = terms[good], left[good]
            fit = np.linalg.lstsq(x, y, rcond=None)[0]
            rest = np.sum((y - x @ fit) ** 2) / (n - 8)
            tells = np.array([0.0, -0.25, 0.25, 0.0, 0.0, 0.0, 0.0, 0.0])
            second2 = (fit[3] ** 2 + fit[4] ** 2) / 16.0
            px = 16.0 / (2.0 * np.pi) / max(1.0 - 4.0 * second2, 0.3)
            known = good & np.isfinite(before) & np.isfinite(after)
            steep = known & (np.abs(slope) > 0.1)
            pair = here & (np.roll(p, -1, 0) >= 0.0) & (v < height - 1)
            apart = np.roll(left - terms @ fit, -1, 0) - (left - terms @ fit)
            two = 2.0 * DARK_DN2 + PER_DN * (light + np.roll(light, -1, 0))
            noise = DARK_DN2 + PER_DN * light[good].mean()
            values = {
                "drift_px": px * tells @ fit,
                "early_px": px * fit[2] / 2.0,
                "late_px": -px * fit[1] / 2.0,
                "sd_px": px * np.sqrt(rest * tells @ np.linalg.inv(x.T @ x) @ tells),
                "u_px": u[good].mean(),
                "v_px": v[good].mean(),
                "slope_per_px": slope[known].mean(),
                "noise_rad2": 0.5 * noise * np.mean(modulation[good] ** -2.0),
                "texture_per_px2": max(np.sum(gradient[steep] ** 2 - own[steep]) / np.sum(modulation[steep] ** 2), 0.0),
                "uneven_rad2": np.sum((apart**2 - 4.0 * two)[pair]) / np.sum(4.0 * modulation[pair] ** 2),
                "second2": second2,
            }
            for name, value in values.items():
                out[name][row, column] = value
    return out


@pytest.mark.parametrize(
    ("width", "height", "stride", "second"), [(160, 120, 1, 0.1), (600, 450, 2, 0.1), (160, 120, 1, 0.5)]
)
def test_every_cell_is_the_least_squares_of_its_pixels(width: int, height: int, stride: int, second: float) -> None:
    given = scene(width, height, stride, second)
    found, wanted = drift_map(given.frames, given.decoder, SEQUENCE, (DARK_DN2, PER_DN)), expected(given)
    known = np.isfinite(wanted["drift_px"])
    assert known.sum() > 10
    assert not known[FEW]
    assert known[ENOUGH]
    for name in DriftMap.__dataclass_fields__:
        mine = getattr(found, name)
        if name in {"u_px", "v_px", "noise_rad2"}:
            assert np.isnan(mine[FEW])
        atol = 5e-5 if name in {"drift_px", "early_px", "late_px"} else 2e-6
        np.testing.assert_allclose(mine, wanted[name], rtol=2e-3, atol=atol, err_msg=name)
    assert (wanted["second2"][known] > 0.175).any() == (second > 0.4), "the limit of what is put back is reached"
    assert (wanted["texture_per_px2"][known] > 0.0).any()


def test_what_lies_below_the_last_row_of_cells_is_added_nowhere() -> None:
    """Compiled code would write beyond the end of the sums and say nothing."""
    given = scene(160, 120, 1, 0.1)
    given.decoder.q_px[100:] = 230.0
    p, q = given.decoder.p_px, given.decoder.q_px
    images = tuple(given.frames[k] for k in SEQUENCE.axis(Direction.X).sine)
    variance = np.float32(DARK_DN2), np.float32(PER_DN)
    runs = run_sums(given.frames, p, SEQUENCE, (DARK_DN2, PER_DN))
    for code in (runs.code, np.zeros_like(runs.code)):  # of runs that are kept, and of pixels that are summed anew
        sums = np.zeros((ROWS, COLUMNS, SUMS))
        _collect(images, p, q, 1, variance, code, runs.sums, sums[: ROWS - 1])
        assert (sums[: ROWS - 1] != 0.0).any()
        assert (sums[ROWS - 1] == 0.0).all()


def summed(given: Scene, runs: RunSums | None) -> np.ndarray:
    p, q = given.decoder.p_px, given.decoder.q_px
    return cell_sums(given.frames, p, q, SEQUENCE, (DARK_DN2, PER_DN), runs).ones


def test_runs_summed_before_y_are_the_pixels_that_are_left_when_y_has_taken_some() -> None:
    """Pixels that lost their coordinates, whose neighbour lost its own, or the one below them; and a row read anew in another column."""
    given = scene(600, 450, 2, 0.1)
    p = given.decoder.p_px
    early = run_sums(given.frames, p, SEQUENCE, (DARK_DN2, PER_DN))
    before = summed(given, early)
    np.testing.assert_array_equal(before, summed(given, None))
    p[101, 200:240] = np.nan  # looked at
    p[141, 303:343:2] = np.nan  # beside one that is
    p[182, 400:440] = np.nan  # below one that is
    p[221, 300:400] += 64.0
    after, wanted = summed(given, early), summed(given, None)
    np.testing.assert_allclose(after, wanted, rtol=1e-6, atol=1e-3)
    assert before[..., COUNT].sum() > after[..., COUNT].sum()
    assert (np.abs(before - wanted) > 1.0).any()


def test_most_of_what_was_summed_before_y_is_not_summed_again() -> None:
    """Told by sums that nobody could have made of the frames: they come through as they are."""
    given = scene(600, 450, 2, 0.1)
    given.decoder.p_px[:] = np.linspace(1.0, 310.0, 600, dtype=np.float32)
    given.decoder.q_px[:] = np.linspace(1.0, 190.0, 450, dtype=np.float32)[:, None]
    runs = run_sums(given.frames, given.decoder.p_px, SEQUENCE, (DARK_DN2, PER_DN))
    runs.sums[:, COUNT] = 1000.0
    assert summed(given, runs)[..., COUNT].sum() == 1000.0 * len(runs.sums)
