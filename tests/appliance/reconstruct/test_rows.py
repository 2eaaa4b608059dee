"""From rows of maps to points of a plane: the same points in pieces as in one, coarse as fine, and nothing of an earlier scan."""

from __future__ import annotations

from functools import cache
from typing import NamedTuple

import numpy as np
import pytest
from numpy.typing import NDArray

from appliance.optics.rays import ray_lattice
from appliance.reconstruct.match import RightMaps, fill_inverse_map, right_maps
from appliance.reconstruct.rows import CHUNK, LeftMaps, reconstruct_rows, scratch_rows
from appliance.reconstruct.select import PointLimits
from appliance.reconstruct.sigma import SigmaFactors, sigma_factors
from appliance.reconstruct.table import PointTable
from appliance.reconstruct.triangulate import rays_of
from appliance.scan.noise import TYPICAL_PAIR
from tests.support import synthetic

WIDTH_PX, HEIGHT_PX = 40, 30
CAL = synthetic.calibration(WIDTH_PX, HEIGHT_PX)
INDEX = synthetic.WATER.index
CENTRE_MM = CAL.rig.volume_centre_mm(INDEX)
RAYS = rays_of(
    ray_lattice(CAL.rig.left, INDEX, float(CENTRE_MM[2])),
    ray_lattice(CAL.rig.right, INDEX, float(CENTRE_MM[2])),
    WIDTH_PX,
)
NORMAL = np.array([0.1, -0.15, 1.0]) / np.linalg.norm([0.1, -0.15, 1.0])
FACTORS = sigma_factors(16, TYPICAL_PAIR)
f = np.float32
NOISE_ALONE = FACTORS._replace(blur2_px4=f(0.0), border_px2=f(0.0))
"""Errors without what neighbours tell of a pixel's footprint."""
LIMITS = PointLimits(f(0.5), f(5.0), f(300.0), f(800.0), f(30.0), f(5.0))


