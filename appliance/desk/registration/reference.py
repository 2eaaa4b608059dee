"""Registration of a measured surface to a reference by shape alone.

A reference is the triangles of a CAD model, or an object that was measured before. First guesses come from pairs of oriented points (B. Drost, M. Ulrich, N. Navab, S. Ilic, "Model globally, match
locally", 2010): two points with normals have four numbers that no motion changes, and every pair of one surface votes
for the motions that lay it on a pair of the other with the same numbers. So a part of a surface is found on the
complete surface, wherever both are. The best guesses are refined by planes (``equations.py``), and the resistance to a
displacement is known as for two scans.

Guesses are ranked by **all** points, near and far alike: most of a pipe fits wherever it is slid along its axis, and
only its flange decides. So a direction that the equations leave loose is not taken for free: the surface is slid along
its full range, and the place with most points near the reference is taken. Only the remaining range, on which hardly a
point changes, is called free, and deviations are measured at its ends. A given start is kept along it.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize
from scipy.spatial import cKDTree

from appliance.desk.registration.bow import Array
from appliance.measure import FEWEST, Rigid, System

MAX_POINTS = 12_000
"""Largest number of points of the measured surface in the final fit."""
TILE_MM = 15.0
"""Side of a cube within which residuals count as fully correlated."""
LAST_GATE_MM = 1.0
"""Least distance up to which a point takes part in the fit: a part may differ from its CAD model by as much."""
FITS_MM = 2.0
"""Distance within which a point counts as lying on the reference."""
LEAST_FITTING = 0.5
"""Least share of the points that must lie on the reference; with less, it is another object."""
START_GATE_MM = 8.0
"""Largest distance of a point from the reference with a given start."""
AS_GOOD = 0.9
"""Share of the best pose's points within three standard deviations of the scatter from which a pose fits as well."""
MIN_SIGNIFICANCE = 5.0
"""Least stiffness of a direction that the shape holds, in standard deviations of the stiffness that noise makes."""
ROUNDS = 24
MIN_ALIKE = 0.7
"""Least cosine between the normals of places that may correspond."""

_STEPS, _ANGLES = 24, 15
"""Bins of a pair's distance, and of its angles."""
_MOST_REFERENCE, _MOST_MEASURED = 1_500, 400
"""Largest numbers of points in pairs, of the reference and of the measured surface."""
_VOTERS = 48
"""Number of measured points that vote, each in pairs with all others."""
_MAX_VOTES = 200
"""Largest number of pairs for which one pair votes; of more pairs with its numbers, as on a plane, a random part."""
_TURNS = 30
_ROUGH_SAMPLES = 40_000
"""Number of samples of the reference while guesses are refined."""
_MAX_SLID_POINTS = 300
"""Largest number of points that are slid along a loose direction."""
_SLIDE_STEP_MM = 3.0
UNCHANGED = 0.02
"""Largest difference in the share of fitting points along a free direction."""
_GUESSES = 20
_MAX_REFINED = 8
"""Largest number of guesses that are refined by many points; before that a part of the points decides."""


class SurfaceMatchError(Exception):
    """A surface does not fit the reference; the text gives the share that would, and the remedy."""


@dataclass(frozen=True, slots=True, eq=False)
class OrientedPoints:
    """Points of a surface with their normals."""

    points_mm: Array
    """(n, 3) float64."""
    normals: Array
    """(n, 3) float64, unit vectors out of the surface."""
    sigma_mm: Array
    """(n,) float64, standard deviation along the normal; zeros for a CAD model."""


@dataclass(frozen=True, slots=True, eq=False)
class ReferencePlaces:
    """Nearest places on a reference, one for each of n points."""

    distance_mm: Array
    """(n,), unsigned; infinite where the reference has no place for the point, beyond its open border."""
    places_mm: Array
    normals: Array
    sigma_mm: Array
    """(n,): standard deviation of the reference there, along the normal."""


class ReferenceSurface(Protocol):
    """A surface to which others are registered."""

    def spread(self, count: int) -> OrientedPoints:
        """Return ``count`` evenly spread places on the surface."""
        ...

    def nearest(self, points_mm: Array, limit_mm: float) -> ReferencePlaces:
        """Return the nearest place to each of the points (n, 3), as far as it lies within ``limit_mm``."""
        ...


