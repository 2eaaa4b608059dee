"""Fine registration of two scans: the pose of scan B in the frame of scan A, with its covariance.

It is an ICP with two residuals for each patch of B that lies on A: the distance from A's plane, and the difference of
texture. ``correspond`` finds the corresponding patches by projecting B into A's image. ``equations.py`` gives the step,
and defines the symbols used here. ``refine`` repeats both, with a shrinking distance limit, until the pose no longer
moves.

Fit                    the pose, its covariance, and what the caller needs to accept or reject it: overlap, outliers,
                       and how far each direction is determined beyond noise (``significance``)
DepthErrorEquations    what this pair contributes to the estimate of the depth error of all scans of one calibration
PreparedScan           a scan at one resolution
correspond, refine     the two parts of the iteration
self_resistance        how well the shape of one scan alone determines a pose
derivatives, depth_error_equations    the equations for the depth error
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from appliance.measure.calibration.depth_error import DEPTH_ERROR_TERMS, along_ray, shapes
from appliance.measure.light.volume import STANDARD, WorkingVolume
from appliance.measure.overlap.albedo import Texture, patch_pitch_mm
from appliance.measure.overlap.equations import (
    EXTRA_MM,
    EXTRA_TEXTURE,
    FEWEST,
    Correspondences,
    Resistance,
    System,
    spread,
    system_of,
)
from appliance.measure.overlap.patches import Array, Bools, Patches
from appliance.measure.overlap.rigid import Rigid

MIN_NORMAL_COSINE = 0.8
"""Least cosine between the normals of corresponding patches."""
TILE_MM = 15.0
"""Side of the tiles of the image grid within which residuals are taken to be correlated."""
ROUNDS = 14
FIRST_LIMIT_MM, LAST_LIMIT_MM = 3.0, 0.25
"""Largest distance of corresponding patches, in the first round and the least in the last."""
MIN_TEXTURE = 0.025
"""Least standard deviation of the logarithm of albedo: below it, residual shading would be taken for texture."""


@dataclass(frozen=True, slots=True, eq=False)
class DepthErrorEquations:
    """Equations of one scan pair for the depth error that all scans share."""

    response: Array
    """(6, k): error of the pair's pose per mm of each coefficient."""
    information: Array
    """(k, k), 1/mm²: information on the coefficients after the pose is eliminated."""
    gradient: Array
    """(k,), 1/mm: gradient of half the sum of squares, at zero coefficients."""


@dataclass(frozen=True, slots=True, eq=False)
class Fit:
    """A fine pose, its uncertainty and its agreement."""

    pose: Rigid
    """Maps B's points into A's frame."""
    middle_mm: Array
    """(3,): middle of the overlap in A's frame; rotations are about it."""
    lever_mm: float
    """RMS distance of the overlap from its middle; rotations are stated in mm at this distance."""
    stiffness: Array
    """(6, 6): S, 1/mm²."""
    covariance: Array
    """(6, 6): covariance of δ, mm², with residuals of a tile taken as correlated."""
    significance: Array
    """(6,): each eigenvalue of S over the standard deviation that noise alone would give it."""
    directions: Array
    """(6, 6): columns are the eigenvectors of S, softest first."""
    patches: int
    overlap: float
    """Share of B's patches that lie on A."""
    rms_mm: float
    """RMS distance between corresponding patches, without outliers."""
    outliers: float
    """Share of corresponding patches farther apart than five of their standard deviations and 0.2 mm."""
    missing: float
    """Share of one scan's patches where the other scan's camera sees no surface; the larger of both."""
    front: float
    """Share of one scan's patches in front of the other's surface; the larger of both."""
    texture_correlation: float | None
    """Correlation of both textures; ``None``: the texture is no more than noise."""
    texture_share: float
    """Share of the softest direction's stiffness that is due to texture."""
    depth_error: DepthErrorEquations
    """The pair's contribution to the estimate of the shared depth error."""

    @property
    def sigma_mm(self) -> float:
        """RMS displacement over the overlap that the covariance allows."""
        return float(np.sqrt(max(np.trace(self.covariance), 0.0)))

    @property
    def sigma_deg(self) -> float:
        """Standard deviation of the rotation about its least certain axis."""
        return float(np.degrees(np.sqrt(max(np.linalg.eigvalsh(self.covariance[:3, :3])[-1], 0.0)) / self.lever_mm))


