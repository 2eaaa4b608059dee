"""Two sequences pixel by pixel, with variances worked out by hand: who is taken, what is averaged, what is masked."""

from __future__ import annotations

import math

import numpy as np
import pytest

from appliance.reconstruct.decode.decoder import DecodedMaps, Mask
from appliance.reconstruct.merge import Agreement, merge
from appliance.scan.noise import CameraNoise

NOISE = CameraNoise(read_dn=0.5, dn_per_e=0.02, black_dn=2.0)
SCALE_PX = 16.0 / (2.0 * math.pi * math.sqrt(2.0))
NAN = math.nan


def sigma_px(modulation_dn: float, middle: float, noise: CameraNoise = NOISE) -> float:
    return SCALE_PX * math.sqrt(noise.read_dn**2 + noise.dn_per_e * (middle - noise.black_dn)) / modulation_dn


def maps(
    mask: list[int], p_px: list[float], modulation_dn: list[float], middle: list[int], q_px: list[float] | None = None
) -> DecodedMaps:
    n = len(mask)
    return DecodedMaps(
        np.array([mask], np.uint8),
        np.array([p_px], np.float32),
        np.array([p_px if q_px is None else q_px], np.float32),
        np.array([np.rint(2.0 * np.array(modulation_dn))], np.uint8),
        np.array([middle], np.uint8),
        np.array([[0, n]], np.int32),
        n,
    )


V, SHADOW, SATURATED, WEAK, CONTRADICTION, EDGE = (
    Mask.VALID,
    Mask.SHADOW,
    Mask.SATURATED,
    Mask.WEAK,
    Mask.CONTRADICTION,
    Mask.EDGE,
)


def merged(
    first: DecodedMaps, second: DecodedMaps, noise: tuple[CameraNoise, CameraNoise] = (NOISE, NOISE)
) -> Agreement:
    return merge(first, second, noise, 16, np.empty(first.mask.shape, np.float32))


def merged_sigma_px(
    first: DecodedMaps, second: DecodedMaps, noise: tuple[CameraNoise, CameraNoise] = (NOISE, NOISE)
) -> np.ndarray:
    """Standard deviation (n,) of the merged coordinates of one row."""
    variance_px2 = np.full(first.mask.shape, np.nan, np.float32)
    merge(first, second, noise, 16, variance_px2)
    return np.asarray(np.sqrt(variance_px2[0]))


def test_two_coordinates_become_their_mean_by_variance_which_has_the_variance_of_a_mean() -> None:
    first = maps([V], [100.0], [40.0], [80], [50.0])
    second = maps([V], [100.02], [20.0], [50], [50.01])
    a, b = sigma_px(40.0, 80) ** 2, sigma_px(20.0, 50) ** 2
    variance_px2 = np.zeros((1, 1), np.float32)
    agreement = merge(first, second, (NOISE, NOISE), 16, variance_px2)
    weight = b / (a + b)
    assert first.p_px[0, 0] == pytest.approx(100.0 + 0.02 * (1 - weight), abs=1e-5)
    assert first.q_px[0, 0] == pytest.approx(50.0 + 0.01 * (1 - weight), abs=1e-5)
    assert variance_px2[0, 0] == pytest.approx(1.0 / (1.0 / a + 1.0 / b), rel=1e-5)
    assert (first.modulation_half_dn[0, 0], first.gray_threshold[0, 0]) == (80, 80), "what the clearer one saw"
    assert (agreement.first, agreement.second, agreement.both, agreement.masked) == (0.0, 0.0, 1.0, 0.0)
    assert agreement.agrees is None, "one pixel tells nothing of a movement"


def test_the_modulation_of_a_merged_pixel_is_the_one_that_the_clearer_sequence_saw() -> None:
    for modulations, seen in (((40.0, 20.0), 40.0), ((20.0, 40.0), 40.0), ((127.0, 126.0), 127.0)):
        first, second = (maps([V], [100.0], [modulation], [80]) for modulation in modulations)
        merged(first, second)
        assert first.modulation_half_dn[0, 0] == 2.0 * seen


