"""Owns a nominal surface: the triangles that something was to have, with the normals that tell its inside from its outside.

Whether a point lies inside or outside of the nearest triangle is undecided where an edge or a corner is nearest: each of the
triangles there may say otherwise. The pseudonormals decide it: of an edge the sum of both triangles' normals, of a corner the sum
of all, each by its angle (J. A. Bærentzen and H. Aanæs, "Signed distance computation using the angle weighted pseudonormal", 2005).
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from appliance.one_line import one_line
from appliance.surface.libraries import needed
from appliance.surface.mesh import Mesh

SUFFIXES = (".stl", ".obj", ".ply")
_LEAST_AREA = 1e-12


class NominalError(Exception):
    """A file holds no nominal surface; the text names it, and says why."""


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

    __repr__ = one_line


def nominal_of(vertices_mm: NDArray[Any], faces: NDArray[Any]) -> Nominal:
    """Return the nominal surface of triangles: (v, 3) mm and (m, 3) rows of them. Triangles without area are left out.

    Vertices at exactly the same place become one: STL files know no neighbours. Raises ValueError where nothing is left.
    """
    places, place_of = np.unique(np.asarray(vertices_mm, np.float64), axis=0, return_inverse=True)
    whole = place_of.reshape(-1)[np.asarray(faces, np.int64)]
    a, b, c = (places[whole[:, k]] for k in range(3))
    across = np.cross(b - a, c - a)
    length = np.linalg.norm(across, axis=1)
    kept = length > _LEAST_AREA
    if not kept.any():
        raise ValueError("no triangle has an area")
    whole, normals = whole[kept], across[kept] / length[kept, None]

    following = np.roll(whole, -1, axis=1)
    edge = np.stack([np.minimum(whole, following), np.maximum(whole, following)], axis=-1).reshape(-1, 2)
    _, edge_of = np.unique(edge, axis=0, return_inverse=True)
    edge_of = edge_of.reshape(-1)
    of_edges = np.zeros((int(edge_of.max()) + 1, 3))
    np.add.at(of_edges, edge_of, np.repeat(normals, 3, axis=0))

    of_corners = np.zeros_like(places)
    for k in range(3):
        here, one, other = (places[whole[:, (k + j) % 3]] for j in range(3))
        to, fro = one - here, other - here
        cosine = np.einsum("nk,nk->n", to, fro) / (np.linalg.norm(to, axis=1) * np.linalg.norm(fro, axis=1))
        np.add.at(of_corners, whole[:, k], np.arccos(np.clip(cosine, -1.0, 1.0))[:, None] * normals)
    return Nominal(places, whole, normals, of_edges[edge_of].reshape(-1, 3, 3), of_corners)


def nominal_of_mesh(mesh: Mesh) -> Nominal:
    """Return a mesh as the surface that others are compared with. Raises ValueError for one without triangles."""
    return nominal_of(mesh.vertices_mm, mesh.faces)


def read_nominal(file: Path | str) -> Nominal:
    """Read a nominal surface in mm (``SUFFIXES``). Raises NominalError, MissingLibraryError where trimesh is absent."""
    path = Path(file)
    if path.suffix.lower() not in SUFFIXES:
        raise NominalError(
            f"{path}: a nominal surface is read from {', '.join(SUFFIXES)}, in mm; convert it to one of these"
        )
    trimesh = needed("trimesh", "trimesh", "a nominal surface")
    try:
        with path.open("rb") as opened:
            read = trimesh.load(opened, file_type=path.suffix[1:].lower(), force="mesh", process=False)
        return nominal_of(read.vertices, read.faces)
    except OSError as error:
        raise NominalError(f"{path}: cannot be read ({error.strerror or error})") from error
    # Whatever a parser makes of bytes that are no mesh; it names no kinds of errors of its own.
    except Exception as error:
        raise NominalError(
            f"{path}: holds no triangles that can be used ({error}); give an STL, OBJ or PLY file in mm"
        ) from error
