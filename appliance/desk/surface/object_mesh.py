"""Mesh of an object: triangles through a fused surface, where it has points and nowhere else.

A grid of voxels holds the signed distance to the surface: at a voxel v, the mean of (v − p) · (n + m) / |n + m| over
the points p within two voxels, n their normals and m that of the nearest one, with weights 1/σ² · exp(−|v − p|² / h²),
h the voxel. The mean of two normals moves no curved surface (``fusion.py``). Only points that face the same way as the
nearest one count, so that the far side of a plate does not pull. The surface is where that is zero (W. Lorensen and H.
Cline, "Marching cubes", 1987; the variant of T. Lewiner, 2003, as scikit-image has it), within cells all of whose
corners have a point near them, and no farther than 0.75 voxels from a point. So holes stay open. A plate must be two
voxels thick to have two sides.

Blocks of the grid are processed one after the other, so that memory does not grow with the object's volume; at their
borders they share the same voxels with the same points in the same order, and therefore the same vertices.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import TypeVar

import numba
import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from appliance.base import needed
from appliance.desk.surface.fusion import FusedCloud
from appliance.desk.surface.mesh import Mesh

VOXEL_MM = 0.5
BLOCK = 64
"""Cells of a block along each side."""
_REACH = 2
"""Number of voxels in each direction to which a point contributes."""
_NEAR = 2.0
"""Largest distance in voxels between a corner of a cell and the nearest point: a surface through one corner of a cell is
√3 from the opposite corner."""
_BEYOND = 0.75
"""Largest distance in voxels from a vertex to the nearest point: vertices beyond extend the border of the data, and are
cut off."""
_NEIGHBOURS = 4


def mesh_of_surface(cloud: FusedCloud, voxel_mm: float = VOXEL_MM, close_holes_mm: float = 0.0) -> Mesh:
    """Return the mesh of a fused surface, whose points should be half a voxel apart, and at most one.

    ``close_holes_mm``: holes that are no wider are closed with triangles about their middle, which have no sigma (NaN); the outer border is
    no hole. Sigma, grey and normals of the other vertices are those of the nearest points. Raises ValueError for a voxel outside of
    0.05..20 mm, MissingLibraryError where scikit-image is absent.
    """
    if not 0.05 <= voxel_mm <= 20.0:
        raise ValueError(f"voxel_mm is {voxel_mm}; allowed are 0.05..20")
    measure = needed("skimage.measure", "scikit-image", "the mesh of an object")
    # Single precision and 32 bits, freed as soon as they are joined: a metre of pipe has nine million triangles.
    vertices, faces = [np.empty((0, 3), np.float32)], [np.empty((0, 3), np.int32)]
    attributes, first = [np.empty((0, 5), np.float32)], 0
    shared, edges = [np.empty(0, np.int64)], [np.empty(0, np.int64)]
    for origin, points, normals, weight, point_indices in _blocks(cloud, voxel_mm):
        distance, near = _field(points, normals, weight)
        cell = _all_corners(near <= _NEAR)
        if not cell.any() or not ((distance[near <= _NEAR] < 0).any() and (distance[near <= _NEAR] > 0).any()):
            continue
        # The library reads the mask of a cell at its last corner.
        mask = np.zeros(distance.shape, np.bool_)
        mask[1:, 1:, 1:] = cell
        try:
            crossings, triangles, _, _ = measure.marching_cubes(
                distance, 0.0, mask=mask, allow_degenerate=False, gradient_direction="descent"
            )
        except (ValueError, RuntimeError):
            continue  # no cell of the block is crossed: the library calls that an error
        grid = crossings.astype(np.float64) + origin
        place = grid * voxel_mm
        attributes_of_block, far_mm = _attributes(cloud, point_indices, place)
        triangles = triangles[(far_mm <= _BEYOND * voxel_mm)[triangles].all(axis=1)]
        vertices.append(place.astype(np.float32))
        border_vertices, grid_edges = _on_borders(grid)
        shared.append(border_vertices + first)
        edges.append(grid_edges)
        faces.append(triangles + np.int32(first))
        attributes.append(attributes_of_block)
        first += len(place)
    places, triangles, attributes_of_block = _weld(
        _join(vertices), _join(faces), _join(attributes), _join(shared), _join(edges)
    )
    if close_holes_mm > 0.0:
        places, triangles, attributes_of_block = _close_holes(places, triangles, attributes_of_block, close_holes_mm)
    return Mesh(
        vertices_mm=places,
        faces=triangles,
        normals=np.ascontiguousarray(attributes_of_block[:, :3]),
        sigma_mm=np.ascontiguousarray(attributes_of_block[:, 3]),
        grey=np.rint(attributes_of_block[:, 4]).astype(np.uint8),
    )


_Block = tuple[NDArray[np.int64], NDArray[np.float64], NDArray[np.float32], NDArray[np.float32], NDArray[np.int64]]


def _blocks(cloud: FusedCloud, voxel_mm: float) -> Iterator[_Block]:
    """Yield each block that has points, with all points that contribute to it.

    It is the block's first voxel, and the points' places (in voxels from there), normals, weights and indices.
    """
    voxel = np.floor(cloud.points_mm / np.float32(voxel_mm)).astype(np.int32)
    if not len(voxel):
        return
    low = voxel.min(axis=0) // BLOCK - 1
    block_counts = voxel.max(axis=0) // BLOCK - low + 2
    # A point near a border contributes to several blocks, so each block reads the points of its 26 neighbours, too.
    i, j, k = (voxel[:, axis] // BLOCK - low[axis] for axis in range(3))
    number = (i.astype(np.int64) * block_counts[1] + j) * block_counts[2] + k
    del i, j, k
    order = np.argsort(number, kind="stable").astype(np.int32)
    block_numbers, start = np.unique(number[order], return_index=True)
    del number
    end = np.append(start[1:], len(order))
    where = dict(zip(block_numbers.tolist(), zip(start.tolist(), end.tolist(), strict=True), strict=True))
    neighbours = [
        (i * int(block_counts[1]) + j) * int(block_counts[2]) + k
        for i in (-1, 0, 1)
        for j in (-1, 0, 1)
        for k in (-1, 0, 1)
    ]
    # Blocks beside a block with points may have a part of the surface, too.
    for block in sorted({number + step for number in where for step in neighbours}):
        runs = [order[slice(*where[block + step])] for step in neighbours if block + step in where]
        candidates = np.sort(np.concatenate(runs))
        first = (
            np.array(
                [
                    block // (block_counts[1] * block_counts[2]),
                    block // block_counts[2] % block_counts[1],
                    block % block_counts[2],
                ]
            )
            + low
        ) * BLOCK
        local = voxel[candidates] - first
        inside = ((local >= -_REACH - 1) & (local <= BLOCK + _REACH)).all(axis=1)
        point_indices = candidates[inside]
        if not len(point_indices):
            continue
        places = cloud.points_mm[point_indices].astype(np.float64) / voxel_mm - first
        # Neighbours are weighted by the errors that they do not have in common.
        sigma = np.maximum(cloud.beside_mm[point_indices], np.float32(1e-4))
        yield first, places, cloud.normals[point_indices], 1.0 / sigma**2, point_indices


def _field(
    points: NDArray[np.float64], normals: NDArray[np.float32], weight: NDArray[np.float32]
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Return the signed distance and the distance of the nearest point, in voxels, at a block's corners.

    Far away they are 9 and infinite.
    """
    shape = (BLOCK + 1,) * 3
    near, nearest = np.full(shape, np.inf, np.float32), np.full(shape, -1, np.int32)
    _find_nearest(points, near, nearest)
    total, sum_of_weights = np.zeros(shape), np.zeros(shape)
    _add_distances(points, normals, weight / weight.max(), nearest, total, sum_of_weights)
    has = sum_of_weights > 0
    distance = np.full(shape, 9.0, np.float32)
    distance[has] = total[has] / sum_of_weights[has]
    return distance, np.sqrt(near)


