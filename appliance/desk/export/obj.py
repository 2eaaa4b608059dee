"""OBJ files of meshes: mm, as is the custom; the file says so, since the format has no unit.

It has vertices with grey as colour (three numbers after the place, as MeshLab and most others read them) and normals.
It has no room for sigma. Source: Wavefront, "Object Files (.obj)" (1990s).
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from appliance.desk.export.content import Metadata, finite
from appliance.desk.surface.mesh import Mesh
from appliance.store import LocalFileSystem

_ROWS = 20_000
"""Number of lines that are written at once: a list of all numbers of a large mesh would take gigabytes."""


def write_mesh(path: Path, mesh: Mesh, metadata: Metadata) -> None:
    """Write the file. Raises StorageError."""
    LocalFileSystem().replace_file(path, *encode_obj(mesh, metadata))


def encode_obj(mesh: Mesh, metadata: Metadata) -> list[bytes]:
    """Return an OBJ file in pieces. Places have six decimals, of which float32 holds four or five."""
    marks = metadata.mark_lines()
    head = "".join(f"# {'' if line in marks else 'Kingfisher '}{line}\n" for line in metadata.lines("mm")) + "o mesh\n"
    shade = mesh.grey.astype(np.float64)[:, None] / 255.0
    places = np.concatenate([mesh.vertices_mm.astype(np.float64), np.repeat(shade, 3, axis=1)], axis=1)
    # Indices begin with 1; each vertex has the normal of the same number.
    corners = np.repeat(mesh.faces.astype(np.int64) + 1, 2, axis=1)
    return [
        head.encode("ascii"),
        *_lines("v %.6f %.6f %.6f %.4f %.4f %.4f\n", places),
        *_lines("vn %.5f %.5f %.5f\n", finite(mesh.normals)),
        *_lines("f %d//%d %d//%d %d//%d\n", corners),
    ]


def _lines(form: str, rows: NDArray[Any]) -> list[bytes]:
    blocks = (rows[start : start + _ROWS] for start in range(0, len(rows), _ROWS))
    return [((form * len(block)) % tuple(block.reshape(-1).tolist())).encode("ascii") for block in blocks]
