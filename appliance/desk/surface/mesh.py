"""Mesh of triangles, and the mesh of one scan from its own pixel grid."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from appliance.base import one_line
from appliance.desk.surface.normals import normals
from appliance.desk.surface.steps import connect_neighbours
from appliance.measure import OrganisedCloud


@dataclass(frozen=True, slots=True, eq=False)
class Mesh:
    """Triangles, with normal, sigma and grey value of each vertex.

    The corners of a face go round counter-clockwise seen from outside.
    """

    vertices_mm: NDArray[np.float32]
    """(n, 3) float32."""
    faces: NDArray[np.int32]
    """(m, 3) int32: rows of ``vertices_mm``."""
    normals: NDArray[np.float32]
    """(n, 3) float32 unit vectors out of the surface, to the side from which it was seen; NaN where unknown."""
    sigma_mm: NDArray[np.float32]
    """(n,) float32: of a scan's mesh along the ray, of an object's along the normal."""
    grey: NDArray[np.uint8]
    """(n,) uint8."""

    __repr__ = one_line


def mesh_of_scan(cloud: OrganisedCloud) -> Mesh:
    """Return the mesh of one scan, in its frame; points without a triangle are left out, holes stay open.

    A cell of four pixels has two triangles, or one where a corner is missing or stands off by a step: both sides of a
    triangle along the grid join pixels that see one surface (``steps.py``). The diagonal is taken that gives more triangles,
    else the shorter one. The points are those of the scan, unmoved.
    """
    same = connect_neighbours(cloud)
    top, bottom, left, right = same.right[:-1], same.right[1:], same.down[:, :-1], same.down[:, 1:]
    falling = (top & right).astype(np.uint8) + (left & bottom)
    rising = (top & left).astype(np.uint8) + (right & bottom)
    p = cloud.points_mm
    # With a missing corner (NaN) the number of triangles has decided already.
    shorter = _length2(p[:-1, :-1], p[1:, 1:]) <= _length2(p[:-1, 1:], p[1:, :-1])
    fall = (falling > rising) | ((falling == rising) & shorter)
    h, w = cloud.shape
    pixel = np.arange(h * w, dtype=np.int32).reshape(h, w)
    a, b, c, d = pixel[:-1, :-1], pixel[:-1, 1:], pixel[1:, :-1], pixel[1:, 1:]
    # x goes to the right and y down, so that these turn counter-clockwise as the camera sees them.
    corners = (
        (fall & top & right, (a, d, b)),
        (fall & left & bottom, (a, c, d)),
        (~fall & top & left, (a, c, b)),
        (~fall & right & bottom, (b, c, d)),
    )
    faces = np.concatenate([np.stack([index[where] for index in three], axis=1) for where, three in corners])
    used = np.zeros(h * w, np.bool_)
    used[faces.reshape(-1)] = True
    row = np.cumsum(used, dtype=np.int32) - 1
    flat = np.flatnonzero(used)
    return Mesh(
        vertices_mm=p.reshape(-1, 3)[flat],
        faces=row[faces],
        normals=normals(cloud, same).reshape(-1, 3)[flat],
        sigma_mm=cloud.sigma_mm.reshape(-1)[flat],
        grey=cloud.grey.reshape(-1)[flat],
    )


def _length2(p: NDArray[np.float32], q: NDArray[np.float32]) -> NDArray[np.float32]:
    offset = p - q
    squared: NDArray[np.float32] = np.einsum("yxk,yxk->yx", offset, offset)
    return squared
