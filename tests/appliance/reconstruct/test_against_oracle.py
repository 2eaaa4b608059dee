"""The kernels agree with the plain float64 oracle on noisy frames of every period, also where sizes are odd."""

from __future__ import annotations

import numpy as np
import pytest

from appliance.optics.rays import ray_lattice
from appliance.patterns.sequence import Direction, build_sequence
from appliance.reconstruct.decode.decoder import (
    MAX_GRAY_DISAGREEMENT,
    MIN_CONTRAST_DN,
    MIN_MODULATION_DN,
    CameraDecoder,
    Mask,
)
from appliance.reconstruct.pipeline import Pipeline
from appliance.reconstruct.scratch import SIZE, SX2, SY2, X2, Y2, U, V, Z
from appliance.reconstruct.triangulate import rays_of, triangulate_row
from tests.support import oracle, synthetic

NORMAL = np.array([-0.2, 0.15, 1.0]) / np.linalg.norm([-0.2, 0.15, 1.0])


def noisy_scan(period_px: int, width_px: int, height_px: int) -> dict[str, np.ndarray]:
    cal = synthetic.calibration(width_px, height_px)
    sequence = build_sequence(period_px)
    index = synthetic.WATER.index
    offset = float(NORMAL @ cal.rig.volume_centre_mm(index))
    rng = np.random.default_rng(period_px)
    out = {}
    for side, camera in (("left", cal.rig.left), ("right", cal.rig.right)):
        pq = synthetic.projector(cal).project(synthetic.plane_points(camera, NORMAL, offset), index)
        image = synthetic.frames(sequence, pq)
        out[side] = np.clip(np.rint(image + 1.6 * rng.standard_normal(image.shape)), 0, 255).astype(np.uint8)
    return out


@pytest.mark.parametrize("period_px", [16, 21, 32, 64])
@pytest.mark.parametrize("size_px", [(400, 300), (333, 251)])
def test_decoding(period_px: int, size_px: tuple[int, int]) -> None:
    sequence = build_sequence(period_px)
    stack = noisy_scan(period_px, *size_px)["left"]
    decoder = CameraDecoder(sequence, *size_px)
    for k in range(len(sequence)):
        decoder.push(stack, k)
    expected = oracle.decode(sequence, stack)
    shadow = stack[sequence.bright].astype(int) - stack[sequence.dark] < MIN_CONTRAST_DN
    np.testing.assert_array_equal(decoder.mask == Mask.SHADOW, shadow)
    valid = decoder.mask == Mask.VALID
    assert valid.mean() > 0.6
    got = np.stack([decoder.p_px, decoder.q_px], -1)[valid]
    assert np.abs(got - expected.pq[valid]).max() < 2e-4, "float32 against float64"
    assert (expected.modulation[valid] >= MIN_MODULATION_DN - 1e-3).all()
    half_dn = decoder.modulation_half_dn[valid]
    assert np.abs(half_dn / 2 - expected.modulation[valid]).max() < 0.2501, "half grey values"
    assert (np.abs(expected.offset[valid]) <= MAX_GRAY_DISAGREEMENT + 1e-4).all()


@pytest.mark.parametrize("period_px", [16, 21, 32, 64])
@pytest.mark.parametrize("size_px", [(400, 300), (333, 251)])
def test_every_reason_for_a_mask(period_px: int, size_px: tuple[int, int]) -> None:
    """Two surfaces with a step between, a hot corner, a dim one, a dark hole, and a band where the code is wrong."""
    width, height = size_px
    sequence = build_sequence(period_px)
    stack = noisy_scan(period_px, width, height)["left"].astype(float)
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


