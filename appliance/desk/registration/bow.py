"""Smooth depth error that all scans of one calibration share, as coefficients with a prior.

An error of 30 µm, smooth over the view and the same in every scan, fits every scan pair: each neighbour is only rotated a
little, always in the same sense, and twelve scans in a row bend by more than half a millimetre; residuals of a merge do
not show it. So the shared error is carried as parameters with a prior: overlaps of rotated or nearer views and closed
loops make it smaller, and the remainder stays in the budget.

``measure/calibration/depth_error.py`` has its shapes φ; c are their coefficients, mm.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from appliance.measure import BORDER, DISTANCE_MM, POWERS, STANDARD, WorkingVolume, along_ray, shapes

Array = NDArray[np.float64]

_USUAL_MM = {2: 0.030, 3: 0.020, 4: 0.010, 5: 0.007}
"""Standard deviations of coefficients by their order in u and v."""
_WITH_DISTANCE = 0.2
"""Standard deviation of shapes that grow with the distance, over that of those that do not; of a tilt as of a bend."""
PRIOR_MM2 = np.diag([(_USUAL_MM[max(i + j, 2)] * (_WITH_DISTANCE if k else 1.0)) ** 2 for i, j, k in POWERS])
"""Prior covariance for a calibration that states none: flatness errors of calibrated instruments (docs/calibration.md:
worst 0.017 % of the view's diagonal, 46 µm from the highest to the lowest point)."""
MIN_SHARE = 0.5
"""Least share of a direction's variance that overlaps must remove for the direction to count."""
LEAST_MM = 0.006
"""Standard deviation of each coefficient that is added to that of a calibration, for errors that its model lacks."""


def prior_covariance(stated_mm2: Array | None) -> Array:
    """Return the prior covariance (k, k), mm², of the shared error.

    ``stated_mm2``: the calibration's own (``Calibration.depth_error_mm2``); ``None``: it states none.
    """
    return PRIOR_MM2 if stated_mm2 is None else np.asarray(stated_mm2 + LEAST_MM**2 * np.eye(len(PRIOR_MM2)))


def bow_score(estimate_mm: Array, prior_mm2: Array, posterior_mm2: Array) -> float | None:
    """Return the distance of an estimate (k,) from its prior mean, in standard deviations.

    It is about 1 if the prior is right. ``prior_mm2`` and ``posterior_mm2``: covariances (k, k) before and after. If the
    prior is right, the estimate scatters by their difference. Directions in which the overlaps tell little do not
    count; ``None`` if all are so.
    """
    removed_mm2 = prior_mm2 - posterior_mm2
    # In units of the prior an eigenvalue is the share of variance that the overlaps have removed.
    root = np.linalg.cholesky(prior_mm2)
    half = np.linalg.inv(root)
    share, vector = np.linalg.eigh(half @ removed_mm2 @ half.T)
    clear = share > MIN_SHARE
    if not clear.any():
        return None
    along = vector.T @ (half @ estimate_mm)
    return float(np.sqrt(np.mean(along[clear] ** 2 / share[clear])))


def spread_mm(covariance_mm2: Array) -> float:
    """Return the RMS depth over the view of an error whose coefficients have this covariance (k, k).

    It is at 525 mm in the standard housing, and at a distance in proportion in any other.
    """
    u, v = np.meshgrid(np.linspace(-1.0, 1.0, 9), np.linspace(-0.75, 0.75, 7))
    points = DISTANCE_MM * np.stack([BORDER * u, BORDER * v, np.ones_like(u)], axis=-1)
    of_view = shapes(points)
    return float(np.sqrt(np.einsum("...i,ij,...j->...", of_view, covariance_mm2, of_view).mean()))


def remove_depth_error(points_mm: Array, coefficients_mm: Array, volume: WorkingVolume = STANDARD) -> Array:
    """Return points (…, 3) of a scan's own frame without the shared depth error."""
    error = shapes(points_mm, volume) @ coefficients_mm
    return np.asarray(points_mm - along_ray(points_mm) * error[..., None])
