"""From rows of maps to points of a plane: the same points in pieces as in one, coarse as fine, and nothing of an earlier scan."""

from __future__ import annotations

from functools import cache
from typing import Any, NamedTuple

import numpy as np
import pytest
from numpy.typing import NDArray

from appliance.measure.light.noise import TYPICAL_PAIR
from appliance.measure.light.rays import ray_lattice
from appliance.measure.points.match import RightMaps, fill_inverse_map, right_maps
from appliance.measure.points.rows import CHUNK, LeftMaps, reconstruct_rows, scratch_rows
from appliance.measure.points.select import PointLimits
from appliance.measure.points.sigma import sigma_factors
from appliance.measure.points.table import PointTable
from appliance.measure.points.triangulate import Rays, rays_of
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
f = np.float32
FACTORS = sigma_factors(16, TYPICAL_PAIR)._replace(blur2_px4=f(0.0), border_px2=f(0.0))
"""Errors without what neighbours tell of a pixel's footprint."""
LIMITS = PointLimits(f(0.5), f(5.0), f(300.0), f(800.0), f(30.0), f(5.0))


@cache
def _plane() -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Pattern coordinates (2, h, w) that either camera sees on the plane."""
    left, right = (np.moveaxis(pq, -1, 0).astype(np.float32) for pq in synthetic.wall_px(CAL, NORMAL).values())
    return left, right


def left_maps(columns: tuple[int, int] = (0, WIDTH_PX)) -> LeftMaps:
    p_px, q_px = _plane()[0].copy()
    v, u = np.mgrid[0:HEIGHT_PX, 0:WIDTH_PX]
    bright, even = ((7 * u + 11 * v) % 256).astype(np.uint8), np.full(v.shape, 160, np.uint8)
    return LeftMaps(p_px, q_px, even, bright, even, np.tile(np.array(columns, np.int32), (HEIGHT_PX, 1)))


def right() -> RightMaps:
    p_px, q_px = _plane()[1].copy()
    made = right_maps(p_px, q_px, np.full(p_px.shape, 160, np.uint8), 1024, 768)
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
    rows: tuple[int, int] = (0, HEIGHT_PX),
    stride: int = 1,
    *,
    scratch: NDArray[np.float32] | None = None,
    offset: int = 0,
    limits: PointLimits = LIMITS,
    rays: Rays = RAYS,
) -> Rows:
    p = PointTable(left.p_px.size + offset).points
    p.pixel[:offset] = 4_000_000_000
    scratch = scratch_rows() if scratch is None else scratch
    n = reconstruct_rows(left, right(), rays, limits, FACTORS, *rows, stride, scratch, p, offset)
    assert (p.pixel[:offset] == 4_000_000_000).all(), "what stands before is left alone"
    assert not p.pixel[offset + n :].any(), "nothing is written behind"
    here = slice(offset, offset + n)
    return Rows(p.xyz_mm[here], p.sigma_mm[here], p.modulation_half_dn[here], p.pixel[here], p.intensity[here])


def assert_same(one: Rows, other: Rows) -> None:
    for name, a, b in zip(Rows._fields, one, other, strict=True):
        np.testing.assert_array_equal(a, b, err_msg=name)


def test_two_threads_find_what_one_finds_behind_what_is_there() -> None:
    """A point at the seam has neighbours on the other side of it."""
    above, below = found(left_maps(), (0, 13)), found(left_maps(), (13, HEIGHT_PX), offset=17)
    both = {name: np.concatenate([getattr(above, name), getattr(below, name)]) for name in Rows._fields}
    assert_same(Rows(**both), found(left_maps()))


@pytest.mark.parametrize(("stride", "columns"), [(1, (16, 32)), (3, (16, 32)), (1, (0, 9))])
def test_beyond_lit_columns_there_is_no_point_whatever_came_before(stride: int, columns: tuple[int, int]) -> None:
    scratch = scratch_rows()
    narrow = found(left_maps(columns), stride=stride)
    found(left_maps(), stride=stride, scratch=scratch)
    assert_same(found(left_maps(columns), stride=stride, scratch=scratch), narrow)
    u = narrow.pixel % WIDTH_PX
    lit = np.arange(0, WIDTH_PX, stride)
    lit = lit[(lit >= columns[0]) & (lit < columns[1])]
    assert (u.min(), u.max()) == (lit[0], lit[-1])


def test_a_row_wider_than_one_chunk_has_no_seam() -> None:
    """The same columns again and again, so that each copy must have the same depths; the right camera sees them all."""
    copies, one = CHUNK // WIDTH_PX + 2, left_maps()
    tiled: dict[str, Any] = {name: np.tile(getattr(one, name), (1, copies)) for name in LeftMaps._fields[:5]}
    columns = np.tile(np.array([0, WIDTH_PX * copies], np.int32), (HEIGHT_PX, 1))
    many = one._replace(**tiled, illuminated_columns=columns)
    rays = RAYS._replace(left=np.ascontiguousarray(np.tile(RAYS.left, (1, 1, copies))))
    loose = LIMITS._replace(max_step_mm=f(1e6))
    narrow, wide = found(one, (12, 14), limits=loose), found(many, (12, 14), limits=loose, rays=rays)
    depth_mm = np.full((HEIGHT_PX, WIDTH_PX), np.nan)
    depth_mm.ravel()[narrow.pixel] = narrow.xyz_mm[:, 2]
    v, u = np.divmod(wide.pixel.astype(np.int64), WIDTH_PX * copies)
    inner = (u % WIDTH_PX > 8) & (u % WIDTH_PX < WIDTH_PX - 8)
    np.testing.assert_allclose(wide.xyz_mm[inner, 2], depth_mm[v, u % WIDTH_PX][inner], atol=0.3)
    assert inner.sum() > 0.6 * copies * np.isfinite(depth_mm[:, 9 : WIDTH_PX - 8]).sum()
