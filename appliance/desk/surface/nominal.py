"""Nominal surface: triangles with the normals that separate inside from outside.

Where an edge or a corner is nearest to a point, its triangles may disagree whether the point is inside. The
pseudonormals decide it: of an edge the sum of both triangles' normals, of a corner the sum of all, each by its angle
(J. A. Bærentzen and H. Aanæs, "Signed distance computation using the angle weighted pseudonormal", 2005).
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from appliance.base import one_line
from appliance.desk.surface.drawing_file import NominalError as NominalError
from appliance.desk.surface.drawings import read_triangles
from appliance.desk.surface.mesh import Mesh

_LEAST_AREA = 1e-12


@dataclass(frozen=True, slots=True, eq=False)
class Nominal:
    """Triangles in mm, corners counter-clockwise seen from outside."""

    vertices_mm: NDArray[np.float64]
    """(v, 3) float64, each place once."""
    faces: NDArray[np.int64]
    """(m, 3)."""
    face_normals: NDArray[np.float64]
    """(m, 3) unit vectors."""
    edge_normals: NDArray[np.float64]
    """(m, 3, 3): pseudonormal of each face's edges, from corner k to the next; of any length."""
    corner_normals: NDArray[np.float64]
    """(v, 3): pseudonormal of each vertex; of any length."""
    open_edges: NDArray[np.bool_]
    """(m, 3): the edge belongs to this triangle alone."""
    open_corners: NDArray[np.bool_]
    """(v,): the vertex lies on such an edge."""
    origin_mm: NDArray[np.float64]
    """(3,) float64, whole metres: place of the vertices' (0, 0, 0) in the frame of the file.

    Far from a frame's origin single precision is too coarse for points; relative to this place it is fine enough.
    """

    __repr__ = one_line


def nominal_of(vertices_mm: NDArray[Any], faces: NDArray[Any], origin_mm: NDArray[np.float64] | None = None) -> Nominal:
    """Return the nominal surface of triangles: (v, 3) mm and (m, 3) rows of them.

    Triangles without area are left out. Vertices at exactly the same place become one, since STL files have no neighbours.
    Raises ValueError if no triangle remains.
    """
    places, place_of = np.unique(np.asarray(vertices_mm, np.float64), axis=0, return_inverse=True)
    corners_of = place_of.reshape(-1)[np.asarray(faces, np.int64)]
    a, b, c = (places[corners_of[:, k]] for k in range(3))
    across = np.cross(b - a, c - a)
    length = np.linalg.norm(across, axis=1)
    has_area = length > _LEAST_AREA
    if not has_area.any():
        raise ValueError("no triangle has an area")
    corners_of, normals = corners_of[has_area], across[has_area] / length[has_area, None]

    following = np.roll(corners_of, -1, axis=1)
    edge = np.stack([np.minimum(corners_of, following), np.maximum(corners_of, following)], axis=-1).reshape(-1, 2)
    # Sorting one number for both ends is many times faster than sorting pairs.
    _, edge_of, shared_by = np.unique(edge[:, 0] * len(places) + edge[:, 1], return_inverse=True, return_counts=True)
    edge_of = edge_of.reshape(-1)
    open_edges = (shared_by[edge_of] == 1).reshape(-1, 3)
    open_corners = np.zeros(len(places), np.bool_)
    open_corners[corners_of[open_edges]] = open_corners[following[open_edges]] = True
    of_edges = np.zeros((int(edge_of.max()) + 1, 3))
    np.add.at(of_edges, edge_of, np.repeat(normals, 3, axis=0))

    of_corners = np.zeros_like(places)
    for k in range(3):
        corner, next_corner, last_corner = (places[corners_of[:, (k + j) % 3]] for j in range(3))
        to_next, to_last = next_corner - corner, last_corner - corner
        cosine = np.einsum("nk,nk->n", to_next, to_last) / (
            np.linalg.norm(to_next, axis=1) * np.linalg.norm(to_last, axis=1)
        )
        np.add.at(of_corners, corners_of[:, k], np.arccos(np.clip(cosine, -1.0, 1.0))[:, None] * normals)
    origin = np.zeros(3) if origin_mm is None else origin_mm
    return Nominal(
        places, corners_of, normals, of_edges[edge_of].reshape(-1, 3, 3), of_corners, open_edges, open_corners, origin
    )


def nominal_of_mesh(mesh: Mesh) -> Nominal:
    """Return a mesh as a nominal surface. Raises ValueError for one without triangles."""
    return nominal_of(mesh.vertices_mm, mesh.faces)


def read_nominal(file: Path | str) -> Nominal:
    """Read a nominal surface in mm about a local origin.

    Raises NominalError, MissingLibraryError where the library that reads it is absent.
    """
    vertices, faces = read_triangles(Path(file))
    used = vertices[np.unique(faces)]
    origin = 1000.0 * np.round(0.5 * (used.min(axis=0) + used.max(axis=0)) / 1000.0)
    try:
        return nominal_of(vertices - origin, faces, origin)
    except ValueError as error:
        raise NominalError(f"{file}: {error}") from error
