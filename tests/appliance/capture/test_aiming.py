"""Live images say before the scan what it would fail for: by light, glow and corners that hw_sim's rules make, drawn here."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from appliance.capture.aiming import Aimed, look, moved_px, too_fast
from appliance.scan.fault import FaultCode

BLACK_DN = 2.0
SIZE = (300, 400)


def picture(
    light_dn: float, glow_dn: float = 0.0, shift_px: tuple[float, float] = (0.0, 0.0), seed: int = 0
) -> NDArray[np.uint8]:
    """Blobs of paint on an object that sends ``light_dn`` of grey values, behind a smooth glow, with a camera's noise."""
    rng = np.random.default_rng(3)
    paint = cv2.GaussianBlur(rng.uniform(0.0, 1.0, (380, 480)).astype(np.float32), (0, 0), 5.0)
    paint = np.clip((paint - paint.mean()) / (4.0 * paint.std()) + 0.5, 0.0, 1.0).astype(np.float32)
    place = np.array([[1.0, 0.0, shift_px[0] - 40.0], [0.0, 1.0, shift_px[1] - 40.0]])
    seen = cv2.warpAffine(paint, place, SIZE[::-1], flags=cv2.INTER_LINEAR)
    y, x = np.mgrid[-1.0 : 1.0 : SIZE[0] * 1j, -1.0 : 1.0 : SIZE[1] * 1j]
    mean = BLACK_DN + light_dn * seen + glow_dn * np.exp(-(x**2 + y**2))
    noisy = mean + np.random.default_rng(seed).normal(0.0, 1.0, SIZE) * np.sqrt(0.5 + 0.02 * mean)
    return np.asarray(np.clip(np.rint(noisy), 0, 255), np.uint8)


def test_an_object_in_ordinary_light_is_not_warned_of() -> None:
    for light_dn in (30.0, 80.0, 200.0):
        assert look(picture(light_dn), BLACK_DN).fault() is None


def test_a_black_picture_is_warned_of_before_the_scan() -> None:
    """It said READY over a black picture."""
    fault = look(picture(0.0), BLACK_DN).fault()
    assert fault is not None
    assert fault.code is FaultCode.AIM_DARK


def test_water_that_shines_and_shows_nothing_is_too_turbid() -> None:
    fault = look(picture(2.0, glow_dn=12.0), BLACK_DN).fault()
    assert fault is not None
    assert fault.code is FaultCode.AIM_TURBID
    assert fault.numbers["glow_dn"] == pytest.approx(12.0, abs=3.0)


def test_an_object_in_little_light_is_dark_and_not_turbid() -> None:
    fault = look(picture(10.0), BLACK_DN).fault()
    assert fault is not None
    assert fault.code is FaultCode.AIM_DARK


def test_what_is_seen_through_a_veil_is_not_warned_of() -> None:
    assert look(picture(60.0, glow_dn=60.0), BLACK_DN).fault() is None


@pytest.mark.parametrize("shift_px", [(6.0, 0.0), (0.0, -9.0), (8.0, 8.0)])
def test_motion_is_measured_in_px_of_the_reduced_image(shift_px: tuple[float, float]) -> None:
    """Images of 400 px are looked at in 200."""
    before, after = look(picture(100.0), BLACK_DN), look(picture(100.0, shift_px=shift_px, seed=1), BLACK_DN)
    assert moved_px(before, after) == pytest.approx(float(np.hypot(*shift_px)) / 2.0, rel=0.05)


def test_what_is_at_rest_does_not_move_by_noise() -> None:
    before, after = look(picture(100.0), BLACK_DN), look(picture(100.0, seed=1), BLACK_DN)
    assert moved_px(before, after) == 0.0


def test_a_lamp_that_flickers_moves_nothing() -> None:
    before, after = look(picture(100.0), BLACK_DN), look(picture(130.0, seed=1), BLACK_DN)
    assert moved_px(before, after) in (0.0, None)


def test_only_what_cannot_be_undone_is_too_fast() -> None:
    assert too_fast(60.0) is None
    fault = too_fast(100.0)
    assert fault is not None
    assert fault.code is FaultCode.AIM_FAST
    assert fault.numbers["speed_mm_s"] == 100.0


