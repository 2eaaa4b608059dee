"""What the Gray images say of a movement is what NumPy finds among the pixels that count, edge by edge and frame by frame."""

from __future__ import annotations

import numpy as np
import pytest

from appliance.patterns.sequence import Direction, build_sequence
from appliance.reconstruct.decode.decoder import CameraDecoder
from appliance.verdict.motion import edges as motion_edges
from appliance.verdict.motion.albedo import AlbedoShifts, albedo_shifts
from appliance.verdict.motion.edges import edge_shifts

SEQUENCE = build_sequence(16, 320, 200)
GRAY_X, GRAY_Y = SEQUENCE.axis(Direction.X).gray, SEQUENCE.axis(Direction.Y).gray
ROWS, COLUMNS = 4, 5

# --------------------------------------------------------------------------------------------------- edges


def striped(width: int, height: int) -> tuple[np.ndarray, CameraDecoder]:
    """Gray stripes with soft edges, moved by 0.4 px, over pixels whose coordinates are halves of px."""
    rng = np.random.default_rng(7)
    v, u = np.mgrid[0:height, 0:width].astype(float)
    p = np.round(2.0 * (-15.0 + 350.0 * u / width)) / 2.0
    p = np.where((v // 8) % 3 == 1, 316.0 - p, p)
    q = -12.0 + 280.0 * v / height
    q[20:24, 10:60], p[20:24, 10:60] = 0.0, 10.0
    p[30:34, 10:14] = 0.0
    p[rng.random(p.shape) < 0.05] = np.nan
    q[rng.random(q.shape) < 0.05] = np.nan
    dark = rng.integers(5, 40, p.shape)
    bright = dark + rng.choice([7, 8, 9, 60, 150], p.shape)
    frames = np.zeros((len(SEQUENCE), height, width), np.uint8)
    frames[SEQUENCE.bright], frames[SEQUENCE.dark] = bright, dark
    for k in GRAY_X:
        codes = SEQUENCE.patterns[k].codes() / 247.0
        soft = np.interp(np.nan_to_num(p) + 0.4 + np.array([[[-1.5]], [[0.0]], [[1.5]]]), np.arange(320), codes).mean(0)
        soft = np.where(q > 128.0, 0.45 * soft + 0.2, soft)
        frames[k] = np.clip(np.rint(dark + (bright - dark) * soft + rng.normal(0.0, 1.0, p.shape)), 0, 255)
    decoder = CameraDecoder(SEQUENCE, width, height)
    decoder.p_px[:], decoder.q_px[:] = p, q
    return frames, decoder


def light_taken_along(frames: np.ndarray, decoder: CameraDecoder, k: int, stride: int) -> np.ndarray:
    """(ROWS, COLUMNS): how far the edges of frame ``k`` have moved, cell by cell."""
    codes = SEQUENCE.patterns[k].codes().astype(int)
    edges = np.flatnonzero(np.diff(codes)) + 0.5
    ways = np.sign(np.diff(codes))[np.flatnonzero(np.diff(codes))]
    p, q = decoder.p_px.astype(float), decoder.q_px.astype(float)
    asked = np.zeros(p.shape, bool)
    asked[stride // 2 :: stride, stride // 2 :: stride] = True
    low, high = frames[SEQUENCE.dark].astype(float), frames[SEQUENCE.bright].astype(float)
    asked &= (p >= 0.0) & (q >= 0.0) & (np.floor(p + 0.5) < 320) & (high - low >= 8.0)
    out = np.full((ROWS, COLUMNS), np.nan)
    if not edges.size:
        return out
    nearest = np.abs(np.floor(np.nan_to_num(p) + 0.5)[..., None] - edges).argmin(-1)
    edge, way = edges[nearest], ways[nearest]
    asked &= np.abs(np.floor(p + 0.5) - edge) <= 7.5
    lit = (frames[k] - low) / np.maximum(high - low, 1.0)
    beside = way * (p - edge)
    for row in range(ROWS):
        for column in range(COLUMNS):
            cell = asked & (q // 64 == row) & (edge // 64 == column)
            inner = cell & (np.abs(beside) <= 4.5)
            before, after = cell & (beside < -4.5), cell & (beside > 4.5)
            if min(np.count_nonzero(x) for x in (inner, before, after)) < 10:
                continue
            dark, light = lit[before].mean(), lit[after].mean()
            if light - dark <= 0.3:
                continue
            moved = way * ((lit - dark) / (light - dark) - (beside > 0.0))
            out[row, column] = 9.0 * moved[inner].mean()
    return out


@pytest.mark.parametrize(("width", "height", "stride"), [(160, 120, 1), (450, 340, 2)])
def test_every_edge_takes_as_much_light_with_it_as_it_has_moved(width: int, height: int, stride: int) -> None:
    frames, decoder = striped(width, height)
    found = edge_shifts(frames, decoder, SEQUENCE).shift_px
    wanted = np.array([light_taken_along(frames, decoder, k, stride) for k in GRAY_X])
    assert np.isfinite(wanted).sum() > 30
    assert np.isnan(wanted).any()
    assert np.nanmedian(wanted) == pytest.approx(0.4, abs=0.15)
    np.testing.assert_allclose(found, wanted, rtol=1e-5, atol=1e-6)


def added(inner: float = 20.0, low: float = 12.0, high: float = 12.0, height: float = 0.8) -> np.ndarray:
    """Sums of an edge at which light begins, that has moved by 0.9 px: of 20 pixels over 9 px, two more are lit."""
    lit = inner * (0.1 + 0.6 * height)
    return np.array([[inner, lit, 0.5 * inner, inner, low, 0.1 * low, high, (0.1 + height) * high]])


def test_an_edge_that_moved_is_known_from_ten_pixels_of_each_part_and_from_enough_contrast() -> None:
    def shift(**parts: float) -> float:
        return float(motion_edges._solve(added(**parts))[0])

    assert shift() == pytest.approx(0.9)
    for part in ("inner", "low", "high"):
        assert shift(**{part: 10.0}) == pytest.approx(0.9)
        assert np.isnan(shift(**{part: 9.0}))
        assert np.isnan(shift(**{part: 0.0}))
    assert shift(height=0.31) == pytest.approx(0.9)
    assert np.isnan(shift(height=0.29))


def test_edges_of_what_lies_below_the_last_row_of_cells_are_added_nowhere() -> None:
    """Compiled code would write beyond the end of the sums and say nothing."""
    frames, decoder = striped(160, 120)
    edges_px, rises = motion_edges.edges_of(SEQUENCE)
    gray = np.array(GRAY_X, np.int64)
    sums = np.zeros((len(GRAY_X), ROWS + 1, COLUMNS, 8))
    motion_edges._accumulate(frames, (0, 1), gray, decoder.p_px, decoder.q_px, edges_px, rises, 1, 64.0, sums[:, :ROWS])
    assert (decoder.q_px > 256.0).any()
    assert (sums[:, :ROWS] > 0.0).any()
    assert (sums[:, ROWS] == 0.0).all()


def test_a_stripe_without_an_edge_has_none() -> None:
    edge_px, rises = motion_edges._edges(np.full(64, 247, np.uint8))
    assert edge_px.shape == rises.shape == (64,)
    assert np.isnan(edge_px).all()


# --------------------------------------------------------------------------------------------------- paint

NOISE = (1.2, 0.04)


def painted(width: int, height: int, way: bool = True) -> tuple[np.ndarray, CameraDecoder]:
    """Paint that lies somewhere else in every Gray image, under a light that grows; coordinates are anywhere."""
    rng = np.random.default_rng(3)
    v, u = np.mgrid[0:height, 0:width].astype(float)
    decoder = CameraDecoder(SEQUENCE, width, height)
    for coordinate, size in ((decoder.p_px, 320), (decoder.q_px, 200)):
        coordinate[:] = rng.integers(-2, 2 * size + 3, coordinate.shape) / 2.0
        coordinate[rng.random(coordinate.shape) < 0.05] = 0.0
        coordinate[rng.random(coordinate.shape) < 0.03] = np.nan
    dark = rng.integers(3, 30, u.shape)

    def light(du: float, dv: float) -> np.ndarray:
        x, y = u - du, v - dv
        return np.asarray(120.0 + 40.0 * np.sin(x / 4.0) * np.cos(y / 5.0) + 25.0 * np.sin(0.21 * x + 0.33 * y))

    frames = np.zeros((len(SEQUENCE), height, width), np.uint8)
    noise = rng.normal(0.0, 1.5, frames.shape)
    for k in range(len(SEQUENCE)):
        shift = (0.05 * k, -0.03 * k) if k in (*GRAY_X, *GRAY_Y) and way else (0.0, 0.0)
        gain = 1.0 + 0.01 * k if way else 1.0
        frames[k] = np.clip(np.rint(gain * light(*shift) + noise[k if way else 0]), 0, 254)
    frames[SEQUENCE.bright][rng.random(u.shape) < 0.001] = 255
    barely = rng.random(u.shape) < 0.1
    dark[barely] = frames[SEQUENCE.bright][barely] - rng.integers(14, 19, np.count_nonzero(barely))
    frames[SEQUENCE.dark] = dark
    return frames, decoder


def counted(frames: np.ndarray, decoder: CameraDecoder, k: int, reach: int, stride: int) -> np.ndarray:
    """(h, w) bool: pixels that frame ``k`` lights as the bright frame does, with paint on all sides."""
    pattern = SEQUENCE.patterns[k]
    at = decoder.p_px if pattern.direction is Direction.X else decoder.q_px
    codes = pattern.codes()
    edges = np.flatnonzero(np.diff(codes.astype(int))) + 0.5
    columns = np.arange(codes.size)
    far = np.abs(columns[:, None] - edges).min(1) > 8.0 if edges.size else np.full(codes.size, True)
    height, width = at.shape
    asked = np.zeros(at.shape, bool)
    asked[reach + stride // 2 : height - reach : stride, reach + stride // 2 : width - reach : stride] = True
    place = np.floor(np.nan_to_num(at, nan=-9.0))
    asked &= (at >= 0.0) & (at < codes.size - 1)
    asked &= (far & (codes > 0))[np.clip(place, 0, codes.size - 1).astype(int)]
    white, dark = frames[SEQUENCE.bright].astype(int), frames[SEQUENCE.dark].astype(int)
    asked &= (white - dark >= 16) & (white < 255)
    for axis in (0, 1):
        for step in (-reach, reach):
            asked &= np.roll(at, step, axis) >= 0.0
    return asked


def least_squares(
    frames: np.ndarray, here: np.ndarray, k: int, reach: int, noise: tuple[float, float]
) -> tuple[np.ndarray, float, float]:
    """Shift (2,), its sd, and the contrast of the gradients over noise where it is least."""
    white, dark = frames[SEQUENCE.bright].astype(float), frames[SEQUENCE.dark].astype(float)
    right, down = ((np.roll(white, -reach, a) - np.roll(white, reach, a)) / (2.0 * reach) for a in (1, 0))
    x = np.stack([white - dark, np.ones_like(white), right, down], -1)[here]
    y = (frames[k] - dark)[here]
    own = np.sum(noise[0] + noise[1] * white[here]) / (2.0 * reach**2)
    normal = x.T @ x
    contrast = float(np.linalg.eigvalsh(normal[2:, 2:])[0] / own)
    normal[[2, 3], [2, 3]] -= own
    fit = np.linalg.solve(normal, x.T @ y)
    rest = max(y @ y - fit @ (x.T @ y), 0.0) / (len(y) - 4)
    inverse = np.linalg.inv(normal)
    return -fit[2:], float(np.sqrt(0.5 * rest * (inverse[2, 2] + inverse[3, 3]))), contrast


@pytest.mark.parametrize(("width", "height", "reach", "stride"), [(160, 75, 1, 1), (640, 300, 2, 4)])
def test_paint_is_where_least_squares_find_it_in_every_gray_image(
    width: int, height: int, reach: int, stride: int
) -> None:
    frames, decoder = painted(width, height)
    found = albedo_shifts(frames, decoder, SEQUENCE, NOISE)
    known = np.isfinite(found.sd_px)
    assert known.sum() > 6
    assert not known[[SEQUENCE.bright, SEQUENCE.dark, *SEQUENCE.axis(Direction.X).sine]].any()
    for k in (*GRAY_X, *GRAY_Y):
        here = counted(frames, decoder, k, reach, stride)
        if np.count_nonzero(here) < 300:
            assert not known[k]
            continue
        shift, sd, _ = least_squares(frames, here, k, reach, NOISE)
        assert found.shift_px[k] == pytest.approx(shift, rel=1e-6, abs=1e-9)
        assert found.sd_px[k] == pytest.approx(sd, rel=1e-6)
        assert found.shift_px[k] == pytest.approx((0.05 * k, -0.03 * k), rel=0.3, abs=0.1)


def test_paint_that_lies_still_has_moved_by_nothing_for_certain() -> None:
    frames, decoder = painted(160, 75, way=False)
    frames[SEQUENCE.bright][frames[SEQUENCE.bright] == 255] = 254
    for k in (*GRAY_X, *GRAY_Y):
        frames[k] = frames[SEQUENCE.bright]
    found = albedo_shifts(frames, decoder, SEQUENCE, NOISE)
    known = np.isfinite(found.sd_px)
    assert known.any()
    np.testing.assert_allclose(found.shift_px[known], 0.0, atol=1e-9)
    np.testing.assert_allclose(found.sd_px[known], 0.0, atol=1e-6)
    assert found.double_step2 == pytest.approx(0.0, abs=1e-9)


def test_three_hundred_pixels_tell_where_the_paint_is_and_one_less_does_not() -> None:
    frames, decoder = painted(160, 75)
    k = GRAY_X[1]
    here = np.argwhere(counted(frames, decoder, k, 1, 1))
    for many, told in ((300, True), (299, False)):
        fewer = frames.copy()
        for v, u in here[many:]:
            fewer[SEQUENCE.dark, v, u] = fewer[SEQUENCE.bright, v, u]
        assert np.isfinite(albedo_shifts(fewer, decoder, SEQUENCE, NOISE).sd_px[k]) == told


def test_paint_whose_gradients_are_hardly_more_than_noise_is_not_followed() -> None:
    frames, decoder = painted(160, 75)
    k = GRAY_X[1]
    here = counted(frames, decoder, k, 1, 1)
    *_, contrast = least_squares(frames, here, k, 1, NOISE)
    for wanted, told in ((2.1, True), (1.9, False)):
        noise = NOISE[0] * contrast / wanted, NOISE[1] * contrast / wanted
        assert np.isfinite(albedo_shifts(frames, decoder, SEQUENCE, noise).sd_px[k]) == told


def course(shift: list[tuple[float, float]], sd: list[float]) -> AlbedoShifts:
    return AlbedoShifts(np.array(shift), np.array(sd))


def test_a_double_step_is_the_way_from_a_frame_to_the_next_but_one_without_its_noise() -> None:
    nan = float("nan")
    # 3-4-5 to the right and down, then back; the last is not known.
    moved = course([(0.0, 0.0), (1.0, 1.0), (0.3, 0.4), (1.0, 3.0), (nan, nan)], [0.1, 0.2, 0.3, 0.4, nan])
    first = 0.25 - 2.0 * (0.1**2 + 0.3**2)
    second = 4.0 - 2.0 * (0.2**2 + 0.4**2)
    assert moved.double_step2 == pytest.approx(0.5 * (first + second))
    assert course([(0.0, 0.0), (nan, nan), (0.1, 0.0)], [0.5, nan, 0.5]).double_step2 == 0.0, "less than its noise"
    assert course([(0.0, 0.0), (0.5, 0.1), (nan, 0.0)], [0.1, 0.1, 0.1]).double_step2 is None