@dataclass(frozen=True, slots=True, eq=False)
class PreparedScan:
    """One scan at one resolution, ready to be registered."""

    patches: Patches
    texture: Texture


def correspond(a: PreparedScan, b: PreparedScan, pose: Rigid, max_distance_mm: float) -> Correspondences:
    """Return the patches of B that lie on A at ``pose``, at most ``max_distance_mm`` from A's surface."""
    pa, pb = a.patches, b.patches
    index = np.flatnonzero(pb.valid)
    c, n = pb.centre_mm.reshape(-1, 3)[index], pb.normal.reshape(-1, 3)[index]
    x, m = pose.of(c), n @ pose.rotation.T
    cell = pa.cells(x)
    gh, gw = pa.sigma_mm.shape
    with np.errstate(invalid="ignore"):
        visible = (cell[:, 0] > 0.5) & (cell[:, 1] > 0.5) & (cell[:, 0] < gw - 1.5) & (cell[:, 1] < gh - 1.5)
        # A's camera cannot have seen patches that face away from it or are too oblique.
        visible &= -(m * x).sum(1) > 0.3 * np.linalg.norm(x, axis=1)
    index, x, m, cell = index[visible], x[visible], m[visible], cell[visible]
    i, j = np.floor(cell[:, 0]).astype(int), np.floor(cell[:, 1]).astype(int)
    s, t = cell[:, 0] - i, cell[:, 1] - j
    total = np.zeros(len(x))
    apart, sigma2 = np.zeros(len(x)), np.zeros(len(x))
    normal = np.zeros((len(x), 3))
    texture_total, texture_a, gradient, noise2 = (
        np.zeros(len(x)),
        np.zeros(len(x)),
        np.zeros((len(x), 3)),
        np.zeros(len(x)),
    )
    nearest = np.full(len(x), np.inf)
    for dj in (0, 1):
        for di in (0, 1):
            corner = (j + dj, i + di)
            weight = (s if di else 1.0 - s) * (t if dj else 1.0 - t)
            centre, plane = pa.centre_mm[corner], pa.normal[corner]
            # Along the mean of both normals, which is perpendicular to the chord of a curved surface; the tangent
            # plane lies outside of the surface.
            off = 0.5 * ((plane + m) * (x - centre)).sum(1)
            finite = np.isfinite(off)
            # The nearest of the four decides, so that distances on both sides of an edge are not averaged.
            nearest = np.where(finite & (np.abs(off) < np.abs(nearest)), off, nearest)
            is_near = finite & (np.abs(off) < max_distance_mm) & ((plane * m).sum(1) > MIN_NORMAL_COSINE)
            w = np.where(is_near, weight, 0.0)
            total += w
            apart += np.where(is_near, w * off, 0.0)
            sigma2 += np.where(is_near, w * pa.sigma_mm[corner] ** 2, 0.0)
            normal += np.where(is_near[:, None], w[:, None] * plane, 0.0)
            has_texture = is_near & np.isfinite(a.texture.value[corner]) & np.isfinite(a.texture.gradient[corner][:, 0])
            w = np.where(has_texture, weight, 0.0)
            texture_total += w
            # Each of the four is extrapolated to the exact place by its gradient: fractions of a cell are too coarse.
            offset = (a.texture.gradient[corner] * (x - centre)).sum(1)
            texture_a += np.where(has_texture, w * (a.texture.value[corner] + offset), 0.0)
            gradient += np.where(has_texture[:, None], w[:, None] * a.texture.gradient[corner], 0.0)
            noise2 += np.where(has_texture, w * a.texture.noise[corner] ** 2, 0.0)
    empty = ~np.isfinite(nearest)
    matched = total > 0.45
    with np.errstate(divide="ignore", invalid="ignore"):
        apart, sigma2, normal = apart / total, sigma2 / total, normal / np.linalg.norm(normal, axis=1)[:, None]
        texture_a, gradient, noise2 = (
            texture_a / texture_total,
            gradient / texture_total[:, None],
            noise2 / texture_total,
        )
    texture_b = b.texture.value.ravel()[index]
    gradient_b = b.texture.gradient.reshape(-1, 3)[index] @ pose.rotation.T
    has_texture = (texture_total > 0.45) & np.isfinite(texture_b) & np.isfinite(gradient_b[:, 0])
    difference = np.where(has_texture, texture_a - texture_b, np.nan)
    row, column = np.divmod(index[matched], pb.sigma_mm.shape[1])
    tile = max(1, round(TILE_MM / patch_pitch_mm(pb)))
    return Correspondences(
        x_mm=x[matched], source=index[matched], tile=row // tile * 1000 + column // tile,
        distance_mm=apart[matched], normal_a=normal[matched], normal_b=m[matched],
        sigma_mm=np.sqrt(sigma2[matched] + pb.sigma_mm.ravel()[index[matched]] ** 2),
        texture=difference[matched], gradient_a=np.where(has_texture[:, None], gradient, 0.0)[matched],
        gradient_b=np.where(has_texture[:, None], gradient_b, 0.0)[matched],
        texture_noise=np.sqrt(np.where(has_texture, noise2 + b.texture.noise.ravel()[index] ** 2, np.nan))[matched],
        texture_a=texture_a[matched], texture_b=texture_b[matched],
        # Towards the camera is towards A's normal: a positive distance means before the surface.
        missing=empty, front=~empty & (nearest > max(1.0, max_distance_mm)), tested=len(x),
    )  # fmt: skip


