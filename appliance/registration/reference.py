"""Owns where a measured surface lies on another one, from shape alone: a drawing's triangles, or an object that was measured before.

Both are oriented points. First guesses come from pairs of points (B. Drost, M. Ulrich, N. Navab, S. Ilic, "Model globally, match locally",
2010): two points with normals have four numbers that no motion changes, and every pair of the one surface votes for the motions that lay
it on a pair of the other with the same numbers. So a part of a surface finds its place on the whole, wherever both are. The best
guesses are led by planes (``equations.py``), and what resists a displacement is known as it is of two scans.

Deviations from a drawing are what the user is looking for, so that distances do not refuse a pose unless most of it does not fit. What slides or
fits as well elsewhere is said and not refused: along such a direction no deviation changes.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from appliance.optics.rotation import rotation_vector
from appliance.registration.equations import (
    FEWEST,
    Laid,
    System,
    moved,
    resistance_of,
    spread,
    step_of,
    system_of,
)  # fmt: skip
from appliance.registration.patches import Array
from appliance.registration.rigid import Rigid

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
_MOST_REFERENCE, _MOST_MEASURED = 2_500, 500
"""Points that pairs are made of."""
_FIRSTS = 48
"""Measured points that vote, each with all the others."""
_COMMON = 200
"""Largest number of pairs that one pair votes for; where more have its four numbers (those of a plane), so many of them by lot."""
_TURNS = 30
_ROUGHLY = 40_000
"""Samples of the reference while guesses are led."""
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
class LaidOnto:
    """Place of a measured surface on a reference."""

    pose: Rigid
    """Maps the measured points into the reference's frame."""
    middle_mm: Array
    """(3,): middle of the points that lie on it, in the reference's frame, about which turns are meant."""
    lever_mm: float
    covariance: Array
    """(6, 6) of δ, mm², zero along the directions that nothing holds."""
    free: tuple[Array, ...]
    """Directions (6,) of δ along which it slides: no deviation changes along them."""
    fitting: float
    """Share of the points that lie within ``FITS_MM`` of the reference."""
    scatter_mm: float
    """Standard deviation of most of the distances."""
    elsewhere: tuple[Rigid, ...]
    """Other poses that fit as well."""

    def sigma_at(self, points_mm: Array, normals: Array) -> Array:
        """Return the standard deviation (n,), mm, that the pose adds to deviations of ``points_mm`` (n, 3) along ``normals``."""
        arm = points_mm - self.middle_mm
        rows = np.concatenate([np.cross(arm, normals) / self.lever_mm, normals], axis=1)
        return np.asarray(np.sqrt(np.maximum(np.einsum("ni,ij,nj->n", rows, self.covariance, rows), 0.0)))


