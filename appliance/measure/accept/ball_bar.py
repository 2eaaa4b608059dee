"""The search for a ball bar in a cloud with other objects, and the distance between its centres."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from appliance.measure.accept.points import Array, FitPoints, Indices, NotFound, PointSource, finite_rows, thinned
from appliance.measure.accept.sphere import STEEPEST_COS, Sphere, SphereSolution, algebraic_sphere, fit_sphere

CELL_MM = 2.0
"""Size of the cubes of which the search uses one point each."""
PATCH_MM = 6.0
"""Radius of the neighbourhoods to which candidate spheres are fitted."""
RADII_MM = (5.0, 40.0)
AGREES_MM = 0.3
"""Largest distance of a point from a candidate that it supports."""
BELONGS_MM = 1.0
"""Largest distance of a ball's points from it: far more than any error of a point, so that no outlier is removed by it.
"""
ALIKE = 0.15
"""Largest relative difference of the two radii."""
STEM_COS = 0.82
"""Cosine of 35°, the angle to the direction of the other ball within which no point is used: the bar is there."""
MOST_PROPOSALS = 400
LEAST_FILL = 0.2
"""Least share of a ball's visible face with points."""
ROUNDS = 3


@dataclass(frozen=True, slots=True, eq=False)
class Ball:
    """One ball: the sphere and its points."""

    sphere: Sphere
    used: FitPoints

    def seen_from(self, eye_mm: Array, cloud: PointSource) -> Indices:
        """Return the rows of the used points, in order, that are not seen flatter than 55° from ``eye_mm``."""
        rows = np.sort(self.used.indices)
        points = cloud.points_mm[rows].astype(np.float64)
        outward = (points - np.array(self.sphere.centre_mm)) / self.sphere.radius_mm
        sight = eye_mm - points
        return np.asarray(rows[np.sum(outward * sight, 1) > STEEPEST_COS * np.linalg.norm(sight, axis=1)])


@dataclass(frozen=True, slots=True, eq=False)
class BallBar:
    """Two balls, the one with the smaller x first."""

    first: Ball
    second: Ball

    @property
    def length_mm(self) -> float:
        """Distance of the centres, L_a of the paper's Eq. (6)."""
        return float(np.linalg.norm(self._between()))

    @property
    def sigma_length_mm(self) -> float:
        """Standard deviation of the length by the points' noise, without systematic errors."""
        along = self._between() / self.length_mm
        covariance_mm2 = self.first.sphere.covariance_mm2[:3, :3] + self.second.sphere.covariance_mm2[:3, :3]
        return float(np.sqrt(along @ covariance_mm2 @ along))

    def _between(self) -> Array:
        return np.subtract(self.second.sphere.centre_mm, self.first.sphere.centre_mm)


def find_ball_bar(cloud: PointSource) -> BallBar | NotFound:
    """Return the two balls of nearly equal radius (5..40 mm) that most points support. Deterministic."""
    rows = finite_rows(cloud.points_mm)
    if rows.size < 100:
        return NotFound(
            f"the cloud has only {rows.size} points; bring the ball bar into the light of the projector, at the "
            "working distance, or check that the calibration is of this instrument"
        )
    points = cloud.points_mm[rows].astype(np.float64)
    # One point per cube, so that a near, bright ball does not have more votes than the other.
    few = points[thinned(points, CELL_MM)]
    first = _best(few, None)
    if first is None:
        return NotFound("no ball was found; hold the bar so that both balls are lit and seen by both cameras")
    remaining = few[np.linalg.norm(few - first[0], axis=1) > 1.3 * first[1]]
    second = _best(remaining, first[1])
    if second is None:
        return NotFound("only one ball was found; turn the bar so that both are lit")
    guesses = sorted((first, second), key=lambda ball: float(ball[0][0]))
    balls = _refine(cloud, rows, points, guesses)
    if balls is None:
        return NotFound("a ball has too few good points for its centre; turn the bar or bring it nearer to the middle")
    return BallBar(*balls)


_Guess = tuple[Array, float]