@numba.njit(nogil=True, cache=True, error_model="numpy")
def _find_nearest(points: NDArray[np.float64], near: NDArray[np.float32], nearest: NDArray[np.int32]) -> None:
    """Write the squared distance of the nearest point, and its index, for each voxel within reach."""
    side = near.shape[0]
    for n in range(len(points)):
        x, y, z = points[n, 0], points[n, 1], points[n, 2]
        for i in range(max(0, int(np.ceil(x)) - _REACH), min(side, int(np.floor(x)) + _REACH + 1)):
            for j in range(max(0, int(np.ceil(y)) - _REACH), min(side, int(np.floor(y)) + _REACH + 1)):
                for k in range(max(0, int(np.ceil(z)) - _REACH), min(side, int(np.floor(z)) + _REACH + 1)):
                    square = (i - x) ** 2 + (j - y) ** 2 + (k - z) ** 2
                    if square < near[i, j, k]:
                        near[i, j, k] = square
                        nearest[i, j, k] = n


@numba.njit(nogil=True, cache=True, error_model="numpy")
def _add_distances(
    points: NDArray[np.float64],
    normals: NDArray[np.float32],
    weight: NDArray[np.float32],
    nearest: NDArray[np.int32],
    total: NDArray[np.float64],
    sum_of_weights: NDArray[np.float64],
) -> None:
    """Add the weighted distances of all points to the voxels in reach.

    Only voxels whose nearest point faces the same way count.
    """
    side = total.shape[0]
    for n in range(len(points)):
        x, y, z = points[n, 0], points[n, 1], points[n, 2]
        a, b, c = normals[n, 0], normals[n, 1], normals[n, 2]
        for i in range(max(0, int(np.ceil(x)) - _REACH), min(side, int(np.floor(x)) + _REACH + 1)):
            for j in range(max(0, int(np.ceil(y)) - _REACH), min(side, int(np.floor(y)) + _REACH + 1)):
                for k in range(max(0, int(np.ceil(z)) - _REACH), min(side, int(np.floor(z)) + _REACH + 1)):
                    m = nearest[i, j, k]
                    cosine = a * normals[m, 0] + b * normals[m, 1] + c * normals[m, 2]
                    if cosine <= 0.0:
                        continue
                    square = (i - x) ** 2 + (j - y) ** 2 + (k - z) ** 2
                    # (v − p) · (n + m) / |n + m|; |n + m|² = 2 + 2 n · m.
                    d = (a + normals[m, 0]) * (i - x) + (b + normals[m, 1]) * (j - y) + (c + normals[m, 2]) * (k - z)
                    w = weight[n] * np.exp(-square)
                    total[i, j, k] += w * d / np.sqrt(2.0 + 2.0 * cosine)
                    sum_of_weights[i, j, k] += w


