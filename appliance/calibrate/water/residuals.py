"""Owns what a calibration leaves of a recording: transfer errors in px, with the artefact put where it fits best.

The same measure for every method, however it was found: the ray of the left pixel meets the artefact, the point is seen
by the right camera, and there it misses the matched pixel.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from appliance.calibrate.recordings import Recording, thinned
from appliance.calibrate.water.artefact import first_place
from appliance.measure import StereoRig

Array = NDArray[np.float64]

STEPS_AT_MOST = 12
SMALL_PX = 1e-5


@dataclass(frozen=True, slots=True, eq=False)
class Residuals:
    """Residuals of one recording."""

    name: str
    left_px: Array
    """(n, 2)."""
    miss_px: Array
    """(n, 2), where the right camera should see it minus where it does."""

    @property
    def rms_px(self) -> float:
        """RMS residual per coordinate."""
        return float(np.sqrt(np.mean(self.miss_px**2)))


def residuals_of(recording: Recording, rig: StereoRig, points: int = 1500) -> Residuals:
    """Compute the residuals that ``rig`` leaves of a recording. Raises RecordingError when it does not look like its
    artefact."""
    place, used = first_place(thinned(recording, points), rig)
    index = used.water.index
    origin, direction = rig.left.rays(used.left_px, index)

    def miss(q: Array) -> Array:
        return rig.right.project(place.meet(origin, direction, used.sphere, q), index) - used.right_px

    q = np.zeros(len(place.steps))
    now = miss(q)
    for _ in range(STEPS_AT_MOST):
        # Only the artefact's pose is adjusted; the rig stays as it is. Gauss-Newton without damping: the start is
        # within tenths of a millimetre.
        J = np.stack([(miss(q + e) - now).ravel() / e.max() for e in np.diag(place.steps)], -1)
        known = np.isfinite(J).all(axis=1) & np.isfinite(now.ravel())
        # In units of a hundredth of a pixel, as matches are; the certificate of a bar is in units of its own.
        extra, D = place.certificate(q)
        step = -np.linalg.lstsq(
            np.concatenate([J[known] / 0.04, D]), np.concatenate([now.ravel()[known] / 0.04, extra]), rcond=None
        )[0]
        q = q + step
        before, now = now, miss(q)
        if float(np.nanmax(np.abs(now - before))) < SMALL_PX:
            break
    seen = np.isfinite(now).all(axis=1)
    return Residuals(recording.name, used.left_px[seen], now[seen])
