"""Owns the fine pose of one scan relative to another: planes against planes and paint against paint, and what holds it.

Patches of scan B are laid upon scan A. Each gives two residuals: its distance from A's plane, and the difference of paint. What resists a
displacement is their stiffness, a 6 × 6 matrix. Noise in normals and gradients would add stiffness of its own where there is none: a bare
pipe would seem to be held along its axis, with a residual as good as everywhere. So each product of the matrix takes one factor from A and
one from B, whose noise is independent: along a direction that nothing holds it is zero in the mean, and how far it scatters is known. An
estimate with such products is that of instrumental variables (Durbin 1954).

Symbols: R, t  rotation and translation that map B's points into A's frame;  x  a patch of B in A's frame
         δ = (ω, τ)  a small turn (as mm at the lever's end) about the overlap's middle, and a shift, mm
         J, Z  derivatives (n, 6) of the residuals by δ with A's normals and gradients, and with B's
         S  stiffness, 1/mm²;  r residuals;  w weights 1/variance, less for outliers
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from appliance.optics.rotation import rotation_matrix
from appliance.registration.albedo import Paint, patch_pitch_mm
from appliance.registration.bow import BowNews, derivatives, news_of
from appliance.registration.patches import Array, Bools, Patches

MIN_ALIKE = 0.8
"""Least cosine between the normals of patches that may be the same place."""
CLUSTER_MM = 15.0
"""Residuals within such a tile are taken to err together."""
ROUNDS = 14
FIRST_GATE_MM, LAST_GATE_MM = 3.0, 0.25
"""Largest distance at which patches are taken for the same place, in the first round and the least in the last."""
FEWEST = 120
"""Fewest patches in common."""
NEIGHBOURS_ALIKE = 2.0
"""Standard deviation of a stiffness of noise, over that for independent patches: target planes are means of four."""
EXTRA_MM = 0.006
"""Least standard deviation of a distance between two scans: what calibrations leave between places of the image."""
EXTRA_PAINT = 0.01
"""The same of paint: light is not regressed away to better than a hundredth."""
FAINT = 0.025
"""Paint whose logarithm varies by less than this is none: what light leaves would be taken for it."""


@dataclass(frozen=True, slots=True, eq=False)
class Rigid:
    """A rigid motion: x' = rotation x + translation_mm."""

    rotation: Array
    """(3, 3)."""
    translation_mm: Array
    """(3,)."""

    def of(self, points_mm: Array) -> Array:
        """Return the moved points (…, 3)."""
        return np.asarray(points_mm @ self.rotation.T + self.translation_mm)

    def then(self, later: Rigid) -> Rigid:
        """Return the motion that does this one and then ``later``."""
        return Rigid(later.rotation @ self.rotation, later.rotation @ self.translation_mm + later.translation_mm)

    @property
    def inverse(self) -> Rigid:
        """The motion that undoes it."""
        return Rigid(self.rotation.T, -self.rotation.T @ self.translation_mm)


@dataclass(frozen=True, slots=True, eq=False)
class Laid:
    """Patches of B laid upon A: n of them that meet a patch of A, in A's frame."""

    x_mm: Array
    source: NDArray[np.int64]
    """(n,): flat index of B's patch."""
    apart_mm: Array
    """(n,): distance from A's surface along its normal."""
    normal_a: Array
    normal_b: Array
    sigma_mm: Array
    """Standard deviation of ``apart_mm`` by both scans' noise."""
    paint: Array
    """(n,): A's paint less B's; NaN where either is unknown."""
    gradient_a: Array
    gradient_b: Array
    paint_noise: Array
    paint_a: Array
    paint_b: Array
    unmet: Bools
    """(m,) of all patches of B that were tried: seen by A's camera, yet A has nothing there."""
    front: Bools
    """(m,): B's patch lies clearly before A's surface: A's camera would have seen it there."""
    tried: int