def _best(points: Array, radius_mm: float | None) -> _Guess | None:
    """Return the sphere with the most supporting points (thinned), if it has enough for a ball."""
    if len(points) < 20:
        return None
    from scipy.spatial import cKDTree  # half a second that a start of the service does not need

    tree = cKDTree(points)
    best: _Guess | None = None
    most_votes = 0
    # Patches are spread evenly over the cloud; flat ones are rejected by their radius, at the cost of one fit.
    proposals = 0
    for k in _spread(len(points)):
        patch = tree.query_ball_point(points[k], PATCH_MM)
        if len(patch) < 8:
            continue
        guess = algebraic_sphere(points[patch])
        # The second ball must have the first one's radius, which excludes a bottle or a fist.
        if guess is None or not _possible(guess, radius_mm):
            continue
        # Consensus over the whole cloud, as in RANSAC, but with candidates from patches, since random points hardly
        # ever lie on one ball.
        off = np.abs(np.linalg.norm(points - guess[0], axis=1) - guess[1])
        if (count := int((off < AGREES_MM).sum())) > most_votes:
            best, most_votes = guess, count
        proposals += 1
        if proposals == MOST_PROPOSALS:
            break
    if best is None:
        return None
    for _ in range(4):  # refine the sphere of a small patch with all supporting points
        off = np.abs(np.linalg.norm(points - best[0], axis=1) - best[1])
        better = algebraic_sphere(points[off < 2.0 * AGREES_MM])
        if better is None or not _possible(better, radius_mm):
            break
        best = better
    # Any rounded edge fits some sphere; only a ball has points on much of its face.
    return best if _fill(points, best) > LEAST_FILL else None


def _spread(count: int) -> Indices:
    """Return all of 0..count−1 in an order of which every beginning is evenly spread (golden section)."""
    return np.argsort((np.arange(count) * 0.6180339887498949) % 1.0, kind="stable")


def _possible(guess: _Guess, radius_mm: float | None) -> bool:
    low, high = RADII_MM if radius_mm is None else ((1 - ALIKE) * radius_mm, (1 + ALIKE) * radius_mm)
    return low <= guess[1] <= high and float(guess[0][2]) > 0.0


def _fill(points: Array, guess: _Guess) -> float:
    """Return the share of the ball's usable face that supporting points (thinned) cover."""
    centre, radius = guess
    away = points - centre
    length = np.linalg.norm(away, axis=1)
    # Area of a spherical cap up to the steepest angle: 2π r² (1 − cos). Thinned points stand for one cell each.
    facing = -(away @ centre) / np.maximum(length, 1e-9) / np.linalg.norm(centre)
    count = int(((np.abs(length - radius) < AGREES_MM) & (facing > STEEPEST_COS)).sum())
    return count * CELL_MM**2 / float(2.0 * np.pi * radius**2 * (1.0 - STEEPEST_COS))


def _refine(cloud: PointSource, rows: Indices, points: Array, guesses: list[_Guess]) -> tuple[Ball, Ball] | None:
    solutions: list[tuple[Indices, SphereSolution]] = []
    for _ in range(ROUNDS):
        solutions = []
        for k in (0, 1):
            (centre, radius), other_centre = guesses[k], guesses[1 - k][0]
            away = points - centre
            length = np.linalg.norm(away, axis=1)
            towards = (other_centre - centre) / np.linalg.norm(other_centre - centre)
            # Points towards the other ball are on the bar, not on the ball.
            mine = np.flatnonzero((np.abs(length - radius) < BELONGS_MM) & (away @ towards < STEM_COS * length))
            solution = fit_sphere(points[mine], cloud.sigma_mm[rows[mine]].astype(np.float64), (centre, radius))
            if solution is None:
                return None
            solutions.append((rows[mine], solution))
        guesses = [(np.array(s.sphere.centre_mm), s.sphere.radius_mm) for _, s in solutions]
    first, second = (_ball(cloud, mine, solution) for mine, solution in solutions)
    return first, second


def _ball(cloud: PointSource, rows: Indices, solution: SphereSolution) -> Ball:
    inliers = rows[solution.used]
    used = FitPoints(inliers, cloud.pixel[inliers], solution.residual_mm[solution.used], rows[solution.outlier])
    return Ball(solution.sphere, used)