@dataclass(frozen=True, slots=True, eq=False)
class FreeDirection:
    """A direction that the shape does not hold, with the fit at both ends of its free range."""

    direction: Array
    """(6,) of δ, unit length."""
    is_rotation: bool
    ends: tuple[float, float]
    """Ends of the range from the pose, in degrees for rotations, else in mm."""
    rms_mm: tuple[float, float]
    """Root mean square of the distances within ``FITS_MM`` at each end."""
    fitting: tuple[float, float]
    """Share of the points within ``FITS_MM`` at each end."""


@dataclass(frozen=True, slots=True, eq=False)
class SurfaceRegistration:
    """Pose of a measured surface on a reference, with its uncertainty."""

    pose: Rigid
    """Maps the measured points into the reference's frame."""
    middle_mm: Array
    """Centre (3,) of rotations: the middle of the points on the reference, in its frame."""
    lever_mm: float
    covariance: Array
    """(6, 6) of δ, mm², zero along free directions."""
    free: tuple[FreeDirection, ...]
    """Directions along which the shape does not hold it."""
    fitting: float
    """Share of the points that lie within ``FITS_MM`` of the reference."""
    rms_mm: float
    """Root mean square of the distances of those points."""
    scatter_mm: float
    """Standard deviation of most of the distances."""
    elsewhere: tuple[Rigid, ...]
    """Other poses that fit as well."""

    def sigma_at(self, points_mm: Array, normals: Array) -> Array:
        """Return the standard deviation (n,), mm, that the pose adds to deviations.

        They are those of ``points_mm`` (n, 3) along ``normals``.
        """
        arm = points_mm - self.middle_mm
        rows = np.concatenate([np.cross(arm, normals) / self.lever_mm, normals], axis=1)
        return np.asarray(np.sqrt(np.maximum(np.einsum("ni,ij,nj->n", rows, self.covariance, rows), 0.0)))


