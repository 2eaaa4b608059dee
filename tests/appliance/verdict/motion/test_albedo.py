"""Paint between the x-sines and the y-sines: by how much it moved, and that what stands still differs by noise alone."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter, sobel, uniform_filter
from scipy.stats import median_abs_deviation

from appliance.patterns.sequence import Direction, build_sequence
from appliance.reconstruct.decode.decoder import CameraDecoder, Mask
from appliance.verdict.motion.texture import (
    TextureShift,
    _add_binned,
    _difference,
    _follow,
    _judged,
    _structure,
    _texture,
    _weights,
    means_of,
    texture_shift,
)

SEQUENCE = build_sequence(16)
X_SINE, Y_SINE = SEQUENCE.axis(Direction.X).sine, SEQUENCE.axis(Direction.Y).sine


@cache
def paint(width: int, height: int, fine_px: float, moved: tuple[float, float] = (0.0, 0.0)) -> np.ndarray:
    """(height, width): waves in all directions, of ``fine_px`` to five times that a period; the picture is ``moved`` right and down."""
    rng = np.random.default_rng(11)
    v, u = np.mgrid[0:height, 0:width].astype(float)
    u, v = u - moved[0], v - moved[1]
    out = np.full(u.shape, 100.0)
    for _ in range(60):
        angle, phase = rng.uniform(0.0, 2.0 * np.pi, 2)
        k = 2.0 * np.pi / (fine_px * 5.0 ** rng.random())
        out += 2.0 * np.sin(k * (u * np.cos(angle) + v * np.sin(angle)) + phase)
    out.flags.writeable = False
    return out


def seen(
    size: tuple[int, int], first: np.ndarray, second: np.ndarray, noise_dn: float = 0.8, gain: float = 1.0
) -> tuple[np.ndarray, CameraDecoder]:
    """Frames: ``first`` under white and under the x-sines, ``second`` under the y-sines with ``gain``, and a noise."""
    width, height = size
    rng = np.random.default_rng(2)
    frames = np.zeros((len(SEQUENCE), height, width), np.uint8)
    images = dict.fromkeys(X_SINE, first) | dict.fromkeys(Y_SINE, gain * second)
    images |= {SEQUENCE.bright: 2.0 * first - 10.0, SEQUENCE.dark: np.full_like(first, 10.0)}
    for k, image in images.items():
        frames[k] = np.clip(np.rint(image + noise_dn * rng.standard_normal(image.shape)), 0, 255)
    decoder = CameraDecoder(SEQUENCE, width, height)
    decoder.p_px[:], decoder.q_px[:] = 1.0, 1.0
    return frames, decoder


SIZES = [(400, 300, 1), (800, 300, 2), (1603, 403, 4)]


@pytest.mark.parametrize(("width", "height", "bin_px"), SIZES)
def test_paint_that_slides_is_followed_right_and_down_in_px_of_the_camera(width: int, height: int, bin_px: int) -> None:
    moved = (0.7 * bin_px, -0.4 * bin_px)
    pictures = paint(width, height, 7.0 * bin_px), paint(width, height, 7.0 * bin_px, moved)
    found = texture_shift(*seen((width, height), *pictures), SEQUENCE, (0.72, 0.0))
    assert found.bin_px == bin_px
    assert found.flow_px == pytest.approx(moved, abs=0.03 * bin_px)
    assert found.flow_sd_px is not None
    assert 0.0 < found.flow_sd_px < 0.02 * bin_px
    assert found.change is not None
    assert found.change > 3.0
    # Four x-sines, then seven or eight Gray images, then four y-sines.
    assert found.frames == np.mean(Y_SINE) - np.mean(X_SINE) == len(SEQUENCE.axis(Direction.Y).gray) + 4.0


@pytest.mark.parametrize(("width", "height", "bin_px"), SIZES)
@pytest.mark.parametrize("gain", [1.0, 0.8])
def test_what_stands_still_differs_by_the_noise_that_is_stated(
    width: int, height: int, bin_px: int, gain: float
) -> None:
    """Of photons as well: 0.04 grey values squared per grey value. Daylight that fades is a gain."""
    picture = gaussian_filter(paint(width, height, 30.0 * bin_px), 1.0)
    noise_dn = np.sqrt(0.8 + 0.04 * 100.0 - 1.0 / 12.0)
    frames, decoder = seen((width, height), picture, picture, noise_dn, gain)
    found = texture_shift(frames, decoder, SEQUENCE, (0.8, 0.04))
    # Of the gained noise only half is known to be: 1 at a gain of 1.
    expected = np.sqrt((1.0 + gain**2) / (2.0 * gain**2))
    assert found.change == pytest.approx(expected, abs=0.03)
    assert found.early_change == pytest.approx(1.0, abs=0.03)
    calm = texture_shift(frames, decoder, SEQUENCE, (4.0 * 0.8, 4.0 * 0.04))
    assert calm.change == pytest.approx(0.5 * expected, abs=0.02)


def test_only_the_middle_of_a_bin_says_whether_its_coordinates_are_known() -> None:
    picture = paint(1603, 403, 28.0)
    frames, decoder = seen((1603, 403), picture, picture)
    whole = texture_shift(frames, decoder, SEQUENCE, (0.72, 0.0))
    for coordinate in (decoder.p_px, decoder.q_px):
        kept = coordinate[2::4, 2::4].copy()
        coordinate[:] = np.nan
        coordinate[2::4, 2::4] = kept
    assert texture_shift(frames, decoder, SEQUENCE, (0.72, 0.0)) == whole
    for coordinate in (decoder.p_px, decoder.q_px):
        coordinate[:] = np.nan
        assert texture_shift(frames, decoder, SEQUENCE, (0.72, 0.0)).change is None
        coordinate[:] = 1.0


def test_fewer_than_two_hundred_pixels_away_from_borders_tell_nothing() -> None:
    picture = paint(400, 300, 7.0)
    frames, decoder = seen((400, 300), picture, picture)
    decoder.mask[:] = Mask.SHADOW
    for wide, known in ((204, True), (203, False)):
        decoder.p_px[:] = np.nan
        decoder.p_px[100:105, 50 : 50 + wide] = 1.0
        found = texture_shift(frames, decoder, SEQUENCE, (0.72, 0.0))
        assert (found.change is not None) == known
        assert (found.early_change is not None) == known
        assert (found.flow_px, found.flow_sd_px) == (None, None)
        assert (found.frames, found.bin_px) == (len(SEQUENCE.axis(Direction.Y).gray) + 4.0, 1)


@pytest.mark.parametrize(
    ("mask", "followed"),
    [(Mask.WEAK, True), (Mask.CONTRADICTION, True), (Mask.SHADOW, False), (Mask.SATURATED, False)],
    ids=lambda value: value.name.lower() if isinstance(value, Mask) else None,
)
def test_paint_that_moves_too_fast_to_be_decoded_is_followed_where_it_is_illuminated(
    mask: Mask, followed: bool
) -> None:
    """60 mm/s in milk: no pixel was decoded, so nothing was said of the movement, and it came as TOO DARK."""
    pictures = paint(400, 300, 7.0), paint(400, 300, 7.0, (4.0, -2.0))
    frames, decoder = seen((400, 300), *pictures)
    decoder.p_px[:], decoder.q_px[:], decoder.mask[:] = np.nan, np.nan, mask
    found = texture_shift(frames, decoder, SEQUENCE, (0.72, 0.0))
    assert (found.change, found.early_change) == (None, None), "noise says nothing where nothing is decoded"
    assert (found.flow_px is not None) == followed
    if followed:
        assert found.flow_px == pytest.approx((4.0, -2.0), abs=0.1)
    # At the outline of what is not illuminated nothing is followed.
    decoder.mask[:, 12::25] = Mask.SHADOW
    assert texture_shift(frames, decoder, SEQUENCE, (0.72, 0.0)).flow_px is None


def test_six_points_make_a_flow_and_five_do_not() -> None:
    pictures = paint(400, 300, 7.0), paint(400, 300, 7.0, (0.5, 0.0))
    frames, decoder = seen((400, 300), *pictures)
    decoder.p_px[:] = np.nan
    # Points are asked every 25 px: three in a row, two rows.
    decoder.p_px[55:95, 105:170] = 1.0
    found = texture_shift(frames, decoder, SEQUENCE, (0.72, 0.0))
    assert found.flow_px == pytest.approx((0.5, 0.0), abs=0.1)
    decoder.p_px[62, 112] = np.nan
    found = texture_shift(frames, decoder, SEQUENCE, (0.72, 0.0))
    assert found.flow_px is None
    assert found.flow_sd_px is None
    assert found.change is not None


def test_the_uncertainty_of_a_flow_is_that_of_a_median() -> None:
    rng = np.random.default_rng(8)
    first = paint(400, 300, 7.0)
    second = paint(400, 300, 7.0, (0.5, 0.3))
    frames, decoder = seen((400, 300), first, second + gaussian_filter(rng.normal(0.0, 8.0, first.shape), 1.0))
    found = texture_shift(frames, decoder, SEQUENCE, (0.72, 0.0))
    means = [frames[list(sine)].mean(0).astype(np.float32) for sine in (X_SINE, Y_SINE)]
    inside = np.ones(first.shape, bool)
    flows = _follow(means[0], means[1], inside, inside, 0.0)
    assert len(flows) > 150
    sd = np.hypot(*median_abs_deviation(flows, 0, scale="normal")) * np.sqrt(np.pi / 2.0) / np.sqrt(len(flows))
    assert found.flow_sd_px == pytest.approx(sd, rel=0.02)


@pytest.mark.parametrize(("bin_px", "stride"), [(1, 1), (3, 1), (3, 2), (4, 2), (5, 3)])
def test_a_binned_mean_is_the_mean_of_its_rows(bin_px: int, stride: int) -> None:
    images = np.random.default_rng(1).integers(0, 256, (6, 31, 43)).astype(np.uint8)
    sums = np.zeros((31 // bin_px, 43 // bin_px), np.uint32)
    for number in (1, 4, 5):
        _add_binned(images[number], bin_px, stride, sums)
    for j in range(sums.shape[0]):
        for i in range(sums.shape[1]):
            square = images[[1, 4, 5], j * bin_px : (j + 1) * bin_px : stride, i * bin_px : (i + 1) * bin_px]
            assert sums[j, i] == square.sum()


@pytest.mark.parametrize(("width", "bin_px", "stride"), [(400, 1, 1), (1300, 3, 1), (1603, 4, 2)])
def test_means_are_those_of_their_own_images_bin_by_bin(width: int, bin_px: int, stride: int) -> None:
    images = np.random.default_rng(2).integers(0, 256, (len(SEQUENCE), 37, width)).astype(np.uint8)
    found = means_of(images, SEQUENCE)
    rows, columns = 37 // bin_px, width // bin_px
    for mean, numbers in (
        (found.references, (SEQUENCE.bright, SEQUENCE.dark)),
        (found.x, X_SINE),
        (found.y, Y_SINE),
    ):
        image = images[list(numbers)].mean(0)[: rows * bin_px, : columns * bin_px]
        wanted = image.reshape(rows, bin_px, columns, bin_px)[:, ::stride].mean((1, 3))
        np.testing.assert_allclose(mean, wanted, rtol=1e-6)


def test_a_difference_is_what_is_neither_gain_nor_smooth_nor_an_outlier() -> None:
    rng = np.random.default_rng(6)
    v, u = np.mgrid[0:90, 0:120].astype(float)
    a = (80.0 + 20.0 * np.sin(u / 2.0) * np.sin(v / 3.0)).astype(np.float32)
    b = (0.9 * a + 0.05 * u + rng.normal(0.0, 1.0, a.shape)).astype(np.float32)
    b[rng.random(b.shape) < 0.01] += 40.0
    inside = (rng.random(a.shape) < 0.97) & (u > 10.0)
    gain = np.sum(a[inside] * b[inside]) / np.sum(a[inside] ** 2)
    rest = np.where(inside, b - gain * a, 0.0)
    smooth = uniform_filter(rest, 9, mode="mirror") / np.maximum(
        uniform_filter(inside.astype(float), 9, mode="mirror"), 1e-9
    )
    high = (rest - smooth)[inside]
    most = 2.5 * high.std()
    # Of a normal distribution, 0.986 is left between 2.5 standard deviations.
    wanted = np.clip(high, -most, most).std() / 0.986 / (gain * np.sqrt(0.7))
    assert _difference(a, b, _judged(inside), 0.7) == pytest.approx(wanted, rel=1e-3)


def light_over_surroundings(image: np.ndarray, valid: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    weight = uniform_filter(valid.astype(float), 15, mode="mirror")
    around = uniform_filter(np.where(valid, image, 0.0), 15, mode="mirror") / np.maximum(weight, 1e-9)
    scale = 500.0 / np.maximum(around, 1.0)
    return np.where(valid, np.clip(np.rint(128.0 + scale * (image - around)), 0, 255), 128.0), scale


def test_texture_is_the_light_over_its_surroundings() -> None:
    rng = np.random.default_rng(9)
    image = paint(120, 90, 7.0).astype(np.float32) + np.linspace(0.0, 100.0, 120, dtype=np.float32)
    image[:, :40] *= np.float32(0.005)  # next to no light: less than a grey value
    image[40:44, 60:64] = 250.0
    valid = rng.random(image.shape) < 0.9
    valid[60:, 70:] = False
    picture, scale = _texture(image, valid, _weights(valid))
    wanted, wanted_scale = light_over_surroundings(image, valid)
    assert (wanted == 255.0).any()
    assert picture.dtype == np.uint8
    assert np.abs(picture - wanted).max() <= 1.0
    assert np.mean(picture != wanted) < 0.01
    known = uniform_filter(valid.astype(float), 15, mode="mirror") > 0.01
    np.testing.assert_allclose(scale[known], wanted_scale[known], rtol=1e-3)


def test_points_are_followed_where_there_is_texture_in_every_direction() -> None:
    """Of the squared gradients' smaller eigenvalue over a window of 21 px, four times that of the noise."""
    first, second = (paint(400, 300, 7.0, (x, 0.0)).astype(np.float32) for x in (0.0, 0.4))
    fading = np.linspace(0.02, 1.0, 400, dtype=np.float32)
    for picture, x in ((first, 0.0), (second, 0.4)):
        picture[150:200] = 100.0 + 15.0 * np.sin((np.arange(400.0) - x) / 2.0)  # stripes: one direction
        picture[:] = 100.0 + fading * (picture - 100.0)
    inside = np.ones(first.shape, bool)
    inside[:, 330:345] = False
    picture, scale = light_over_surroundings(first, np.ones_like(inside))
    gx, gy = (np.where(inside, sobel(picture, axis) / 8.0, 0.0) for axis in (1, 0))
    xx, yy, xy = (uniform_filter(g, 21, mode="mirror") for g in (gx * gx, gy * gy, gx * gy))
    least = np.linalg.eigvalsh(np.stack([xx, xy, xy, yy], -1).reshape(*xx.shape, 2, 2))[..., 0]
    share = uniform_filter(inside.astype(float), 21, mode="mirror")
    at = [(int(25.0 * (j + 0.5)), int(25.0 * (i + 0.5))) for j in range(12) for i in range(16)]
    asked = [(v, u) for v, u in at if inside[v, u]]
    ratio = np.array([least[v, u] / (3.0 / 16.0 * scale[v, u] ** 2 * share[v, u]) for v, u in asked])
    for noise in (0.5, 1.0, 2.0, 4.0):
        flows = _follow(first, second, np.ones_like(inside), inside, noise)
        assert len(flows) == pytest.approx(np.count_nonzero(ratio > 4.0 * noise), abs=1)
        assert np.median(flows, 0) == pytest.approx((0.4, 0.0), abs=0.05)
    assert len(_follow(first, second, np.ones_like(inside), inside, 1e9)) == 0