def _all_corners(valid: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return which cells, one less along each side, have eight valid corners."""
    for axis in range(3):
        valid = np.logical_and(
            np.take(valid, range(1, valid.shape[axis]), axis), np.take(valid, range(valid.shape[axis] - 1), axis)
        )
    return valid


def _attributes(
    cloud: FusedCloud, point_indices: NDArray[np.int64], places: NDArray[np.float64]
) -> tuple[NDArray[np.float32], NDArray[np.float64]]:
    """Return normal, sigma and grey (n, 5) of vertices, and the distance of the nearest point in mm.

    They are means over the nearest points of the block that face as the nearest does.
    """
    count = min(_NEIGHBOURS, len(point_indices))
    far, near = cKDTree(cloud.points_mm[point_indices]).query(places, np.arange(1, count + 1))
    number = point_indices[near]
    normals = cloud.normals[number]
    same = np.einsum("nmk,nk->nm", normals, normals[:, 0]) > 0
    weight = np.where(same, 1.0, 0.0)[..., None] / same.sum(axis=1)[:, None, None]
    columns = np.concatenate([normals, cloud.sigma_mm[number][..., None], cloud.grey[number][..., None]], axis=2)
    mean = (weight * columns).sum(axis=1)
    mean[:, :3] /= np.linalg.norm(mean[:, :3], axis=1, keepdims=True)
    return mean.astype(np.float32), far[:, 0]


_Parts = tuple[NDArray[np.float32], NDArray[np.int32], NDArray[np.float32]]
_Kind = TypeVar("_Kind", bound=np.generic)


def _join(parts: list[NDArray[_Kind]]) -> NDArray[_Kind]:
    """Return the parts as one array, and empty their list."""
    joined = np.concatenate(parts)
    parts.clear()
    return joined


def _on_borders(grid: NDArray[np.float64]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the vertices on the sides of a block, where another block has them too, and their grid edges.

    An edge is one number: that of its lower corner and of its direction. Places of the vertices would differ between two
    blocks, as they are float32 from either block's corner.
    """
    corner = np.floor(grid)
    within = grid - corner
    vertices = np.flatnonzero(((within == 0) & (corner % BLOCK == 0)).any(axis=1))
    i, j, k = (corner[vertices].astype(np.int64) + (1 << 19)).T
    return vertices, i << 42 | j << 22 | k << 2 | within[vertices].argmax(axis=1)


def _weld(
    places: NDArray[np.float32],
    faces: NDArray[np.int32],
    attributes: NDArray[np.float32],
    shared: NDArray[np.int64],
    edges: NDArray[np.int64],
) -> _Parts:
    """Return the mesh with one vertex for all ``shared`` vertices on an edge.

    Vertices in no triangle are removed.
    """
    _, first, edge_index = np.unique(edges, return_index=True, return_inverse=True)
    replacement = np.arange(len(places), dtype=np.int32)
    replacement[shared] = shared[first[edge_index.reshape(-1)]]
    faces = replacement[faces]
    flat = (faces[:, 0] == faces[:, 1]) | (faces[:, 1] == faces[:, 2]) | (faces[:, 0] == faces[:, 2])
    if flat.any():
        faces = faces[~flat]
    used = np.zeros(len(places), np.bool_)
    used[faces.reshape(-1)] = True
    return places[used], (np.cumsum(used, dtype=np.int32) - 1)[faces], attributes[used]


def _close_holes(
    places: NDArray[np.float32], faces: NDArray[np.int32], attributes: NDArray[np.float32], widest_mm: float
) -> _Parts:
    """Return the mesh with holes up to ``widest_mm`` across closed; the longest border stays."""
    n = len(places)
    edges = np.concatenate([faces[:, [k, (k + 1) % 3]] for k in range(3)]).astype(np.int64)
    key, back = edges[:, 0] * n + edges[:, 1], edges[:, 1] * n + edges[:, 0]
    border = edges[~np.isin(key, back)]
    following = dict(zip(border[:, 0].tolist(), border[:, 1].tolist(), strict=True))
    loops = []
    while following:
        loop = [next(iter(following))]
        while (after := following.pop(loop[-1], None)) is not None and after != loop[0]:
            loop.append(after)
        # Where two borders touch in a point, a path may end before it returns; such a hole is left open.
        if after == loop[0] and len(loop) >= 3:
            loops.append(loop)
    loops.sort(key=lambda loop: float(np.ptp(places[loop], axis=0).max()))
    for loop in loops[:-1]:
        if float(np.ptp(places[loop], axis=0).max()) > widest_mm:
            break
        middle = places[loop].mean(axis=0)
        mean = attributes[loop].mean(axis=0)
        # A vertex that was not measured has no sigma.
        mean[:3], mean[3] = mean[:3] / np.linalg.norm(mean[:3]), np.nan
        places, attributes = np.vstack([places, middle]), np.vstack([attributes, mean])
        ring = np.array(loop, np.int32)
        # Against the border's own direction, so that both sides of each edge agree.
        faces = np.vstack(
            [faces, np.stack([np.roll(ring, -1), ring, np.full(len(ring), len(places) - 1, np.int32)], axis=1)]
        )
    return places, faces, attributes