@pytest.mark.parametrize("period_px", [16, 32, 64])
def test_points(period_px: int) -> None:
    cal = synthetic.calibration()
    sequence = build_sequence(period_px)
    stacks = noisy_scan(period_px, 400, 300)
    pipeline = Pipeline(cal, synthetic.WATER, sequence)
    for side, stack in stacks.items():
        for k in range(len(sequence)):
            pipeline.push(side, stack, k)
    pipeline.coarse()
    cloud = pipeline.full()
    left, right = oracle.decode(sequence, stacks["left"]), oracle.decode(sequence, stacks["right"])
    v, u = np.divmod(cloud.pixel.astype(np.int64), 400)
    right_valid = np.isfinite(pipeline.decoded("right").p_px)
    right_uv = oracle.match(left.pq[v, u], right.pq, right_valid)
    found = np.isfinite(right_uv).all(-1)
    assert found.mean() > 0.99
    points, gap = oracle.triangulate(
        cal, synthetic.WATER.index, np.stack([u, v], -1)[found].astype(float), right_uv[found]
    )
    difference = np.linalg.norm(cloud.points_mm[found] - points, axis=1)
    assert np.median(difference) < 0.0015, "lattice interpolation and float32"
    # Noise lets some points start from a neighbouring right pixel: another sample of the same noise.
    assert np.quantile(difference, 0.85) < 0.004
    assert np.quantile(difference, 0.999) < 8 * np.median(cloud.sigma_mm)
    np.testing.assert_allclose(np.median(cloud.ray_gap_mm[found]), np.median(gap), rtol=0.02)


def test_lattice_rays_pass_the_left_pixels() -> None:
    cal = synthetic.calibration()
    lattice = ray_lattice(cal.rig.right, synthetic.WATER.index, 535.0)
    origin, direction = cal.rig.right.rays(np.array([40.0, 60.0]), synthetic.WATER.index)
    node = lattice.nodes[60 // lattice.step_px, 40 // lattice.step_px]
    at = origin + direction * (535.0 - origin[2]) / direction[2]
    np.testing.assert_allclose(node[:2], at[:2], atol=1e-4)


def test_nothing_of_the_scan_before_remains() -> None:
    """Light moves across the image from scan to scan, one of which is broken off; the maps are those of a new decoder."""
    width, height = 333, 251
    sequence = build_sequence(32)
    whole = noisy_scan(32, width, height)["left"]
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


def test_rays_asked_block_by_block_are_those_of_each_pixel() -> None:
    """Also where neighbours see different surfaces, where some have no match, and beyond the image."""
    cal = synthetic.calibration(1600, 1200)
    right, index = cal.rig.right, synthetic.WATER.index
    rays = rays_of(ray_lattice(cal.rig.left, index, 522.5), ray_lattice(right, index, 522.5), 1600)
    n = 1200
    rng = np.random.default_rng(5)
    uv = np.stack([200.0 + 1.15 * np.arange(n), 300.0 + 0.5 * np.arange(n)], -1) + rng.normal(0.0, 0.3, (n, 2))
    uv[500:520] += 60.0
    uv = np.clip(uv, 0.0, [1599.0, 1199.0])
    scratch = np.full(SIZE, np.nan, np.float32)
    scratch[U : U + n], scratch[V : V + n] = uv.astype(np.float32).T
    scratch[U + 700 : U + 740] = np.nan
    triangulate_row(rays, 600, 0, 1, scratch, scratch, n)
    origin, direction = right.rays(uv.astype(np.float32).astype(float), index)
    slope = direction[:, :2] / direction[:, 2:]
    at_plane = origin[:, :2] + slope * (522.5 - origin[:, 2:])
    known = np.arange(n)[np.isfinite(scratch[U : U + n])]
    got = np.stack([scratch[place + known] for place in (X2, Y2, SX2, SY2)], -1)
    difference_mm = np.abs(got[:, :2] - at_plane[known])
    assert difference_mm.max() < 0.0006
    assert np.median(difference_mm) < 0.00005
    np.testing.assert_allclose(got[:, 2:], slope[known], atol=3e-6)
    assert np.isnan(scratch[Z + 700 : Z + 740]).all()