def test_a_window_at_the_border_sees_the_picture_mirrored() -> None:
    rng = np.random.default_rng(3)
    picture, inside = rng.integers(0, 256, (30, 40)).astype(np.uint8), rng.random((30, 40)) < 0.9
    at = np.array([[0, 0], [39, 29], [3, 25], [20, 15]])
    found = np.empty((len(at), 4), np.float32)
    _structure(picture, inside, at, found)
    gx, gy = (np.where(inside, sobel(picture.astype(float), axis, mode="mirror") / 8.0, 0.0) for axis in (1, 0))
    wanted = [uniform_filter(g, 21, mode="mirror") for g in (gx * gx, gy * gy, gx * gy, inside.astype(float))]
    np.testing.assert_allclose(found, np.stack([w[at[:, 1], at[:, 0]] for w in wanted], -1), rtol=1e-5, atol=1e-4)


def test_what_does_not_lead_back_was_not_followed() -> None:
    """A third of the picture shows something else afterwards."""
    first, second = (paint(400, 300, 7.0, (x, 0.0)).astype(np.float32) for x in (0.0, 0.4))
    second[:, 250:] = paint(400, 300, 6.0)[::-1, ::-1][:, 250:]
    inside = np.ones(first.shape, bool)
    flows = _follow(first, second, inside, inside, 0.01)
    right = np.hypot(*(flows - (0.4, 0.0)).T) < 0.1
    assert np.count_nonzero(right) >= 9 * 12
    assert np.count_nonzero(~right) < 3 * 12


def still(found: TextureShift) -> bool:
    return found.flow_px is not None and float(np.hypot(*found.flow_px)) < 0.02


def test_a_beam_that_stays_with_the_instrument_is_no_texture_that_slides() -> None:
    """The paint goes left by a px; light that varies smoothly stays."""
    v, u = np.mgrid[0:300, 0:400].astype(float)
    beam = 0.7 + 0.3 * np.cos((u - 200.0) / 120.0) * np.cos((v - 150.0) / 120.0)
    pictures = beam * paint(400, 300, 7.0), beam * paint(400, 300, 7.0, (-1.0, 0.0))
    found = texture_shift(*seen((400, 300), *pictures), SEQUENCE, (0.72, 0.0))
    assert found.flow_px == pytest.approx((-1.0, 0.0), abs=0.03)
    assert still(texture_shift(*seen((400, 300), pictures[0], pictures[0]), SEQUENCE, (0.72, 0.0)))
