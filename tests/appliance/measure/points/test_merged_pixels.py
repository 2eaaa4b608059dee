"""Two sequences pixel by pixel, with variances worked out by hand: who is taken, what is averaged, what is masked."""

from __future__ import annotations

import math

import numpy as np
import pytest

from appliance.measure.decode.decoder import DecodedMaps, Mask
from appliance.measure.light.noise import CameraNoise
from appliance.measure.points.merge import Agreement, merge

NOISE = CameraNoise(read_dn=0.5, dn_per_e=0.02, black_dn=2.0)
LOUD = CameraNoise(read_dn=2.0, dn_per_e=0.08, black_dn=2.0)
NAN = math.nan
V, SHADOW, SATURATED, WEAK = Mask.VALID, Mask.SHADOW, Mask.SATURATED, Mask.WEAK
CONTRADICTION, EDGE = Mask.CONTRADICTION, Mask.EDGE


def variance_px2(modulation_dn: float, middle: float, noise: CameraNoise = NOISE) -> float:
    """(P/(2π√2))² σ²/B², of period 16 px."""
    grey_dn2 = noise.read_dn**2 + noise.dn_per_e * max(middle - noise.black_dn, 0.0)
    return (16.0 / (2.0 * math.pi * math.sqrt(2.0) * modulation_dn)) ** 2 * grey_dn2


def maps(
    mask: list[int], p_px: list[float], modulation_dn: list[float], middle: list[int], q_px: list[float] | None = None
) -> DecodedMaps:
    n, rows = len(mask), np.array([p_px, p_px if q_px is None else q_px], np.float32)
    half_dn = np.array([np.rint(2.0 * np.array(modulation_dn))], np.uint8)
    lit = np.array([[0, n]], np.int32)
    return DecodedMaps(np.array([mask], np.uint8), rows[:1], rows[1:], half_dn, np.array([middle], np.uint8), lit, n)


def merged(
    first: DecodedMaps, second: DecodedMaps, noise: tuple[CameraNoise, CameraNoise] = (NOISE, NOISE)
) -> tuple[Agreement, np.ndarray]:
    """How far both agree, and the variance of each merged coordinate, (h, w)."""
    variance = np.full(first.mask.shape, np.nan, np.float32)
    return merge(first, second, noise, 16, variance), variance


def test_two_coordinates_become_their_mean_by_variance_which_has_the_variance_of_a_mean() -> None:
    """Modulations of 20 and 90, at grey values of 60 and of black; where a bend was taken out of coordinates, they err more."""
    light = (20.0, 60), (90.0, 0)
    first, second = (maps([V], [p], [m], [at], [p / 2.0]) for p, (m, at) in zip((100.0, 100.02), light, strict=True))
    first.variance_factor, second.variance_factor = 1.2, 1.8
    agreement, variance = merged(first, second, (NOISE, LOUD))
    a, b = 1.2 * variance_px2(*light[0]), 1.8 * variance_px2(*light[1], LOUD)
    assert first.p_px[0, 0] == pytest.approx(100.0 + 0.02 * a / (a + b), abs=2e-5)
    assert first.q_px[0, 0] == pytest.approx(50.0 + 0.01 * a / (a + b), abs=2e-5)
    assert variance[0, 0] == pytest.approx(1.0 / (1.0 / a + 1.0 / b), rel=1e-5)
    assert (first.modulation_half_dn[0, 0], first.gray_threshold[0, 0]) == (180, 0), "what the clearer one saw"
    assert (agreement.first, agreement.second, agreement.both, agreement.masked) == (0.0, 0.0, 1.0, 0.0)
    assert agreement.agrees is None, "one pixel tells nothing of a movement"


@pytest.mark.parametrize("times", [4.8, 5.2])
@pytest.mark.parametrize(("axis", "sign"), [(0, 1), (1, -1)])
def test_more_than_five_sigmas_apart_in_either_direction_is_a_contradiction(times: float, axis: int, sign: int) -> None:
    at = [100.0, 50.0]
    at[axis] += sign * times * math.sqrt(variance_px2(40.0, 80) + variance_px2(20.0, 50))
    first = maps([V], [100.0], [40.0], [80], [50.0])
    agreement, _ = merged(first, maps([V], [at[0]], [20.0], [50], [at[1]]))
    apart = times > 5.0
    assert first.mask[0, 0] == (CONTRADICTION if apart else V)
    assert np.isnan([first.p_px[0, 0], first.q_px[0, 0]]).tolist() == [apart, apart]
    assert (agreement.both, agreement.masked) == (1.0, float(apart))