def register_to_reference(
    measured: OrientedPoints, reference: ReferenceSurface, start: Rigid | None = None
) -> SurfaceRegistration:
    """Return the pose of ``measured`` on ``reference``.

    ``start``: its pose within some millimetres, kept along free directions; ``None``: it is searched. Raises
    SurfaceMatchError if most of the surface fits no place of the reference.
    """
    if len(measured.points_mm) < FEWEST:
        raise SurfaceMatchError(
            f"it has {len(measured.points_mm)} points; at least {FEWEST} are needed on the reference"
        )
    final_points, points, few_points, slid_points = (
        _thin_out(measured, max_count) for max_count in (MAX_POINTS, MAX_POINTS // 4, MAX_POINTS // 8, _MAX_SLID_POINTS)
    )
    samples = reference.spread(_ROUGH_SAMPLES)
    rough = _Sampled.of(samples)
    if start is None:
        refined = _distinct(
            [_refine(few_points, rough, guess, gate_mm) for guess, gate_mm in _guesses(measured, samples)], few_points
        )
        refined = _distinct(_slide_all(refined, few_points, slid_points, rough), few_points)[:_MAX_REFINED]
        fits = _distinct([_refine(points, reference, fit.pose, 2.0 * LAST_GATE_MM) for fit in refined], points)
        fits = _distinct([_slide_to_best(fits[0], points, reference), *fits], points) if fits else []
    else:
        fits = _distinct([_refine(points, reference, start, START_GATE_MM)], points)
    best = _refine(final_points, reference, fits[0].pose, LAST_GATE_MM) if fits else None
    if best is None or best.fitting < LEAST_FITTING:
        share = f"{100.0 * fits[0].fitting:.0f} %" if fits else "nothing"
        raise SurfaceMatchError(
            f"{share} of it lies within {FITS_MM:g} mm of the reference in any place; at least "
            f"{100.0 * LEAST_FITTING:.0f} % must: "
            f"is it the same thing, in mm, with its outside out? Sizes are {_size_text(measured)} and {_size_text(samples)} mm"
            f"{_metres_hint(measured, samples)}"
        )
    free = tuple(_free_way(best, loose, points, slid_points, rough, reference) for loose in best.loose)
    return _result(best, fits, final_points, free)


def _result(
    best: _Fit, fits: list[_Fit], points: OrientedPoints, free: tuple[FreeDirection, ...]
) -> SurfaceRegistration:
    resistance = best.system.resistance()
    value, vector = np.linalg.eigh(resistance.stiffness)
    loose = resistance.significance < MIN_SIGNIFICANCE
    held = vector[:, ~loose]
    inverse = held @ np.diag(1.0 / value[~loose]) @ held.T
    close = fits[0].close(best.system.scatter_mm)
    as_good = [
        fit
        for fit in fits[1:]
        if fit.close(best.system.scatter_mm) > AS_GOOD * close and not _differs_by_sliding(fit.pose, best, held, points)
    ]
    return SurfaceRegistration(
        pose=best.pose,
        middle_mm=best.system.middle,
        lever_mm=best.system.lever,
        covariance=np.asarray(inverse @ resistance.meat @ inverse),
        free=free,
        fitting=best.fitting,
        rms_mm=best.rms_mm,
        scatter_mm=best.system.scatter_mm,
        elsewhere=tuple(fit.pose for fit in as_good),
    )


def _differs_by_sliding(pose: Rigid, best: _Fit, held: Array, used: OrientedPoints) -> bool:
    """Return whether ``pose`` differs from the best one only along loose directions."""
    if held.shape[1] == 6:
        return False
    rotation, shift = best.pose.inverse.then(pose).screw(best.system.middle)
    delta = np.concatenate([best.system.lever * rotation, shift])
    return bool(np.linalg.norm(held.T @ delta) < 0.1 * np.linalg.norm(delta) + _extent_mm(used) * 0.02)


# ------------------------------------------------------------------------------------------------ loose directions


def _poses_along(fit: _Fit, direction: Array, amounts: Array) -> list[Rigid]:
    """Return the fit's pose moved by each of the ``amounts`` of δ as one screw.

    A rotation stays about its axis at any amount.
    """
    rotation, shift, middle = direction[:3] / fit.system.lever, direction[3:], fit.system.middle
    return [fit.pose.then(Rigid.along_screw(amount * rotation, amount * shift, middle)) for amount in amounts]


def _is_rotation(direction: Array) -> bool:
    return bool(np.linalg.norm(direction[:3]) > 0.1)


def _largest_amount_mm(fit: _Fit, direction: Array, rough: _Sampled) -> float:
    """Return the largest useful amount of δ: half a turn, or the size of the reference."""
    if _is_rotation(direction):
        return float(np.pi * fit.system.lever / np.linalg.norm(direction[:3]))
    return _extent_mm(rough.points)


def _shares(fit: _Fit, direction: Array, amounts: Array, points: OrientedPoints, rough: _Sampled) -> Array:
    """Return the share (k,) of the points near the reference at each of the ``amounts`` (k,)."""
    gate, poses = max(FITS_MM, rough.spacing_mm), _poses_along(fit, direction, amounts)
    x = np.concatenate([pose.of(points.points_mm) for pose in poses])
    m = np.concatenate([points.normals @ pose.rotation.T for pose in poses])
    nearest = rough.nearest(x, gate)
    fits = (nearest.distance_mm < gate) & ((nearest.normals * m).sum(1) > MIN_ALIKE)
    return np.asarray(fits.reshape(len(amounts), -1).mean(axis=1))


def _slide_all(
    fits: list[_Fit], points: OrientedPoints, slid_points: OrientedPoints, rough: _Sampled
) -> list[_Fit | None]:
    """Return the best place of each fit along its loose directions.

    Fits that differ only by sliding count as one, the first.
    """
    slid_fits: list[tuple[_Fit, Array]] = []
    for fit in fits:
        if len(slid_fits) < _MAX_REFINED and not any(
            _differs_by_sliding(fit.pose, slid_fit, held, points) for slid_fit, held in slid_fits
        ):
            resistance = fit.system.resistance()
            slid_fits.append((fit, resistance.directions[:, resistance.significance >= MIN_SIGNIFICANCE]))
    return [_slide_one(fit, points, slid_points, rough) for fit, _ in slid_fits]


def _slide_one(fit: _Fit, points: OrientedPoints, slid_points: OrientedPoints, rough: _Sampled) -> _Fit:
    """Return the best fit along the loose directions, each in turn over its full range."""
    for direction in fit.loose:
        range_mm = _largest_amount_mm(fit, direction, rough)
        amounts = (
            np.arange(-np.ceil(range_mm / _SLIDE_STEP_MM), np.ceil(range_mm / _SLIDE_STEP_MM) + 1.0) * _SLIDE_STEP_MM
        )
        shares = _shares(fit, direction, amounts, slid_points, rough)
        # Of equally good places take the nearest.
        best = min(np.flatnonzero(shares >= shares.max() - 1e-9), key=lambda k: abs(amounts[k]))
        if shares[best] <= shares[np.abs(amounts).argmin()] + 1e-9:
            continue
        refined = _refine(points, rough, _poses_along(fit, direction, amounts[best : best + 1])[0], 2.0 * FITS_MM)
        fit = refined if refined is not None and refined.support > fit.support else fit
    return fit


def _slide_to_best(fit: _Fit, points: OrientedPoints, reference: ReferenceSurface) -> _Fit | None:
    """Return the fit at the place along the loose directions where the points fit best, by however little."""
    loose = fit.loose
    if not loose:
        return fit
    width_mm = max(3.0 * fit.system.scatter_mm, 0.1)

    def cost(amounts: Array) -> float:
        (pose,) = _poses_along(fit, np.tensordot(amounts, loose, 1), np.ones(1))
        distance_mm = _equations(points, reference, pose, FITS_MM)[1]
        return -_support(distance_mm, FITS_MM) - _support(distance_mm, width_mm)

    simplex = np.concatenate([np.zeros((1, len(loose))), 1.5 * np.eye(len(loose))])
    optimum = minimize(
        cost,
        simplex[0],
        method="Nelder-Mead",
        options={"initial_simplex": simplex, "maxfev": 120, "xatol": 0.01, "fatol": 1e-6},
    )
    return _refine(points, reference, _poses_along(fit, np.tensordot(optimum.x, loose, 1), np.ones(1))[0], LAST_GATE_MM)


def _free_way(
    fit: _Fit,
    direction: Array,
    points: OrientedPoints,
    slid_points: OrientedPoints,
    rough: _Sampled,
    reference: ReferenceSurface,
) -> FreeDirection:
    """Return the range along ``direction`` on which hardly a point changes, with the fit at its ends."""
    range_mm = _largest_amount_mm(fit, direction, rough)
    start_share = float(_shares(fit, direction, np.zeros(1), slid_points, rough)[0])
    ends, rms, fitting = [], [], []
    for sign in (-1.0, 1.0):
        amounts = sign * np.append(np.arange(_SLIDE_STEP_MM, range_mm, _SLIDE_STEP_MM), range_mm)
        beyond = np.flatnonzero(_shares(fit, direction, amounts, slid_points, rough) < start_share - UNCHANGED)
        reached = len(amounts) if not len(beyond) else int(beyond[0])
        end = float(amounts[reached - 1]) if reached else 0.0
        end_fit = _refine(points, reference, _poses_along(fit, direction, np.array([end]))[0], LAST_GATE_MM)
        ends.append(
            np.degrees(np.linalg.norm(direction[:3]) * end / fit.system.lever) if _is_rotation(direction) else end
        )
        rms.append(np.nan if end_fit is None else end_fit.rms_mm)
        fitting.append(0.0 if end_fit is None else end_fit.fitting)
    return FreeDirection(
        direction, _is_rotation(direction), (ends[0], ends[1]), (rms[0], rms[1]), (fitting[0], fitting[1])
    )


def _distinct(fits: list[_Fit | None], points: OrientedPoints) -> list[_Fit]:
    """Return different fits, the best first.

    All points rank them, since a wrong pose has its own few that fit better.
    """
    distinct: list[_Fit] = []
    for fit in sorted((fit for fit in fits if fit is not None), key=lambda candidate: -candidate.support):
        if all(not _same_pose(fit.pose, better.pose, points) for better in distinct):
            distinct.append(fit)
    return distinct


def thin_evenly(points: OrientedPoints, spacing_mm: float) -> OrientedPoints:
    """Return the first of the points in each cube of ``spacing_mm``."""
    _, first = np.unique(_cells(points.points_mm, spacing_mm), return_index=True)
    return _select(points, np.sort(first))


def _cells(points_mm: Array, side_mm: float) -> NDArray[np.int64]:
    """Return the index (n,) of the cube of ``side_mm`` in which each point lies, as one number."""
    cell = np.floor((points_mm - points_mm.min(axis=0, initial=0.0)) / side_mm).astype(np.int64)
    return np.asarray((cell[:, 0] * 2_000_000 + cell[:, 1]) * 2_000_000 + cell[:, 2])


# ------------------------------------------------------------------------------------------------ refined by planes


@dataclass(frozen=True, slots=True, eq=False)
class _Fit:
    pose: Rigid
    system: System
    apart_mm: Array
    """(n,): distance of every point from the reference; infinite if it is not near."""

    @property
    def fitting(self) -> float:
        return float(np.mean(self.apart_mm < FITS_MM))

    @property
    def rms_mm(self) -> float:
        near = self.apart_mm[self.apart_mm < FITS_MM]
        return float(np.sqrt(np.mean(near**2))) if len(near) else np.nan

    @property
    def support(self) -> float:
        """The rank of the fit, 1 if each point lies on the reference, 0 if none is near it.

        Source: MSAC, P. Torr, A. Zisserman, 2000.
        """
        return _support(self.apart_mm, FITS_MM)

    @property
    def loose(self) -> list[Array]:
        """The directions (6,) of δ that the shape does not hold: shifts, and rotations with their shift."""
        resistance = self.system.resistance()
        vectors = resistance.directions[:, resistance.significance < MIN_SIGNIFICANCE]
        if not vectors.shape[1]:
            return []
        # Choose a basis of the loose space with as many pure shifts as possible.
        return list((vectors @ np.linalg.svd(vectors[:3], full_matrices=True)[2].T).T)

    def close(self, scatter_mm: float) -> float:
        """Return the share of the points within three standard deviations of ``scatter_mm``."""
        return float(np.mean(self.apart_mm < 3.0 * max(scatter_mm, 0.01)))


def _support(apart_mm: Array, width_mm: float) -> float:
    return float(np.mean(np.maximum(0.0, 1.0 - (apart_mm / width_mm) ** 2)))


@dataclass(frozen=True, slots=True, eq=False)
class _Sampled:
    """A reference as samples that can be searched."""

    points: OrientedPoints
    tree: cKDTree
    spacing_mm: float
    """Largest distance of a place on it from a sample."""

    @classmethod
    def of(cls, points: OrientedPoints) -> _Sampled:
        tree = cKDTree(points.points_mm)
        samples = points.points_mm[:: max(1, len(points.points_mm) // 2000)]
        return cls(points, tree, 2.0 * float(np.percentile(tree.query(samples, 2)[0][:, 1], 99)))

    def nearest(self, points_mm: Array, limit_mm: float) -> ReferencePlaces:
        """Return the plane of the nearest sample to each point.

        Beyond the border there is none: there the last sample is farther away than samples are apart.
        """
        distance, index = self.tree.query(points_mm, distance_upper_bound=limit_mm + self.spacing_mm)
        index = np.minimum(index, len(self.points.points_mm) - 1)
        normals, offset = self.points.normals[index], points_mm - self.points.points_mm[index]
        distance_mm = (normals * offset).sum(1)
        is_near = np.isfinite(distance) & ((offset**2).sum(1) - distance_mm**2 < self.spacing_mm**2)
        return ReferencePlaces(
            np.where(is_near, np.abs(distance_mm), np.inf),
            self.points.points_mm[index],
            normals,
            self.points.sigma_mm[index],
        )


def _refine(
    measured: OrientedPoints, reference: _Sampled | ReferenceSurface, guess: Rigid, gate_mm: float
) -> _Fit | None:
    """Return the refined fit from ``guess``, unmoved along loose directions.

    ``None`` if too few points lie on the reference.
    """
    pose, gate = guess, gate_mm
    for _ in range(ROUNDS):
        system, _ = _equations(measured, reference, pose, gate)
        if system is None:
            return None
        resistance = system.resistance()
        held = resistance.directions[:, resistance.significance >= MIN_SIGNIFICANCE]
        step = held @ (held.T @ system.step())
        pose = system.moved(pose, step)
        gate = max(LAST_GATE_MM, min(0.7 * gate, max(6.0 * system.scatter_mm, 0.35 * gate)))
        if gate <= LAST_GATE_MM and float(np.linalg.norm(step)) < 2e-4:
            break
    system, apart = _equations(measured, reference, pose, LAST_GATE_MM)
    return None if system is None else _Fit(pose, system, apart)


def _equations(
    measured: OrientedPoints, reference: _Sampled | ReferenceSurface, pose: Rigid, gate_mm: float
) -> tuple[System | None, Array]:
    """Return the equations of points on the planes of their nearest places, and all distances (n,).

    The equations are ``None`` for too few points; distances are infinite without a place of like normal.
    """
    x, m = pose.of(measured.points_mm), measured.normals @ pose.rotation.T
    nearest = reference.nearest(x, max(gate_mm, FITS_MM))
    alike = (nearest.normals * m).sum(1) > MIN_ALIKE
    distance_mm = np.where(alike, nearest.distance_mm, np.inf)
    index = np.flatnonzero(distance_mm < gate_mm)
    if len(index) < FEWEST:
        return None, distance_mm
    plane = nearest.normals[index]
    residual_mm = (plane * (x[index] - nearest.places_mm[index])).sum(1)
    sigma_mm = np.hypot(measured.sigma_mm[index], nearest.sigma_mm[index])
    return System.of_planes(x[index], residual_mm, (plane, m[index]), sigma_mm, _cells(x[index], TILE_MM)), distance_mm


# ------------------------------------------------------------------------------------------------ guesses by pairs of points


def _guesses(measured: OrientedPoints, reference: OrientedPoints) -> Iterator[tuple[Rigid, float]]:
    """Yield poses for which many pairs of points vote, the best first, with the gate to refine them from."""
    reach_mm = _extent_mm(measured)
    points, spacing_mm = _thin_to_count(measured, reach_mm / 25.0, _MOST_MEASURED)
    model, model_mm = _thin_to_count(reference, spacing_mm, _MOST_REFERENCE)
    gate_mm = 1.5 * max(spacing_mm, model_mm)
    tree = cKDTree(model.points_mm)
    scored = []
    for pose in _vote(points, model, tree, reach_mm):
        distance, index = tree.query(pose.of(points.points_mm), distance_upper_bound=gate_mm)
        near = np.isfinite(distance)
        alike = (model.normals[index[near]] * (points.normals[near] @ pose.rotation.T)).sum(1) > MIN_ALIKE
        scored.append((float(np.count_nonzero(alike)) / len(distance), pose))
    scored.sort(key=lambda entry: -entry[0])
    chosen: list[Rigid] = []
    for _, pose in scored:
        if len(chosen) < _GUESSES and all(not _same_pose(pose, earlier, points, 0.08) for earlier in chosen):
            chosen.append(pose)
            yield pose, gate_mm


def _vote(points: OrientedPoints, model: OrientedPoints, tree: cKDTree, reach_mm: float) -> Iterator[Rigid]:
    """Yield the poses for which pairs of points vote."""
    close = tree.sparse_distance_matrix(tree, reach_mm, output_type="ndarray")
    close = close[close["v"] > reach_mm / _STEPS]
    first, second = close["i"].astype(np.int64), close["j"].astype(np.int64)
    key = _key(model, first, second, reach_mm)
    order = np.argsort(key, kind="stable")
    key, first, second = key[order], first[order], second[order]
    model_angle = _angle_about_normal(model, first, second)
    numbers, rng = np.arange(len(points.points_mm)), np.random.default_rng(11)
    for voter in np.linspace(0, len(numbers) - 1, min(_VOTERS, len(numbers))).astype(int):
        distance = np.linalg.norm(points.points_mm - points.points_mm[voter], axis=1)
        partners = numbers[(distance > reach_mm / _STEPS) & (distance < reach_mm)]
        voters = np.full(len(partners), voter)
        pair_key = _key(points, voters, partners, reach_mm)
        low, high = np.searchsorted(key, pair_key), np.searchsorted(key, pair_key, side="right")
        count = np.minimum(high - low, _MAX_VOTES)
        if not count.sum():
            continue
        number = np.arange(count.sum()) - np.repeat(np.cumsum(count) - count, count)
        # Of more pairs than may vote take some at equal steps; their order favours no place on the reference.
        step = np.repeat((high - low) / np.maximum(count, 1), count)
        row = np.repeat(low, count) + ((number + rng.random(len(number))) * step).astype(np.int64)
        # The rotation about the first point's normal that lays one pair on the other.
        angle = model_angle[row] - np.repeat(_angle_about_normal(points, voters, partners), count)
        bins = np.floor(angle / (2.0 * np.pi) * _TURNS).astype(np.int64) % _TURNS
        # A frequent pair counts less for each place.
        weight = np.repeat(1.0 / np.sqrt(np.maximum(high - low, 1)), count)
        votes = np.bincount(first[row] * _TURNS + bins, weight, len(model.points_mm) * _TURNS)
        for best in np.argpartition(-votes, 4)[:4]:
            place, bin_ = divmod(int(best), _TURNS)
            rotation_angle = 2.0 * np.pi * (bin_ + 0.5) / _TURNS
            yield _pose_of_pair(points, int(voter), model, place, rotation_angle)


def _key(
    points: OrientedPoints, first: NDArray[np.int64], second: NDArray[np.int64], reach_mm: float
) -> NDArray[np.int64]:
    """Return the four numbers of pairs that no motion changes, as one: distance, and three angles.

    The angles are of both normals to the distance, and between them.
    """
    direction = points.points_mm[second] - points.points_mm[first]
    distance = np.linalg.norm(direction, axis=1)
    direction = direction / distance[:, None]
    n, m = points.normals[first], points.normals[second]
    key = np.minimum((distance / reach_mm * _STEPS).astype(np.int64), _STEPS - 1)
    for cosine in ((n * direction).sum(1), (m * direction).sum(1), (n * m).sum(1)):
        angle = np.arccos(np.clip(cosine, -1.0, 1.0))
        key = key * _ANGLES + np.minimum((angle / np.pi * _ANGLES).astype(np.int64), _ANGLES - 1)
    return np.asarray(key)


def _frame(normal: Array) -> Array:
    """Return rotations (n, 3, 3) that map the normals (n, 3) to the x axis."""
    help_ = np.where(np.abs(normal[:, :1]) < 0.8, np.array([1.0, 0.0, 0.0]), np.array([0.0, 1.0, 0.0]))
    y = np.cross(normal, help_)
    y /= np.linalg.norm(y, axis=1)[:, None]
    return np.stack([normal, y, np.cross(normal, y)], axis=1)


def _angle_about_normal(points: OrientedPoints, first: NDArray[np.int64], second: NDArray[np.int64]) -> Array:
    """Return the angle of each pair's second point about the normal of the first one."""
    offset = points.points_mm[second] - points.points_mm[first]
    frame = _frame(points.normals)[first]
    return np.asarray(np.arctan2((frame[:, 2] * offset).sum(1), (frame[:, 1] * offset).sum(1)))


def _pose_of_pair(points: OrientedPoints, index: int, model: OrientedPoints, place: int, angle: float) -> Rigid:
    own_frame, model_frame = _frame(points.normals[index : index + 1])[0], _frame(model.normals[place : place + 1])[0]
    c, s = np.cos(angle), np.sin(angle)
    rotation = model_frame.T @ np.array([[1.0, 0.0, 0.0], [0.0, c, -s], [0.0, s, c]]) @ own_frame
    return Rigid(rotation, model.points_mm[place] - rotation @ points.points_mm[index])


# ------------------------------------------------------------------------------------------------ points


def _select(points: OrientedPoints, rows: NDArray[np.int64]) -> OrientedPoints:
    return OrientedPoints(points.points_mm[rows], points.normals[rows], points.sigma_mm[rows])


def _thin_out(points: OrientedPoints, max_count: int) -> OrientedPoints:
    n = len(points.points_mm)
    return (
        points
        if n <= max_count
        else _select(points, np.sort(np.random.default_rng(5).choice(n, max_count, replace=False)))
    )


def _thin_to_count(points: OrientedPoints, spacing_mm: float, max_count: int) -> tuple[OrientedPoints, float]:
    """Return at most ``max_count`` evenly thinned points, and their spacing, mm."""
    while True:
        thinned = thin_evenly(points, spacing_mm)
        if len(thinned.points_mm) <= max_count:
            return thinned, spacing_mm
        spacing_mm *= 1.2


def _extent_mm(points: OrientedPoints) -> float:
    return float(np.linalg.norm(np.ptp(points.points_mm, axis=0)))


def _size_text(points: OrientedPoints) -> str:
    return " x ".join(f"{length_mm:.3g}" for length_mm in np.ptp(points.points_mm, axis=0))


def _metres_hint(measured: OrientedPoints, reference: OrientedPoints) -> str:
    """Return the question whether the reference is in metres, if its size suggests so."""
    ratio = _extent_mm(measured) / max(_extent_mm(reference), 1e-12)
    return "; if the CAD model is in metres, scale it by 1000" if 50.0 < ratio < 5000.0 else ""


def _same_pose(first: Rigid, second: Rigid, points: OrientedPoints, share: float = 0.005) -> bool:
    """Return whether two poses map the points to the same places, within a ``share`` of their size."""
    samples = points.points_mm[:: max(1, len(points.points_mm) // 50)]
    return bool(np.linalg.norm(first.of(samples) - second.of(samples), axis=1).max() < share * _extent_mm(points))
