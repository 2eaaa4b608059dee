"""The quantities of VDI/VDE 2634 part 2 (acceptance of optical area measurement) and their limits.

PF, probing error of form: range of the radial distances of a ball's points from their best-fit sphere. PS, probing
error of size: diameter of that sphere less the calibrated one. SD, sphere-spacing error: measured less calibrated
distance of the centres. F, flatness error: range of the distances of a plane's points from their best-fit plane. Best
fit is by least squares of orthogonal distances with a free radius; at most 0.3 % of the points are left out.

A value complies with its limit (maximum permissible error), or exceeds it, if that is true of every value within the
expanded uncertainty (k = 2); in between it is undecided (ISO 14253-1). PF and F are ranges, whose uncertainty is not
derived: they are compared as they are.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from enum import Enum

import numpy as np

from appliance.measure.accept.ball_bar import Ball, BallBar
from appliance.measure.accept.plane import PlaneFit
from appliance.measure.accept.points import Array, PointSource, without_outliers

COVERAGE = 2.0
"""k of the expanded uncertainty: 95 % of a normal distribution."""
STEPS = 50
ROUNDS = 3


class Symbol(Enum):
    """Quantities by the letters of the guideline."""

    PF = "PF"
    PS = "PS"
    SD = "SD"
    F = "F"


class Compliance(Enum):
    """Compliance of a value with its limit."""

    PASS = "pass"
    FAIL = "fail"
    UNDECIDED = "not decided: within the uncertainty of the limit"
    NO_LIMIT = "no limit stated"


@dataclass(frozen=True, slots=True)
class Certificate:
    """The data of an artefact's certificate besides its lengths; ``None``: not stated."""

    length_sd_mm: float | None = None
    """Standard uncertainty of the length."""
    radius_mm: float | None = None
    """Radius of both balls."""
    radius_sd_mm: float | None = None


@dataclass(frozen=True, slots=True)
class Quantity:
    """One quantity of one surface or length of a scan."""

    symbol: Symbol
    part: str
    """Measured part: ``first ball``, ``length``, ``plane``."""
    value_mm: float
    uncertainty_mm: float | None
    """Expanded uncertainty (k = 2), from the noise of the points and the certificate; ``None``: not derived."""
    points: int
    rejected: int
    limit_mm: float | None = None

    @property
    def compliance(self) -> Compliance:
        """Compliance with the limit, with the uncertainty considered."""
        if self.limit_mm is None:
            return Compliance.NO_LIMIT
        # ISO 14253-1: conformity is proved only inside the limit less the uncertainty, and a breach only beyond it plus
        # the uncertainty.
        size_mm, around_mm = abs(self.value_mm), self.uncertainty_mm or 0.0
        if size_mm + around_mm <= self.limit_mm:
            return Compliance.PASS
        return Compliance.FAIL if size_mm - around_mm > self.limit_mm else Compliance.UNDECIDED


def overall(quantities: Iterable[Quantity]) -> Compliance:
    """Return the compliance of all together: one failure fails, and every limited quantity must pass."""
    results = [quantity.compliance for quantity in quantities]
    for compliance in (Compliance.FAIL, Compliance.UNDECIDED, Compliance.PASS):
        if compliance in results:
            return compliance
    return Compliance.NO_LIMIT


def expanded_mm(*standard_mm: float | None) -> float:
    """Return k = 2 times the root sum of squares; ``None`` counts as zero."""
    return COVERAGE * math.sqrt(sum(part * part for part in standard_mm if part is not None))