def refine(
    a: PreparedScan,
    b: PreparedScan,
    start: Rigid,
    *,
    max_distance_mm: float = FIRST_LIMIT_MM,
    rounds: int = ROUNDS,
    with_texture: bool = True,
) -> Fit | None:
    """Return the fine pose to which ``start`` converges; ``None`` if the overlap is too small."""
    pose, limit_mm = start, max_distance_mm
    moved_mm = np.inf
    for k in range(rounds):
        correspondences = correspond(a, b, pose, limit_mm)
        if len(correspondences.source) < FEWEST:
            return None
        system = system_of(correspondences, with_texture and k >= 2)
        step = system.step()
        pose = system.moved(pose, step)
        moved_mm = float(np.linalg.norm(step))
        limit_mm = max(LAST_LIMIT_MM, min(limit_mm, 5.0 * system.scatter_mm), 0.6 * limit_mm if limit_mm > 1.0 else 0.0)
        if moved_mm < 2e-4 and k >= 5:
            break
    return _assess(a, b, pose, with_texture)


def self_resistance(scan: PreparedScan) -> Resistance:
    """Return the resistance of a scan's shape to a displacement against itself.

    No pair with this scan can have more. The two factors of each product are a patch's normal and the mean normal of
    its neighbours, which rest on other points and so have other noise.
    """
    patches = scan.patches
    neighbours = np.full_like(patches.normal, np.nan)
    neighbours[:, 1:-1] = patches.normal[:, 2:] + patches.normal[:, :-2]
    with np.errstate(invalid="ignore"):
        neighbours /= np.linalg.norm(neighbours, axis=-1)[..., None]
        is_used = patches.valid & ((neighbours * patches.normal).sum(-1) > MIN_NORMAL_COSINE)
    index, n = np.flatnonzero(is_used), int(np.count_nonzero(is_used))
    normals = patches.normal[is_used], neighbours[is_used]
    return System.of_planes(
        patches.centre_mm[is_used], np.zeros(n), normals, patches.sigma_mm[is_used], index
    ).resistance()


def _assess(a: PreparedScan, b: PreparedScan, pose: Rigid, with_texture: bool) -> Fit | None:
    correspondences = correspond(a, b, pose, 1.0)
    if len(correspondences.source) < FEWEST:
        return None
    limit = np.maximum(5.0 * np.hypot(correspondences.sigma_mm, EXTRA_MM), 0.2)
    is_outlier = np.abs(correspondences.distance_mm) > limit
    inliers = correspond(a, b, pose, max(LAST_LIMIT_MM, 5.0 * spread(correspondences.distance_mm)))
    if len(inliers.source) < FEWEST:
        return None
    system = system_of(inliers, with_texture)
    resistance = system.resistance()
    is_inlier = np.abs(correspondences.distance_mm) < limit
    # Patches of A that B's camera should see must be in B, too.
    back = correspond(b, a, pose.inverse, 1.0)
    return Fit(
        pose=pose,
        middle_mm=system.middle,
        lever_mm=system.lever,
        stiffness=resistance.stiffness,
        covariance=resistance.covariance,
        significance=resistance.significance,
        directions=resistance.directions,
        patches=len(correspondences.source),
        overlap=len(correspondences.source) / max(int(np.count_nonzero(b.patches.valid)), 1),
        rms_mm=float(np.sqrt(np.mean(correspondences.distance_mm[is_inlier] ** 2)))
        if is_inlier.any()
        else float("inf"),
        outliers=float(is_outlier.mean()),
        missing=max(_share(correspondences.missing), _share(back.missing)),
        front=max(_share(correspondences.front), _share(back.front)),
        texture_correlation=_texture_correlation(inliers),
        texture_share=resistance.texture_share,
        depth_error=_depth_error(system, inliers, b, pose, resistance),
    )


