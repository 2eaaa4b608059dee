"""What is read of the backscatter at a point, and how its fringes are taken out of the rows, from frames and phasors written down here."""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
import pytest
from numpy.typing import NDArray

from appliance.measure.calibration.gaps import VeilGaps
from appliance.measure.light.patterns import Direction, build_sequence
from appliance.measure.points.veil import SideVeil, VeilFringes, looks_veiled, remove_veil, sample_side

Array = NDArray[np.float64]

SEQUENCE = build_sequence(16)
HEIGHT, WIDTH = 30, 40
ROWS = (100.0, 9.0, 24.0, -3.0, 2.0, 4.0, 1.5, -2.0, 1.0, -1.2)
STRENGTH = (20.0, -4.0, 3.0, 2.0, -1.5, 2.5)


def surface(coefficients: tuple[float, ...]) -> Array:
    """Polynomial of the image place: x from −1 to 1 over the width, y to the same scale, each at a pixel."""
    v, u = np.mgrid[0:HEIGHT, 0:WIDTH].astype(float)
    x, y = 2.0 * u / WIDTH - 1.0, 2.0 * (v - HEIGHT / 2.0) / WIDTH
    terms = [x**0, x, y, x**2, x * y, y**2, x**3, x**2 * y, x * y**2, y**3]
    return np.asarray(sum(c * t for c, t in zip(coefficients, terms, strict=False)))


def test_rows_of_a_sum_of_phasors_become_the_objects_where_they_can_be_told() -> None:
    """Z = B e^{iφ} + A e^{iψ}: found is the phase of Z, wanted that of its first part."""
    own, veil, strength = 40.0, surface(ROWS), surface(STRENGTH)
    q_object = veil + 9.0 * np.sin(0.37 * np.arange(WIDTH)) + 0.2
    turn = 2.0 * math.pi / 16.0
    together = own * np.exp(1j * turn * q_object) + strength * np.exp(1j * turn * veil)
    q = q_object + np.angle(together * np.exp(-1j * turn * q_object)) / turn
    q_px, p_px = q.astype(np.float32), np.full(q.shape, 7.0, np.float32)
    mask, half_dn = np.zeros(q.shape, np.uint8), np.full(q.shape, round(2.0 * own), np.uint8)
    half_dn[4, :] = 22  # a dark stripe of the object: the veil is as strong as 11 grey values of fringes there
    dark_sine = (strength * np.sin(turn * (veil - q)))[4] / 11.0
    lost = remove_veil(SideVeil(ROWS, STRENGTH, 0.5), 16, q_px, p_px, half_dn, mask)
    assert np.abs(q - q_object).max() > 0.8, "a veil that moves nothing proves nothing"
    assert np.abs(q_px - q_object)[np.arange(HEIGHT) != 4].max() < 2e-3
    # Where it is nearly as strong as the object's fringes, aside of them, both are told apart no more.
    unsure = np.abs(dark_sine) > 0.9
    assert 0 < unsure.sum() < WIDTH
    assert lost == np.count_nonzero(mask) == unsure.sum()
    for told in (mask[4] == 4, np.isnan(q_px[4]), np.isnan(p_px[4])):
        np.testing.assert_array_equal(told, unsure)


