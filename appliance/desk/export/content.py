"""Content of files for other programs: points with their attributes, and metadata."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from appliance.desk.export.formats import ExportError
from appliance.desk.surface.drawings import COARSEST_MM
from appliance.desk.surface.fusion import FusedCloud
from appliance.desk.surface.mesh import Mesh
from appliance.desk.surface.normals import normals
from appliance.measure import OrganisedCloud

MM_PER_M = 1000.0
MAX_LINE_CHARACTERS, MAX_MARK_CHARACTERS = 200, 2000
"""Length of the longest line, and of the longest mark, as in the instrument's own clouds (``appliance.store.ply``)."""
CAMERA_FRAME = "left camera frame (x right, y down, z forward)"
OBJECT_FRAME = "object frame"


@dataclass(frozen=True, slots=True)
class Metadata:
    """Metadata of a file, as far as its format has room; ASCII, since most formats have no other text."""

    title: str
    """Name of the scan or the object."""
    frame: str
    """Frame of reference, in words."""
    notes: tuple[str, ...] = ()
    """Further lines: calibration, water, warnings."""
    marks: tuple[str, ...] = ()
    """Faults of all points, each with its word in front (``unchecked: …``): the same words in every format, never
    shortened to a line's length, so that one search finds them in any file."""
    unit: str = ""
    """Unit of all lengths in place of the format's own, for a cloud of unknown scale."""

    def lines(self, unit: str) -> list[str]:
        """Return the metadata as ASCII lines, with the format's ``unit`` of lengths.

        All but marks have 200 characters at most.
        """
        texts = [f"{self.title}: unit {self.unit or unit}, {self.frame}", *self.notes]
        first, *notes = [_plain(line)[:MAX_LINE_CHARACTERS] for line in texts]
        return [first, *self.mark_lines(), *notes]

    def mark_lines(self) -> list[str]:
        """Return the marks alone, as they stand among the lines."""
        return [_plain(mark)[:MAX_MARK_CHARACTERS] for mark in self.marks]


def _plain(line: str) -> str:
    return " ".join(line.encode("ascii", "replace").decode("ascii").split())


@dataclass(frozen=True, slots=True, eq=False)
class ExportedPoints:
    """Points for a writer; all arrays have the same length n."""

    points_mm: NDArray[np.float32]
    """(n, 3) float32."""
    sigma_mm: NDArray[np.float32]
    grey: NDArray[np.uint8]
    normals: NDArray[np.float32]
    """(n, 3) float32; NaN where unknown."""
    more: Mapping[str, NDArray[np.float32]] = field(default_factory=dict)
    """Further columns (n,) float32 by name, each name with its unit."""
    origin_mm: NDArray[np.float64] = field(default_factory=lambda: np.zeros(3))
    """(3,) float64: place of ``points_mm``'s (0, 0, 0) in the frame.

    Site coordinates need more digits than float32 has.
    """
    rotation: NDArray[np.float64] = field(default_factory=lambda: np.eye(3))
    """(3, 3) float64: a point p lies at rotation · p + ``origin_mm`` in the frame."""

    def __post_init__(self) -> None:
        if not (np.isfinite(self.points_mm).all() and np.isfinite(self.origin_mm).all()):
            raise ExportError("a point has a coordinate that is not finite; nothing is written")


def points_of_scan(cloud: OrganisedCloud, unit: str = "mm") -> ExportedPoints:
    """Return the points of one scan, in the order of their pixels, with normals; ``unit`` of its lengths."""
    has_point = cloud.mask
    return ExportedPoints(
        points_mm=cloud.points_mm[has_point],
        sigma_mm=cloud.sigma_mm[has_point],
        grey=cloud.grey[has_point],
        normals=normals(cloud)[has_point],
        more={"modulation_dn": cloud.modulation_dn[has_point], f"ray_gap_{unit}": cloud.ray_gap_mm[has_point]},
    )


def points_of_surface(cloud: FusedCloud, origin_mm: NDArray[np.float64] | None = None) -> ExportedPoints:
    """Return the points of a fused surface, with the number of scans that saw each.

    They have the shares of sigma where these are known.
    """
    more = {"views": cloud.views.astype(np.float32)}
    if cloud.shares is not None:
        more |= {
            "sigma_beside_mm": cloud.shares.beside_mm,
            "sigma_place_mm": cloud.shares.place_mm,
            "sigma_bending_mm": cloud.shares.bending_mm,
        }
    origin = np.zeros(3) if origin_mm is None else origin_mm
    return ExportedPoints(cloud.points_mm, cloud.sigma_mm, cloud.grey, cloud.normals, more, origin)


def points_of_mesh(mesh: Mesh) -> ExportedPoints:
    """Return the vertices of a mesh."""
    return ExportedPoints(mesh.vertices_mm, mesh.sigma_mm, mesh.grey, mesh.normals)


def single_precision(points: ExportedPoints, suffix: str) -> NDArray[np.float32]:
    """Return the points (n, 3) in their frame as float32.

    Raises ExportError where that is too coarse for them.
    """
    if not points.origin_mm.any() or not len(points.points_mm):
        return points.points_mm
    in_frame = points.points_mm.astype(np.float64) + points.origin_mm
    farthest = float(np.abs(in_frame).max())
    step_mm = float(np.spacing(np.float32(farthest)))
    if step_mm > COARSEST_MM:
        raise ExportError(
            f"{suffix} has single precision, which {farthest / MM_PER_M:,.0f} m from the frame's origin has steps of "
            f"{step_mm:g} mm; write .e57 or .las"
        )
    return in_frame.astype(np.float32)


def finite(values: NDArray[Any]) -> NDArray[Any]:
    """Return the values with 0 for unknown ones.

    Formats have no word for these, and most readers fail at NaN.
    """
    replaced: NDArray[Any] = np.nan_to_num(values, nan=0.0)
    return replaced


def scaled_to_mm(points: ExportedPoints, metadata: Metadata) -> ExportedPoints:
    """Return points for a format that divides by 1000 for its metres.

    Without a known scale they are multiplied by 1000, so that their numbers stay.
    """
    if not metadata.unit:
        return points
    return replace(
        points, points_mm=points.points_mm * np.float32(MM_PER_M), sigma_mm=points.sigma_mm * np.float32(MM_PER_M)
    )
