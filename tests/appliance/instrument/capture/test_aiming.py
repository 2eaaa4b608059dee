"""Live images say before the scan what it would fail for: by light, glow and corners that hw_sim's rules make, drawn here."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from appliance.instrument.capture.aiming import LiveImage, displacement_px, measure_image, too_fast
from appliance.measure.fault import FaultCode

BLACK_DN = 2.0
SIZE = (300, 400)
Image = NDArray[np.uint8]


def picture(light_dn: float, glow_dn: float = 0.0, shift_px: tuple[float, float] = (0.0, 0.0), seed: int = 0) -> Image:
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


@pytest.mark.parametrize(
    ("light_dn", "glow_dn", "code"),
    [
        (30.0, 0.0, None), (200.0, 0.0, None), (60.0, 60.0, None), (0.0, 0.0, FaultCode.AIM_DARK), (10.0, 0.0, FaultCode.AIM_DARK),
        (2.0, 12.0, FaultCode.AIM_TURBID),
    ],
)  # fmt: skip
def test_what_a_scan_would_fail_for_is_seen_in_the_live_picture(
    light_dn: float, glow_dn: float, code: FaultCode | None
) -> None:
    fault = measure_image(picture(light_dn, glow_dn), BLACK_DN).fault()
    assert (None if fault is None else fault.code) is code
    if fault is not None and glow_dn:
        assert fault.numbers["glow_dn"] == pytest.approx(glow_dn, abs=3.0)


@pytest.mark.parametrize(
    ("detail_dn", "glow_dn", "code"),
    [
        (5.0, 200.0, None), (4.8, 24.0, FaultCode.AIM_TURBID), (4.8, 23.0, FaultCode.AIM_DARK), (2.0, 11.0, FaultCode.AIM_TURBID),
        (2.0, 9.0, FaultCode.AIM_DARK), (0.3, 5.0, FaultCode.AIM_TURBID), (0.3, 4.5, FaultCode.AIM_DARK), (0.0, 0.0, FaultCode.AIM_DARK),
    ],
)  # fmt: skip
def test_turbid_is_what_shines_five_times_as_much_as_it_shows(
    detail_dn: float, glow_dn: float, code: FaultCode | None
) -> None:
    fault = LiveImage(np.zeros((1, 1), np.uint8), detail_dn, glow_dn).fault()
    assert (None if fault is None else fault.code) == code
    assert fault is None or dict(fault.numbers) == {"detail_dn": detail_dn, "glow_dn": glow_dn}


@pytest.mark.parametrize(("share", "counts"), [(0.013, False), (0.03, True)])
def test_detail_counts_from_a_fiftieth_of_the_picture_on(share: float, counts: bool) -> None:
    image = np.full(SIZE, 10, np.uint8)
    points = round(share * 150 * 200)
    y, x = np.divmod(np.random.default_rng(1).choice(30 * 40, points // 9, replace=False), 40)
    for row, column in zip(10 * y, 10 * x, strict=True):  # spots of 3 x 3 px of the reduced image
        image[row : row + 6, column : column + 6] = 110
    assert (measure_image(image, 0.0).detail_dn > 50.0) == counts


@pytest.mark.parametrize(("size", "small"), [((1200, 1600), (150, 200)), ((1, 900), (1, 200))])
def test_images_are_looked_at_in_200_px_of_width_and_keep_their_form(
    size: tuple[int, int], small: tuple[int, int]
) -> None:
    seen = measure_image(np.full(size, 30, np.uint8), 4.0)
    assert seen.small.shape == small
    assert np.all(seen.small == 30)
    assert (seen.detail_dn, seen.glow_dn) == pytest.approx((0.0, 26.0), abs=1e-3), "over the black level"


def test_detail_is_what_is_finer_than_a_fortieth_of_the_picture() -> None:
    x = np.arange(SIZE[1])
    stripes = np.tile(np.where(x // 20 % 2, 200, 0).astype(np.uint8), (SIZE[0], 1))
    sharp, soft = (
        measure_image(np.asarray(cv2.GaussianBlur(stripes, (0, 0), sd), np.uint8), 0.0).detail_dn for sd in (1.0, 8.0)
    )
    assert sharp > 80.0
    assert 8.0 < soft < 45.0
    for periods in (1, 5):  # of a wave of 90 grey values, of which a blur of 5 px of 200 leaves that part
        wave = np.rint(100.0 + 90.0 * np.cos(periods * np.linspace(0.0, 2.0 * np.pi, SIZE[1]))).astype(np.uint8)
        left = np.exp(-0.5 * (5.0 * 2.0 * np.pi * periods / 200.0) ** 2)
        seen = measure_image(np.tile(wave, (SIZE[0], 1)), 0.0)
        assert seen.detail_dn == pytest.approx(90.0 * (1.0 - left), abs=1.5)


def moved(x_px: float = 0.0, y_px: float = 0.0) -> Image:
    return picture(200.0, shift_px=(x_px, y_px), seed=1)


def joined(first: Image, *others: tuple[int, Image]) -> Image:
    image = first.copy()
    for row, other in others:
        image[row:] = other[row:]
    return image


def swum(patch_px: int) -> Image:
    image, patch = picture(200.0), np.s_[50 : 50 + patch_px, 100 : 100 + patch_px]
    image[patch] = moved(10.0)[patch]
    return image


def turned() -> Image:
    turn = cv2.getRotationMatrix2D((200.0, 150.0), 6.0, 1.0)
    return np.asarray(cv2.warpAffine(picture(200.0), turn, SIZE[::-1], borderMode=cv2.BORDER_REFLECT), np.uint8)


@pytest.mark.parametrize(
    ("after", "found_px"),
    [
        *((moved(x, y), float(np.hypot(x, y)) / 2.0) for x, y in ((48.0, 0.0), (-30.0, 20.0), (8.0, 8.0), (1.6, 0.0), (0.0, -1.2))),
        (moved(), 0.0),  # noise alone
        (joined(moved(-10.0), (210, moved(10.0))), 5.0),
        (joined(moved(-10.0), (90, moved(10.0))), 5.0),  # that of the greater part
        (joined(moved(-10.0), (100, moved(10.0)), (200, moved(0.0, 10.0))), 0.0),
        # Three parts of which the middle one is two fifths: within three tenths of the way it is one motion, beyond it is none.
        (joined(moved(16.0), (90, moved(20.0)), (210, moved(24.0))), 10.0),
        (joined(moved(11.0), (90, moved(20.0)), (210, moved(29.0))), 0.0),
        (joined(moved(12.0), (120, picture(200.0))), 6.0),  # the rest is what the live light makes
        (swum(20), 0.0), (swum(150), 5.0),  # a fish is less than a fiftieth of the picture
        (turned(), 0.0),
    ],
)  # fmt: skip
def test_motion_is_that_of_the_greater_part_in_px_of_the_reduced_image(after: Image, found_px: float) -> None:
    found = displacement_px(measure_image(picture(200.0), BLACK_DN), measure_image(after, BLACK_DN))
    assert found == (pytest.approx(found_px, rel=0.15, abs=0.05) if found_px else 0.0)


def test_where_nothing_can_be_followed_no_motion_is_told() -> None:
    flat = [measure_image(np.full(SIZE, grey, np.uint8), BLACK_DN) for grey in (20, 200)]
    weak = measure_image(picture(8.0), BLACK_DN), measure_image(picture(40.0, shift_px=(12.0, 0.0), seed=1), BLACK_DN)
    assert displacement_px(*flat) is displacement_px(*weak) is None
    still = measure_image(picture(200.0), BLACK_DN)
    other = measure_image(np.asarray(255 - picture(200.0)[::-1, ::-1], np.uint8), BLACK_DN)
    flickers = measure_image(picture(230.0, seed=1), BLACK_DN)
    assert all(displacement_px(still, after) in (None, 0.0) for after in (other, flickers))


@pytest.mark.parametrize(("speed_mm_s", "fast"), [(60.0, False), (70.0, False), (71.4, True), (100.0, True)])
def test_the_speed_from_which_on_motion_cannot_be_undone(speed_mm_s: float, fast: bool) -> None:
    fault = too_fast(speed_mm_s)
    assert (fault is not None) == fast
    assert fault is None or (fault.code, fault.numbers["speed_mm_s"]) == (FaultCode.AIM_FAST, speed_mm_s)
