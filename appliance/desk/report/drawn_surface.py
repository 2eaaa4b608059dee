"""Surface as it is drawn: few enough points for a browser, each with the values for its colour."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from appliance.base import ColourScale
from appliance.desk.report.content import Report

MAX_DRAWN_POINTS = 60_000
"""Number of points or vertices that a browser on a plain computer can draw smoothly."""


@dataclass(frozen=True, slots=True, eq=False)
class Colouring:
    """One way of colouring the surface."""

    name: str
    values: NDArray[np.float32]
    """(n,) float32; NaN if there is none."""
    low: float
    high: float
    """Values of the first and the last colour."""
    unit: str
    scale: ColourScale

    def rgb(self) -> NDArray[np.float32]:
        """Return (n, 3) float32, 0..255: the colour of each value."""
        return self.scale.of(self.values, self.low, self.high)


@dataclass(frozen=True, slots=True, eq=False)
class DrawnSurface:
    """Points or a mesh, with the ways to colour them; the page begins with the first one."""

    points_mm: NDArray[np.float32]
    normals: NDArray[np.float32]
    faces: NDArray[np.int32] | None
    colourings: tuple[Colouring, ...]


def surface_to_draw(report: Report) -> DrawnSurface | None:
    """Return the surface of a report at full resolution; ``None`` if it has neither points nor a mesh."""
    surface, mesh, nominal = report.surface, report.mesh, report.nominal
    if nominal is None and mesh is not None and len(mesh.faces):
        colourings = (_grey(mesh.grey), _sigma(mesh.sigma_mm))
        return DrawnSurface(mesh.vertices_mm, mesh.normals, mesh.faces, colourings)
    if surface is None or not len(surface.grey):
        return None
    all_colourings = [_grey(surface.grey), _sigma(surface.sigma_mm)]
    if surface.shares is not None:
        all_colourings.append(replace(_sigma(surface.shares.bending_mm), name="Bending"))
    if nominal is not None:
        deviation = nominal.deviation.deviation_mm
        near = np.abs(deviation[np.isfinite(deviation)])
        # Twice the tolerance shows points beyond it; without one, nearly all points are within the colours.
        reach = (
            2.0 * nominal.tolerance_mm if nominal.tolerance_mm else float(np.percentile(near, 99)) if len(near) else 1.0
        )
        all_colourings.insert(
            0,
            Colouring(
                "Deviation", deviation * np.float32(1000), -1000 * reach, 1000 * reach, "µm", ColourScale.DIVERGING
            ),
        )
    most_views = int(surface.views.max())
    if most_views > 1:
        all_colourings.append(
            Colouring("Scans", surface.views.astype(np.float32), 1.0, float(most_views), "", ColourScale.SEQUENTIAL)
        )
    return DrawnSurface(surface.points_mm, surface.normals, None, tuple(all_colourings))


def thin_out(full: DrawnSurface, max_points: int = MAX_DRAWN_POINTS) -> DrawnSurface:
    """Return at most about ``max_points`` of its points, evenly over the surface.

    It takes one point for each cell of a grid.
    """
    if len(full.points_mm) <= max_points:
        return full
    low, high = full.points_mm.min(axis=0), full.points_mm.max(axis=0)
    # A surface meets about (side / cell)² cells; a few tries find the right size of a cell.
    cell = float(np.linalg.norm(high - low)) / np.sqrt(max_points)
    for _ in range(12):
        first, cell_of = _cells(full.points_mm, low, cell)
        if len(first) <= max_points:
            break
        cell *= max(1.05, float(np.sqrt(len(first) / max_points)))
    faces = full.faces
    if faces is not None:
        faces = cell_of[faces].astype(np.int32)
        # Remove triangles whose corners fell together.
        flat = (faces[:, 0] == faces[:, 1]) | (faces[:, 1] == faces[:, 2]) | (faces[:, 0] == faces[:, 2])
        _, once = np.unique(np.sort(faces[~flat], axis=1), axis=0, return_index=True)
        faces = faces[~flat][once]
    colourings = tuple(
        Colouring(
            colouring.name, colouring.values[first], colouring.low, colouring.high, colouring.unit, colouring.scale
        )
        for colouring in full.colourings
    )
    return DrawnSurface(full.points_mm[first], full.normals[first], faces, colourings)


def _grey(grey: NDArray[np.uint8]) -> Colouring:
    low, high = (float(value) for value in np.percentile(grey, (1, 99)))
    return Colouring("Picture", grey.astype(np.float32), low, max(high, low + 1.0), "", ColourScale.GREYS)


def _sigma(sigma_mm: NDArray[np.float32]) -> Colouring:
    low, high = (1000.0 * float(value) for value in np.nanpercentile(sigma_mm, (2, 98)))
    return Colouring("Sigma", sigma_mm * np.float32(1000), low, max(high, low + 0.1), "µm", ColourScale.SEQUENTIAL)


def _cells(
    points: NDArray[np.float32], low: NDArray[np.float32], cell: float
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the first point of each cell, and the cell of each point."""
    number = ((points - low) / np.float32(cell)).astype(np.int64)
    # 21 bits a direction: more cells than any picture has.
    key = number[:, 0] << 42 | number[:, 1] << 21 | number[:, 2]
    _, first, cell_of = np.unique(key, return_index=True, return_inverse=True)
    return first, cell_of.reshape(-1)