@dataclass(frozen=True, slots=True, eq=False)
class Fit:
    """A fine pose with what is known about it."""

    pose: Rigid
    """Maps B's points into A's frame."""
    middle_mm: Array
    """(3,): middle of the overlap in A's frame, about which turns are meant."""
    lever_mm: float
    """RMS distance of the overlap from its middle: turns are counted in mm at its end."""
    stiffness: Array
    """(6, 6): S, 1/mm²."""
    covariance: Array
    """(6, 6): of δ, mm², robust: residuals of a tile may err together."""
    held: Array
    """(6,): each eigenvalue of S over the standard deviation that noise alone would give it."""
    directions: Array
    """(6, 6): columns are the eigenvectors of S, softest first."""
    patches: int
    overlap: float
    """Share of B's patches that lie on A."""
    rms_mm: float
    """RMS distance of planes, outliers left out."""
    outliers: float
    """Share of patches that meet A and are farther off than five of their standard deviations and 0.2 mm."""
    unmet: float
    """Share of one scan's patches that the other's camera looks at and has nothing there; the larger of both."""
    front: float
    """Share of one scan's patches that hover before the other's surface; the larger of both."""
    alike: float | None
    """Correlation of paint; ``None``: paint says nothing, since it is no more than noise."""
    paint_share: float
    """Share of the softest direction's stiffness that is paint's."""
    bow: BowNews
    """Equations of the pair for the depth error that all scans share."""

    @property
    def sigma_mm(self) -> float:
        """RMS displacement over the overlap that the covariance allows."""
        return float(np.sqrt(max(np.trace(self.covariance), 0.0)))


@dataclass(frozen=True, slots=True, eq=False)
class Prepared:
    """One scan at one resolution, ready to be registered."""

    patches: Patches
    paint: Paint


