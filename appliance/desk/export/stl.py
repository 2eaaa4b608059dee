"""STL files of meshes: mm, as is the custom; the file says so, since the format has no unit.

It is binary: 80 bytes of text that do not begin with ``solid``, and 50 bytes a triangle. It has no room for sigma.
Source: 3D Systems, "StereoLithography Interface Specification" (1989).
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from appliance.desk.export.content import Metadata
from appliance.desk.surface.mesh import Mesh
from appliance.store import LocalFileSystem

_FACET = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
_STL_TEXT = 80


def write_mesh(path: Path, mesh: Mesh, metadata: Metadata) -> None:
    """Write the file. Raises StorageError, ValueError for more than 2³² - 1 triangles."""
    LocalFileSystem().replace_file(path, *encode_stl(mesh, metadata))


def encode_stl(mesh: Mesh, metadata: Metadata) -> tuple[bytes, bytes]:
    """Return the head and the triangles of a binary STL file; normals are those of the triangles.

    Raises ValueError for more than 2³² - 1 triangles.
    """
    facets = np.zeros(len(mesh.faces), _FACET)
    corners = mesh.vertices_mm[mesh.faces]
    facets["corners"] = corners
    across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    length = np.linalg.norm(across, axis=1, keepdims=True)
    # A triangle without area has no normal; (0, 0, 0) asks the reader to find one.
    facets["normal"] = np.divide(across, length, out=np.zeros_like(across), where=length > 0)
    text = f"Kingfisher {metadata.lines('mm')[0]}".encode("ascii")[:_STL_TEXT].ljust(_STL_TEXT)
    return text + np.uint32(len(facets)).tobytes(), facets.tobytes()
