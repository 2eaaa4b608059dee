"""Owns the STL and OBJ files of a mesh: mm, as is the custom, and said in the file since neither format has a unit.

STL is binary: 80 bytes of text that do not begin with ``solid``, and 50 bytes a triangle. OBJ has vertices with grey as colour
(three numbers after the place, as MeshLab and most others read them) and normals. Neither has room for sigma.
Sources: 3D Systems, "StereoLithography Interface Specification" (1989); Wavefront, "Object Files (.obj)" (1990s).
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from appliance.desk.export.content import About, finite
from appliance.desk.surface.mesh import Mesh

_FACET = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
_STL_TEXT = 80
_ROWS = 20_000
"""Lines that are written at once: a list of all numbers of a large mesh would take gigabytes."""


def encode_stl(mesh: Mesh, about: About) -> tuple[bytes, bytes]:
    """Return the head and the triangles of a binary STL file; normals are those of the triangles. Raises ValueError for
    more than 2³² - 1 of them."""
    facets = np.zeros(len(mesh.faces), _FACET)
    corners = mesh.vertices_mm[mesh.faces]
    facets["corners"] = corners
    across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    length = np.linalg.norm(across, axis=1, keepdims=True)
    # A triangle without area has no normal; (0, 0, 0) asks the reader to find one.
    facets["normal"] = np.divide(across, length, out=np.zeros_like(across), where=length > 0)
    text = f"Kingfisher {about.lines('mm')[0]}".encode("ascii")[:_STL_TEXT].ljust(_STL_TEXT)
    return text + np.uint32(len(facets)).tobytes(), facets.tobytes()


def encode_obj(mesh: Mesh, about: About) -> list[bytes]:
    """Return an OBJ file in pieces. Places have six decimals, of which the float32 behind them knows four or five."""
    marks = about.mark_lines()
    head = "".join(f"# {'' if line in marks else 'Kingfisher '}{line}\n" for line in about.lines("mm")) + "o mesh\n"
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