def test_a_veil_is_nowhere_less_than_nothing() -> None:
    """Its polynomial may be, at the edge: rows stay as they are there."""
    q_px = np.full((HEIGHT, WIDTH), 95.0, np.float32)
    veil = SideVeil((99.0,) + (0.0,) * 9, (0.0, 5.0, 0.0, 0.0, 0.0, 0.0), 0.1)
    remove_veil(veil, 16, q_px, q_px.copy(), np.full(q_px.shape, 80, np.uint8), np.zeros(q_px.shape, np.uint8))
    assert (q_px[:, : WIDTH // 2] == 95.0).all()
    # δ is a quarter of a turn: 5 of 40 at the right edge move it by asin(5/40) of 16 px in 2π; the last pixel is a 20th before.
    assert q_px[7, -1] == pytest.approx(95.0 - 16.0 / (2.0 * math.pi) * math.asin(0.95 * 5.0 / 40.0), abs=1e-4)


def frames_of(p: Array, q: Array, columns_dn: float, rows_dn: float, backscatter_dn: float) -> NDArray[np.uint8]:
    """Frames of fringes of such modulations, and of stripes before which the water has some light."""
    frames = np.zeros((len(SEQUENCE), *p.shape))
    for direction, along, dn in ((Direction.X, p, columns_dn), (Direction.Y, q, rows_dn)):
        axis = SEQUENCE.axis(direction)
        for step, k in enumerate(axis.sine):
            frames[k] = 90.0 + dn * np.cos(2.0 * math.pi * along / 16.0 + step * math.pi / 2.0)
        for k in axis.gray:  # of stripes the water shows half everywhere
            level = SEQUENCE.patterns[k].codes()[np.clip(np.rint(along), 0, None).astype(int) % SEQUENCE.width_px]
            frames[k] = np.where(level > 128, 180.0 - backscatter_dn / 2.0, 5.0 + backscatter_dn / 2.0)
    frames[SEQUENCE.bright], frames[SEQUENCE.dark] = 180.0, 5.0
    return np.rint(frames).astype(np.uint8)


def maps() -> tuple[Array, Array]:
    """Columns that pass by 3 px per pixel, rows by 2: both of several stripes."""
    v, u = np.mgrid[0:HEIGHT, 0:WIDTH].astype(float)
    return 200.0 + 3.0 * u, 60.0 + 2.0 * v


def test_a_point_shows_both_modulations_its_row_and_the_backscatter_in_the_middle_of_stripes() -> None:
    p, q = maps()
    v, u = (a.ravel() for a in np.mgrid[1 : HEIGHT - 1, 1 : WIDTH - 1])
    uv = np.stack([u + 0.3, v - 0.4], 1)
    found = sample_side(SEQUENCE, frames_of(p, q, 50.0, 30.0, 24.0), p.astype(np.float32), q.astype(np.float32), uv)
    assert found.place == pytest.approx(np.stack([u / 20.0 - 1.0, (v - 15.0) / 20.0], 1))
    assert found.own_dn == pytest.approx(50.0, abs=0.8)
    # A pixel of a tenth of a square px blurs fringes by exp(−2π² s |∇|²/P²): columns here by 9, rows by 4.
    even = math.exp(-2.0 * math.pi**2 * 0.1 * (9.0 - 4.0) / 256.0)
    assert found.both_dn / even == pytest.approx(30.0, abs=0.8)
    assert found.row_px == pytest.approx(q[v, u])
    # Within 0.15 widths of the middle of stripes that are 32 or 64 px wide, as the patterns have them.
    near = np.zeros(len(u), bool)
    for k in SEQUENCE.axis(Direction.X).gray:
        ends = np.flatnonzero(np.diff(SEQUENCE.patterns[k].codes().astype(float))) + 1
        for first, end in pairwise(ends.tolist()):
            if end - first in (32, 64):
                near |= np.abs(p[v, u] - (first + end - 1) / 2.0) < 0.15 * (end - first)
    known = np.isfinite(found.backscatter_dn)
    np.testing.assert_array_equal(known, near)
    assert 0.2 < known.mean() < 0.8
    assert found.backscatter_dn[known] == pytest.approx(24.0, abs=1.0)


def test_water_that_is_as_bright_as_the_object_looks_veiled_and_clear_water_does_not() -> None:
    p, q = (np.repeat(np.repeat(one, 2, 0), 2, 1) for one in maps())
    # Its fringes are supposed to be a fortieth of it, and count from two thousandths of the object's on: of 80 DN from 6.4 on.
    for backscatter_dn, veiled in ((0.0, False), (4.0, False), (8.0, True), (100.0, True)):
        frames = frames_of(p, q, 80.0, 80.0, backscatter_dn)
        assert looks_veiled(SEQUENCE, frames, p.astype(np.float32), q.astype(np.float32)) == veiled
    few = np.full_like(p, np.nan)
    few[:4, :4] = p[:4, :4]
    assert not looks_veiled(SEQUENCE, frames, few.astype(np.float32), q.astype(np.float32)), "a handful tells nothing"


def test_six_hundredths_of_the_objects_fringes_in_either_camera_are_worth_removing() -> None:
    nothing = VeilGaps(np.zeros((1, 2)), np.zeros(1), np.zeros((1, 2)), np.zeros(1))
    for left, right, worth in ((0.059, 0.0, False), (0.061, 0.0, True), (0.0, 0.061, True), (0.06, 0.06, False)):
        shares = zip(("left", "right"), (left, right), strict=True)
        sides = {side: SideVeil((0.0,) * 10, (0.0,) * 6, share) for side, share in shares}
        assert VeilFringes(sides, nothing).removable == worth
