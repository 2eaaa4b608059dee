"""Live images say before the scan what it would fail for: by light, glow and corners that hw_sim's rules make, drawn here."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from appliance.capture.aiming import look, moved_px, too_fast
from appliance.capture.fault import FaultCode

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
