"""Offsets of patches that were moved by a known amount."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from appliance.desk.foreign.texture import texture_offset, textures_of

HEIGHT, WIDTH = 240, 320


def speckled(moved: tuple[float, float], width: int = WIDTH) -> np.ndarray[tuple[int, ...], np.dtype[np.uint8]]:
    """A speckle, moved by (u, v), on shading that stays where it is."""
    shape = (HEIGHT, width)
    speckle = cv2.GaussianBlur(np.random.default_rng(2).normal(0.0, 1.0, shape), (0, 0), 2.5)
    move = np.array([[1.0, 0.0, moved[0]], [0.0, 1.0, moved[1]]])
    there = cv2.warpAffine(speckle * 300.0, move, shape[::-1], flags=cv2.INTER_CUBIC)
    return np.clip(120.0 + there + np.linspace(-30, 30, shape[1]), 0, 255).astype(np.uint8)


def places(width: int = WIDTH) -> np.ndarray[tuple[int, ...], np.dtype[np.int64]]:
    v, u = np.mgrid[0:HEIGHT:9, 0:width:9]
    return np.stack([u.ravel(), v.ravel()], axis=1)


def test_a_large_image_is_reduced_and_its_offset_is_in_its_own_pixels() -> None:
    textures = textures_of(speckled((0.0, 0.0), 2000), speckled((0.0, 6.4), 2000))
    assert textures[0].shape == (HEIGHT // 2, 1000)
    said = texture_offset(textures, places(2000)[::4], places(2000)[::4].astype(float), True)
    assert said.median_px == pytest.approx(6.4, abs=0.1)


def test_what_is_smooth_repeats_or_lies_beyond_the_reach_tells_nothing() -> None:
    smooth = np.full((HEIGHT, WIDTH), 90, np.uint8)
    fringes = np.broadcast_to(100 + 50 * np.cos(np.arange(HEIGHT) * 0.7)[:, None], (HEIGHT, WIDTH)).astype(np.uint8)
    still = speckled((0.0, 0.0))
    pairs = [(smooth, smooth), (fringes, fringes), *((still, speckled((0.0, moved))) for moved in (60.0, 16.0, -16.0))]
    for left, right in pairs:
        assert not texture_offset(textures_of(left, right), places(), places().astype(float), True).tells