@pytest.mark.parametrize(
    ("detail_dn", "glow_dn", "code"),
    [
        (6.0, 200.0, None),
        (5.0, 200.0, None),
        (4.8, 30.0, FaultCode.AIM_TURBID),
        (4.8, 24.0, FaultCode.AIM_TURBID),
        (4.8, 23.0, FaultCode.AIM_DARK),
        (2.0, 11.0, FaultCode.AIM_TURBID),
        (2.0, 9.0, FaultCode.AIM_DARK),
        (0.3, 5.0, FaultCode.AIM_TURBID),
        (0.3, 4.5, FaultCode.AIM_DARK),
        (0.0, 0.0, FaultCode.AIM_DARK),
    ],
)
def test_turbid_is_what_shines_five_times_as_much_as_it_shows(
    detail_dn: float, glow_dn: float, code: FaultCode | None
) -> None:
    fault = Aimed(np.zeros((1, 1), np.uint8), detail_dn, glow_dn).fault()
    assert (None if fault is None else fault.code) == code
    if fault is not None:
        assert dict(fault.numbers) == {"detail_dn": detail_dn, "glow_dn": glow_dn}


def test_the_glow_is_told_over_the_black_level() -> None:
    seen = look(np.full(SIZE, 30, np.uint8), 4.0)
    assert (seen.detail_dn, seen.glow_dn) == pytest.approx((0.0, 26.0), abs=1e-3)


