"""The result of one artefact in one scan: relative errors after VDI/VDE 2634, and the noise."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import Enum
from types import MappingProxyType
from typing import assert_never

import numpy as np

from appliance.measure.accept.acceptance import (
    Certificate,
    Quantity,
    Symbol,
    bar_quantities,
    expanded_mm,
    plane_quantities,
)
from appliance.measure.accept.ball_bar import BallBar, find_ball_bar
from appliance.measure.accept.flatness import REFERENCE_MM, flatness, local_noise_mm
from appliance.measure.accept.frustum import Frustum, find_frustum
from appliance.measure.accept.plane import PlaneFit, fit_plane
from appliance.measure.accept.points import FitPoints, NotFound, PointSource

Fit = BallBar | PlaneFit | Frustum


class Artefact(Enum):
    """Artefacts that can be evaluated."""

    BALL_BAR = "ball-bar"
    PLANE = "plane"
    FRUSTUM = "frustum"


LENGTHS: Mapping[Artefact, tuple[str, ...]] = {
    Artefact.BALL_BAR: ("length",),
    Artefact.PLANE: (),
    Artefact.FRUSTUM: ("top", "base", "slanted", "height"),
}
"""Names of the calibrated lengths of each artefact."""


@dataclass(frozen=True, slots=True)
class Length:
    """One measured length and the calibrated one."""

    name: str
    measured_mm: float
    calibrated_mm: float
    sigma_mm: float | None = None
    """Standard deviation by the noise of the points; ``None``: not derived."""
    certificate_sd_mm: float | None = None
    """Standard uncertainty of the calibrated length; ``None``: not stated."""

    @property
    def e_l(self) -> float:
        """(measured − calibrated)/calibrated, signed: the paper's Eq. (6) is its absolute value. 1 is 100 %."""
        return (self.measured_mm - self.calibrated_mm) / self.calibrated_mm

    @property
    def uncertainty_mm(self) -> float | None:
        """Expanded (k = 2) uncertainty of the length error by noise and certificate; ``None``: both unknown."""
        if self.sigma_mm is None and self.certificate_sd_mm is None:
            return None
        return expanded_mm(self.sigma_mm, self.certificate_sd_mm)


@dataclass(frozen=True, slots=True, eq=False)
class Result:
    """Result for one cloud; ``fit`` is ``NotFound`` if the artefact was not found."""

    artefact: Artefact
    fit: Fit | NotFound
    lengths: tuple[Length, ...] = ()
    e_f: float | None = None
    e_f_sys: float | None = None
    noise_mm: float | None = None
    quantities: tuple[Quantity, ...] = ()
    """Quantities of VDI/VDE 2634 part 2: PF, PS and SD of a ball bar, F of a plane."""

    @property
    def surfaces(self) -> Mapping[str, FitPoints]:
        """The fitted surfaces by name."""
        match self.fit:
            case BallBar(first, second):
                return {"first ball": first.used, "second ball": second.used}
            case PlaneFit():
                return {"plane": self.fit.used}
            case Frustum(top, plate, sides):
                named = {f"side {k + 1}": side.used for k, side in enumerate(sides)}
                return {"top": top.used, "plate": plate.used, **named}
            case NotFound():
                return {}
            case unknown:
                assert_never(unknown)

    @property
    def worst_e_l(self) -> float | None:
        """The largest absolute relative length error; ``None`` without lengths."""
        return max((abs(length.e_l) for length in self.lengths), default=None)


def evaluate(
    cloud: PointSource,
    artefact: Artefact,
    calibrated_mm: Mapping[str, float],
    reference_mm: float = REFERENCE_MM,
    certificate: Certificate | None = None,
    limits_mm: Mapping[Symbol, float] = MappingProxyType({}),
) -> Result:
    """Find ``artefact`` in ``cloud`` and compare it with its calibrated lengths and ``limits_mm``.

    ``calibrated_mm``: by the names in ``LENGTHS``.
    """
    stated = certificate or Certificate()
    match artefact:
        case Artefact.BALL_BAR:
            bar = find_ball_bar(cloud)
            if isinstance(bar, NotFound):
                return Result(artefact, bar)
            lengths = tuple(
                Length("length", bar.length_mm, value, bar.sigma_length_mm, stated.length_sd_mm)
                for value in calibrated_mm.values()
            )
            quantities = tuple(
                quantity
                for value in calibrated_mm.values()
                for quantity in bar_quantities(cloud, bar, value, stated, limits_mm)
            )
            noises = [_noise_of_ball(cloud, ball.used) for ball in (bar.first, bar.second)]
            # A ball with too few points has no noise; that of the other one is used.
            finite_noises = [noise for noise in noises if noise is not None]
            noise_mm = float(np.mean(finite_noises)) if finite_noises else None
            return Result(artefact, bar, lengths, noise_mm=noise_mm, quantities=quantities)
        case Artefact.PLANE:
            plane = fit_plane(cloud)
            if isinstance(plane, NotFound):
                return Result(artefact, plane)
            flat = flatness(plane, reference_mm)
            return Result(
                artefact, plane, (), flat.e_f, flat.e_f_sys, flat.noise_mm, plane_quantities(plane, limits_mm)
            )
        case Artefact.FRUSTUM:
            frustum = find_frustum(cloud)
            if isinstance(frustum, NotFound):
                return Result(artefact, frustum)
            lengths = tuple(
                # A frustum has four edges of a kind: each is compared with the same calibrated length.
                Length(name if len(measured) == 1 else f"{name} {k + 1}", value, calibrated_mm[name])
                for name, measured in frustum.lengths_mm.items()
                if name in calibrated_mm
                for k, value in enumerate(measured)
            )
            return Result(artefact, frustum, lengths)
        case unknown:
            assert_never(unknown)


def _noise_of_ball(cloud: PointSource, used: FitPoints) -> float | None:
    """Return the sigma to the local surface of a ball; slow bends over the ball are no noise."""
    return local_noise_mm(cloud.points_mm[used.indices, :2].astype(np.float64), used.residual_mm)
