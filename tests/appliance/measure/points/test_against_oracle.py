"""The kernels agree with the plain float64 oracle on noisy frames of every period, also where sizes are odd."""

from __future__ import annotations

import numpy as np
import pytest

from appliance.measure.decode.decoder import (
    MAX_GRAY_DISAGREEMENT,
    MIN_CONTRAST_DN,
    MIN_MODULATION_DN,
    CameraDecoder,
    Mask,
)
from appliance.measure.light.patterns import Direction, build_sequence
from tests.support import oracle, synthetic

NORMAL = np.array([-0.2, 0.15, 1.0]) / np.linalg.norm([-0.2, 0.15, 1.0])


def noisy_scan(period_px: int, width_px: int, height_px: int) -> np.ndarray:
    """Left frames of a plane."""
    cal, sequence = synthetic.calibration(width_px, height_px), build_sequence(period_px)
    image = synthetic.frames(sequence, synthetic.wall_px(cal, NORMAL)["left"])
    noise = 1.6 * np.random.default_rng(period_px).standard_normal(image.shape)
    return np.clip(np.rint(image + noise), 0, 255).astype(np.uint8)


@pytest.mark.parametrize(("period_px", "size_px"), [(16, (400, 300)), (21, (333, 251))])
def test_every_reason_for_a_mask(period_px: int, size_px: tuple[int, int]) -> None:
    """Two surfaces with a step between, a hot corner, a dim one, a dark hole, and a band where the code is wrong."""
    width, height = size_px
    sequence = build_sequence(period_px)
    stack = noisy_scan(period_px, width, height).astype(float)
    stack[:, :, width // 2 :] = np.roll(stack[:, :, width // 2 :], 7, axis=1)
    stack[:, : height // 4, : width // 3] *= 1.6
    mean = stack.mean(0)
    stack[2:, 3 * height // 4 :, : width // 2] = 0.03 * stack[2:, 3 * height // 4 :, : width // 2] + 80.0
    stack[:, 100:110, 150:170] = 5.0
    for k in sequence.axis(Direction.Y).gray[-1:]:
        stack[k, 60:64, 200:260] = 2 * mean[60:64, 200:260] - stack[k, 60:64, 200:260]
    frames = np.clip(np.rint(stack), 0, 255).astype(np.uint8)
    decoder = CameraDecoder(sequence, width, height)
    for k in range(len(sequence)):
        decoder.push(frames, k)
    step_px, noise_px = 1024.0 / width, period_px / 45.0
    limits = oracle.MaskLimits(
        MIN_CONTRAST_DN,
        MIN_MODULATION_DN,
        MAX_GRAY_DISAGREEMENT,
        4 * step_px + 4 * noise_px,
        0.9 * step_px + 2.5 * noise_px,
    )
    expected = oracle.masks(sequence, frames, limits)
    assert set(np.unique(expected)) == {reason.value for reason in Mask}, "the scene shows every reason"
    # A float32 on a limit may fall on the other side of it.
    assert np.count_nonzero(decoder.mask != expected) <= 2
    assert (np.isfinite(decoder.p_px) == (decoder.mask == Mask.VALID)).all()
    assert (np.isfinite(decoder.q_px) == (decoder.mask == Mask.VALID)).all()


def test_nothing_of_the_scan_before_remains() -> None:
    """Light moves across the image from scan to scan, one of which is broken off; the maps are those of a new decoder."""
    width, height = 333, 251
    sequence = build_sequence(32)
    whole = noisy_scan(32, width, height)
    used = CameraDecoder(sequence, width, height)
    every = len(sequence)
    for first, stop, frames in ((0, 333, every), (30, 100, every), (150, 310, 15), (90, 200, every)):
        stack = np.full_like(whole, 5)
        stack[:, 20:200, first:stop] = whole[:, 20:200, first:stop]
        used.reset()
        for k in range(frames):
            used.push(stack, k)
    new = CameraDecoder(sequence, width, height)
    for k in range(len(sequence)):
        new.push(stack, k)
    assert new.illuminated_pixels > 10_000
    assert used.illuminated_pixels == new.illuminated_pixels == np.count_nonzero(new.mask != Mask.SHADOW)
    np.testing.assert_array_equal(used.mask, new.mask)
    np.testing.assert_array_equal(used.p_px, new.p_px)
    np.testing.assert_array_equal(used.q_px, new.q_px)