@cache
def _plane() -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Pattern coordinates (2, h, w) that either camera sees on the plane."""
    projector = synthetic.projector(CAL)
    offset = float(NORMAL @ CENTRE_MM)
    left, right = (
        np.moveaxis(projector.project(synthetic.plane_points(camera, NORMAL, offset), INDEX), -1, 0).astype(np.float32)
        for camera in (CAL.rig.left, CAL.rig.right)
    )
    return left, right


def left_maps(half_dn: int = 160, columns: tuple[int, int] = (0, WIDTH_PX)) -> LeftMaps:
    p_px, q_px = _plane()[0].copy()
    v, u = np.mgrid[0:HEIGHT_PX, 0:WIDTH_PX]
    return LeftMaps(
        p_px,
        q_px,
        np.full((HEIGHT_PX, WIDTH_PX), half_dn, np.uint8),
        ((7 * u + 11 * v) % 256).astype(np.uint8),
        np.full((HEIGHT_PX, WIDTH_PX), 90, np.uint8),
        np.tile(np.array(columns, np.int32), (HEIGHT_PX, 1)),
    )


def right(half_dn: int = 160) -> RightMaps:
    p_px, q_px = _plane()[1].copy()
    made = right_maps(p_px, q_px, np.full(p_px.shape, half_dn, np.uint8), 1024, 768)
    fill_inverse_map(made, 1)
    return made


class Rows(NamedTuple):
    """The points that were written."""

    xyz_mm: NDArray[np.float32]
    sigma_mm: NDArray[np.float32]
    modulation_half_dn: NDArray[np.uint8]
    pixel: NDArray[np.uint32]
    intensity: NDArray[np.uint8]


def found(
    left: LeftMaps,
    start: int = 0,
    stop: int = HEIGHT_PX,
    stride: int = 1,
    *,
    seen: RightMaps | None = None,
    scratch: NDArray[np.float32] | None = None,
    offset: int = 0,
    limits: PointLimits = LIMITS,
    factors: SigmaFactors = FACTORS,
) -> Rows:
    table = PointTable(WIDTH_PX * HEIGHT_PX + offset)
    p = table.points
    p.pixel[:offset] = 4_000_000_000
    scratch = scratch_rows() if scratch is None else scratch
    n = reconstruct_rows(
        left, seen or right(), RAYS, limits, factors, start, stop, stride, scratch, table.points, offset
    )
    assert (p.pixel[:offset] == 4_000_000_000).all(), "what stands before is left alone"
    assert not p.pixel[offset + n :].any(), "nothing is written behind"
    here = slice(offset, offset + n)
    return Rows(p.xyz_mm[here], p.sigma_mm[here], p.modulation_half_dn[here], p.pixel[here], p.intensity[here])


@cache
def whole() -> Rows:
    return found(left_maps())


def assert_same(one: Rows, other: Rows) -> None:
    for name, a, b in zip(Rows._fields, one, other, strict=True):
        np.testing.assert_array_equal(a, b, err_msg=name)


def test_the_points_of_a_plane_lie_on_it_each_at_its_pixel() -> None:
    points, left = whole(), left_maps()
    assert len(points.pixel) > 0.4 * WIDTH_PX * HEIGHT_PX, "as many as the right camera sees too"
    assert (np.diff(points.pixel.astype(np.int64)) > 0).all()
    v, u = np.divmod(points.pixel.astype(np.int64), WIDTH_PX)
    exact = synthetic.plane_points(CAL.rig.left, NORMAL, float(NORMAL @ CENTRE_MM))[v, u]
    # The lattice of rays is coarse for so few pixels.
    assert np.abs(points.xyz_mm - exact).max() < 0.3
    np.testing.assert_array_equal(points.intensity, left.bright[v, u])
    assert set(points.modulation_half_dn.tolist()) == {160}
    assert {0, HEIGHT_PX - 1} <= set(v.tolist()), "a point at the image's edge has five neighbours"


@pytest.mark.parametrize("cut", [1, 13, HEIGHT_PX - 1])
def test_two_threads_find_what_one_finds(cut: int) -> None:
    """A point at the seam has neighbours on the other side of it."""
    above, below = found(left_maps(), 0, cut), found(left_maps(), cut, HEIGHT_PX)
    for name in Rows._fields:
        both = np.concatenate([getattr(above, name), getattr(below, name)])
        np.testing.assert_array_equal(both, getattr(whole(), name), err_msg=name)


def test_points_are_written_behind_those_that_are_there() -> None:
    assert_same(found(left_maps(), offset=17), whole())


@pytest.mark.parametrize("stride", [2, 3])
def test_every_second_row_and_column_is_a_grid_of_its_own(stride: int) -> None:
    left = left_maps()
    left.modulation_half_dn[:] = 80 + 2 * np.arange(WIDTH_PX)
    coarse, fine, noise = found(left, stride=stride), found(left), found(left, factors=NOISE_ALONE)
    v, u = np.divmod(coarse.pixel.astype(np.int64), WIDTH_PX)
    assert not (v % stride).any()
    assert not (u % stride).any()
    np.testing.assert_array_equal(coarse.intensity, left.bright[v, u])
    np.testing.assert_array_equal(coarse.modulation_half_dn, 80 + 2 * u)
    shared, here, there = np.intersect1d(coarse.pixel, fine.pixel, return_indices=True)
    grid = np.count_nonzero((fine.pixel // WIDTH_PX % stride == 0) & (fine.pixel % WIDTH_PX % stride == 0))
    assert len(shared) > 0.9 * grid
    np.testing.assert_allclose(coarse.xyz_mm[here], fine.xyz_mm[there], atol=0.3)
    # Places that are no neighbours tell nothing of a footprint: noise alone, which is less than both. (In so small a picture a block
    # that shares one node is off by a hundredth.)
    assert np.median(coarse.sigma_mm[here] / noise.sigma_mm[there]) == pytest.approx(1.0, abs=2e-2)
    assert np.median(coarse.sigma_mm[here] / fine.sigma_mm[there]) < 0.99


@pytest.mark.parametrize("stride", [1, 2, 3])
def test_beyond_the_lit_columns_there_is_no_point_also_when_an_earlier_scan_had_some(stride: int) -> None:
    scratch, columns = scratch_rows(), (16, 32)
    narrow = found(left_maps(columns=columns), stride=stride)
    found(left_maps(), stride=stride, scratch=scratch)
    again = found(left_maps(columns=columns), stride=stride, scratch=scratch)
    assert_same(again, narrow)
    u = narrow.pixel % WIDTH_PX
    grid = np.arange(0, WIDTH_PX, stride)
    lit = grid[(grid >= columns[0]) & (grid < columns[1])]
    assert (u.min(), u.max()) == (lit[0], lit[-1])


@pytest.mark.parametrize("columns", [(0, WIDTH_PX), (0, 9), (16, 27)], ids=str)
def test_where_a_row_ends_within_a_block_its_points_do_not_depend_on_what_was_computed_before(
    columns: tuple[int, int],
) -> None:
    scratch = scratch_rows()
    scratch[:] = np.random.default_rng(7).uniform(-50.0, 50.0, scratch.shape)
    assert_same(found(left_maps(columns=columns), scratch=scratch), found(left_maps(columns=columns)))


def test_rows_with_nothing_lit_have_no_points_and_the_rows_beside_them_lose_their_neighbours() -> None:
    left = left_maps()
    left.illuminated_columns[10:12] = 0
    got = found(left)
    v = set((got.pixel // WIDTH_PX).tolist())
    assert not v & {10, 11}
    assert {9, 12} <= v, "five of eight neighbours are left"
    six = LIMITS._replace(min_neighbours=f(6.0))
    assert not {9, 12} & set((found(left, limits=six).pixel // WIDTH_PX).tolist())


def test_half_the_modulation_is_twice_the_error() -> None:
    """Of a flat and evenly lit surface nothing but noise counts: σ = P σ_grey / (2π √2 B), in either camera."""
    strong = found(left_maps(), factors=NOISE_ALONE)
    weak = found(left_maps(80), seen=right(80), factors=NOISE_ALONE)
    _, here, there = np.intersect1d(weak.pixel, strong.pixel, return_indices=True)
    assert len(here) > 300
    ratio = weak.sigma_mm[here] / strong.sigma_mm[there]
    assert np.median(ratio) == pytest.approx(2.0, rel=1e-3)


def test_less_light_in_the_fringes_than_half_way_is_less_noise() -> None:
    """Shot noise of 90 grey values, and of 45."""
    bright = found(left_maps(), factors=NOISE_ALONE)
    dimmer = found(left_maps()._replace(offset_per_threshold=f(0.5)), factors=NOISE_ALONE)
    camera = TYPICAL_PAIR.left
    wanted = np.sqrt(camera.variance_dn2(45.0) / camera.variance_dn2(90.0))
    assert np.median(dimmer.sigma_mm / bright.sigma_mm) == pytest.approx(wanted, rel=1e-3)


def test_a_variance_that_both_maps_carry_is_the_noise_and_one_alone_is_not() -> None:
    given = [np.full((HEIGHT_PX, WIDTH_PX), value, np.float32) for value in (1e-4, 4e-4)]
    one, two = (
        found(left_maps()._replace(variance_px2=each), seen=right()._replace(variance_px2=each), factors=NOISE_ALONE)
        for each in given
    )
    assert np.median(two.sigma_mm / one.sigma_mm) == pytest.approx(2.0, rel=1e-3)
    assert_same(found(left_maps()._replace(variance_px2=given[0])), whole())
    assert_same(found(left_maps(), seen=right()._replace(variance_px2=given[0])), whole())


def test_a_row_wider_than_one_chunk_has_no_seam() -> None:
    """The same columns again and again, so that each copy must have the same depths; the right camera sees them all."""
    copies = CHUNK // WIDTH_PX + 2
    one = left_maps()
    wide = LeftMaps(
        np.tile(one.p_px, (1, copies)),
        np.tile(one.q_px, (1, copies)),
        np.tile(one.modulation_half_dn, (1, copies)),
        np.tile(one.bright, (1, copies)),
        np.tile(one.gray_threshold, (1, copies)),
        np.tile(np.array([0, WIDTH_PX * copies], np.int32), (HEIGHT_PX, 1)),
    )
    rays = RAYS._replace(left=np.ascontiguousarray(np.tile(RAYS.left, (1, 1, copies))))
    tables = []
    for maps, with_rays in ((one, RAYS), (wide, rays)):
        table = PointTable(maps.p_px.size)
        loose = LIMITS._replace(max_step_mm=f(1e6))
        n = reconstruct_rows(maps, right(), with_rays, loose, FACTORS, 12, 14, 1, scratch_rows(), table.points, 0)
        tables.append((table.points.pixel[:n].astype(np.int64), table.points.xyz_mm[:n]))
    (pixel, xyz_mm), (wide_pixel, wide_xyz_mm) = tables
    v, u = np.divmod(wide_pixel, WIDTH_PX * copies)
    inner = (u % WIDTH_PX > 8) & (u % WIDTH_PX < WIDTH_PX - 8)
    at = {int(p): xyz for p, xyz in zip(pixel, xyz_mm, strict=True)}
    wanted = [at.get(int(p), np.full(3, np.nan)) for p in v * WIDTH_PX + u % WIDTH_PX]
    np.testing.assert_allclose(wide_xyz_mm[inner], np.array(wanted)[inner], atol=0.3)
    assert inner.sum() > 0.6 * copies * ((pixel % WIDTH_PX > 8) & (pixel % WIDTH_PX < WIDTH_PX - 8)).sum()