def test_where_only_one_has_a_coordinate_it_is_taken_and_where_none_has_there_is_none() -> None:
    first = maps([V, SATURATED, WEAK, SHADOW, WEAK], [1.0, NAN, NAN, NAN, NAN], [40, 50, 3, 0, 3], [80, 200, 20, 5, 20])
    second = maps([WEAK, V, V, V, SHADOW], [NAN, 2.0, 3.0, 4.0, NAN], [3, 30, 20, 25, 0], [20, 60, 50, 55, 4])
    agreement, variance = merged(first, second)
    assert first.mask.tolist() == [[V, V, V, V, WEAK]]
    np.testing.assert_array_equal(first.p_px, np.array([[1.0, 2.0, 3.0, 4.0, NAN]], np.float32))
    light = [(40, 80), (30, 60), (20, 50), (25, 55)]
    np.testing.assert_array_equal(first.modulation_half_dn[0, :4], [2 * modulation for modulation, _ in light])
    np.testing.assert_array_equal(first.gray_threshold[0, :4], [middle for _, middle in light])
    np.testing.assert_allclose(variance[0, :4], [variance_px2(*one) for one in light], rtol=1e-5)
    assert (agreement.first, agreement.second, agreement.both) == pytest.approx((0.2, 0.6, 0.0))


@pytest.mark.parametrize("doubt", [CONTRADICTION, EDGE])
def test_an_edge_in_the_clearer_sequence_is_one_whatever_the_other_shows(doubt: Mask) -> None:
    first = maps([V, V, doubt, doubt, V, doubt], [1.0, 2.0, NAN, NAN, 5.0, NAN], [20, 40, 40, 20, 30, 30], [60] * 6)
    second = maps([doubt, doubt, V, V, doubt, V], [NAN, NAN, 3.0, 4.0, NAN, 6.0], [40, 20, 20, 40, 30, 30], [60] * 6)
    agreement, _ = merged(first, second)
    assert first.mask[0].tolist() == [EDGE, V, doubt, V, V, V], "one that is no clearer takes nothing away"
    np.testing.assert_array_equal(first.p_px[0], np.array([NAN, 2.0, NAN, 4.0, 5.0, 6.0], np.float32))
    assert (agreement.first, agreement.second, agreement.both) == pytest.approx((2 / 6, 2 / 6, 0.0))


def whole(off_px: np.ndarray, shape: tuple[int, int] = (96, 160)) -> tuple[DecodedMaps, DecodedMaps]:
    """Two sequences of an image that differ by ``off_px`` in p."""
    v, u = np.mgrid[0 : shape[0], 0 : shape[1]].astype(np.float32)
    masks, half_dn = np.zeros(shape, np.uint8), np.full(shape, 80, np.uint8)
    lit = np.tile(np.array([0, shape[1]], np.int32), (shape[0], 1))
    first, second = (
        DecodedMaps(masks.copy(), p.astype(np.float32), v.copy(), half_dn.copy(), half_dn.copy(), lit.copy(), u.size)
        for p in (u, u + off_px)
    )
    return first, second


@pytest.mark.parametrize(("noises", "agrees"), [(0.45, True), (0.55, False), (-0.55, False)])
def test_a_shift_of_half_the_noise_common_to_the_image_is_a_movement(noises: float, agrees: bool) -> None:
    noise_px = math.sqrt(2.0 * variance_px2(40.0, 80))
    agreement, _ = merged(*whole(np.full((96, 160), noises * noise_px)))
    assert agreement.agrees is agrees
    assert agreement.shift == pytest.approx(abs(noises), abs=0.01)
    corner = np.zeros((96, 160))
    corner[:40, :60] = noise_px
    assert merged(*whole(corner))[0].shift == pytest.approx(0.0, abs=0.01), "a corner is not the whole image"


@pytest.mark.parametrize(
    ("rows", "columns", "told"),
    [
        # Parts of 16 x 20: 112 shared pixels are enough in one part, and not enough on both sides of a border.
        ((0, 16), (0, 7), True), ((80, 96), (140, 147), True), ((8, 24), (0, 7), False), ((0, 6), (10, 30), False),
        # A hundred are.
        ((0, 5), (0, 20), True), ((0, 9), (0, 11), False),
    ],
)  # fmt: skip
def test_the_image_is_asked_in_six_times_eight_parts(
    rows: tuple[int, int], columns: tuple[int, int], told: bool
) -> None:
    first, second = whole(np.zeros((96, 160)))
    second.mask[:] = SATURATED
    second.mask[slice(*rows), slice(*columns)] = V
    assert (merged(first, second)[0].agrees is not None) == told
    with pytest.raises(ValueError, match="images of 160x96 and 64x48 px cannot be merged"):
        merged(first, whole(np.zeros((48, 64)), shape=(48, 64))[1])