def lay(a: Prepared, b: Prepared, pose: Rigid, gate_mm: float) -> Laid:
    """Lay all of B's patches upon A by ``pose``; patches farther than ``gate_mm`` from A's surface do not meet it."""
    pa, pb = a.patches, b.patches
    index = np.flatnonzero(pb.valid)
    c, n = pb.centre_mm.reshape(-1, 3)[index], pb.normal.reshape(-1, 3)[index]
    x, m = pose.of(c), n @ pose.rotation.T
    cell = pa.cells(x)
    gh, gw = pa.sigma_mm.shape
    with np.errstate(invalid="ignore"):
        seen = (cell[:, 0] > 0.5) & (cell[:, 1] > 0.5) & (cell[:, 0] < gw - 1.5) & (cell[:, 1] < gh - 1.5)
        # From A's camera: patches that it sees from behind or too flatly are not expected there.
        seen &= -(m * x).sum(1) > 0.3 * np.linalg.norm(x, axis=1)
    index, x, m, cell = index[seen], x[seen], m[seen], cell[seen]
    i, j = np.floor(cell[:, 0]).astype(int), np.floor(cell[:, 1]).astype(int)
    s, t = cell[:, 0] - i, cell[:, 1] - j
    total = np.zeros(len(x))
    apart, sigma2 = np.zeros(len(x)), np.zeros(len(x))
    normal = np.zeros((len(x), 3))
    paint_total, paint_a, gradient, noise2 = np.zeros(len(x)), np.zeros(len(x)), np.zeros((len(x), 3)), np.zeros(len(x))
    nearest = np.full(len(x), np.inf)
    for dj in (0, 1):
        for di in (0, 1):
            at = (j + dj, i + di)
            weight = (s if di else 1.0 - s) * (t if dj else 1.0 - t)
            centre, plane = pa.centre_mm[at], pa.normal[at]
            # Along the mean of both normals, which on a curved surface is square to the chord: a plane alone lies outside of it.
            off = 0.5 * ((plane + m) * (x - centre)).sum(1)
            there = np.isfinite(off)
            # Distances on both sides of an edge do not mix: the nearest of the four decides.
            nearest = np.where(there & (np.abs(off) < np.abs(nearest)), off, nearest)
            good = there & (np.abs(off) < gate_mm) & ((plane * m).sum(1) > MIN_ALIKE)
            w = np.where(good, weight, 0.0)
            total += w
            apart += np.where(good, w * off, 0.0)
            sigma2 += np.where(good, w * pa.sigma_mm[at] ** 2, 0.0)
            normal += np.where(good[:, None], w[:, None] * plane, 0.0)
            known = good & np.isfinite(a.paint.value[at]) & np.isfinite(a.paint.gradient[at][:, 0])
            w = np.where(known, weight, 0.0)
            paint_total += w
            # Each of the four tells the paint at the very place, from its own place and gradient: a cell's fraction is not exact.
            beside = (a.paint.gradient[at] * (x - centre)).sum(1)
            paint_a += np.where(known, w * (a.paint.value[at] + beside), 0.0)
            gradient += np.where(known[:, None], w[:, None] * a.paint.gradient[at], 0.0)
            noise2 += np.where(known, w * a.paint.noise[at] ** 2, 0.0)
    empty = ~np.isfinite(nearest)
    met = total > 0.45
    with np.errstate(divide="ignore", invalid="ignore"):
        apart, sigma2, normal = apart / total, sigma2 / total, normal / np.linalg.norm(normal, axis=1)[:, None]
        paint_a, gradient, noise2 = paint_a / paint_total, gradient / paint_total[:, None], noise2 / paint_total
    paint_b = b.paint.value.ravel()[index]
    gradient_b = b.paint.gradient.reshape(-1, 3)[index] @ pose.rotation.T
    known = (paint_total > 0.45) & np.isfinite(paint_b) & np.isfinite(gradient_b[:, 0])
    difference = np.where(known, paint_a - paint_b, np.nan)
    k = met
    return Laid(
        x_mm=x[k], source=index[k], apart_mm=apart[k], normal_a=normal[k], normal_b=m[k],
        sigma_mm=np.sqrt(sigma2[k] + pb.sigma_mm.ravel()[index[k]] ** 2),
        paint=difference[k], gradient_a=np.where(known[:, None], gradient, 0.0)[k],
        gradient_b=np.where(known[:, None], gradient_b, 0.0)[k],
        paint_noise=np.sqrt(np.where(known, noise2 + b.paint.noise.ravel()[index] ** 2, np.nan))[k],
        paint_a=paint_a[k], paint_b=paint_b[k],
        # Towards the camera is towards A's normal: a positive distance means before the surface.
        unmet=empty, front=~empty & (nearest > max(1.0, gate_mm)), tried=len(x),
    )  # fmt: skip


@dataclass(frozen=True, slots=True, eq=False)
class _System:
    """The equations of one round."""

    J: Array
    Z: Array
    r: Array
    w: Array
    cluster: NDArray[np.int64]
    of_paint: Bools
    middle: Array
    lever: float


