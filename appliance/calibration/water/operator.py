"""Owns the distortion operator D from two planes: the published repair of what perpendicular ports leave (RMD).

Every point of the planes is moved to its fitted plane and projected back; what is then missing in the images is
approximated by a bivariate cubic (ten coefficients per coordinate and camera). A bicubic spline contains every cubic,
so that the operator travels in the calibration file as an ordinary image correction.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from appliance.calibration.file import Calibration
from appliance.calibration.recordings import ArtefactKind, Recording, RecordingError
from appliance.calibration.water.interface import SearchResult, SearchSettings, cubic, search_distances
from appliance.calibration.water.shapes import fit_plane, triangulate
from appliance.optics.correction import INTERVALS, ImageCorrection, basis_matrix
from appliance.optics.model import HousedCamera, StereoRig

Array = NDArray[np.float64]

LEAST_POINTS = 100
"""Ten for each coefficient."""


def search_with_operator(
    recordings: Sequence[Recording], start: Calibration, settings: SearchSettings | None = None
) -> SearchResult:
    """Search for distances, then the operator, then the distances once more. Not repeated: they would walk along T's
    valley."""
    first = search_distances(recordings, start, settings)
    corrected = replace(first.calibration, rig=with_operator(recordings, first.calibration))
    again = search_distances(recordings, corrected, settings)
    return replace(
        again,
        calibration=replace(
            again.calibration, method="search of distances, operator", made_from=first.calibration.made_from
        ),
    )


def with_operator(recordings: Sequence[Recording], calibration: Calibration) -> StereoRig:
    """Return the rig with the operator of both cameras. Raises RecordingError for fewer than two planes."""
    planes = [r for r in recordings if r.kind is ArtefactKind.PLANE]
    if len(planes) < 2:
        raise RecordingError(f"{len(planes)} recordings of a plane; the operator needs two, near and far; record them")
    rig = calibration.rig
    seen: dict[str, list[tuple[Array, Array]]] = {"left": [], "right": []}
    for plane in planes:
        points = triangulate(rig, plane.left_px, plane.right_px, plane.water.index)
        normal, offset = fit_plane(points)
        # The nearest point of the plane is taken for the true one: what separates it from the seen one is read as
        # distortion, also where the port is to blame. That is the method's limit.
        flat = points - (points @ normal - offset)[:, None] * normal
        seen["left"].append((plane.left_px, plane.left_px - rig.left.project(flat, plane.water.index)))
        seen["right"].append((plane.right_px, plane.right_px - rig.right.project(flat, plane.water.index)))
    return replace(rig, left=_operator(rig.left, seen["left"]), right=_operator(rig.right, seen["right"]))


def _operator(camera: HousedCamera, seen: Sequence[tuple[Array, Array]]) -> HousedCamera:
    uv, missing = (np.concatenate(parts) for parts in zip(*seen, strict=True))
    there = np.isfinite(missing).all(axis=1)
    uv, missing = uv[there], missing[there]
    if len(uv) < LEAST_POINTS:
        raise RecordingError(
            f"{len(uv)} points of the planes lie in the water before a camera; {LEAST_POINTS} are needed; check the start, and record again"
        )
    coefficients = np.linalg.lstsq(cubic(_unit(camera, uv)), missing, rcond=None)[0]
    columns, rows = INTERVALS
    v, u = np.meshgrid(
        np.linspace(0, camera.height_px - 1, 4 * rows + 1),
        np.linspace(0, camera.width_px - 1, 4 * columns + 1),
        indexing="ij",
    )
    grid = np.stack([u.ravel(), v.ravel()], -1)
    matrix = basis_matrix(grid, (camera.width_px, camera.height_px), INTERVALS)
    # The spline's nodes follow from the cubic on a grid four times finer than the intervals: exact but for rounding, as
    # a cubic is a spline.
    nodes = np.linalg.lstsq(matrix, cubic(_unit(camera, grid)) @ coefficients, rcond=None)[0]
    correction = ImageCorrection(camera.width_px, camera.height_px, INTERVALS, tuple(float(c) for c in nodes.ravel()))
    return replace(camera, correction=correction)


def _unit(camera: HousedCamera, uv_px: Array) -> Array:
    """Return image coordinates from −1 to 1."""
    return np.asarray(2.0 * (uv_px + 0.5) / [camera.width_px, camera.height_px] - 1.0)
