"""Owns the map of phase drift: how far the fringes move from one sine image to the next, place by place.

Four steps of 90° leave one combination that holds no phase, C = I₀ − I₁ + I₂ − I₃. On a thing at rest it is noise, but
for what daylight adds between images (in proportion to the modulation) and for the second harmonic of the projector's
light (cos 2φ). A fringe that drifts by ε from image to image makes C = 2 ε B (sin φ − cos φ). Least squares over a cell
of the pattern therefore tell ε, signed. Flickering and drifting daylight adds a part of the mean light and of the
modulation to each image, and the projector's second harmonic a cos 2φ: all three are terms of the fit. So is its sixth,
the only other one below the tenth that is left in C: a light that is made of bit planes and seen for a part of a frame
has steps, and these have harmonics. Depth steps, shadows and edges of albedo at rest give the same C as any other
pixel: nothing. Cells are squares of the *pattern*, so that both cameras' cells are the same place on the thing,
whatever its shape.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from appliance.measure.decode.decoder import CameraDecoder
from appliance.measure.light.patterns import Direction, PatternSequence
from appliance.measure.verdicts.motion.cells import TERMS, CellSums, cell_sums

LEAST_LEFT = 0.3
"""Least share of the drift's terms that is left in C, whatever the second harmonic takes of them."""
DRIFT_PIXELS = 40
"""Fewer in a cell tell nothing."""


@dataclass(frozen=True, slots=True)
class DriftMap:
    """One camera's cells; arrays (rows, columns) float64 of the pattern's cells, NaN where there are too few pixels."""

    drift_px: NDArray[np.float64]
    """Drift of the fringes ε, pattern px per frame; positive: a pixel's coordinate grows."""
    sd_px: NDArray[np.float64]
    """Standard deviation of it from what the fit leaves."""
    u_px: NDArray[np.float64]
    """Mean place in the image."""
    v_px: NDArray[np.float64]
    slope_per_px: NDArray[np.float64]
    """Pattern px per image px to the right."""
    noise_rad2: NDArray[np.float64]
    """Variance of the phase from the cameras' noise."""
    texture_per_px2: NDArray[np.float64]
    """Mean square of how much the light changes per pattern px across the fringes, in modulations."""
    uneven_rad2: NDArray[np.float64]
    """Mean square difference, from one pixel to that below, of the phase error that moving albedo makes."""
    second2: NDArray[np.float64]
    """Square of the second harmonic's share of the first, of the projector's light as it was recorded."""


def drift_map(
    frames: NDArray[np.uint8],
    decoded: CameraDecoder,
    sequence: PatternSequence,
    variance_dn2: tuple[float, float],
) -> DriftMap:
    """Measure the drift in one camera's frames (n, h, w) uint8, by the sine images across which depth moves the
    pattern.

    ``variance_dn2``: of the cameras' noise as (dark, per grey value), see ``CameraNoise``.
    """
    sums = cell_sums(frames, decoded.p_px, decoded.q_px, sequence, variance_dn2)
    pair_frames = sequence.axis(Direction.X).pair_frames
    return _drift_of_sums(sums, sequence.period_px / (2.0 * np.pi), variance_dn2, pair_frames)


def _drift_of_sums(
    sums: CellSums, px_per_rad: float, variance_dn2: tuple[float, float], pair_frames: tuple[int, int]
) -> DriftMap:
    """Solve for the drift; ``pair_frames`` as ``Axis`` says."""
    means, count = sums.means, sums.means["count"]
    enough = count >= DRIFT_PIXELS
    normal, right = sums.here[..., :TERMS, :TERMS], sums.here[..., TERMS, :TERMS]
    # A little of the trace keeps cells with few fringes solvable; it is far below what any cell can tell.
    trace = np.trace(normal, axis1=-2, axis2=-1)
    normal = normal + (1e-6 * np.maximum(trace, 1.0))[..., None, None] * np.eye(TERMS)
    inverse = np.linalg.inv(normal)
    fit = (inverse @ right[..., None])[..., 0]
    # Residual variance of the fit: (Σ C² − fit · right) / degrees of freedom.
    rest = np.maximum(sums.here[..., TERMS, TERMS] - np.sum(fit * right, -1), 0.0) / np.maximum(count - TERMS, 1.0)
    # C = ε B (m sin φ − n cos φ), with m frames from 0° to 180° and n from 90° to 270°: least squares of ε.
    m, n = pair_frames
    both = float(m * m + n * n)
    drift = (m * fit[..., 2] - n * fit[..., 1]) / both
    # A second harmonic κ puts 4 κ cos 2φ into C, and a drift bends φ itself, by 2 ε κ sin 2φ (cos φ − sin φ): of the
    # drift's own terms, 4 κ² are then missing from C.
    second2 = (fit[..., 3] ** 2 + fit[..., 4] ** 2) / 16.0
    px = px_per_rad / np.maximum(1.0 - 4.0 * second2, LEAST_LEFT)
    of_both = n * n * inverse[..., 1, 1] + m * m * inverse[..., 2, 2] - 2.0 * m * n * inverse[..., 1, 2]
    variance = rest * of_both / both**2
    # Σ (C − fit · x)² of differences from one pixel to that below, which a drift does not make: down an x-fringe the
    # phase hardly changes. What the light's own steps leave of the fit, which follows the phase, is none of it, and
    # neither is noise.
    left = np.concatenate([-fit, np.ones((*count.shape, 1))], -1)
    apart = np.sum(left * (sums.apart @ left[..., None])[..., 0], -1)

    with np.errstate(invalid="ignore", divide="ignore"):
        # Σ I of fringes that drift holds ε B (m sin φ + n cos φ), which is no texture. Where the steps rise, what it
        # adds to the harm is a hundredth of the ripple.
        leak = 0.0 if m == n else (drift / px_per_rad) ** 2 * both / 32.0
        dark, per_dn = variance_dn2

        def known(values: NDArray[np.float64]) -> NDArray[np.float64]:
            return np.where(enough, values, np.nan)

        return DriftMap(
            known(px * drift),
            known(px * np.sqrt(variance)),
            known(means["u"] / count),
            known(means["v"] / count),
            known(means["slope"] / means["sloped"]),
            known(0.5 * (dark + per_dn * means["light"] / count) * means["inverse"] / count),
            known(np.maximum(means["texture"] / means["steep"] - leak, 0.0)),
            # A cell without a pair of pixels knows nothing.
            known((apart - means["apart_noise"]) / means["apart_scale"]),
            known(second2),
        )
