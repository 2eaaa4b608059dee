"""Paint between the x-sines and the y-sines: by how much it moved, and that what stands still differs by noise alone."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from appliance.measure.decode.decoder import CameraDecoder
from appliance.measure.light.patterns import Direction, build_sequence
from appliance.measure.verdicts.motion.scores import MOVED, texture_score
from appliance.measure.verdicts.motion.texture import TextureChange, follow_px, means_of, texture_change

SEQUENCE = build_sequence(16)
X_SINE, Y_SINE = SEQUENCE.axis(Direction.X).sine, SEQUENCE.axis(Direction.Y).sine
VARIANCE = (0.72, 0.0)
"""Of 0.8 grey values, and of rounding."""


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


def seen(first: np.ndarray, second: np.ndarray) -> tuple[np.ndarray, CameraDecoder]:
    """Frames: ``first`` under white and under the x-sines, ``second`` under the y-sines, and a noise of 0.8."""
    height, width = first.shape
    rng = np.random.default_rng(2)
    frames = np.zeros((len(SEQUENCE), height, width), np.uint8)
    images = dict.fromkeys(X_SINE, first) | dict.fromkeys(Y_SINE, second)
    images |= {SEQUENCE.bright: 2.0 * first - 10.0, SEQUENCE.dark: np.full_like(first, 10.0)}
    for k, image in images.items():
        frames[k] = np.clip(np.rint(image + 0.8 * rng.standard_normal(image.shape)), 0, 255)
    decoder = CameraDecoder(SEQUENCE, width, height)
    decoder.p_px[:], decoder.q_px[:] = 1.0, 1.0
    return frames, decoder


def told(frames: np.ndarray, decoder: CameraDecoder) -> TextureChange | None:
    return texture_change(frames, decoder, SEQUENCE, VARIANCE, means_of(frames, SEQUENCE))


@pytest.mark.parametrize(("width", "height", "bin_px"), [(400, 200, 1), (800, 200, 2), (1603, 203, 4)])
def test_paint_that_slides_changes_and_what_stands_still_differs_by_noise(width: int, height: int, bin_px: int) -> None:
    moved = (0.7 * bin_px, -0.4 * bin_px)
    found = told(*seen(paint(width, height, 7.0 * bin_px), paint(width, height, 7.0 * bin_px, moved)))
    assert found is not None
    assert found.late > 3.0
    assert found.early == pytest.approx(1.0, abs=0.05)


@pytest.mark.parametrize(
    ("width", "bin_px", "moved"), [(400, 1, (0.7, -0.4)), (800, 2, (1.4, -0.8)), (1603, 4, (30.0, 6.0)), (400, 1, (0.1, 0.2))]
)  # fmt: skip
def test_paint_is_followed_right_and_down_in_px_of_the_camera(
    width: int, bin_px: int, moved: tuple[float, float]
) -> None:
    frames, decoder = seen(paint(width, 200, 7.0 * bin_px), paint(width, 200, 7.0 * bin_px, moved))
    decoder.p_px[: 20 * bin_px] = np.nan
    found = follow_px(decoder, means_of(frames, SEQUENCE))
    assert found == (None if width == 400 and moved == (0.1, 0.2) else pytest.approx(moved, abs=0.04 * bin_px))


@pytest.mark.parametrize(("share", "followed"), [(0.15, True), (0.6, False)])
def test_a_picture_of_which_much_is_another_one_is_not_followed(share: float, followed: bool) -> None:
    after = (1.0 - share) * paint(400, 200, 7.0, (1.0, 0.0)) + share * paint(400, 200, 7.0)[::-1]
    frames, decoder = seen(paint(400, 200, 7.0), after)
    assert (follow_px(decoder, means_of(frames, SEQUENCE)) is not None) == followed


def test_fewer_than_two_hundred_pixels_away_from_borders_tell_nothing() -> None:
    frames, decoder = seen(paint(400, 300, 7.0), paint(400, 300, 7.0))
    for wide, known in ((204, True), (203, False)):
        decoder.p_px[:] = np.nan
        decoder.p_px[100:105, 50 : 50 + wide] = 1.0
        assert (told(frames, decoder) is not None) == known


def test_a_light_made_of_steps_is_no_texture_that_moves() -> None:
    """What four steps leave of such a light follows the fringes of each direction: at rest both means differ by it."""
    v, u = np.mgrid[0:300, 0:400].astype(float)
    p, q = 100.0 + 0.61 * u + 0.05 * v, 80.0 + 0.57 * v
    of_x, of_y = (1.0 + 0.05 * np.cos(8.0 * np.pi * at / 16.0 + 0.7) for at in (p, q))
    light, white = paint(400, 300, 9.0), [SEQUENCE.bright, SEQUENCE.dark]
    for moved, moves in (((0.0, 0.0), False), ((3.0, -1.5), True)):
        frames, decoder = seen(light * of_x, paint(400, 300, 9.0, moved) * of_y)
        frames[white] = seen(light, light)[0][white]
        decoder.p_px[:], decoder.q_px[:] = p, q
        found = told(frames, decoder)
        assert found is not None
        assert found.locked > 2.0, "without the fringes' part the difference would be several times the noise"
        assert ((texture_score({"left": found}) or 0.0) > MOVED) == moves
