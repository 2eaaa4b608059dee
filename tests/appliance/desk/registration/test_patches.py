"""Patches, paint and equations by values: what becomes a patch, what of grey is paint, what repeats, and what holds a pose."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from appliance.desk.registration.solve import by_place, overlap
from appliance.measure.overlap.albedo import Texture, patch_pitch_mm
from appliance.measure.overlap.equations import EXTRA_TEXTURE, Correspondences, system_of
from appliance.measure.overlap.fine import PreparedScan
from appliance.measure.overlap.pair import ReadyScan, repeats_of
from appliance.measure.overlap.patches import Patches, block_size_px, patches_of
from appliance.measure.overlap.rigid import Rigid
from appliance.measure.points.organised import OrganisedCloud
from tests.appliance.desk.registration.test_marks import of_look
from tests.support.views import PROJECTION, Array

SIGMA_MM = 0.025


def flat(
    shape: tuple[int, int] = (48, 64), pitch_mm: float = 0.25, tilt: float = 0.0, sigma_mm: float = SIGMA_MM
) -> OrganisedCloud:
    """A plane without noise, half a metre away: its slope is ``tilt`` along y."""
    v, u = np.mgrid[0 : shape[0], 0 : shape[1]].astype(float)
    x, y = (u - shape[1] / 2) * pitch_mm, (v - shape[0] / 2) * pitch_mm
    points = np.stack([x, y, 520.0 + tilt * y], axis=-1).astype(np.float32)
    column = np.full(shape, sigma_mm, np.float32)
    return OrganisedCloud(points, column, column, column, np.full(shape, 100, np.uint8))


def without(cloud: OrganisedCloud, where: np.ndarray[tuple[int, ...], np.dtype[np.bool_]]) -> OrganisedCloud:
    points = cloud.points_mm.copy()
    points[where] = np.nan
    return replace(cloud, points_mm=points)


# -------------------------------------------------------------------------------------------------- patches


@pytest.mark.parametrize(("pitch_mm", "size_px"), [(0.25, 4), (0.125, 8), (2.0, 2), (0.01, 16)])
def test_a_patch_is_about_a_millimetre_wide(pitch_mm: float, size_px: int) -> None:
    assert block_size_px(flat(pitch_mm=pitch_mm)) == size_px
    assert block_size_px(without(flat(), np.ones((48, 64), bool))) == 4


def test_a_patch_lies_on_its_points_and_is_as_certain_as_their_independent_ones() -> None:
    cloud = flat(tilt=0.5)
    patches = patches_of(cloud, PROJECTION, 4)
    assert patches.valid.shape == (12, 16)
    assert patches.valid.all()
    np.testing.assert_allclose(patches.centre_mm[3, 5], cloud.points_mm[12:16, 20:24].mean(axis=(0, 1)), atol=1e-4)
    normal = np.broadcast_to(np.array([0.0, 0.5, -1.0]) / np.sqrt(1.25), (12, 16, 3))
    np.testing.assert_allclose(patches.normal, normal, atol=1e-4)
    # Of 16 points four are independent; their errors lie along the ray.
    np.testing.assert_allclose(patches.sigma_mm, np.hypot(SIGMA_MM / 2.0 / np.sqrt(1.25), 0.004), rtol=1e-3)
    np.testing.assert_allclose(patches.grey_noise, np.sqrt(0.25 + 1.0) / 100.0 / 4)
    np.testing.assert_allclose(patch_pitch_mm(patches), 1.0, atol=0.13)


def some_missing(count: float) -> OrganisedCloud:
    """Of the patch at (5, 5); that at (2, 2) is missing whole."""
    lost = np.zeros((48, 64), bool)
    lost[20:24, 20:24].flat[: int(count)] = True
    lost[8:12, 8:12] = True
    return without(flat(), lost)


def saddle(rough_mm: float) -> OrganisedCloud:
    """A saddle of ±1, without slope, in the patch at (5, 5): of 16 points 13 are free."""
    cloud = flat(sigma_mm=1e-4)
    v, u = np.mgrid[0:4, 0:4]
    cloud.points_mm[20:24, 20:24, 2] += rough_mm * np.sqrt(13.0 / 16.0) * np.where((u // 2 + v // 2) % 2, 1.0, -1.0)
    return cloud


def tilted(cosine: float) -> OrganisedCloud:
    return flat((48, 64), 0.05, tilt=float(np.sqrt(1.0 / cosine**2 - 1.0)))


@pytest.mark.parametrize(
    ("made", "at", "limit", "beyond"),
    [(some_missing, (5, 5), 4, 5), (saddle, (5, 5), 0.11, 0.13), (tilted, (6, 8), 0.26, 0.24)],
    ids=["three quarters have points", "no rougher than an eighth of a millimetre", "not seen too flatly"],
)
def test_a_patch_has_its_points_and_is_a_plane(
    made: Callable[[float], OrganisedCloud], at: tuple[int, int], limit: float, beyond: float
) -> None:
    for value, there in ((limit, True), (beyond, False)):
        # Its grey is not asked for, so that nothing bridges a hole.
        patches = patches_of(replace(made(value), grey=np.zeros((48, 64), np.uint8)), PROJECTION, 4)
        assert bool(patches.valid[at]) is there
        if there and made is saddle:
            assert patches.sigma_mm[at] == pytest.approx(value, rel=0.01), "its plane depends on where it lies"
        if made is some_missing:
            assert not patches.valid[2, 2]


@pytest.mark.parametrize(("grey", "known"), [(254, True), (255, False), (7, True), (6, False)])
def test_saturated_and_black_patches_have_no_grey(grey: int, known: bool) -> None:
    patches = patches_of(replace(flat(), grey=np.full((48, 64), grey, np.uint8)), PROJECTION, 4)
    assert (bool(np.isfinite(patches.log_grey).all()), bool(patches.valid.all())) == (known, True)


@pytest.mark.parametrize(("patches_wide", "bridged"), [(3, True), (9, False)])
def test_a_small_dark_print_is_bridged_and_counts_for_its_grey(patches_wide: int, bridged: bool) -> None:
    lost = np.zeros((120, 160), bool)
    low = 4 * (15 - patches_wide // 2)
    lost[low : low + 4 * patches_wide, low : low + 4 * patches_wide] = True
    lost[:, 140:] = True  # beyond the object's border
    cloud = replace(without(flat((120, 160)), lost), grey=np.where(lost, 20, 200).astype(np.uint8))
    patches = patches_of(cloud, PROJECTION, 4)
    assert bool(patches.valid[15, 15]) is bridged
    assert not patches.valid[15, 37]
    if not bridged:
        return
    assert (patches.sigma_mm[15, 15], patches.log_grey[15, 15]) == (0.5, pytest.approx(np.log(20.0)))
    assert patches.centre_mm[15, 15, 2] == pytest.approx(520.0, abs=0.05)
    np.testing.assert_allclose(patches.normal[15, 15], [0.0, 0.0, -1.0], atol=1e-3)
    stepped = cloud.points_mm.copy()
    stepped[:, 60:, 2] += 4.0
    dark = replace(cloud, grey=np.where(lost, 3, 200).astype(np.uint8))
    for unknown in (dark, replace(cloud, points_mm=stepped)):
        assert not patches_of(unknown, PROJECTION, 4).valid[15, 15]


# -------------------------------------------------------------------------------------------- overlap of two


def ready(cloud: OrganisedCloud) -> ReadyScan:
    patches = patches_of(cloud, SMALL, 3)
    nothing = np.full(patches.valid.shape, np.nan)
    prepared = PreparedScan(patches, Texture(nothing, np.full((*nothing.shape, 3), np.nan), nothing))
    system = system_of(laid(np.zeros(6)), with_texture=False)
    return ReadyScan(prepared, prepared, of_look(np.zeros((0, 128), np.float32)), (), system.resistance())


SMALL = replace(PROJECTION, terms=PROJECTION.terms / 4.0, size_px=(120, 160))


def facing() -> OrganisedCloud:
    """A plane at 525 mm that fills the view of the camera, pixel by pixel."""
    v, u = np.mgrid[0:120, 0:160].astype(float)
    at = np.stack([np.zeros_like(u), np.zeros_like(v), np.full_like(u, 525.0)], axis=-1)
    for _ in range(12):  # where each pixel looks, by the projection itself
        off = np.stack([u, v], axis=-1) - SMALL.pixels(at)
        at[..., :2] += off * 1.4
    column = np.full(u.shape, SIGMA_MM, np.float32)
    return OrganisedCloud(at.astype(np.float32), column, column, column, np.full(u.shape, 100, np.uint8))


def shifted(*by_mm: float) -> Rigid:
    return Rigid(np.eye(3), np.array(by_mm))


def test_two_placed_scans_overlap_by_the_share_of_patches_within_three_millimetres() -> None:
    scan, width_mm = ready(facing()), float(np.ptp(facing().points_mm[..., 0]))
    aside = (0.6 * width_mm, 0.0, 0.0)
    for by_mm, share in (((0.0, 0.0, 2.9), 1.0), ((0.0, 0.0, 3.1), 0.0), ((0.0, 0.0, -2.9), 1.0), (aside, 0.4)):
        assert overlap(scan, scan, shifted(*by_mm)) == pytest.approx(share, abs=0.06)
    for share, found in ((0.26, True), (0.14, False)):
        poses = {3: shifted(0.0, 0.0, 0.0), 7: shifted((1.0 - share) * width_mm, 0.0, 0.0)}
        pairs = by_place([scan] * 8, poses, set())
        assert [(first, second) for first, second, _ in pairs] == [(3, 7)] * found
        assert by_place([scan] * 8, poses, {(3, 7)}) == []
        if found:
            np.testing.assert_allclose(pairs[0][2].translation_mm, poses[7].translation_mm)


# -------------------------------------------------------------------------------------------------- repeats


def print_of(period_mm: float, noise: float, shape: tuple[int, int] = (40, 50)) -> tuple[Patches, Texture]:
    v, u = np.mgrid[0 : shape[0], 0 : shape[1]].astype(float)
    stripes = np.sin(2.0 * np.pi * u / period_mm) + np.sin(2.0 * np.pi * v / 13.0)
    value = stripes + noise * np.random.default_rng(4).normal(size=shape)
    at, facing_z, sigma = np.stack([u, v, np.full(shape, 520.0)], -1), np.zeros((*shape, 3)), np.full(shape, SIGMA_MM)
    facing_z[..., 2] = -1.0
    patches = Patches(at, facing_z, sigma, value, 0.01 * np.ones(shape), 4, PROJECTION)
    return patches, Texture(value, np.full((*shape, 3), np.nan), np.zeros(shape))


def test_a_print_repeats_by_its_period_and_by_no_less_than_four_millimetres() -> None:
    shifts = repeats_of(*print_of(8.0, 0.0))
    assert len(shifts) == 12, "six, and their opposites"
    assert all(round(float(x)) % 8 == 0 and round(float(y)) % 13 == 0 for x, y, _ in shifts)
    # Twice the period leaves 0.27 or 0.33 of the patches in common.
    for columns, multiples in ((22, {-8, 8}), (24, {-16, -8, 8, 16})):
        found = repeats_of(*print_of(8.0, 0.0, (16, columns)))
        assert {(round(float(x)), round(float(y))) for x, y, _ in found} == {(x, 0) for x in multiples}
    assert min(float(np.hypot(*one[:2])) for one in repeats_of(*print_of(3.0, 0.0))) > 4.0


@pytest.mark.parametrize(
    ("noise", "shape", "repeats"),
    [(0.8, (40, 50), True), (1.1, (40, 50), False), (0.0, (8, 26), True), (0.0, (7, 26), False)],
)
def test_paint_of_two_hundred_patches_repeats_where_it_correlates_with_itself_by_more_than_half(
    noise: float, shape: tuple[int, int], repeats: bool
) -> None:
    # Of two waves with a variance of ½ each, correlation is 1 / (1 + noise²): 0.61 and 0.45.
    assert bool(repeats_of(*print_of(8.0, noise, shape))) is repeats


# ------------------------------------------------------------------------------------------------ equations


def laid(delta: Array, plane: bool = False) -> Correspondences:
    """400 patches all about a middle that lie off A by what the displacement δ makes."""
    rng, count = np.random.default_rng(5), 400
    x = rng.uniform(-50.0, 50.0, (count, 3)) + np.array([0.0, 0.0, 520.0])
    x[:, 2] = 520.0 if plane else x[:, 2]
    arm = x - x.mean(axis=0)
    lever = np.sqrt((arm**2).sum(axis=1).mean())
    n = np.tile([0.0, 0.0, -1.0], (count, 1)) if plane else rng.normal(size=(count, 3))
    n /= np.linalg.norm(n, axis=1, keepdims=True)
    rows = np.concatenate([np.cross(arm, n) / lever, n], axis=1)
    unknown, zeros, none_missing, index = (
        np.full(count, np.nan),
        np.zeros((count, 3)),
        np.ones(0, bool),
        np.arange(count),
    )
    return Correspondences(
        x_mm=x, source=index, tile=index, distance_mm=rows @ delta, normal_a=n, normal_b=n,
        sigma_mm=np.full(count, SIGMA_MM), texture=unknown, gradient_a=zeros, gradient_b=zeros,
        texture_noise=unknown, texture_a=unknown, texture_b=unknown, missing=none_missing,
        front=none_missing, tested=count,
    )  # fmt: skip


DELTA = np.array([0.1, -0.2, 0.15, 0.3, -0.1, 0.05])


def test_a_step_undoes_the_displacement_and_is_eight_millimetres_at_most() -> None:
    system = system_of(laid(DELTA), with_texture=False)
    np.testing.assert_allclose(system.step(), -DELTA, atol=1e-9)
    x = laid(DELTA).x_mm
    off = system.moved(shifted(0.0, 0.0, 0.0), DELTA).of(x) - x
    np.testing.assert_allclose(off, np.cross(DELTA[:3] / system.lever, x - system.middle) + DELTA[3:], atol=1e-3)
    for factor, size in ((10.0, 10.0 * float(np.linalg.norm(DELTA))), (40.0, 8.0)):
        assert np.linalg.norm(system_of(laid(factor * DELTA), with_texture=False).step()) == pytest.approx(size)


@pytest.mark.parametrize(("known", "used"), [(119, False), (120, True)])
def test_paint_counts_from_a_hundred_and_twenty_patches_on(known: int, used: bool) -> None:
    paint = np.where(np.arange(400) < known, 0.7, np.nan)
    noise = np.where(np.isfinite(paint), 0.02, np.nan)
    along = np.tile([0.05, 0.0, 0.0], (400, 1))
    both = replace(
        laid(np.zeros(6), plane=True), texture=paint, texture_noise=noise, gradient_a=along, gradient_b=along
    )
    system = system_of(both, with_texture=True)
    assert len(system.r) == 400 + (known if used else 0)
    assert len(system_of(both, with_texture=False).r) == 400
    if used:
        np.testing.assert_allclose(system.r[400:], 0.0, err_msg="a brighter picture is no displacement")
        np.testing.assert_allclose(system.w[400:], 1.0 / (0.02**2 + EXTRA_TEXTURE**2))