def _system(laid: Laid, b: Prepared, with_paint: bool) -> _System:
    middle = laid.x_mm.mean(axis=0)
    arm = laid.x_mm - middle
    lever = max(float(np.sqrt((arm**2).sum(axis=1).mean())), 1.0)

    def rows(direction: Array) -> Array:
        return np.concatenate([np.cross(arm, direction) / lever, direction], axis=1)

    scatter = _spread(laid.apart_mm)
    variance = laid.sigma_mm**2 + EXTRA_MM**2
    # Where distances scatter more than noise explains, all of them are believed less.
    excess = max(scatter**2 - float(np.median(variance)), 0.0)
    J, Z, r, w = rows(laid.normal_a), rows(laid.normal_b), laid.apart_mm, _weights(laid.apart_mm, variance + excess)
    gw = b.patches.sigma_mm.shape[1]
    tile = max(1, round(CLUSTER_MM / patch_pitch_mm(b.patches)))
    cluster = (laid.source // gw) // tile * 1000 + (laid.source % gw) // tile
    of_paint = np.zeros(len(r), bool)
    known = np.isfinite(laid.paint)
    if with_paint and np.count_nonzero(known) >= FEWEST:
        p = laid.paint[known]
        p = p - np.median(p)
        noise2 = laid.paint_noise[known] ** 2 + EXTRA_PAINT**2
        more = max(_spread(p) ** 2 - float(np.median(noise2)), 0.0)
        J = np.concatenate([J, rows(laid.gradient_a)[known]])
        Z = np.concatenate([Z, rows(laid.gradient_b)[known]])
        r = np.concatenate([r, p])
        w = np.concatenate([w, _weights(p, noise2 + more)])
        cluster = np.concatenate([cluster, cluster[known]])
        of_paint = np.concatenate([of_paint, np.ones(len(p), bool)])
    return _System(J, Z, r, w, cluster, of_paint, middle, lever)


def _spread(values: Array) -> float:
    return 1.4826 * float(np.median(np.abs(values - np.median(values)))) if len(values) else 0.0


def _weights(r: Array, variance: Array) -> Array:
    """Return 1/variance, falling for outliers (Cauchy at three standard deviations)."""
    return np.asarray(1.0 / variance / (1.0 + r * r / (9.0 * variance)))


def refine(
    a: Prepared,
    b: Prepared,
    start: Rigid,
    *,
    gate_mm: float = FIRST_GATE_MM,
    rounds: int = ROUNDS,
    with_paint: bool = True,
) -> Fit | None:
    """Return the fine pose that ``start`` leads to; ``None`` where too little overlaps to tell."""
    pose, gate = start, gate_mm
    moved_mm = np.inf
    for k in range(rounds):
        laid = lay(a, b, pose, gate)
        if len(laid.source) < FEWEST:
            return None
        system = _system(laid, b, with_paint and k >= 2)
        step = _step(system)
        pose = _moved(pose, system, step)
        moved_mm = float(np.linalg.norm(step))
        gate = max(LAST_GATE_MM, min(gate, 5.0 * _spread(laid.apart_mm)), 0.6 * gate if gate > 1.0 else 0.0)
        if moved_mm < 2e-4 and k >= 5:
            break
    return _judged(a, b, pose, with_paint)


def _step(system: _System) -> Array:
    plain = system.J.T @ (system.w[:, None] * system.J)
    mixed = system.Z.T @ (system.w[:, None] * system.J)
    rhs = 0.5 * (system.J + system.Z).T @ (system.w * system.r)
    value, vector = np.linalg.eigh(0.5 * (mixed + mixed.T))
    # Along what nothing holds, no step is taken: a thousandth of the mean stiffness stands in.
    value = np.maximum(value, 1e-4 * np.trace(plain) / 6.0)
    step = -vector @ ((vector.T @ rhs) / value)
    size = float(np.linalg.norm(step))
    return np.asarray(step * min(1.0, 8.0 / size) if size > 0 else step)


def _moved(pose: Rigid, system: _System, step: Array) -> Rigid:
    turn = rotation_matrix(step[:3] / system.lever)
    return Rigid(turn @ pose.rotation, turn @ (pose.translation_mm - system.middle) + system.middle + step[3:])


def _judged(a: Prepared, b: Prepared, pose: Rigid, with_paint: bool) -> Fit | None:
    laid = lay(a, b, pose, 1.0)
    if len(laid.source) < FEWEST:
        return None
    limit = np.maximum(5.0 * np.hypot(laid.sigma_mm, EXTRA_MM), 0.2)
    wrong = np.abs(laid.apart_mm) > limit
    kept = lay(a, b, pose, max(LAST_GATE_MM, 5.0 * _spread(laid.apart_mm)))
    if len(kept.source) < FEWEST:
        return None
    system = _system(kept, b, with_paint)
    labels, number = np.unique(system.cluster, return_inverse=True)
    mixed = system.Z.T @ (system.w[:, None] * system.J)
    S = 0.5 * (mixed + mixed.T)
    value, vector = np.linalg.eigh(S)
    # Under the hypothesis of no stiffness each product is noise times noise; how large that is, the difference of both factors tells.
    noise = 0.5 * ((system.Z - system.J) @ vector) ** 2
    deviation = NEIGHBOURS_ALIKE * np.sqrt(((system.w[:, None] * noise) ** 2).sum(axis=0))
    score = np.zeros((len(labels), 6))
    np.add.at(score, number, 0.5 * (system.J + system.Z) * (system.w * system.r)[:, None])
    count = len(labels)
    meat = score.T @ score * (count / max(count - 6.0, 1.0))
    floor = 1e-9 * max(value[-1], 1.0)
    inverse = vector @ np.diag(1.0 / np.maximum(value, floor)) @ vector.T
    soft = vector[:, 0]
    paint_only = system.of_paint
    by_paint = float(((system.Z[paint_only] @ soft) * (system.J[paint_only] @ soft) * system.w[paint_only]).sum())
    good = np.abs(laid.apart_mm) < limit
    # What A has where B's camera looks must be there, too.
    back = lay(b, a, pose.inverse, 1.0)
    return Fit(
        pose=pose,
        middle_mm=system.middle,
        lever_mm=system.lever,
        stiffness=S,
        covariance=inverse @ meat @ inverse,
        held=value / deviation,
        directions=vector,
        patches=len(laid.source),
        overlap=len(laid.source) / max(int(np.count_nonzero(b.patches.valid)), 1),
        rms_mm=float(np.sqrt(np.mean(laid.apart_mm[good] ** 2))) if good.any() else float("inf"),
        outliers=float(wrong.mean()),
        unmet=max(_share(laid.unmet), _share(back.unmet)),
        front=max(_share(laid.front), _share(back.front)),
        alike=_alike(kept),
        paint_share=by_paint / value[0] if value[0] > 0 else 0.0,
        bow=_bow(system, kept, b, pose, inverse, meat),
    )


def _bow(system: _System, laid: Laid, b: Prepared, pose: Rigid, inverse: Array, meat: Array) -> BowNews:
    at_b = b.patches.centre_mm.reshape(-1, 3)[laid.source]
    B = np.zeros((len(system.r), 7))
    B[: len(at_b)] = derivatives(laid.normal_a, laid.x_mm, at_b, pose.rotation)
    J = 0.5 * (system.J + system.Z)
    # Residuals of a tile err together: so many times are sums of them more uncertain than of independent ones.
    independent = np.einsum("ni,ni,n->", J, J, (system.w * system.r) ** 2)
    return news_of(J, inverse, B, system.w, system.r, max(float(np.trace(meat)) / max(float(independent), 1e-12), 1.0))


def _share(of: Bools) -> float:
    return float(of.mean()) if len(of) else 0.0


def _alike(laid: Laid) -> float | None:
    """Return the correlation of both scans' paint; ``None`` where it is no more than their noise."""
    known = np.isfinite(laid.paint)
    if np.count_nonzero(known) < FEWEST:
        return None
    p, q = (_clipped(one[known]) for one in (laid.paint_a, laid.paint_b))
    noise2 = float(np.mean(laid.paint_noise[known] ** 2)) + EXTRA_PAINT**2
    # By the median: what lighting leaves at a few edges of a bare object is not paint.
    if min(_spread(p), _spread(q)) ** 2 < max(2.0 * noise2, FAINT**2):
        return None
    return float((p * q).mean() / np.sqrt((p * p).mean() * (q * q).mean()))


def _clipped(values: Array) -> Array:
    """Return values about their median, at most three standard deviations of most of them away."""
    limit = 3.0 * _spread(values)
    return np.asarray(np.clip(values - np.median(values), -limit, limit))
