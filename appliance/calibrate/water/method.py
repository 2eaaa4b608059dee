"""Owns the methods of calibrating in water, and what each gives: a calibration, and what one should know before trusting it.

It also owns what is known before any recording in water: lenses and pose from air, ports from the drawing.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from enum import Enum
from typing import TYPE_CHECKING

from appliance.calibrate.air.adjustment import AirCalibration
from appliance.calibrate.recordings import RecordingError
from appliance.measure import IN_AIR, Calibration

if TYPE_CHECKING:
    from appliance.calibrate.water.artefact import Residuals
    from appliance.calibrate.water.expected import Expected
    from appliance.measure import Calibration, Estimate


class Method(Enum):
    """Methods of calibrating in water."""

    PAPER = "paper"
    """The published way: perpendicular ports, their distances searched, and a distortion operator from two planes."""
    PORTS = "ports"
    """Adjust each port's tilt and distance; the calibration in air is believed."""
    SPLINE = "spline"
    """Adjust lenses and pose, too, held by their covariance from air, and an image correction per camera: the method to use."""


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
    """The robust sum of squares, priors included: before the first step of the adjustment and after each. Where the prior is
    estimated on the way, earlier ones are moved by what that changes."""
    expected: Expected | None = None
    """Errors to be expected of lengths and planes that were not recorded; ``None`` where the method does not tell."""
    before: Mapping[str, Calibration] = field(default_factory=dict)
    """Calibrations of the models in ``BEFORE_OPERATOR``; empty but for the published way."""

    @property
    def unobserved(self) -> tuple[str, ...]:
        """Names of the parameters that stayed at their prior because the recordings say nothing about them."""
        return tuple(estimate.name for estimate in self.estimates if estimate.at_prior)


def start_from_air(
    air: AirCalibration, drawn: Calibration, made_from: tuple[str, ...] = ("boards in air",)
) -> Calibration:
    """Return the calibration that every adjustment in water begins with: ``drawn``'s ports, all else, its
    covariance and the lenses' fields from air."""
    left, right = (
        replace(measured, port=design.port)
        for measured, design in ((air.rig.left, drawn.rig.left), (air.rig.right, drawn.rig.right))
    )
    symmetric = 0.5 * (air.covariance + air.covariance.T)
    return replace(
        drawn,
        method=IN_AIR,
        made_from=made_from,
        rig=replace(drawn.rig, left=left, right=right),
        residual_px=air.residual_px,
        air_covariance=tuple(tuple(float(v) for v in row) for row in symmetric),
        air_field=air.field,
    )


def check_start(start: Calibration) -> None:
    """Raises RecordingError unless ``start`` has plain lenses behind ports, as a calibration in air and a drawing have."""
    for side, camera in (("left", start.rig.left), ("right", start.rig.right)):
        if camera.lens_in_water or camera.correction is not None or camera.ray_shift is not None:
            raise RecordingError(
                f"the {side} camera of {start.method} is no plain lens behind a port, as a start must have; put the "
                f"one in air at calibration/air.json, or name it"
            )
