"""The texture's movement from one direction's fringes to the other's: known shifts of an albedo made of waves."""

from __future__ import annotations

import math

import numpy as np
import pytest
from numpy.typing import NDArray

from appliance.patterns.sequence import Direction, PatternSequence, build_sequence
from appliance.reconstruct.decode.decoder import CameraDecoder, Mask
from appliance.verdict.motion.scores import MOVED, texture_score
from appliance.verdict.motion.texture import TextureShift, texture_shift

Array = NDArray[np.float64]
SEQUENCE = build_sequence(16)
SIZE = WIDTH_PX, HEIGHT_PX = 240, 160


def albedo(size: tuple[int, int], shift_px: tuple[float, float], bin_px: int = 1, seed: int = 5) -> Array:
    """Mean 1, about 0.7 to 1.3: thirty waves of 9 to 24 binned px, so that a shift is exact."""
    rng = np.random.default_rng(seed)
    v, u = np.mgrid[0 : size[1], 0 : size[0]].astype(np.float64)
    found = np.ones((size[1], size[0]))
    for _ in range(30):
        turn, length = rng.uniform(0.0, 2.0 * math.pi), bin_px * rng.uniform(9.0, 24.0)
        kx, ky = (2.0 * math.pi / length * f for f in (math.cos(turn), math.sin(turn)))
        found += 0.03 * np.cos(kx * (u - shift_px[0]) + ky * (v - shift_px[1]) + rng.uniform(0.0, 2.0 * math.pi))
    return found


def frames(
    first: Array, second: Array, noise_dn: float = 0.0, sequence: PatternSequence = SEQUENCE
) -> NDArray[np.uint8]:
    """Every image shows ``first``, those of the y-sines ``second``: fringes average out, and none are drawn."""
    made = np.stack([first] * len(sequence))
    made[list(sequence.axis(Direction.Y).sine)] = second
    made += noise_dn * np.random.default_rng(1).standard_normal(made.shape)
    return np.clip(np.rint(made), 0, 255).astype(np.uint8)


def decoded(size: tuple[int, int], part: tuple[slice, slice] = (slice(None), slice(None))) -> CameraDecoder:
    """Coordinates in a part of the image; nothing is illuminated beside it."""
    maps = CameraDecoder(SEQUENCE, *size)
    maps.p_px[:], maps.q_px[:], maps.mask[:] = np.nan, np.nan, Mask.SHADOW
    maps.p_px[part], maps.q_px[part], maps.mask[part] = 1.0, 1.0, Mask.VALID
    return maps


def told(
    first: Array, second: Array, noise_dn: float = 1.0, variance_dn2: tuple[float, float] | None = None
) -> TextureShift:
    size = first.shape[1], first.shape[0]
    variance = (noise_dn**2 + 1.0 / 12.0, 0.0) if variance_dn2 is None else variance_dn2
    return texture_shift(frames(first, second, noise_dn), decoded(size), SEQUENCE, variance)


def test_a_light_made_of_steps_is_no_texture_that_moves() -> None:
    """What four steps leave of such a light follows the fringes of each direction: at rest both means differ by it."""
    v, u = np.mgrid[0:HEIGHT_PX, 0:WIDTH_PX].astype(np.float64)
    maps = decoded(SIZE)
    maps.p_px[:], maps.q_px[:] = 100.0 + 0.61 * u + 0.05 * v, 80.0 + 0.57 * v
    light = 100.0 * albedo(SIZE, (0.0, 0.0))
    moved = 100.0 * albedo(SIZE, (3.0, -1.5))
    of_x, of_y = (1.0 + 0.05 * np.cos(8.0 * np.pi * at / 16.0 + 0.7) for at in (maps.p_px, maps.q_px))
    variance = (1.0 + 1.0 / 12.0, 0.0)
    for second, moves in ((light, False), (moved, True)):
        stack = frames(light * of_x, second * of_y, 1.0)
        stack[[SEQUENCE.bright, SEQUENCE.dark]] = frames(light, light, 1.0)[:2]
        found = texture_shift(stack, maps, SEQUENCE, variance)
        assert found.change is not None
        assert found.early_change is not None
        assert found.locked > 2.0, "without the fringes' part the difference would be several times the noise"
        score = texture_score({"left": found})
        assert score is not None
        assert (score > MOVED) == moves


