"""Owns the quantities of VDI/VDE 2634 part 2, acceptance of optical systems that measure areas, and their limits.

PF, probing error of form: range of the radial distances of a ball's points from their own best-fit sphere. PS, probing
error of size: diameter of that sphere less the calibrated one. SD, sphere-spacing error: measured less calibrated
distance of the centres. F, flatness error: range of the distances of a plane's points from their best-fit plane. Best
fit is by least squares of orthogonal distances, the radius free; at most 0.3 % of the points are left out.

A stated limit (maximum permissible error) is kept or exceeded beyond doubt when that holds for every value within the
expanded uncertainty (k = 2); in between it is not decided (ISO 14253-1). PF and F are ranges, whose uncertainty is not
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


class Kept(Enum):
    """Statement of a value about its limit."""

    PASS = "pass"
    FAIL = "fail"
    UNDECIDED = "not decided: within the uncertainty of the limit"
    NO_LIMIT = "no limit stated"


@dataclass(frozen=True, slots=True)
class Certificate:
    """Statements of an artefact's certificate besides its lengths; ``None``: nothing."""

    length_sd_mm: float | None = None
    """Standard uncertainty of the length."""
    radius_mm: float | None = None
    """Radius of both balls."""
    radius_sd_mm: float | None = None


@dataclass(frozen=True, slots=True)
class Quantity:
    """One quantity of one surface or length of a scan."""

    symbol: Symbol
    of: str
    """Measured thing: ``first ball``, ``length``, ``plane``."""
    value_mm: float
    uncertainty_mm: float | None
    """Expanded uncertainty (k = 2), from the noise of the points and the certificate; ``None``: not derived."""
    points: int
    rejected: int
    limit_mm: float | None = None

    @property
    def kept(self) -> Kept:
        """Statement about the limit, with the uncertainty considered."""
        if self.limit_mm is None:
            return Kept.NO_LIMIT
        # ISO 14253-1: conformity is proved only inside the limit less the uncertainty, and a breach only beyond it plus
        # the uncertainty.
        size_mm, around_mm = abs(self.value_mm), self.uncertainty_mm or 0.0
        if size_mm + around_mm <= self.limit_mm:
            return Kept.PASS
        return Kept.FAIL if size_mm - around_mm > self.limit_mm else Kept.UNDECIDED


def overall(quantities: Iterable[Quantity]) -> Kept:
    """Return the statement about all together: one failure fails, and a pass needs every limited quantity to pass."""
    said = [quantity.kept for quantity in quantities]
    for kept in (Kept.FAIL, Kept.UNDECIDED, Kept.PASS):
        if kept in said:
            return kept
    return Kept.NO_LIMIT


def expanded_mm(*standard_mm: float | None) -> float:
    """Return k = 2 times the root sum of squares; what is not known counts as nothing."""
    return COVERAGE * math.sqrt(sum(part * part for part in standard_mm if part is not None))


def of_bar(
    cloud: PointSource, bar: BallBar, length_mm: float, certificate: Certificate, limits_mm: Mapping[Symbol, float]
) -> tuple[Quantity, ...]:
    """Return PF of both balls, PS of both where their radius is certified, and SD against ``length_mm``."""
    found: list[Quantity] = []
    for name, ball in (("first ball", bar.first), ("second ball", bar.second)):
        probed = probe(_belonging(cloud, ball), np.array([*ball.sphere.centre_mm, ball.sphere.radius_mm]))
        if probed is None:
            continue
        counts = (probed.points, probed.rejected)
        found.append(Quantity(Symbol.PF, name, probed.range_mm, None, *counts, limits_mm.get(Symbol.PF)))
        if certificate.radius_mm is not None:
            size_mm = 2.0 * (probed.radius_mm - certificate.radius_mm)
            sd_mm = (2.0 * probed.radius_sd_mm, 2.0 * (certificate.radius_sd_mm or 0.0))
            found.append(Quantity(Symbol.PS, name, size_mm, expanded_mm(*sd_mm), *counts, limits_mm.get(Symbol.PS)))
    used = (bar.first.used, bar.second.used)
    found.append(
        Quantity(
            Symbol.SD,
            "length",
            bar.length_mm - length_mm,
            expanded_mm(bar.sigma_length_mm, certificate.length_sd_mm),
            sum(one.count for one in used),
            sum(one.rejected_count for one in used),
            limits_mm.get(Symbol.SD),
        )
    )
    return tuple(found)


def of_plane(plane: PlaneFit, limits_mm: Mapping[Symbol, float]) -> tuple[Quantity, ...]:
    """Return F of the plane."""
    used = plane.used
    return (Quantity(Symbol.F, "plane", used.range_mm, None, used.count, used.rejected_count, limits_mm.get(Symbol.F)),)


@dataclass(frozen=True, slots=True)
class Probed:
    """A ball by its own best-fit sphere."""

    radius_mm: float
    radius_sd_mm: float
    """Standard deviation of the radius from the scatter of the radial distances; systematic errors are not in it."""
    range_mm: float
    points: int
    rejected: int


def probe(points: Array, start: Array) -> Probed | None:
    """Return the sphere with the least sum of squared radial distances to points (n, 3), from ``start`` (x, y, z,
    radius in mm).

    The worst 0.3 % of the points are left out. ``None`` where there is no such sphere.
    """
    # The guideline's own sphere, radial and unweighted, beside the ball bar's fit, which weighs points by their noise.
    x, keep = start.astype(np.float64), np.ones(len(points), bool)
    sd_mm = 0.0
    for _ in range(ROUNDS):
        found = _least_squares(points[keep], x)
        if found is None:
            return None
        x, sd_mm = found
        keep = without_outliers(np.abs(_radial(points, x)))
    found = _least_squares(points[keep], x)
    if found is None:
        return None
    x, sd_mm = found
    return Probed(float(x[3]), sd_mm, float(np.ptp(_radial(points[keep], x))), int(keep.sum()), int((~keep).sum()))


def _radial(points: Array, x: Array) -> Array:
    return np.asarray(np.linalg.norm(points - x[:3], axis=1) - x[3])


def _least_squares(points: Array, x: Array) -> tuple[Array, float] | None:
    """Return the centre and radius (4,) by Gauss–Newton, and the radius's standard deviation; ``None`` where it does
    not settle."""
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
    """Return every point of the ball that the view meets steeply enough, those included that the ball bar's own fit
    left out."""
    rows = np.sort(np.concatenate([ball.used.indices, ball.used.rejected]))
    return np.asarray(cloud.points_mm[rows], np.float64)
