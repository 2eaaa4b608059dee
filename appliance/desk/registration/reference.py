"""Owns where a measured surface lies on another one, from shape alone: a CAD model's triangles, or an object that was
measured before.

First guesses come from pairs of oriented points (B. Drost, M. Ulrich, N. Navab, S. Ilic, "Model globally, match
locally", 2010): two points with normals have four numbers that no motion changes, and every pair of the one surface
votes for the motions that lay it on a pair of the other with the same numbers. So a part of a surface finds its place
on the whole, wherever both are. The best guesses are led by planes (``equations.py``), and what resists a displacement
is known as it is of two scans.

Guesses are ranked by **all** points, near and far alike: most of a pipe lies well wherever it is slid to, and only its
flange tells. So what the equations call loose is not taken for free: it is slid along all of its way, and the place
with the most points near the surface is taken. Only the way that remains, on which hardly a point changes, is called
free, and what deviates at its ends is measured there. A start that is given is kept along it.
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

USED = 12_000
"""Points of the measured surface that lead the fit."""
TILE_MM = 15.0
"""Residuals within such a cube are taken to err together."""
LAST_GATE_MM = 1.0
"""Least distance up to which a point takes part in the fit: a drawing's part may differ by as much."""
FITS_MM = 2.0
"""Distance within which a point counts as lying on the reference."""
LEAST_FITTING = 0.5
"""Least share of the points that must lie on the reference: with less, it is another thing."""
START_GATE_MM = 8.0
"""Largest distance of a point from the reference where the place is known roughly."""
AS_GOOD = 0.9
"""A pose whose points within three standard deviations of the scatter are this share of the best one's fits as well."""
HELD = 5.0
"""Least stiffness of a direction that is held, in standard deviations of what noise alone would make of it."""
ROUNDS = 24
MIN_ALIKE = 0.7
"""Least cosine between the normals of places that may be the same."""

_STEPS, _ANGLES = 24, 15
"""Bins of a pair's distance, and of its angles."""
_MOST_REFERENCE, _MOST_MEASURED = 1_500, 400
"""Points that pairs are made of."""
_FIRSTS = 48
"""Measured points that vote, each with all the others."""
_COMMON = 200
"""Largest number of pairs that one pair votes for; where more have its four numbers (those of a plane), so many of them
by lot."""
_TURNS = 30
_ROUGHLY = 40_000
"""Samples of the reference while guesses are led."""
_SLID = 300
"""Points that are slid along a loose direction."""
_SLIDE_STEP_MM = 3.0
UNCHANGED = 0.02
"""Share of the points by which a place on a free way may differ from the best one."""
_GUESSES = 20
_LED = 8
"""Guesses that are led by all points; before that a sixth of them decides."""


class SurfaceMatchError(Exception):
    """A surface does not lie on the reference; the text says how much of it would, and what to do."""


@dataclass(frozen=True, slots=True, eq=False)
class OrientedPoints:
    """Points of a surface with its normals."""

    points_mm: Array
    """(n, 3) float64."""
    normals: Array
    """(n, 3) float64, unit vectors out of the surface."""
    sigma_mm: Array
    """(n,) float64, standard deviation along the normal; zeros for a drawing."""


@dataclass(frozen=True, slots=True, eq=False)
class PlacesOn:
    """Places on a reference that are nearest to points, n of each."""

    distance_mm: Array
    """(n,), unsigned; infinite where the reference has no counterpart for the point: beside its open border."""
    places_mm: Array
    normals: Array
    sigma_mm: Array
    """(n,): standard deviation of the reference there, along the normal."""


class ReferenceSurface(Protocol):
    """A surface that others are laid onto."""

    def spread(self, count: int) -> OrientedPoints:
        """Return ``count`` places spread evenly over it."""
        ...

    def nearest(self, points_mm: Array, limit_mm: float) -> PlacesOn:
        """Return the nearest place to each of the points (n, 3), as far as it lies within ``limit_mm``."""
        ...