@pytest.mark.parametrize(("share", "counts"), [(0.013, False), (0.03, True)])
def test_detail_counts_from_a_fiftieth_of_the_picture_on(share: float, counts: bool) -> None:
    """Laser dots and their streaks are less."""
    image = np.full(SIZE, 10, np.uint8)
    points = round(share * 150 * 200)
    y, x = np.divmod(np.random.default_rng(1).choice(30 * 40, points // 9, replace=False), 40)
    for row, column in zip(10 * y, 10 * x, strict=True):  # spots of 3 x 3 px of the reduced image
        image[row : row + 6, column : column + 6] = 110
    assert (look(image, 0.0).detail_dn > 50.0) == counts


@pytest.mark.parametrize(("size", "small"), [((300, 400), (150, 200)), ((1200, 1600), (150, 200)), ((400, 400), (200, 200)), ((1, 900), (1, 200))])  # fmt: skip
def test_images_are_looked_at_in_200_px_of_width_and_keep_their_form(
    size: tuple[int, int], small: tuple[int, int]
) -> None:
    seen = look(np.full(size, 9, np.uint8), 0.0)
    assert seen.small.shape == small
    assert np.all(seen.small == 9)


def blurred(sigma_px: float) -> float:
    """Detail of stripes whose edges are so soft, of full contrast, 40 px apart in the picture."""
    x = np.arange(SIZE[1])
    stripes = np.tile(np.where(x // 20 % 2, 200, 0).astype(np.uint8), (SIZE[0], 1))
    return look(np.asarray(cv2.GaussianBlur(stripes, (0, 0), sigma_px), np.uint8), 0.0).detail_dn


def test_detail_is_what_is_finer_than_a_fortieth_of_the_picture() -> None:
    """Fringes are finer, and a glow is smoother."""
    assert blurred(1.0) > 80.0
    assert 8.0 < blurred(8.0) < 45.0
    x = np.linspace(0.0, 2.0 * np.pi, SIZE[1])
    for periods in (1, 5):  # of a wave of 90 grey values, of which a blur of 5 px of 200 leaves that part
        wave = np.tile(np.rint(100.0 + 90.0 * np.cos(periods * x)).astype(np.uint8), (SIZE[0], 1))
        left = np.exp(-0.5 * (5.0 * 2.0 * np.pi * periods / 200.0) ** 2)
        assert look(wave, 0.0).detail_dn == pytest.approx(90.0 * (1.0 - left), abs=1.5)


@pytest.mark.parametrize("shift_px", [(48.0, 0.0), (-30.0, 20.0), (1.6, 0.0), (0.0, -1.2)])
def test_motion_is_measured_from_less_than_a_px_to_an_eighth_of_the_picture(shift_px: tuple[float, float]) -> None:
    before, after = look(picture(200.0), BLACK_DN), look(picture(200.0, shift_px=shift_px, seed=1), BLACK_DN)
    assert moved_px(before, after) == pytest.approx(float(np.hypot(*shift_px)) / 2.0, rel=0.06)


def joined(first: NDArray[np.uint8], second: NDArray[np.uint8], rows: int) -> NDArray[np.uint8]:
    """The first image's upper ``rows``, and the second one below."""
    return np.vstack([first[:rows], second[rows:]])


@pytest.mark.parametrize("rows", [300, 210, 90], ids=["all", "most", "few"])
def test_what_moves_in_two_ways_moves_by_that_of_the_greater_part(rows: int) -> None:
    """Here a part goes to the left and the other to the right."""
    still = picture(200.0)
    left, right = (picture(200.0, shift_px=(by, 0.0), seed=1) for by in (-10.0, 10.0))
    found = moved_px(look(still, BLACK_DN), look(joined(left, right, rows), BLACK_DN))
    assert found == pytest.approx(5.0, rel=0.1)


def test_what_moves_in_three_ways_does_not_move_as_one() -> None:
    still = picture(200.0)
    left, right, up = (picture(200.0, shift_px=by, seed=1) for by in ((-10.0, 0.0), (10.0, 0.0), (0.0, 10.0)))
    assert moved_px(look(still, BLACK_DN), look(joined(left, joined(right, up, 200), 100), BLACK_DN)) == 0.0


@pytest.mark.parametrize(("by_px", "alike"), [((16.0, 20.0, 24.0), True), ((11.0, 20.0, 29.0), False)])
def test_what_moves_nearly_alike_moves_as_one(by_px: tuple[float, float, float], alike: bool) -> None:
    """Three parts of which the middle one is two fifths: within three tenths of the way it is one motion, beyond it is none."""
    still = picture(200.0)
    upper, middle, lower = (picture(200.0, shift_px=(by, 0.0), seed=1) for by in by_px)
    found = moved_px(look(still, BLACK_DN), look(joined(upper, joined(middle, lower, 210), 90), BLACK_DN))
    assert found == (pytest.approx(10.0, rel=0.12) if alike else 0.0)


def test_a_turn_about_the_middle_moves_nothing_as_one() -> None:
    still = picture(200.0)
    turn = cv2.getRotationMatrix2D((200.0, 150.0), 6.0, 1.0)
    turned = np.asarray(cv2.warpAffine(still, turn, SIZE[::-1], borderMode=cv2.BORDER_REFLECT), np.uint8)
    assert moved_px(look(still, BLACK_DN), look(turned, BLACK_DN)) == 0.0


def test_what_stands_beside_something_that_moves_does_not_count() -> None:
    """The object moves in two fifths of the picture; the rest is what the live light makes."""
    still, moving = picture(200.0), picture(200.0, shift_px=(12.0, 0.0), seed=1)
    found = moved_px(look(still, BLACK_DN), look(joined(moving, still, 120), BLACK_DN))
    assert found == pytest.approx(6.0, rel=0.1)


@pytest.mark.parametrize(("patch_px", "moves"), [(20, False), (150, True)])
def test_a_fish_is_no_motion_of_the_hands(patch_px: int, moves: bool) -> None:
    """What changes less than a fiftieth of the picture."""
    still, moving = picture(200.0), picture(200.0, shift_px=(10.0, 0.0), seed=1)
    swum = still.copy()
    swum[50 : 50 + patch_px, 100 : 100 + patch_px] = moving[50 : 50 + patch_px, 100 : 100 + patch_px]
    assert moved_px(look(still, BLACK_DN), look(swum, BLACK_DN)) == (pytest.approx(5.0, rel=0.15) if moves else 0.0)


def test_of_a_picture_without_contrast_no_motion_is_told() -> None:
    before, after = look(picture(8.0), BLACK_DN), look(picture(40.0, shift_px=(12.0, 0.0), seed=1), BLACK_DN)
    assert before.detail_dn < 6.0
    assert moved_px(before, after) is None
    bright = look(np.full(SIZE, 200, np.uint8), BLACK_DN)
    assert moved_px(look(np.full(SIZE, 20, np.uint8), BLACK_DN), bright) is None


def test_what_is_not_seen_again_is_not_followed() -> None:
    """Another scene altogether: no corner is found forth and back."""
    other = np.asarray(255 - picture(200.0)[::-1, ::-1], np.uint8)
    assert moved_px(look(picture(200.0), BLACK_DN), look(other, BLACK_DN)) in (None, 0.0)


@pytest.mark.parametrize(("speed_mm_s", "said"), [(69.6, None), (70.0, None), (71.4, "71 mm/s across the picture")])
def test_the_speed_from_which_on_motion_cannot_be_undone(speed_mm_s: float, said: str | None) -> None:
    fault = too_fast(speed_mm_s)
    assert (None if fault is None else fault.detail) == said