def test_modulation_does_not_go_to_and_fro_between_two_exposures_where_they_are_about_as_clear() -> None:
    """A jump from pixel to pixel would be taken for an edge of the albedo."""
    for most in (0, 1):
        light = [[80, 90, 80, 90, 80], [90, 80, 90, 80, 90]]
        first, second = (maps([V] * 5, [1.0] * 5, [40.0] * 5, light[k ^ most]) for k in (0, 1))
        seen = (second if most else first).gray_threshold.copy()
        merged(first, second)
        np.testing.assert_array_equal(first.gray_threshold, seen)


def test_coordinates_that_a_bend_was_taken_out_of_are_expected_to_err_more_when_they_are_merged() -> None:
    first, second = maps([V], [100.0], [40.0], [80]), maps([V], [100.02], [40.0], [80])
    first.variance_factor, second.variance_factor = 1.2, 1.8
    one = sigma_px(40.0, 80) ** 2
    found = merged_sigma_px(first, second)[0]
    assert found**2 == pytest.approx(one / (1.0 / 1.2 + 1.0 / 1.8), rel=1e-5)
    assert first.p_px[0, 0] == pytest.approx(100.0 + 0.02 * 1.2 / 3.0, abs=1e-5)


def test_fringes_with_less_light_than_half_way_between_bright_and_dark_have_less_noise() -> None:
    first, second = maps([V], [100.0], [40.0], [82]), maps([V], [100.0], [40.0], [82])
    first.offset_per_threshold = second.offset_per_threshold = 0.75
    assert merged_sigma_px(first, second)[0] == pytest.approx(sigma_px(40.0, 0.75 * 82) / math.sqrt(2.0), rel=1e-5)


def test_of_the_clearer_second_sequence_the_light_is_kept_and_its_own_noise_counts() -> None:
    loud = CameraNoise(read_dn=2.0, dn_per_e=0.08, black_dn=2.0)
    first, second = maps([V], [100.0], [20.0], [60]), maps([V], [100.1], [90.0], [120])
    said = merged_sigma_px(first, second, (NOISE, loud))[0] ** 2
    a, b = sigma_px(20.0, 60) ** 2, sigma_px(90.0, 120, loud) ** 2
    assert first.p_px[0, 0] == pytest.approx(100.0 + 0.1 * a / (a + b), abs=1e-5)
    assert (first.modulation_half_dn[0, 0], first.gray_threshold[0, 0]) == (180, 120)
    assert said == pytest.approx(1.0 / (1.0 / a + 1.0 / b), rel=1e-5)


@pytest.mark.parametrize("times", [4.8, 5.2])
@pytest.mark.parametrize("axis", [0, 1])
@pytest.mark.parametrize("sign", [1, -1])
def test_more_than_five_sigmas_apart_in_either_direction_is_a_contradiction(times: float, axis: int, sign: int) -> None:
    off = sign * times * math.hypot(sigma_px(40.0, 80), sigma_px(20.0, 50))
    at = [100.0, 50.0]
    at[axis] += off
    first = maps([V], [100.0], [40.0], [80], [50.0])
    agreement = merged(first, maps([V], [at[0]], [20.0], [50], [at[1]]))
    apart = times > 5.0
    assert first.mask[0, 0] == (CONTRADICTION if apart else V)
    assert np.isnan([first.p_px[0, 0], first.q_px[0, 0]]).tolist() == [apart, apart]
    assert agreement.both == 1.0
    assert agreement.masked == float(apart)