@dataclass(frozen=True, slots=True, eq=False)
class FreeWay:
    """A direction that the shape does not hold, and what a comparison finds at both ends of the way that remains."""

    direction: Array
    """(6,) of δ, unit length."""
    turns: bool
    ends: tuple[float, float]
    """Ends of the way from the pose, in degrees for turns, else in mm."""
    rms_mm: tuple[float, float]
    """Root mean square of the distances within ``FITS_MM`` at each end."""
    fitting: tuple[float, float]
    """Share of the points within ``FITS_MM`` at each end."""


@dataclass(frozen=True, slots=True, eq=False)
class LaidOnto:
    """Place of a measured surface on a reference."""

    pose: Rigid
    """Maps the measured points into the reference's frame."""
    middle_mm: Array
    """(3,): middle of the points that lie on it, in the reference's frame, about which turns are meant."""
    lever_mm: float
    covariance: Array
    """(6, 6) of δ, mm², zero along the directions that nothing holds."""
    free: tuple[FreeWay, ...]
    """Directions along which its shape does not hold it."""
    fitting: float
    """Share of the points that lie within ``FITS_MM`` of the reference."""
    rms_mm: float
    """Root mean square of the distances of those points."""
    scatter_mm: float
    """Standard deviation of most of the distances."""
    elsewhere: tuple[Rigid, ...]
    """Other poses that fit as well."""

    def sigma_at(self, points_mm: Array, normals: Array) -> Array:
        """Return the standard deviation (n,), mm, that the pose adds to deviations of ``points_mm`` (n, 3) along
        ``normals``."""
        arm = points_mm - self.middle_mm
        rows = np.concatenate([np.cross(arm, normals) / self.lever_mm, normals], axis=1)
        return np.asarray(np.sqrt(np.maximum(np.einsum("ni,ij,nj->n", rows, self.covariance, rows), 0.0)))


