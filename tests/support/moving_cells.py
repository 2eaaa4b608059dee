"""The cells of a pattern over which something moves or rests, made of numbers, for the rules of the judge of movement."""

from __future__ import annotations

from typing import Any

import numpy as np

from appliance.measure.verdicts.motion.harm import Harm

ROWS, COLUMNS = 6, 8


def cells(value: float) -> np.ndarray:
    """The same everywhere."""
    return np.full((ROWS, COLUMNS), value)


def harm(ripple: float | None = 0.1, **maps: np.ndarray) -> Harm:
    """A plane that recedes evenly, and is well seen."""
    v, u = np.mgrid[0:ROWS, 0:COLUMNS].astype(float)
    given: dict[str, Any] = {
        "drift_px": cells(0.02),
        "sd_px": cells(0.002),
        "depth_rate_mm_s": cells(3.0),
        "ripple_mm": cells(0.004),
        "noise_mm": cells(0.02),
        "weight": cells(1.0),
        "u_px": 25.0 + 50.0 * u,
        "v_px": 25.0 + 50.0 * v,
    }
    return Harm(**(given | maps), ripple=ripple, ripple_rms_mm=0.004, noise_rms_mm=0.02)