def _depth_error(
    system: System, correspondences: Correspondences, b: PreparedScan, pose: Rigid, resistance: Resistance
) -> DepthErrorEquations:
    positions_b_mm = b.patches.centre_mm.reshape(-1, 3)[correspondences.source]
    B = np.zeros((len(system.r), DEPTH_ERROR_TERMS))
    B[: len(positions_b_mm)] = derivatives(
        correspondences.normal_a, correspondences.x_mm, positions_b_mm, pose.rotation, b.patches.projection.volume
    )
    J = 0.5 * (system.J + system.Z)
    # Residuals of a tile are correlated: the variance of their sums is larger than of independent ones by this factor.
    independent = np.einsum("ni,ni,n->", J, J, (system.w * system.r) ** 2)
    overdispersion = max(float(np.trace(resistance.meat)) / max(float(independent), 1e-12), 1.0)
    return depth_error_equations(J, resistance.inverse, B, system.w, system.r, overdispersion)


def derivatives(
    normal_a: Array, at_a_mm: Array, at_b_mm: Array, rotation: Array, volume: WorkingVolume = STANDARD
) -> Array:
    """Return ∂r/∂c (n, k): how the distances of B's patches from A's planes change with the depth error.

    ``at_a_mm``: the places (n, 3) in A's frame; ``at_b_mm``: the same places in B's frame; ``rotation``: from B's frame
    to A's.
    """
    of_b = (normal_a * (along_ray(at_b_mm) @ rotation.T)).sum(-1)
    of_a = (normal_a * along_ray(at_a_mm)).sum(-1)
    return np.asarray(of_b[:, None] * shapes(at_b_mm, volume) - of_a[:, None] * shapes(at_a_mm, volume))


def depth_error_equations(
    J: Array, S_inverse: Array, B: Array, w: Array, r: Array, overdispersion: float
) -> DepthErrorEquations:
    """Return a pair's equations for the depth error, with its pose eliminated.

    ``J`` (n, 6) and ``B`` (n, k): derivatives of the residuals ``r`` (n,) by pose and coefficients; ``w``: weights.
    Rows of texture residuals have zeros in ``B``. ``overdispersion``: variance of sums of residuals over that of
    independent ones.
    """
    C = J.T @ (w[:, None] * B)
    response = -S_inverse @ C
    reduced = B + J @ response
    # At the solved pose J' w r = 0, so the residuals belong to the coefficients alone.
    return DepthErrorEquations(
        response, reduced.T @ (w[:, None] * reduced) / overdispersion, -reduced.T @ (w * r) / overdispersion
    )


def _share(flags: Bools) -> float:
    return float(flags.mean()) if len(flags) else 0.0


def _texture_correlation(correspondences: Correspondences) -> float | None:
    """Return the correlation of both scans' texture; ``None`` if it is no more than their noise."""
    finite = np.isfinite(correspondences.texture)
    if np.count_nonzero(finite) < FEWEST:
        return None
    p, q = (_clipped(values[finite]) for values in (correspondences.texture_a, correspondences.texture_b))
    noise2 = float(np.mean(correspondences.texture_noise[finite] ** 2)) + EXTRA_TEXTURE**2
    # Robust, so that shading left at a few edges of a bare object does not count as texture.
    if min(spread(p), spread(q)) ** 2 < max(2.0 * noise2, MIN_TEXTURE**2):
        return None
    return float((p * q).mean() / np.sqrt((p * p).mean() * (q * q).mean()))


def _clipped(values: Array) -> Array:
    """Return values about their median, clipped at three robust standard deviations."""
    limit = 3.0 * spread(values)
    return np.asarray(np.clip(values - np.median(values), -limit, limit))
