"""Methods of calibrating in water, and their common result."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import Enum
from typing import TYPE_CHECKING

from appliance.measure import Calibration

if TYPE_CHECKING:
    from appliance.calibrate.water.artefact import Residuals
    from appliance.calibrate.water.expected import ExpectedErrors
    from appliance.calibrate.water.judgement import Estimate


class Method(Enum):
    """Methods of calibrating in water."""

    PAPER = "paper"
    """The published method: perpendicular ports at searched distances, and a distortion operator from two planes."""
    PORTS = "ports"
    """Adjust each port's tilt and distance; the air calibration stays as it is."""
    SPLINE = "spline"
    """Adjust lenses and extrinsics, too, with their covariance from air as prior, and an image correction per camera.
    The recommended method."""


BEFORE_OPERATOR = ("pm", "rm")
"""Names of the models that the published method goes through: pinholes (PM), and ports without an operator (RM)."""


@dataclass(frozen=True, slots=True, eq=False)
class WaterResult:
    """A water calibration with its residuals, warnings and expected errors."""

    method: Method
    calibration: Calibration
    warnings: tuple[str, ...]
    residuals: tuple[Residuals, ...] = ()
    """Residuals of each recording, in px; the same measure for every method."""
    systematic_px: float = 0.0
    """RMS of the systematic residuals: means over patches of the image, without noise."""
    estimates: tuple[Estimate, ...] = ()
    """Adjusted parameters with prior and posterior standard deviations; empty where the method states none."""
    costs: tuple[float, ...] = ()
    """Robust sum of squares with priors, before the first step of the adjustment and after each.

    Where the prior is estimated during the adjustment, earlier values are shifted to stay comparable.
    """
    expected: ExpectedErrors | None = None
    """Expected errors of lengths and planes that were not recorded; ``None`` where the method gives none."""
    before: Mapping[str, Calibration] = field(default_factory=dict)
    """Calibrations of the models in ``BEFORE_OPERATOR``; empty except for the published method."""

    @property
    def unobserved(self) -> tuple[str, ...]:
        """Names of the parameters that the recordings do not determine, so that they stayed at their prior."""
        return tuple(estimate.name for estimate in self.estimates if estimate.at_prior)
