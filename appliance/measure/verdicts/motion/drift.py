"""The map of the phase drift: the shift of the fringes from one sine image to the next, cell by cell.

Of four steps of 90°, one combination contains no phase, C = I₀ − I₁ + I₂ − I₃. For an object at rest it is noise, apart
from ambient light and from harmonics of the projector's light. A fringe that drifts by ε from image to image makes
C = 2 ε B (sin φ − cos φ). Least squares over a cell of the pattern therefore give ε with its sign.

Changing ambient light adds a part of the mean light and of the modulation to each image, and the projector's second
harmonic a cos 2φ: all three are terms of the fit. So is the sixth harmonic, the only other one below the tenth that C
contains: light by bit planes, captured for a part of a frame, has steps, and these have harmonics. Depth
discontinuities, shadows and edges of albedo at rest give C = 0 as any other pixel. Cells are squares of the *pattern*,
so that both cameras' cells are the same part of the object.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from appliance.measure.decode.decoder import CameraDecoder
from appliance.measure.light.patterns import Direction, PatternSequence
from appliance.measure.verdicts.motion.cells import TERMS, CellSums, cell_sums

LEAST_LEFT = 0.3
"""Lower limit of the share of the drift's terms that the second harmonic leaves in C."""
DRIFT_PIXELS = 40
"""Least number of pixels in a cell."""


@dataclass(frozen=True, slots=True)
class DriftMap:
    """Drift in one camera's images; arrays (rows, columns) of the pattern's cells, NaN: too few pixels."""

    drift_px: NDArray[np.float64]
    """Drift of the fringes ε, pattern px per frame; positive: a pixel's coordinate grows."""
    sd_px: NDArray[np.float64]
    """Standard deviation of it from the residuals of the fit."""
    u_px: NDArray[np.float64]
    """Mean position in the image."""
    v_px: NDArray[np.float64]
    slope_per_px: NDArray[np.float64]
    """Pattern px per image px to the right."""
    noise_rad2: NDArray[np.float64]
    """Variance of the phase from the cameras' noise."""
    texture_per_px2: NDArray[np.float64]
    """Mean square of the light's gradient per pattern px across the fringes, in units of the modulation."""
    uneven_rad2: NDArray[np.float64]
    """Mean square difference, from one pixel to the one below, of the phase error by moving albedo."""
    second2: NDArray[np.float64]
    """Square of the ratio of the second harmonic of the projector's light to the first."""


def drift_map(
    frames: NDArray[np.uint8],
    decoded: CameraDecoder,
    sequence: PatternSequence,
    variance_dn2: tuple[float, float],
) -> DriftMap:
    """Measure the drift in one camera's frames (n, h, w) uint8, by the sine images of X.

    ``variance_dn2``: of the cameras' noise as (dark, per grey value), see ``CameraNoise``.
    """
    sums = cell_sums(frames, decoded.p_px, decoded.q_px, sequence, variance_dn2)
    pair_frames = sequence.axis(Direction.X).pair_frames
    return _drift_of_sums(sums, sequence.period_px / (2.0 * np.pi), variance_dn2, pair_frames)


def _drift_of_sums(
    sums: CellSums, px_per_rad: float, variance_dn2: tuple[float, float], pair_frames: tuple[int, int]
) -> DriftMap:
    """Solve for the drift; ``pair_frames`` as in ``Axis``."""
    means, count = sums.means, sums.means["count"]
    enough = count >= DRIFT_PIXELS
    normal, right = sums.products[..., :TERMS, :TERMS], sums.products[..., TERMS, :TERMS]
    # A small share of the trace keeps the equations of cells with few fringes regular; it is far below their errors.
    trace = np.trace(normal, axis1=-2, axis2=-1)
    normal = normal + (1e-6 * np.maximum(trace, 1.0))[..., None, None] * np.eye(TERMS)
    inverse = np.linalg.inv(normal)
    fit = (inverse @ right[..., None])[..., 0]
    # Residual variance of the fit: (Σ C² − fit · right) / degrees of freedom.
    residual2 = np.maximum(sums.products[..., TERMS, TERMS] - np.sum(fit * right, -1), 0.0) / np.maximum(
        count - TERMS, 1.0
    )
    # C = ε B (m sin φ − n cos φ), with m frames from 0° to 180° and n from 90° to 270°: least squares of ε.
    m, n = pair_frames
    squares_sum = float(m * m + n * n)
    drift = (m * fit[..., 2] - n * fit[..., 1]) / squares_sum
    # A second harmonic κ adds 4 κ cos 2φ to C, and with it a drift makes an error of φ, 2 ε κ sin 2φ (cos φ − sin φ):
    # the terms of the drift in C are then smaller by the share 4 κ².
    second2 = (fit[..., 3] ** 2 + fit[..., 4] ** 2) / 16.0
    px = px_per_rad / np.maximum(1.0 - 4.0 * second2, LEAST_LEFT)
    of_both = n * n * inverse[..., 1, 1] + m * m * inverse[..., 2, 2] - 2.0 * m * n * inverse[..., 1, 2]
    variance = residual2 * of_both / squares_sum**2
    # Σ (C − fit · x)² of differences from one pixel to the one below. A drift makes none, since along an x-fringe the
    # phase hardly changes; nor do harmonics, which follow the phase. Noise is subtracted below.
    combination = np.concatenate([-fit, np.ones((*count.shape, 1))], -1)
    apart = np.sum(combination * (sums.apart @ combination[..., None])[..., 0], -1)

    with np.errstate(invalid="ignore", divide="ignore"):
        # Σ I of drifting fringes contains ε B (m sin φ + n cos φ), which is no texture. With rising steps it adds a
        # hundredth of the ripple, and is neglected.
        leak = 0.0 if m == n else (drift / px_per_rad) ** 2 * squares_sum / 32.0
        dark, per_dn = variance_dn2

        def where_enough(values: NDArray[np.float64]) -> NDArray[np.float64]:
            return np.where(enough, values, np.nan)

        return DriftMap(
            where_enough(px * drift),
            where_enough(px * np.sqrt(variance)),
            where_enough(means["u"] / count),
            where_enough(means["v"] / count),
            where_enough(means["slope"] / means["sloped"]),
            where_enough(0.5 * (dark + per_dn * means["light"] / count) * means["inverse"] / count),
            where_enough(np.maximum(means["texture"] / means["steep"] - leak, 0.0)),
            # NaN for a cell without any pair of pixels.
            where_enough((apart - means["apart_noise"]) / means["apart_scale"]),
            where_enough(second2),
        )
