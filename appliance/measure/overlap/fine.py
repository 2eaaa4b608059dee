"""Owns the fine registration of two scans: the pose of scan B in the frame of scan A, and how well it is determined.

It is an ICP with two residuals for each patch of B that lies on A: the distance from A's plane, and the difference of
texture (``paint`` in the code). ``lay`` finds the corresponding patches by projecting B into A's image.
``equations.py`` gives the step, and defines the symbols used here. ``refine`` repeats both, with a shrinking distance
limit, until the pose no longer moves.

``Fit`` has the pose, its covariance, and what the caller needs to accept or reject it: overlap, outliers, and how far
each direction is determined beyond noise (``held``). ``BowNews`` is what this pair contributes to the estimate of the
depth error that all scans of one calibration share.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from appliance.measure.calibration.depth_error import DEPTH_ERROR_TERMS, along_ray, shapes
from appliance.measure.light.volume import STANDARD, WorkingVolume
from appliance.measure.overlap.albedo import Paint, patch_pitch_mm
from appliance.measure.overlap.equations import (
    EXTRA_MM,
    EXTRA_PAINT,
    FEWEST,
    Laid,
    Resistance,
    System,
    spread,
    system_of,
)
from appliance.measure.overlap.patches import Array, Bools, Patches
from appliance.measure.overlap.rigid import Rigid

MIN_ALIKE = 0.8
"""Least cosine between the normals of patches that may be the same place."""
CLUSTER_MM = 15.0
"""Residuals within such a tile are taken to err together."""
ROUNDS = 14
FIRST_GATE_MM, LAST_GATE_MM = 3.0, 0.25
"""Largest distance at which patches are taken for the same place, in the first round and the least in the last."""
FAINT = 0.025
"""Paint whose logarithm varies by less than this is none: what light leaves would be taken for it."""


@dataclass(frozen=True, slots=True, eq=False)
class BowNews:
    """Equations of one pair for the shared error."""

    response: Array
    """(6, k): by how much the pair's pose is wrong per mm of each coefficient."""
    information: Array
    """(k, k), 1/mm²: of the residuals that no pose takes away."""
    gradient: Array
    """(k,), 1/mm: of half the sum of squares, at zero coefficients."""


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

    @property
    def sigma_deg(self) -> float:
        """Standard deviation of the turn, in its weakest direction."""
        return float(np.degrees(np.sqrt(max(np.linalg.eigvalsh(self.covariance[:3, :3])[-1], 0.0)) / self.lever_mm))


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
            # Along the mean of both normals, which on a curved surface is square to the chord: a plane alone lies
            # outside of it.
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
            # Each of the four tells the paint at the very place, from its own place and gradient: a cell's fraction is
            # not exact.
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
    row, column = np.divmod(index[k], pb.sigma_mm.shape[1])
    tile = max(1, round(CLUSTER_MM / patch_pitch_mm(pb)))
    return Laid(
        x_mm=x[k], source=index[k], tile=row // tile * 1000 + column // tile, apart_mm=apart[k], normal_a=normal[k], normal_b=m[k],
        sigma_mm=np.sqrt(sigma2[k] + pb.sigma_mm.ravel()[index[k]] ** 2),
        paint=difference[k], gradient_a=np.where(known[:, None], gradient, 0.0)[k],
        gradient_b=np.where(known[:, None], gradient_b, 0.0)[k],
        paint_noise=np.sqrt(np.where(known, noise2 + b.paint.noise.ravel()[index] ** 2, np.nan))[k],
        paint_a=paint_a[k], paint_b=paint_b[k],
        # Towards the camera is towards A's normal: a positive distance means before the surface.
        unmet=empty, front=~empty & (nearest > max(1.0, gate_mm)), tried=len(x),
    )  # fmt: skip


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
        system = system_of(laid, with_paint and k >= 2)
        step = system.step()
        pose = system.moved(pose, step)
        moved_mm = float(np.linalg.norm(step))
        gate = max(LAST_GATE_MM, min(gate, 5.0 * system.scatter_mm), 0.6 * gate if gate > 1.0 else 0.0)
        if moved_mm < 2e-4 and k >= 5:
            break
    return _judged(a, b, pose, with_paint)


def own_resistance(scan: Prepared) -> Resistance:
    """Return what resists a displacement of a scan's shape laid upon itself. A pair has part of that shape in common,
    and is held by no more of it.

    The two normals whose products count are a patch's own and that of the patches beside it, which have other points
    and so other noise.
    """
    patches = scan.patches
    beside = np.full_like(patches.normal, np.nan)
    beside[:, 1:-1] = patches.normal[:, 2:] + patches.normal[:, :-2]
    with np.errstate(invalid="ignore"):
        beside /= np.linalg.norm(beside, axis=-1)[..., None]
        used = patches.valid & ((beside * patches.normal).sum(-1) > MIN_ALIKE)
    index, n = np.flatnonzero(used), int(np.count_nonzero(used))
    normals = patches.normal[used], beside[used]
    return System.of_planes(patches.centre_mm[used], np.zeros(n), normals, patches.sigma_mm[used], index).resistance()