def test_where_only_one_has_a_coordinate_it_is_taken_and_where_none_has_there_is_none() -> None:
    first = maps([V, SATURATED, WEAK, SHADOW, WEAK], [1.0, NAN, NAN, NAN, NAN], [40, 50, 3, 0, 3], [80, 200, 20, 5, 20])
    second = maps([WEAK, V, V, V, SHADOW], [NAN, 2.0, 3.0, 4.0, NAN], [3, 30, 20, 25, 0], [20, 60, 50, 55, 4])
    variance_px2 = np.zeros((1, 5), np.float32)
    agreement = merge(first, second, (NOISE, NOISE), 16, variance_px2)
    assert first.mask.tolist() == [[V, V, V, V, WEAK]]
    np.testing.assert_array_equal(first.p_px, np.array([[1.0, 2.0, 3.0, 4.0, NAN]], np.float32))
    for k, (modulation, middle) in enumerate([(40, 80), (30, 60), (20, 50), (25, 55)]):
        assert (first.modulation_half_dn[0, k], first.gray_threshold[0, k]) == (2 * modulation, middle), k
        assert variance_px2[0, k] == pytest.approx(sigma_px(modulation, middle) ** 2, rel=1e-5), k
    assert (agreement.first, agreement.second, agreement.both) == pytest.approx((0.2, 0.6, 0.0))


@pytest.mark.parametrize("doubt", [CONTRADICTION, EDGE])
def test_an_edge_in_the_clearer_sequence_is_one_whatever_the_other_shows(doubt: Mask) -> None:
    first = maps([V, V, doubt, doubt], [1.0, 2.0, NAN, NAN], [20, 40, 40, 20], [50, 80, 80, 50])
    second = maps([doubt, doubt, V, V], [NAN, NAN, 3.0, 4.0], [40, 20, 20, 40], [80, 50, 50, 80])
    agreement = merged(first, second)
    assert np.isnan(first.p_px[0]).tolist() == [True, False, True, False]
    assert first.mask[0].tolist() == [EDGE, V, doubt, V]
    assert (agreement.first, agreement.second, agreement.both) == pytest.approx((0.25, 0.25, 0.0))


def test_a_variance_better_than_any_modulation_of_eight_bits_makes_is_said_as_it_is() -> None:
    first, second = maps([V], [100.0], [127.0], [130]), maps([V], [100.0], [127.0], [130])
    assert merged_sigma_px(first, second)[0] == pytest.approx(sigma_px(127.0, 130) / math.sqrt(2.0), rel=1e-5)


def test_lit_parts_are_joined() -> None:
    for one, other in (([2, 5], [1, 4]), ([1, 4], [2, 5]), ([1, 5], [2, 4]), ([2, 4], [1, 5])):
        first, second = maps([V] * 6, [1.0] * 6, [40.0] * 6, [80] * 6), maps([V] * 6, [1.0] * 6, [40.0] * 6, [80] * 6)
        first.illuminated_columns[:], second.illuminated_columns[:] = one, other
        first.illuminated_pixels, second.illuminated_pixels = one[1] - one[0], other[1] - other[0]
        wanted = max(first.illuminated_pixels, second.illuminated_pixels)
        merged(first, second)
        assert first.illuminated_columns.tolist() == [[1, 5]]
        assert first.illuminated_pixels == wanted


@pytest.mark.parametrize("doubt", [CONTRADICTION, EDGE])
def test_an_edge_in_a_sequence_that_is_no_clearer_takes_nothing_away(doubt: Mask) -> None:
    first = maps([V, doubt], [1.0, NAN], [30, 30], [60, 60])
    merged(first, maps([doubt, V], [NAN, 2.0], [30, 30], [60, 60]))
    assert first.mask.tolist() == [[V, V]]
    assert first.p_px.tolist() == [[1.0, 2.0]]


@pytest.mark.parametrize("middle", [2, 1, 0])
def test_at_black_and_below_it_only_the_noise_of_reading_counts(middle: int) -> None:
    first, second = maps([V], [100.0], [60.0], [middle]), maps([V], [100.05], [60.0], [42])
    said = merged_sigma_px(first, second)[0] ** 2
    a, b = sigma_px(60.0, 2) ** 2, sigma_px(60.0, 42) ** 2
    assert first.p_px[0, 0] == pytest.approx(100.0 + 0.05 * a / (a + b), abs=3e-5)
    assert first.gray_threshold[0, 0] == middle
    assert said == pytest.approx(1.0 / (1.0 / a + 1.0 / b), rel=1e-5)


