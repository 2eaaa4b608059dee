"""The share of the water that stripes light is found also where the water is several times as bright as the object."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest
from numpy.typing import NDArray

from appliance.measure.decode.backscatter import read_through_backscatter
from appliance.measure.decode.decoder import CameraDecoder, Mask
from appliance.measure.light.noise import camera_noise
from appliance.measure.light.patterns import Direction, Kind, PatternSequence, build_sequence

SEQUENCE = build_sequence(16)
ROWS, COLUMNS = 150, 400
GAIN_DB = 0.0
NOISE = camera_noise(13_000.0, 10.0, 2.0, GAIN_DB)
OBJECT_DN = 24.0
VEIL_BEHIND_PX = 3.2


@dataclass(frozen=True)
class Milk:
    """One camera's frames of a plane in milk, and what is true of them."""

    frames: NDArray[np.uint8]
    p_px: NDArray[np.float64]
    half_period: NDArray[np.int64]
    veil_dn: NDArray[np.float64]


def drawn(sequence: PatternSequence, veil_of_object: float, below_dn: float = OBJECT_DN, seed: int = 10_001) -> Milk:
    """G = b O + f V: backscatter grows over the picture, coarse stripes light a share of it that waves, fine ones half.

    ``below_dn``: brightness of the object's lower half.
    """
    rng = np.random.default_rng(seed)
    v, u = np.mgrid[:ROWS, :COLUMNS]
    p, q = 20.0 + 2.4 * u + 0.1 * v, 20.0 + 2.4 * v
    object_dn = np.where(v < ROWS // 2, OBJECT_DN, below_dn)
    veil = OBJECT_DN * veil_of_object * (0.2 + 0.8 * u / COLUMNS)
    across = sequence.axis(Direction.X)
    frames = []
    for pattern in sequence.patterns:
        level = pattern.codes(None).astype(np.float64) / 255.0
        own = np.interp(p, np.arange(level.size), level) if pattern.direction is Direction.X else np.full(p.shape, 0.5)
        share = np.full(p.shape, float(level.mean()))
        if pattern.direction is Direction.Y:
            # A ray stays within one row of the water, which lies beside the object's.
            own, share = (np.interp(at, np.arange(level.size), level) for at in (q, q - VEIL_BEHIND_PX))
        if pattern.kind is Kind.GRAY and pattern.direction is Direction.X:
            coarse = across.gray[-1] - sequence.patterns.index(pattern)
            share = 0.5 + min(0.06 * max(coarse - 2, 0), 0.3) * np.sin(u / 45.0 + coarse + v / 60.0)
        if pattern.kind is Kind.SINE:
            kept = 0.01 if pattern.direction is Direction.Y else 0.0
            own, share = 0.5 + 0.35 * (2.0 * own - 1.0), 0.5 + kept * (2.0 * share - 1.0)
        light = 2.0 + object_dn * own + veil * share
        frames.append(rng.normal(light, np.sqrt(NOISE.variance_dn2(light))))
    half_period = np.floor((p + 0.5) / (0.5 * sequence.period_px)).astype(np.int64)
    return Milk(np.clip(np.rint(np.stack(frames)), 0, 255).astype(np.uint8), p, half_period, veil)


@pytest.fixture(scope="module")
def milk() -> Milk:
    return drawn(SEQUENCE, 5.0)


def test_water_five_times_as_bright_hides_next_to_nothing_and_the_rest_is_right(milk: Milk) -> None:
    """Nothing was sure of a bit there, so that the share of fine stripes stayed unknown and two thirds of a plane were lost."""
    shape = milk.half_period.shape
    half_period, doubtful, mask = (np.zeros(shape, np.uint8) for _ in range(3))
    assert read_through_backscatter(SEQUENCE, milk.frames, mask, NOISE, half_period, doubtful) is not None
    for part in np.array_split(doubtful != 0, 8, axis=1):
        assert np.mean(part) < 0.06
    off = np.abs(half_period.astype(np.int64) - milk.half_period)[doubtful == 0]
    # Half a stripe beside a border noise may choose either; the phase tells which.
    assert np.mean(off > 1) < 100e-6


def decoded(milk: Milk) -> CameraDecoder:
    decoder = CameraDecoder(SEQUENCE, COLUMNS, ROWS)
    for k in range(len(SEQUENCE)):
        decoder.push(milk.frames, k)
    decoder.finish()
    return decoder


def test_rows_are_not_lost_where_the_waters_stripes_lie_beside_the_objects(milk: Milk) -> None:
    """A tenth of these pixels was called contradictions: their Gray bits followed the water, their phase did less so."""
    decoder = decoded(milk)
    assert decoder.read_again_through_backscatter(milk.frames, NOISE)
    assert np.mean(decoder.mask[10:-10, 200:-10] == Mask.CONTRADICTION) < 0.03


@pytest.mark.parametrize("moved_px", [0, 4])
def test_clear_water_is_read_once_also_where_paint_moves(moved_px: int) -> None:
    """A scan that moved was read twice, for a tenth of a second and more: at borders of paint it is as if there were light beside the fringes."""
    clear = drawn(SEQUENCE, 0.0, 3.0 * OBJECT_DN)
    for k in (SEQUENCE.bright, SEQUENCE.dark):
        clear.frames[k] = np.roll(clear.frames[k], moved_px, axis=0)
    decoder = decoded(clear)
    before = decoder.p_px.copy()
    assert not decoder.read_again_through_backscatter(clear.frames, NOISE)
    np.testing.assert_array_equal(decoder.p_px, before)


FAINT_DN = 10.0
"""The lower half of such an object has fringes with a modulation of 0.35 times that: below the usual limit of 5 grey values."""
BELOW = (slice(ROWS // 2 + 10, -10), slice(10, -10))


def test_fringes_that_milk_left_three_grey_values_are_used_as_far_as_their_noise_allows() -> None:
    """A fifth of the planes in milk was lost to a limit of five grey values, though a camera's noise is less than two."""
    faint = drawn(SEQUENCE, 2.0, FAINT_DN)
    decoder = decoded(faint)
    assert np.mean(decoder.mask[BELOW] == Mask.WEAK) > 0.5
    assert decoder.read_again_through_backscatter(faint.frames, NOISE)
    assert np.mean(decoder.mask[BELOW] == Mask.WEAK) < 0.15
    off_px = (decoder.p_px - faint.p_px)[BELOW]
    found = np.isfinite(off_px)
    assert np.mean(found) > 0.85
    # A twentieth of a period is the largest error that is expected, and half a period away lies the next order.
    assert np.sqrt(np.mean(np.square(off_px[found]))) < SEQUENCE.period_px / 20
    assert np.mean(np.abs(off_px[found]) > SEQUENCE.period_px / 2) < 100e-6


def test_a_dark_place_stays_dark_where_the_water_is_not_bright() -> None:
    """Underexposed paint gave two fifths more points, of a quarter of a millimetre of noise, because a few other pixels saw backscatter."""
    faint = drawn(SEQUENCE, 0.8, FAINT_DN)
    decoder = decoded(faint)
    assert decoder.read_again_through_backscatter(faint.frames, NOISE)
    veil_share = faint.veil_dn[BELOW] / FAINT_DN
    weak = decoder.mask[BELOW] == Mask.WEAK
    # Noise of one pixel hides on which side of a half it is; between both, the share falls.
    assert np.mean(weak[veil_share < 0.5]) > 0.4
    assert np.mean(weak[veil_share > 1.0]) < 0.02