@pytest.mark.parametrize(("size", "bin_px"), [(SIZE, 1), ((800, 240), 2), ((1600, 240), 4)])
@pytest.mark.parametrize("shift", [(1.6, -0.7), (-0.5, 1.2)])
def test_a_texture_that_moved_is_followed_in_the_cameras_own_pixels(
    size: tuple[int, int], bin_px: int, shift: tuple[float, float]
) -> None:
    moved_px = (shift[0] * bin_px, shift[1] * bin_px)
    first, second = 100.0 * albedo(size, (0.0, 0.0), bin_px), 100.0 * albedo(size, moved_px, bin_px)
    said = told(first, second)
    assert said.bin_px == bin_px
    assert said.flow_px is not None
    assert said.flow_sd_px is not None
    assert said.flow_px == pytest.approx(moved_px, abs=0.05 * bin_px)
    assert 0.0 <= said.flow_sd_px < 0.02 * bin_px
    assert said.change is not None
    assert said.change > 4.0
    assert said.early_change == pytest.approx(1.0, abs=0.12)


@pytest.mark.parametrize("size", [SIZE, (800, 160), (1600, 160)])
@pytest.mark.parametrize("gain", [1.0, 1.15])
def test_at_rest_both_means_differ_by_noise_whatever_daylight_does(size: tuple[int, int], gain: float) -> None:
    first = 100.0 * albedo(size, (0.0, 0.0), max(1, size[0] // 400))
    said = told(first, gain * first, 3.0)
    # The fitted gain stands at the first mean, whose noise it takes along; noise is that of either mean alone.
    assert said.change == pytest.approx(math.sqrt((1.0 + gain**2) / (2.0 * gain**2)), abs=0.07)
    assert said.early_change == pytest.approx(1.0, abs=0.07)
    assert said.flow_px is not None
    assert said.flow_px == pytest.approx((0.0, 0.0), abs=0.05 * said.bin_px)


def test_noise_is_that_of_the_light_there_is() -> None:
    """A variance of 9 at a mean of 100 grey values: all of it dark, all of it light, or half of it each."""
    first = 100.0 * albedo(SIZE, (0.0, 0.0))
    for variance_dn2 in ((9.0, 0.0), (0.0, 0.09), (4.5, 0.045)):
        assert told(first, first, 3.0, variance_dn2).change == pytest.approx(1.0, abs=0.07), variance_dn2
    assert told(first, first, 3.0, (36.0, 0.0)).change == pytest.approx(0.5, abs=0.05)


@pytest.mark.parametrize(("period_px", "apart"), [(16, 11.0), (32, 10.0), (64, 9.0)])
def test_the_two_means_are_as_many_frames_apart_as_one_direction_has(period_px: int, apart: float) -> None:
    """Four sines and 7, 6 or 5 Gray images."""
    sequence = build_sequence(period_px)
    flat = np.full((HEIGHT_PX, WIDTH_PX), 90.0)
    assert texture_shift(frames(flat, flat, 1.0, sequence), decoded(SIZE), sequence, (1.0, 0.0)).frames == apart


@pytest.mark.parametrize(("rows", "columns", "asked"), [(18, 18, False), (24, 14, True), (14, 24, True)])
def test_a_part_of_less_than_two_hundred_pixels_without_its_rim_is_asked_nothing(
    rows: int, columns: int, asked: bool
) -> None:
    """Two pixels along the rim are left out: 14 x 14 are 196, and 20 x 10 are 200."""
    first = 100.0 * albedo(SIZE, (0.0, 0.0))
    part = (slice(40, 40 + rows), slice(60, 60 + columns))
    said = texture_shift(frames(first, first, 1.0), decoded(SIZE, part), SEQUENCE, (1.0, 0.0))
    assert (said.change is not None) is asked
    assert (said.early_change is not None) is asked
    assert said.flow_px is None
    assert (said.frames, said.bin_px) == (11.0, 1)


def test_a_coordinate_is_needed_in_both_directions() -> None:
    first = 100.0 * albedo(SIZE, (0.0, 0.0))
    for name in ("p_px", "q_px"):
        maps = decoded(SIZE)
        getattr(maps, name)[:] = np.nan
        assert texture_shift(frames(first, first, 1.0), maps, SEQUENCE, (1.0, 0.0)).change is None


def test_without_texture_nothing_is_followed_and_stripes_tell_of_no_movement_along_themselves() -> None:
    flat = np.full((HEIGHT_PX, WIDTH_PX), 100.0)
    smooth = told(flat, flat, 2.0)
    assert (smooth.flow_px, smooth.flow_sd_px) == (None, None)
    assert smooth.change == pytest.approx(1.0, abs=0.07)
    for axis in (0, 1):
        wave = 100.0 + 25.0 * np.cos(2.0 * math.pi / 11.0 * np.mgrid[0:HEIGHT_PX, 0:WIDTH_PX][axis])
        striped = told(wave, wave, 2.0)
        assert striped.flow_px is None, "the smaller contrast is that of noise"
        assert striped.change == pytest.approx(1.0, abs=0.07)


def test_the_projectors_light_stays_while_the_albedo_moves() -> None:
    """Light falls to a third towards the corners; only what is painted on the surface went by."""
    v, u = np.mgrid[0:HEIGHT_PX, 0:WIDTH_PX].astype(np.float64)
    light = 110.0 * np.exp(-(((u - 90.0) / 150.0) ** 2) - ((v - 80.0) / 110.0) ** 2)
    said = told(light * albedo(SIZE, (0.0, 0.0)), light * albedo(SIZE, (1.5, 1.0)))
    assert said.flow_px == pytest.approx((1.5, 1.0), abs=0.06)


def test_the_flow_is_that_of_most_of_the_image() -> None:
    """A third of it moved by itself."""
    rest, moved = 100.0 * albedo(SIZE, (0.0, 0.0)), 100.0 * albedo(SIZE, (3.0, 0.0))
    second = rest.copy()
    second[:, : WIDTH_PX // 3] = moved[:, : WIDTH_PX // 3]
    said = told(rest, second)
    assert said.flow_px == pytest.approx((0.0, 0.0), abs=0.03)
    assert said.flow_sd_px is not None
    assert said.flow_sd_px < 0.02


def test_of_a_texture_that_is_exchanged_no_movement_is_told_for_sure() -> None:
    """The few ways that lead back by chance differ by pixels; the change is far beyond noise."""
    said = told(100.0 * albedo(SIZE, (0.0, 0.0), seed=5), 100.0 * albedo(SIZE, (0.0, 0.0), seed=6))
    assert said.flow_sd_px is None or said.flow_sd_px > 1.0
    assert said.change is not None
    assert said.change > 10.0


def test_the_flows_uncertainty_is_that_of_a_median_of_places_that_differ() -> None:
    """A texture that is stretched by 1 % about the middle: shifts from -1.2 to 1.2 px across, none down, at about 190 places.

    Their robust spread is 1.4826 times a quarter of the range, the median's 1.25 times that over the root of their number.
    """
    v, u = np.mgrid[0:HEIGHT_PX, 0:WIDTH_PX].astype(np.float64)
    rng = np.random.default_rng(5)
    first, second = np.ones_like(u), np.ones_like(u)
    for _ in range(30):
        turn, length, phase = rng.uniform(0.0, 2.0 * math.pi), rng.uniform(9.0, 24.0), rng.uniform(0.0, 2.0 * math.pi)
        kx, ky = (2.0 * math.pi / length * f for f in (math.cos(turn), math.sin(turn)))
        first += 0.03 * np.cos(kx * u + ky * v + phase)
        second += 0.03 * np.cos(kx * (u - 0.01 * (u - 119.5)) + ky * v + phase)
    said = told(100.0 * first, 100.0 * second, 0.5)
    assert said.flow_px == pytest.approx((0.0, 0.0), abs=0.1)
    assert said.flow_sd_px == pytest.approx(1.4826 * 0.6 * 1.25 / math.sqrt(190.0), rel=0.12)
