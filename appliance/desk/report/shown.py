"""Owns what of a surface is drawn: few enough points for a browser to turn, each with the values that it can be
coloured by."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from appliance.base import ColourScale
from appliance.desk.report.content import Report

MOST_TURNED = 60_000
"""Points or vertices that a browser on a plain computer turns smoothly."""


@dataclass(frozen=True, slots=True, eq=False)
class Colouring:
    """One way of colouring the surface."""

    name: str
    values: NDArray[np.float32]
    """(n,) float32; NaN where there is none."""
    low: float
    high: float
    """Values of the first and the last colour."""
    unit: str
    scale: ColourScale

    def rgb(self) -> NDArray[np.float32]:
        """Return (n, 3) float32, 0..255: the colour of each value."""
        return self.scale.of(self.values, self.low, self.high)


@dataclass(frozen=True, slots=True, eq=False)
class ShownSurface:
    """Points or a mesh, with the ways to colour them; the first is the one that the page begins with."""

    points_mm: NDArray[np.float32]
    normals: NDArray[np.float32]
    faces: NDArray[np.int32] | None
    colourings: tuple[Colouring, ...]


def shown(report: Report) -> ShownSurface | None:
    """Return what is drawn of a report at full resolution; ``None`` where it has neither points nor a mesh."""
    surface, mesh, nominal = report.surface, report.mesh, report.nominal
    if nominal is None and mesh is not None and len(mesh.faces):
        colourings = (_grey(mesh.grey), _sigma(mesh.sigma_mm))
        return ShownSurface(mesh.vertices_mm, mesh.normals, mesh.faces, colourings)
    if surface is None or not len(surface.grey):
        return None
    found = [_grey(surface.grey), _sigma(surface.sigma_mm)]
    if surface.shares is not None:
        found.append(replace(_sigma(surface.shares.bending_mm), name="Bending"))
    if nominal is not None:
        deviation = nominal.deviation.deviation_mm
        near = np.abs(deviation[np.isfinite(deviation)])
        # Twice the tolerance shows what is out of it; else nearly all points are within the colours.
        reach = (
            2.0 * nominal.tolerance_mm if nominal.tolerance_mm else float(np.percentile(near, 99)) if len(near) else 1.0
        )
        found.insert(
            0,
            Colouring(
                "Deviation", deviation * np.float32(1000), -1000 * reach, 1000 * reach, "µm", ColourScale.DIVERGING
            ),
        )
    most = int(surface.views.max())
    if most > 1:
        found.append(Colouring("Scans", surface.views.astype(np.float32), 1.0, float(most), "", ColourScale.SEQUENTIAL))
    return ShownSurface(surface.points_mm, surface.normals, None, tuple(found))


def thinned(full: ShownSurface, most: int = MOST_TURNED) -> ShownSurface:
    """Return at most about ``most`` points of it, evenly over the surface: one for each cell of a grid."""
    if len(full.points_mm) <= most:
        return full
    low, high = full.points_mm.min(axis=0), full.points_mm.max(axis=0)
    # A surface meets about (side / cell)² cells; a few tries find the cell that leaves so many.
    cell = float(np.linalg.norm(high - low)) / np.sqrt(most)
    for _ in range(12):
        first, cell_of = _cells(full.points_mm, low, cell)
        if len(first) <= most:
            break
        cell *= max(1.05, float(np.sqrt(len(first) / most)))
    faces = full.faces
    if faces is not None:
        faces = cell_of[faces].astype(np.int32)
        # A triangle whose corners became one point or two is none.
        flat = (faces[:, 0] == faces[:, 1]) | (faces[:, 1] == faces[:, 2]) | (faces[:, 0] == faces[:, 2])
        _, once = np.unique(np.sort(faces[~flat], axis=1), axis=0, return_index=True)
        faces = faces[~flat][once]
    colourings = tuple(
        Colouring(one.name, one.values[first], one.low, one.high, one.unit, one.scale) for one in full.colourings
    )
    return ShownSurface(full.points_mm[first], full.normals[first], faces, colourings)


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