def test_a_shift_of_just_half_the_noise_still_agrees() -> None:
    assert Agreement(0.0, 0.0, 1.0, 0.0, 0.5).agrees is True
    assert Agreement(0.0, 0.0, 1.0, 0.0, 0.5001).agrees is False


def whole(off_px: np.ndarray, shape: tuple[int, int] = (96, 160)) -> tuple[DecodedMaps, DecodedMaps]:
    """Two sequences of an image that differ by ``off_px`` in p."""
    v, u = np.mgrid[0 : shape[0], 0 : shape[1]].astype(np.float32)

    def one(p: np.ndarray) -> DecodedMaps:
        return DecodedMaps(
            np.zeros(shape, np.uint8),
            p.astype(np.float32),
            v.copy(),
            np.full(shape, 80, np.uint8),
            np.full(shape, 80, np.uint8),
            np.tile(np.array([0, shape[1]], np.int32), (shape[0], 1)),
            p.size,
        )

    return one(u), one(u + off_px)


@pytest.mark.parametrize(("noises", "agrees"), [(0.0, True), (0.45, True), (0.55, False), (-0.55, False)])
def test_a_shift_of_half_the_noise_common_to_the_image_is_a_movement(noises: float, agrees: bool) -> None:
    noise_px = math.sqrt(2.0) * sigma_px(40.0, 80)
    first, second = whole(np.full((96, 160), noises * noise_px))
    agreement = merged(first, second)
    assert agreement.shift == pytest.approx(abs(noises), abs=0.01)
    assert agreement.agrees is agrees
    assert agreement.both == 1.0
    assert np.isfinite(first.p_px).all()


def test_a_corner_that_moved_does_not_make_the_whole_image_move() -> None:
    off = np.zeros((96, 160))
    off[:40, :60] = math.sqrt(2.0) * sigma_px(40.0, 80)
    agreement = merged(*whole(off))
    assert agreement.shift == pytest.approx(0.0, abs=0.01)


def test_of_too_few_shared_pixels_no_movement_is_told() -> None:
    for shared, told in ((99, False), (100, True)):
        first, second = whole(np.zeros((96, 160)))
        second.mask[:] = SATURATED
        block = np.zeros((16, 20), bool)
        block.ravel()[:shared] = True
        second.mask[:16, :20][block] = V
        assert (merged(first, second).agrees is not None) == told, shared


def told(*parts: tuple[slice, slice]) -> bool:
    """Whether a movement can be told when only these pixels of an image of 96 x 160 are shared."""
    first, second = whole(np.zeros((96, 160)))
    second.mask[:] = SATURATED
    for part in parts:
        second.mask[part] = V
    return merged(first, second).agrees is not None


def test_the_image_is_asked_in_six_times_eight_equal_parts_each_on_its_own() -> None:
    """Parts of 16 x 20: 112 shared pixels are enough in one part, and not enough on both sides of a border."""
    assert told((slice(0, 16), slice(0, 7)))
    assert told((slice(0, 6), slice(0, 20)))
    assert told((slice(80, 96), slice(140, 147)))
    assert not told((slice(8, 24), slice(0, 7)))
    assert not told((slice(0, 6), slice(10, 30)))
    assert not told((slice(13, 19), slice(0, 20))), "on both sides of the first border"
    assert not told((slice(0, 16), slice(16, 23))), "on both sides of the first border"
    assert not told((slice(76, 83), slice(0, 17)))
    assert not told((slice(0, 17), slice(136, 143)))


def test_a_picture_that_is_higher_than_wide_is_merged_to_its_last_row() -> None:
    first, second = whole(np.full((200, 40), 0.004), shape=(200, 40))
    merged(first, second)
    _, u = np.mgrid[0:200, 0:40]
    np.testing.assert_allclose(first.p_px, u + 0.002, atol=1e-4)


def test_pictures_of_two_sizes_are_refused_with_both() -> None:
    first, _ = whole(np.zeros((96, 160)))
    _, second = whole(np.zeros((48, 64)), shape=(48, 64))
    with pytest.raises(ValueError, match="images of 160x96 and 64x48 px cannot be merged"):
        merged(first, second)
