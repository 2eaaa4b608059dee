"""Owns the search for the interface distances of perpendicular ports (UIDD): the published method, for comparison.

Bräuer-Burchardt et al. 2015, Eqs. 5–7: the pair (d1, d2) that minimises T, the sum of squares of the relative length
errors of ball bars and the relative flatness errors of planes. As published, flatness is a range, whose floor is the
noise and which therefore has a valley along d1 − d2; the noise-free variant takes the range of a bivariate cubic
through the distances instead. Tilted ports cannot be found this way: ``bundle`` finds them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from appliance.calibration.file import Calibration
from appliance.calibration.recordings import ArtefactKind, Recording, RecordingError, thinned
from appliance.calibration.water.shapes import fit_plane, fit_sphere, nearest_points
from appliance.optics.model import HousedCamera

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class SearchSettings:
    """Limits and step widths of the search, and how flatness is measured."""

    reach_mm: float = 4.0
    """Around the starting distances."""
    steps_mm: tuple[float, ...] = (1.0, 0.25, 0.05)
    """Each search goes around the best of the one before, two of its steps to each side."""
    noise_free: bool = True
    """Flatness from a fitted cubic; ``False``: from the points, as published."""
    field_mm: float = 250.0
    """d_r, the size of the measuring field to which flatness is related."""
    outliers: float = 0.003
    """Share of points left out of a published flatness."""
    points_per_recording: int = 600


@dataclass(frozen=True, slots=True, eq=False)
class Valley:
    """T over the pairs of distances that the first, widest search tried."""

    d1_mm: Array
    """(m,) left interface distances, ascending."""
    d2_mm: Array
    """(n,) right ones."""
    statistic: Array
    """(m, n)."""


@dataclass(frozen=True, slots=True, eq=False)
class SearchResult:
    """The distances found, what they leave, and whether the search ended inside its limits."""

    calibration: Calibration
    statistic: float
    """T at the minimum."""
    length_errors: tuple[float, ...]
    """E_L of each bar, as a fraction."""
    flatness_errors: tuple[float, ...]
    """E_F of each plane, as a fraction."""
    warnings: tuple[str, ...]
    valley: Valley


def search_distances(
    recordings: Sequence[Recording], start: Calibration, settings: SearchSettings | None = None
) -> SearchResult:
    """Find d1 and d2 for ports as ``start`` has them otherwise. Raises RecordingError without a bar or a plane."""
    chosen = settings or SearchSettings()
    for kind in ArtefactKind:
        if not any(r.kind is kind for r in recordings):
            raise RecordingError(
                f"no recording of a {kind.value}; the statistic T needs ball bars and planes; record one"
            )
    used = [thinned(r, chosen.points_per_recording) for r in recordings]
    rig = start.rig
    middle = np.array([rig.left.port.distance_mm, rig.right.port.distance_mm])
    # An interface distance below zero would put the window behind the projection centre.
    limits = (np.maximum(middle - chosen.reach_mm, 0.0), middle + chosen.reach_mm)
    reach = chosen.reach_mm
    best, least = middle, np.inf
    valley: Valley | None = None
    for step in chosen.steps_mm:
        count = int(np.ceil(reach / step))
        offsets = np.arange(-count, count + 1) * step
        axes = []
        for side, camera in enumerate((rig.left, rig.right)):
            distances = np.unique(np.clip(best[side] + offsets, limits[0][side], limits[1][side]))
            # Rays depend on one camera's distance only: m + n traces serve all m · n pairs.
            axes.append([(d, _rays(_with_distance(camera, float(d)), used, side)) for d in distances])
        tried = np.zeros((len(axes[0]), len(axes[1])))
        for i, (d1, left) in enumerate(axes[0]):
            for j, (d2, right) in enumerate(axes[1]):
                lengths, ranges = _errors(used, left, right, chosen)
                # T of Eq. 7.
                statistic = float(sum(e * e for e in (*lengths, *ranges)))
                tried[i, j] = statistic
                if statistic < least:
                    best, least = np.array([d1, d2]), statistic
        if valley is None:
            valley = Valley(np.array([d for d, _ in axes[0]]), np.array([d for d, _ in axes[1]]), tried)
        reach = 2.0 * step
    if valley is None:
        raise ValueError("search without a step width; give at least one in steps_mm")
    found = replace(rig, left=_with_distance(rig.left, float(best[0])), right=_with_distance(rig.right, float(best[1])))
    lengths, ranges = _errors(used, _rays(found.left, used, 0), _rays(found.right, used, 1), chosen)
    warnings = tuple(
        f"{side} interface distance {d:.2f} mm is at the limit of the search; widen it, or the port is not as modelled"
        for side, d, low, high in zip(("left", "right"), best, *limits, strict=True)
        if min(d - low, high - d) < 0.5 * chosen.steps_mm[-1]
    )
    made_from = (*start.made_from, *(f"recording {r.name}" for r in recordings))
    calibration = replace(
        start, method="search of distances", made_from=made_from, water=used[0].water, rig=found, air_covariance=None
    )
    return SearchResult(calibration, least, tuple(lengths), tuple(ranges), warnings, valley)


def cubic(uv: Array) -> Array:
    """Return the ten monomials (n, 10) of a bivariate cubic at coordinates (n, 2)."""
    x, y = uv[:, 0], uv[:, 1]
    return np.stack([x**i * y**j for i in range(4) for j in range(4 - i)], -1)


def _with_distance(camera: HousedCamera, distance_mm: float) -> HousedCamera:
    return replace(camera, port=replace(camera.port, distance_mm=distance_mm))


def _rays(camera: HousedCamera, recordings: Sequence[Recording], side: int) -> list[tuple[Array, Array]]:
    return [camera.rays(r.left_px if side == 0 else r.right_px, r.water.index) for r in recordings]


def _errors(
    recordings: Sequence[Recording],
    left: Sequence[tuple[Array, Array]],
    right: Sequence[tuple[Array, Array]],
    settings: SearchSettings,
) -> tuple[list[float], list[float]]:
    """Return relative length errors of the bars and flatness errors of the planes."""
    lengths, ranges = [], []
    for recording, one, other in zip(recordings, left, right, strict=True):
        points = nearest_points(*one, *other)
        if recording.length_mm is not None:
            a, b = (fit_sphere(points[recording.sphere == k], recording.radius_mm)[0] for k in (0, 1))
            lengths.append(float(np.linalg.norm(b - a)) / recording.length_mm - 1.0)
        else:
            normal, offset = fit_plane(points)
            off = points @ normal - offset
            if settings.noise_free:
                # Range of the fitted cubic instead of that of the points: the noise of a point adds several of its
                # standard deviations to a range, and the minimum of T would lie where noise is small.
                terms = cubic((points[:, :2] - points[:, :2].mean(axis=0)) / settings.field_mm)
                off = terms @ np.linalg.lstsq(terms, off, rcond=None)[0]
                ranges.append(float(np.ptp(off)) / settings.field_mm)
            else:
                kept = np.sort(off)
                cut = int(0.5 * settings.outliers * len(kept))
                ranges.append(float(kept[-1 - cut] - kept[cut]) / settings.field_mm)
    return lengths, ranges