def lay_onto(measured: OrientedPoints, reference: OrientedPoints, start: Rigid | None = None) -> LaidOnto:
    """Return the place of ``measured`` on ``reference``, which has to be sampled more finely than a millimetre or so.

    ``start``: where it lies within some millimetres; ``None``: anywhere. Raises SurfaceMatchError where most of it lies nowhere on the reference.
    """
    used = _thinned(measured, USED)
    sampled, few = _Sampled.of(reference), _thinned(measured, USED // 8)
    if start is None:
        roughly = _Sampled.of(_thinned(reference, _ROUGHLY))
        led = [_led(few, roughly, guess, gate_mm) for guess, gate_mm in _guesses(measured, reference)]
    else:
        led = [_led(few, sampled, start, START_GATE_MM)]
    fits = _distinct([_led(used, sampled, one.pose, 2.0 * LAST_GATE_MM) for one in _distinct(led, few)[:_LED]], used)
    if not fits or fits[0].fitting < LEAST_FITTING:
        share = f"{100.0 * fits[0].fitting:.0f} %" if fits else "nothing"
        raise SurfaceMatchError(
            f"{share} of it lies within {FITS_MM:g} mm of the reference in any place; at least {100.0 * LEAST_FITTING:.0f} % must: "
            f"is it the same thing, in mm, with its outside out? Sizes are {_size(measured)} and {_size(reference)} mm"
        )
    return _described(fits, used)


def _described(fits: list[_Fit], used: OrientedPoints) -> LaidOnto:
    best = fits[0]
    resistance = resistance_of(best.system)
    value, vector = np.linalg.eigh(resistance.stiffness)
    loose = resistance.held < HELD
    kept = vector[:, ~loose]
    inverse = kept @ np.diag(1.0 / value[~loose]) @ kept.T
    close = best.close(best.scatter_mm)
    as_good = [
        fit
        for fit in fits[1:]
        if fit.close(best.scatter_mm) > AS_GOOD * close and not _slid(fit.pose, best, kept, used)
    ]
    return LaidOnto(
        pose=best.pose,
        middle_mm=best.system.middle,
        lever_mm=best.system.lever,
        covariance=np.asarray(inverse @ resistance.meat @ inverse),
        free=tuple(vector[:, k] for k in np.flatnonzero(loose)),
        fitting=best.fitting,
        scatter_mm=best.scatter_mm,
        elsewhere=tuple(fit.pose for fit in as_good),
    )


def _slid(pose: Rigid, best: _Fit, kept: Array, used: OrientedPoints) -> bool:
    """Tell whether ``pose`` differs from the best one only along what is not held, so that it is the same news."""
    if kept.shape[1] == 6:
        return False
    off = best.pose.inverse.then(pose)
    middle = best.system.middle
    delta = np.concatenate([best.system.lever * rotation_vector(off.rotation), off.of(middle) - middle])
    return bool(np.linalg.norm(kept.T @ delta) < 0.1 * np.linalg.norm(delta) + _reach(used) * 0.02)


def _distinct(fits: list[_Fit | None], used: OrientedPoints) -> list[_Fit]:
    """Return different fits, the best first: by how many points lie close, since a wrong pose has its own few that fit better."""
    there = [fit for fit in fits if fit is not None]
    least_mm = min((fit.scatter_mm for fit in there), default=0.0)
    found: list[_Fit] = []
    for fit in sorted(there, key=lambda one: -one.close(least_mm)):
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
    scatter_mm: float

    @property
    def fitting(self) -> float:
        return float(np.mean(np.abs(self.apart_mm) < FITS_MM))

    def close(self, scatter_mm: float) -> float:
        """Return the share of the points within three standard deviations of ``scatter_mm``."""
        return float(np.mean(np.abs(self.apart_mm) < 3.0 * max(scatter_mm, 0.01)))


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


def _led(measured: OrientedPoints, reference: _Sampled, guess: Rigid, gate_mm: float) -> _Fit | None:
    """Return the fit that ``guess`` leads to; ``None`` where too little lies on the reference to tell."""
    pose, gate = guess, gate_mm
    for _ in range(ROUNDS):
        laid = _lay(measured, reference, pose, gate)
        if len(laid.source) < FEWEST:
            return None
        system = system_of(laid, with_paint=False)
        step = step_of(system)
        pose = moved(pose, system, step)
        gate = max(LAST_GATE_MM, min(0.7 * gate, max(6.0 * spread(laid.apart_mm), 0.35 * gate)))
        if gate <= LAST_GATE_MM and float(np.linalg.norm(step)) < 2e-4:
            break
    laid = _lay(measured, reference, pose, LAST_GATE_MM)
    if len(laid.source) < FEWEST:
        return None
    wide = _lay(measured, reference, pose, FITS_MM)
    apart = np.full(len(measured.points_mm), np.inf)
    apart[wide.source] = wide.apart_mm
    return _Fit(pose, system_of(laid, with_paint=False), apart, spread(laid.apart_mm))


def _lay(measured: OrientedPoints, reference: _Sampled, pose: Rigid, gate_mm: float) -> Laid:
    """Lay the measured points upon the reference: each on the plane of the sample that is nearest."""
    x, m = pose.of(measured.points_mm), measured.normals @ pose.rotation.T
    on = reference.points
    far, at = reference.tree.query(x, distance_upper_bound=gate_mm + reference.spacing_mm)
    near = np.flatnonzero(np.isfinite(far))
    plane, way = on.normals[at[near]], x[near] - on.points_mm[at[near]]
    off = (plane * way).sum(1)
    # Beside the border of the reference there is nothing to lie on: its last sample is farther than samples are apart.
    aside2 = (way**2).sum(1) - off**2
    good = (np.abs(off) < gate_mm) & ((plane * m[near]).sum(1) > MIN_ALIKE) & (aside2 < reference.spacing_mm**2)
    index = near[good]
    n = len(index)
    nothing, flat = np.full(n, np.nan), np.zeros((n, 3))
    return Laid(
        x_mm=x[index], source=index, tile=_cells(x[index], TILE_MM), apart_mm=off[good],
        normal_a=plane[good], normal_b=m[index],
        sigma_mm=np.hypot(measured.sigma_mm[index], on.sigma_mm[at[index]]),
        paint=nothing, gradient_a=flat, gradient_b=flat, paint_noise=nothing, paint_a=nothing, paint_b=nothing,
        unmet=np.ones(0, bool), front=np.ones(0, bool), tried=len(x),
    )  # fmt: skip


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
        # Of more pairs than may vote every so-manieth does; their order is the reference's, which no place on it is favoured by.
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
    return " x ".join(f"{one:.0f}" for one in np.ptp(points.points_mm, axis=0))


def _same(one: Rigid, other: Rigid, points: OrientedPoints, share: float = 0.005) -> bool:
    """Tell whether two poses put the points to the same places, within a ``share`` of their size."""
    some = points.points_mm[:: max(1, len(points.points_mm) // 50)]
    return bool(np.linalg.norm(one.of(some) - other.of(some), axis=1).max() < share * _reach(points))