def _judged(a: Prepared, b: Prepared, pose: Rigid, with_paint: bool) -> Fit | None:
    laid = lay(a, b, pose, 1.0)
    if len(laid.source) < FEWEST:
        return None
    limit = np.maximum(5.0 * np.hypot(laid.sigma_mm, EXTRA_MM), 0.2)
    wrong = np.abs(laid.apart_mm) > limit
    kept = lay(a, b, pose, max(LAST_GATE_MM, 5.0 * spread(laid.apart_mm)))
    if len(kept.source) < FEWEST:
        return None
    system = system_of(kept, with_paint)
    resistance = system.resistance()
    good = np.abs(laid.apart_mm) < limit
    # What A has where B's camera looks must be there, too.
    back = lay(b, a, pose.inverse, 1.0)
    return Fit(
        pose=pose,
        middle_mm=system.middle,
        lever_mm=system.lever,
        stiffness=resistance.stiffness,
        covariance=resistance.covariance,
        held=resistance.held,
        directions=resistance.directions,
        patches=len(laid.source),
        overlap=len(laid.source) / max(int(np.count_nonzero(b.patches.valid)), 1),
        rms_mm=float(np.sqrt(np.mean(laid.apart_mm[good] ** 2))) if good.any() else float("inf"),
        outliers=float(wrong.mean()),
        unmet=max(_share(laid.unmet), _share(back.unmet)),
        front=max(_share(laid.front), _share(back.front)),
        alike=_alike(kept),
        paint_share=resistance.paint_share,
        bow=_bow(system, kept, b, pose, resistance),
    )


def _bow(system: System, laid: Laid, b: Prepared, pose: Rigid, resistance: Resistance) -> BowNews:
    at_b = b.patches.centre_mm.reshape(-1, 3)[laid.source]
    B = np.zeros((len(system.r), DEPTH_ERROR_TERMS))
    B[: len(at_b)] = derivatives(laid.normal_a, laid.x_mm, at_b, pose.rotation, b.patches.projection.volume)
    J = 0.5 * (system.J + system.Z)
    # Residuals of a tile err together: so many times are sums of them more uncertain than of independent ones.
    independent = np.einsum("ni,ni,n->", J, J, (system.w * system.r) ** 2)
    overdispersion = max(float(np.trace(resistance.meat)) / max(float(independent), 1e-12), 1.0)
    return news_of(J, resistance.inverse, B, system.w, system.r, overdispersion)


def derivatives(
    normal_a: Array, at_a_mm: Array, at_b_mm: Array, rotation: Array, volume: WorkingVolume = STANDARD
) -> Array:
    """Return ∂r/∂c (n, k): how the distance of B's patches from A's planes changes with the shared error.

    ``at_a_mm``: the places (n, 3) in A's frame, ``at_b_mm``: the same in B's, ``rotation``: from B's frame into A's.
    """
    of_b = (normal_a * (along_ray(at_b_mm) @ rotation.T)).sum(-1)
    of_a = (normal_a * along_ray(at_a_mm)).sum(-1)
    return np.asarray(of_b[:, None] * shapes(at_b_mm, volume) - of_a[:, None] * shapes(at_a_mm, volume))


def news_of(J: Array, S_inverse: Array, B: Array, w: Array, r: Array, overdispersion: float) -> BowNews:
    """Return a pair's news from its equations.

    ``J`` (n, 6) and ``B`` (n, k) derivatives of residuals ``r`` (n,) by pose and coefficients, ``w`` weights, all of
    planes alone or with zeros in ``B`` where a residual is paint's. ``overdispersion``: variance of sums of residuals
    over that of independent ones.
    """
    C = J.T @ (w[:, None] * B)
    response = -S_inverse @ C
    rest = B + J @ response
    # Residuals are those at the pose found, where J' w r = 0: what is left for the coefficients alone.
    return BowNews(response, rest.T @ (w[:, None] * rest) / overdispersion, -rest.T @ (w * r) / overdispersion)


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
    if min(spread(p), spread(q)) ** 2 < max(2.0 * noise2, FAINT**2):
        return None
    return float((p * q).mean() / np.sqrt((p * p).mean() * (q * q).mean()))


def _clipped(values: Array) -> Array:
    """Return values about their median, at most three standard deviations of most of them away."""
    limit = 3.0 * spread(values)
    return np.asarray(np.clip(values - np.median(values), -limit, limit))