def lay_onto(measured: OrientedPoints, reference: ReferenceSurface, start: Rigid | None = None) -> LaidOnto:
    """Return the place of ``measured`` on ``reference``.

    ``start``: where it lies within some millimetres, kept along what nothing holds; ``None``: anywhere. Raises
    SurfaceMatchError where most of it lies nowhere on the reference.
    """
    if len(measured.points_mm) < FEWEST:
        raise SurfaceMatchError(f"it has {len(measured.points_mm)} points; at least {FEWEST} must lie on the reference")
    used, some, few, slid = (_thinned(measured, most) for most in (USED, USED // 4, USED // 8, _SLID))
    samples = reference.spread(_ROUGHLY)
    rough = _Sampled.of(samples)
    if start is None:
        led = _distinct([_led(few, rough, guess, gate_mm) for guess, gate_mm in _guesses(measured, samples)], few)
        led = _distinct(_slid_apart(led, few, slid, rough), few)[:_LED]
        fits = _distinct([_led(some, reference, one.pose, 2.0 * LAST_GATE_MM) for one in led], some)
        fits = _distinct([_settled(fits[0], some, reference), *fits], some) if fits else []
    else:
        fits = _distinct([_led(some, reference, start, START_GATE_MM)], some)
    best = _led(used, reference, fits[0].pose, LAST_GATE_MM) if fits else None
    if best is None or best.fitting < LEAST_FITTING:
        share = f"{100.0 * fits[0].fitting:.0f} %" if fits else "nothing"
        raise SurfaceMatchError(
            f"{share} of it lies within {FITS_MM:g} mm of the reference in any place; at least "
            f"{100.0 * LEAST_FITTING:.0f} % must: "
            f"is it the same thing, in mm, with its outside out? Sizes are {_size(measured)} and {_size(samples)} mm"
            f"{_in_metres(measured, samples)}"
        )
    ways = tuple(_way(best, loose, some, slid, rough, reference) for loose in best.loose)
    return _described(best, fits, used, ways)


def _described(best: _Fit, fits: list[_Fit], used: OrientedPoints, ways: tuple[FreeWay, ...]) -> LaidOnto:
    resistance = best.system.resistance()
    value, vector = np.linalg.eigh(resistance.stiffness)
    loose = resistance.significance < HELD
    kept = vector[:, ~loose]
    inverse = kept @ np.diag(1.0 / value[~loose]) @ kept.T
    close = fits[0].close(best.system.scatter_mm)
    as_good = [
        fit
        for fit in fits[1:]
        if fit.close(best.system.scatter_mm) > AS_GOOD * close and not _is_slid(fit.pose, best, kept, used)
    ]
    return LaidOnto(
        pose=best.pose,
        middle_mm=best.system.middle,
        lever_mm=best.system.lever,
        covariance=np.asarray(inverse @ resistance.meat @ inverse),
        free=ways,
        fitting=best.fitting,
        rms_mm=best.rms_mm,
        scatter_mm=best.system.scatter_mm,
        elsewhere=tuple(fit.pose for fit in as_good),
    )


def _is_slid(pose: Rigid, best: _Fit, kept: Array, used: OrientedPoints) -> bool:
    """Tell whether ``pose`` differs from the best one only along what is not held, so that it is the same news."""
    if kept.shape[1] == 6:
        return False
    turn, shift = best.pose.inverse.then(pose).screw(best.system.middle)
    delta = np.concatenate([best.system.lever * turn, shift])
    return bool(np.linalg.norm(kept.T @ delta) < 0.1 * np.linalg.norm(delta) + _reach(used) * 0.02)


# ------------------------------------------------------------------------------------------------ along what is loose


def _along(fit: _Fit, direction: Array, amounts: Array) -> list[Rigid]:
    """Return the fit's pose, moved by each of the ``amounts`` of δ as one screw: a turn stays about its axis however
    far it goes."""
    turn, shift, middle = direction[:3] / fit.system.lever, direction[3:], fit.system.middle
    return [fit.pose.then(Rigid.along_screw(amount * turn, amount * shift, middle)) for amount in amounts]


def _turns(direction: Array) -> bool:
    return bool(np.linalg.norm(direction[:3]) > 0.1)


def _whole_way_mm(fit: _Fit, direction: Array, rough: _Sampled) -> float:
    """Return the largest amount of δ that makes sense: half a turn, or the reference's length."""
    if _turns(direction):
        return float(np.pi * fit.system.lever / np.linalg.norm(direction[:3]))
    return _reach(rough.points)


def _shares(fit: _Fit, direction: Array, amounts: Array, points: OrientedPoints, rough: _Sampled) -> Array:
    """Return the share (k,) of the points near the reference at each of the ``amounts`` (k,)."""
    gate, poses = max(FITS_MM, rough.spacing_mm), _along(fit, direction, amounts)
    x = np.concatenate([pose.of(points.points_mm) for pose in poses])
    m = np.concatenate([points.normals @ pose.rotation.T for pose in poses])
    on = rough.nearest(x, gate)
    fits = (on.distance_mm < gate) & ((on.normals * m).sum(1) > MIN_ALIKE)
    return np.asarray(fits.reshape(len(amounts), -1).mean(axis=1))


def _slid_apart(fits: list[_Fit], few: OrientedPoints, slid: OrientedPoints, rough: _Sampled) -> list[_Fit | None]:
    """Return the best place of each fit along what is loose; of those that only sliding tells apart, one is slid."""
    tried: list[tuple[_Fit, Array]] = []
    for fit in fits:
        if len(tried) < _LED and not any(_is_slid(fit.pose, one, kept, few) for one, kept in tried):
            resistance = fit.system.resistance()
            tried.append((fit, resistance.directions[:, resistance.significance >= HELD]))
    return [_slid_along(fit, few, slid, rough) for fit, _ in tried]


def _slid_along(fit: _Fit, few: OrientedPoints, slid: OrientedPoints, rough: _Sampled) -> _Fit:
    """Return the best fit along what is loose, each direction in turn, over all of its way."""
    for direction in fit.loose:
        whole = _whole_way_mm(fit, direction, rough)
        amounts = np.arange(-np.ceil(whole / _SLIDE_STEP_MM), np.ceil(whole / _SLIDE_STEP_MM) + 1.0) * _SLIDE_STEP_MM
        shares = _shares(fit, direction, amounts, slid, rough)
        # Of places that are as good the one that is least far.
        best = min(np.flatnonzero(shares >= shares.max() - 1e-9), key=lambda k: abs(amounts[k]))
        if shares[best] <= shares[np.abs(amounts).argmin()] + 1e-9:
            continue
        again = _led(few, rough, _along(fit, direction, amounts[best : best + 1])[0], 2.0 * FITS_MM)
        fit = again if again is not None and again.support > fit.support else fit
    return fit


def _settled(fit: _Fit, some: OrientedPoints, reference: ReferenceSurface) -> _Fit | None:
    """Return the fit at the place along what is loose where the points lie best, however little that is."""
    loose = fit.loose
    if not loose:
        return fit
    width_mm = max(3.0 * fit.system.scatter_mm, 0.1)

    def lost(amounts: Array) -> float:
        (pose,) = _along(fit, np.tensordot(amounts, loose, 1), np.ones(1))
        apart = _lay(some, reference, pose, FITS_MM)[1]
        return -_support(apart, FITS_MM) - _support(apart, width_mm)

    simplex = np.concatenate([np.zeros((1, len(loose))), 1.5 * np.eye(len(loose))])
    found = minimize(
        lost,
        simplex[0],
        method="Nelder-Mead",
        options={"initial_simplex": simplex, "maxfev": 120, "xatol": 0.01, "fatol": 1e-6},
    )
    return _led(some, reference, _along(fit, np.tensordot(found.x, loose, 1), np.ones(1))[0], LAST_GATE_MM)


def _way(
    fit: _Fit,
    direction: Array,
    some: OrientedPoints,
    slid: OrientedPoints,
    rough: _Sampled,
    reference: ReferenceSurface,
) -> FreeWay:
    """Return the way along ``direction`` on which hardly a point changes, with what is found at its ends."""
    whole = _whole_way_mm(fit, direction, rough)
    here = float(_shares(fit, direction, np.zeros(1), slid, rough)[0])
    ends, rms, fitting = [], [], []
    for sign in (-1.0, 1.0):
        amounts = sign * np.append(np.arange(_SLIDE_STEP_MM, whole, _SLIDE_STEP_MM), whole)
        lost = np.flatnonzero(_shares(fit, direction, amounts, slid, rough) < here - UNCHANGED)
        reached = len(amounts) if not len(lost) else int(lost[0])
        end = float(amounts[reached - 1]) if reached else 0.0
        there = _led(some, reference, _along(fit, direction, np.array([end]))[0], LAST_GATE_MM)
        ends.append(np.degrees(np.linalg.norm(direction[:3]) * end / fit.system.lever) if _turns(direction) else end)
        rms.append(np.nan if there is None else there.rms_mm)
        fitting.append(0.0 if there is None else there.fitting)
    return FreeWay(direction, _turns(direction), (ends[0], ends[1]), (rms[0], rms[1]), (fitting[0], fitting[1]))


def _distinct(fits: list[_Fit | None], used: OrientedPoints) -> list[_Fit]:
    """Return different fits, the best first: by all points, since a wrong pose has its own few that fit better."""
    found: list[_Fit] = []
    for fit in sorted((fit for fit in fits if fit is not None), key=lambda one: -one.support):
        if all(not _same(fit.pose, one.pose, used) for one in found):
            found.append(fit)
    return found


def thinned_evenly(points: OrientedPoints, spacing_mm: float) -> OrientedPoints:
    """Return one of the points in each cube of ``spacing_mm``, the first."""
    _, first = np.unique(_cells(points.points_mm, spacing_mm), return_index=True)
    return _taken(points, np.sort(first))


def _cells(points_mm: Array, side_mm: float) -> NDArray[np.int64]:
    """Return the number (n,) of the cube of ``side_mm`` that each point lies in, as one."""
    cell = np.floor((points_mm - points_mm.min(axis=0, initial=0.0)) / side_mm).astype(np.int64)
    return np.asarray((cell[:, 0] * 2_000_000 + cell[:, 1]) * 2_000_000 + cell[:, 2])


# ------------------------------------------------------------------------------------------------ led by planes


@dataclass(frozen=True, slots=True, eq=False)
class _Fit:
    pose: Rigid
    system: System
    apart_mm: Array
    """(n,): distance of every used point from the reference; infinite where there is none near."""

    @property
    def fitting(self) -> float:
        return float(np.mean(self.apart_mm < FITS_MM))

    @property
    def rms_mm(self) -> float:
        near = self.apart_mm[self.apart_mm < FITS_MM]
        return float(np.sqrt(np.mean(near**2))) if len(near) else np.nan

    @property
    def support(self) -> float:
        """All points in one number, as in MSAC (P.

        Torr, A. Zisserman 2000): 1 if each lies on the reference, 0 if none is near it.
        """
        return _support(self.apart_mm, FITS_MM)

    @property
    def loose(self) -> list[Array]:
        """The directions (6,) of δ that nothing holds: shifts, and turns with the shift that belongs to them."""
        resistance = self.system.resistance()
        vectors = resistance.directions[:, resistance.significance < HELD]
        if not vectors.shape[1]:
            return []
        # Within what is loose turned so that as many directions as can be do not turn at all.
        return list((vectors @ np.linalg.svd(vectors[:3], full_matrices=True)[2].T).T)

    def close(self, scatter_mm: float) -> float:
        """Return the share of the points within three standard deviations of ``scatter_mm``."""
        return float(np.mean(self.apart_mm < 3.0 * max(scatter_mm, 0.01)))


def _support(apart_mm: Array, width_mm: float) -> float:
    return float(np.mean(np.maximum(0.0, 1.0 - (apart_mm / width_mm) ** 2)))


@dataclass(frozen=True, slots=True, eq=False)
class _Sampled:
    """A reference that can be searched."""

    points: OrientedPoints
    tree: cKDTree
    spacing_mm: float
    """Distance within which every place on it has a sample."""

    @classmethod
    def of(cls, points: OrientedPoints) -> _Sampled:
        tree = cKDTree(points.points_mm)
        some = points.points_mm[:: max(1, len(points.points_mm) // 2000)]
        return cls(points, tree, 2.0 * float(np.percentile(tree.query(some, 2)[0][:, 1], 99)))

    def nearest(self, points_mm: Array, limit_mm: float) -> PlacesOn:
        """Return the plane of the nearest sample to each point; beside the border there is none: its last sample is
        farther than samples are apart."""
        far, at = self.tree.query(points_mm, distance_upper_bound=limit_mm + self.spacing_mm)
        at = np.minimum(at, len(self.points.points_mm) - 1)
        normals, way = self.points.normals[at], points_mm - self.points.points_mm[at]
        off = (normals * way).sum(1)
        there = np.isfinite(far) & ((way**2).sum(1) - off**2 < self.spacing_mm**2)
        return PlacesOn(
            np.where(there, np.abs(off), np.inf), self.points.points_mm[at], normals, self.points.sigma_mm[at]
        )


def _led(measured: OrientedPoints, reference: _Sampled | ReferenceSurface, guess: Rigid, gate_mm: float) -> _Fit | None:
    """Return the fit that ``guess`` leads to, unmoved along what nothing holds; ``None`` where too little lies on the
    reference to tell."""
    pose, gate = guess, gate_mm
    for _ in range(ROUNDS):
        system, _ = _lay(measured, reference, pose, gate)
        if system is None:
            return None
        resistance = system.resistance()
        held = resistance.directions[:, resistance.significance >= HELD]
        step = held @ (held.T @ system.step())
        pose = system.moved(pose, step)
        gate = max(LAST_GATE_MM, min(0.7 * gate, max(6.0 * system.scatter_mm, 0.35 * gate)))
        if gate <= LAST_GATE_MM and float(np.linalg.norm(step)) < 2e-4:
            break
    system, apart = _lay(measured, reference, pose, LAST_GATE_MM)
    return None if system is None else _Fit(pose, system, apart)


def _lay(
    measured: OrientedPoints, reference: _Sampled | ReferenceSurface, pose: Rigid, gate_mm: float
) -> tuple[System | None, Array]:
    """Lay the measured points upon the reference, each on the plane of its nearest place; return the equations,
    ``None`` of too few, and the distance (n,) of all points, infinite where there is nothing like them."""
    x, m = pose.of(measured.points_mm), measured.normals @ pose.rotation.T
    on = reference.nearest(x, max(gate_mm, FITS_MM))
    alike = (on.normals * m).sum(1) > MIN_ALIKE
    apart = np.where(alike, on.distance_mm, np.inf)
    index = np.flatnonzero(apart < gate_mm)
    if len(index) < FEWEST:
        return None, apart
    plane = on.normals[index]
    off = (plane * (x[index] - on.places_mm[index])).sum(1)
    sigma_mm = np.hypot(measured.sigma_mm[index], on.sigma_mm[index])
    return System.of_planes(x[index], off, (plane, m[index]), sigma_mm, _cells(x[index], TILE_MM)), apart


# ------------------------------------------------------------------------------------------------ guesses by pairs of points


def _guesses(measured: OrientedPoints, reference: OrientedPoints) -> Iterator[tuple[Rigid, float]]:
    """Yield poses that many pairs of points agree on, the best first, with the gate to lead them from."""
    reach_mm = _reach(measured)
    few, spacing_mm = _evenly(measured, reach_mm / 25.0, _MOST_MEASURED)
    model, model_mm = _evenly(reference, spacing_mm, _MOST_REFERENCE)
    gate_mm = 1.5 * max(spacing_mm, model_mm)
    tree = cKDTree(model.points_mm)
    scored = []
    for pose in _voted(few, model, tree, reach_mm):
        far, at = tree.query(pose.of(few.points_mm), distance_upper_bound=gate_mm)
        near = np.isfinite(far)
        alike = (model.normals[at[near]] * (few.normals[near] @ pose.rotation.T)).sum(1) > MIN_ALIKE
        scored.append((float(np.count_nonzero(alike)) / len(far), pose))
    scored.sort(key=lambda one: -one[0])
    chosen: list[Rigid] = []
    for _, pose in scored:
        if len(chosen) < _GUESSES and all(not _same(pose, one, few, 0.08) for one in chosen):
            chosen.append(pose)
            yield pose, gate_mm


def _voted(few: OrientedPoints, model: OrientedPoints, tree: cKDTree, reach_mm: float) -> Iterator[Rigid]:
    """Yield the poses that pairs of points vote for."""
    close = tree.sparse_distance_matrix(tree, reach_mm, output_type="ndarray")
    close = close[close["v"] > reach_mm / _STEPS]
    first, second = close["i"].astype(np.int64), close["j"].astype(np.int64)
    key = _key(model, first, second, reach_mm)
    order = np.argsort(key, kind="stable")
    key, first, second = key[order], first[order], second[order]
    turn = _turn(model, first, second)
    others, lots = np.arange(len(few.points_mm)), np.random.default_rng(11)
    for one in np.linspace(0, len(others) - 1, min(_FIRSTS, len(others))).astype(int):
        far = np.linalg.norm(few.points_mm - few.points_mm[one], axis=1)
        with_ = others[(far > reach_mm / _STEPS) & (far < reach_mm)]
        mine = np.full(len(with_), one)
        wanted = _key(few, mine, with_, reach_mm)
        low, high = np.searchsorted(key, wanted), np.searchsorted(key, wanted, side="right")
        count = np.minimum(high - low, _COMMON)
        if not count.sum():
            continue
        number = np.arange(count.sum()) - np.repeat(np.cumsum(count) - count, count)
        # Of more pairs than may vote every so-manieth does; their order is the reference's, which no place on it is
        # favoured by.
        step = np.repeat((high - low) / np.maximum(count, 1), count)
        row = np.repeat(low, count) + ((number + lots.random(len(number))) * step).astype(np.int64)
        # The turn about the first point's normal that lays the one pair on the other.
        angle = turn[row] - np.repeat(_turn(few, mine, with_), count)
        bins = np.floor(angle / (2.0 * np.pi) * _TURNS).astype(np.int64) % _TURNS
        # A pair that many share says less of each place.
        weight = np.repeat(1.0 / np.sqrt(np.maximum(high - low, 1)), count)
        votes = np.bincount(first[row] * _TURNS + bins, weight, len(model.points_mm) * _TURNS)
        for best in np.argpartition(-votes, 4)[:4]:
            place, bin_ = divmod(int(best), _TURNS)
            about = 2.0 * np.pi * (bin_ + 0.5) / _TURNS
            yield _laying(few, int(one), model, place, about)


def _key(
    points: OrientedPoints, first: NDArray[np.int64], second: NDArray[np.int64], reach_mm: float
) -> NDArray[np.int64]:
    """Return the four numbers of pairs that no motion changes, as one: distance, both normals to it, and between them."""
    way = points.points_mm[second] - points.points_mm[first]
    far = np.linalg.norm(way, axis=1)
    way = way / far[:, None]
    n, m = points.normals[first], points.normals[second]
    key = np.minimum((far / reach_mm * _STEPS).astype(np.int64), _STEPS - 1)
    for cosine in ((n * way).sum(1), (m * way).sum(1), (n * m).sum(1)):
        angle = np.arccos(np.clip(cosine, -1.0, 1.0))
        key = key * _ANGLES + np.minimum((angle / np.pi * _ANGLES).astype(np.int64), _ANGLES - 1)
    return np.asarray(key)


def _frame(normal: Array) -> Array:
    """Return rotations (n, 3, 3) that turn the normals (n, 3) to the x axis."""
    help_ = np.where(np.abs(normal[:, :1]) < 0.8, np.array([1.0, 0.0, 0.0]), np.array([0.0, 1.0, 0.0]))
    y = np.cross(normal, help_)
    y /= np.linalg.norm(y, axis=1)[:, None]
    return np.stack([normal, y, np.cross(normal, y)], axis=1)


def _turn(points: OrientedPoints, first: NDArray[np.int64], second: NDArray[np.int64]) -> Array:
    """Return the angle of each pair's second point about the first one's normal."""
    way = points.points_mm[second] - points.points_mm[first]
    frame = _frame(points.normals)[first]
    return np.asarray(np.arctan2((frame[:, 2] * way).sum(1), (frame[:, 1] * way).sum(1)))


def _laying(few: OrientedPoints, one: int, model: OrientedPoints, place: int, about: float) -> Rigid:
    mine, theirs = _frame(few.normals[one : one + 1])[0], _frame(model.normals[place : place + 1])[0]
    c, s = np.cos(about), np.sin(about)
    rotation = theirs.T @ np.array([[1.0, 0.0, 0.0], [0.0, c, -s], [0.0, s, c]]) @ mine
    return Rigid(rotation, model.points_mm[place] - rotation @ few.points_mm[one])


# ------------------------------------------------------------------------------------------------ points


def _taken(points: OrientedPoints, rows: NDArray[np.int64]) -> OrientedPoints:
    return OrientedPoints(points.points_mm[rows], points.normals[rows], points.sigma_mm[rows])


def _thinned(points: OrientedPoints, most: int) -> OrientedPoints:
    n = len(points.points_mm)
    return points if n <= most else _taken(points, np.sort(np.random.default_rng(5).choice(n, most, replace=False)))


def _evenly(points: OrientedPoints, spacing_mm: float, most: int) -> tuple[OrientedPoints, float]:
    """Return points a spacing apart, at most ``most``, and that spacing, mm."""
    while True:
        found = thinned_evenly(points, spacing_mm)
        if len(found.points_mm) <= most:
            return found, spacing_mm
        spacing_mm *= 1.2


def _reach(points: OrientedPoints) -> float:
    return float(np.linalg.norm(np.ptp(points.points_mm, axis=0)))


def _size(points: OrientedPoints) -> str:
    return " x ".join(f"{one:.3g}" for one in np.ptp(points.points_mm, axis=0))


def _in_metres(measured: OrientedPoints, reference: OrientedPoints) -> str:
    """Return the question whether the reference is in metres, where its size speaks for it."""
    ratio = _reach(measured) / max(_reach(reference), 1e-12)
    return "; is the CAD model in metres? Then make it 1000 times as large" if 50.0 < ratio < 5000.0 else ""


def _same(one: Rigid, other: Rigid, points: OrientedPoints, share: float = 0.005) -> bool:
    """Tell whether two poses put the points to the same places, within a ``share`` of their size."""
    some = points.points_mm[:: max(1, len(points.points_mm) // 50)]
    return bool(np.linalg.norm(one.of(some) - other.of(some), axis=1).max() < share * _reach(points))
