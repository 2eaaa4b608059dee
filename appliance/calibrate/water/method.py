"""Owns the methods of calibrating in water, and what each gives: a calibration, and what one should know before
trusting it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import Enum
from typing import TYPE_CHECKING

from appliance.measure import Calibration

if TYPE_CHECKING:
    from appliance.calibrate.water.artefact import Residuals
    from appliance.calibrate.water.expected import Expected
    from appliance.calibrate.water.judgement import Estimate


class Method(Enum):
    """Methods of calibrating in water."""

    PAPER = "paper"
    """The published way: perpendicular ports, their distances searched, and a distortion operator from two planes."""
    PORTS = "ports"
    """Adjust each port's tilt and distance; the calibration in air is believed."""
    SPLINE = "spline"
    """Adjust lenses and pose, too, held by their covariance from air, and an image correction per camera: the method to
    use."""


BEFORE_OPERATOR = ("pm", "rm")
"""Names of the models that the published way goes through: pinholes (PM), and ports without an operator (RM)."""


@dataclass(frozen=True, slots=True, eq=False)
class WaterResult:
    """A calibration, and what one should know before trusting it."""

    method: Method
    calibration: Calibration
    warnings: tuple[str, ...]
    residuals: tuple[Residuals, ...] = ()
    """Residuals of each recording, in px; the same measure for every method."""
    systematic_px: float = 0.0
    """RMS of what remains after averaging the noise away over patches of the image."""
    estimates: tuple[Estimate, ...] = ()
    """Adjusted parameters with prior and posterior uncertainty; empty where the method states none."""
    costs: tuple[float, ...] = ()
    """The robust sum of squares, priors included: before the first step of the adjustment and after each.

    Where the prior is estimated on the way, earlier ones are moved by what that changes.
    """
    expected: Expected | None = None
    """Errors to be expected of lengths and planes that were not recorded; ``None`` where the method does not tell."""
    before: Mapping[str, Calibration] = field(default_factory=dict)
    """Calibrations of the models in ``BEFORE_OPERATOR``; empty but for the published way."""

    @property
    def unobserved(self) -> tuple[str, ...]:
        """Names of the parameters that stayed at their prior because the recordings say nothing about them."""
        return tuple(estimate.name for estimate in self.estimates if estimate.at_prior)