def bar_quantities(
    cloud: PointSource, bar: BallBar, length_mm: float, certificate: Certificate, limits_mm: Mapping[Symbol, float]
) -> tuple[Quantity, ...]:
    """Return PF of both balls, PS of both if their radius is certified, and SD against ``length_mm``."""
    quantities: list[Quantity] = []
    for name, ball in (("first ball", bar.first), ("second ball", bar.second)):
        probed = probe(_belonging(cloud, ball), np.array([*ball.sphere.centre_mm, ball.sphere.radius_mm]))
        if probed is None:
            continue
        counts = (probed.points, probed.rejected)
        quantities.append(Quantity(Symbol.PF, name, probed.range_mm, None, *counts, limits_mm.get(Symbol.PF)))
        if certificate.radius_mm is not None:
            size_mm = 2.0 * (probed.radius_mm - certificate.radius_mm)
            sd_mm = (2.0 * probed.radius_sd_mm, 2.0 * (certificate.radius_sd_mm or 0.0))
            quantities.append(
                Quantity(Symbol.PS, name, size_mm, expanded_mm(*sd_mm), *counts, limits_mm.get(Symbol.PS))
            )
    used = (bar.first.used, bar.second.used)
    quantities.append(
        Quantity(
            Symbol.SD,
            "length",
            bar.length_mm - length_mm,
            expanded_mm(bar.sigma_length_mm, certificate.length_sd_mm),
            sum(part.count for part in used),
            sum(part.rejected_count for part in used),
            limits_mm.get(Symbol.SD),
        )
    )
    return tuple(quantities)


def plane_quantities(plane: PlaneFit, limits_mm: Mapping[Symbol, float]) -> tuple[Quantity, ...]:
    """Return F of the plane."""
    used = plane.used
    return (Quantity(Symbol.F, "plane", used.range_mm, None, used.count, used.rejected_count, limits_mm.get(Symbol.F)),)


@dataclass(frozen=True, slots=True)
class ProbedSphere:
    """The best-fit sphere of one ball."""

    radius_mm: float
    radius_sd_mm: float
    """Standard deviation of the radius from the scatter of the radial distances; systematic errors are not in it."""
    range_mm: float
    points: int
    rejected: int


def probe(points: Array, start: Array) -> ProbedSphere | None:
    """Return the sphere with the least sum of squared radial distances to points (n, 3).

    ``start``: x, y, z, radius in mm. The worst 0.3 % of the points are left out. ``None`` if there is no such sphere.
    """
    # The guideline's sphere is radial and unweighted; the ball bar's fit weights points by their noise.
    x, keep = start.astype(np.float64), np.ones(len(points), bool)
    sd_mm = 0.0
    for _ in range(ROUNDS):
        solution = _least_squares(points[keep], x)
        if solution is None:
            return None
        x, sd_mm = solution
        keep = without_outliers(np.abs(_radial(points, x)))
    solution = _least_squares(points[keep], x)
    if solution is None:
        return None
    x, sd_mm = solution
    return ProbedSphere(
        float(x[3]), sd_mm, float(np.ptp(_radial(points[keep], x))), int(keep.sum()), int((~keep).sum())
    )


def _radial(points: Array, x: Array) -> Array:
    return np.asarray(np.linalg.norm(points - x[:3], axis=1) - x[3])


def _least_squares(points: Array, x: Array) -> tuple[Array, float] | None:
    """Return centre and radius (4,) by Gauss–Newton, and the radius's standard deviation.

    ``None`` if it does not converge.
    """
    if len(points) <= 4:
        return None
    for _ in range(STEPS):
        away = points - x[:3]
        length = np.linalg.norm(away, axis=1)
        # Residual e = |p − c| − r: its derivatives are −(p − c)/|p − c| by the centre and −1 by the radius.
        J = np.column_stack([-away / length[:, None], -np.ones(len(points))])
        e = length - x[3]
        try:
            step = np.linalg.solve(J.T @ J, -(J.T @ e))
        except np.linalg.LinAlgError:
            return None
        x = x + step
        if not np.isfinite(x).all() or x[3] <= 0.0:
            return None
        if np.abs(step).max() < 1e-10:
            variance = float(e @ e) / (len(points) - 4)
            return x, float(np.sqrt(variance * np.linalg.inv(J.T @ J)[3, 3]))
    return None


def _belonging(cloud: PointSource, ball: Ball) -> Array:
    """Return all points of the ball that are not seen too obliquely, also outliers of the ball bar's fit."""
    rows = np.sort(np.concatenate([ball.used.indices, ball.used.rejected]))
    return np.asarray(cloud.points_mm[rows], np.float64)
