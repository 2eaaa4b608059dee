"""The equations of one step of fine registration, and the covariance of the pose that solves them.

Each patch of B that lies on A gives two residuals: its distance from A's plane, and the difference of texture. Their
stiffness, a 6 × 6 matrix, is the resistance to a displacement. Noise in normals and gradients would add stiffness
where there is none: a bare pipe would seem to be fixed along its axis. So each product of the matrix takes one factor
from A and one from B, whose noise is independent. Along a free direction the product is zero in the mean, with a known
standard deviation. This is an estimate with instrumental variables (Durbin 1954).

Correspondences   patches of B with their counterparts on A
System            the equations of one round
Resistance        stiffness, its significance and the covariance of the pose
system_of         the equations of correspondences
spread            a robust standard deviation

Symbols: R, t  rotation and translation that map B's points into A's frame;  x  a patch of B in A's frame
         δ = (ω, τ)  a small rotation (as mm at the lever's end) about the overlap's middle, and a translation, mm
         J, Z  derivatives (n, 6) of the residuals by δ with A's normals and gradients, and with B's
         S  stiffness, 1/mm²;  r residuals;  w weights 1/variance, less for outliers
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from appliance.measure.light.rotation import rotation_matrix
from appliance.measure.overlap.patches import Array, Bools
from appliance.measure.overlap.rigid import Rigid

FEWEST = 120
"""Fewest corresponding patches."""
NEIGHBOURS_ALIKE = 2.0
"""Standard deviation of a stiffness of noise, over that for independent patches: target planes are means of four."""
EXTRA_MM = 0.006
"""Standard deviation added to each distance between two scans: calibration errors vary so much over the image."""
EXTRA_TEXTURE = 0.01
"""Standard deviation added to each difference of texture: shading is regressed away to a hundredth at best."""


@dataclass(frozen=True, slots=True, eq=False)
class Correspondences:
    """Patches of B with their counterparts on A, in A's frame: n that correspond, of m that were tested."""

    x_mm: Array
    source: NDArray[np.int64]
    """(n,): flat index of the patch in B."""
    tile: NDArray[np.int64]
    """(n,): label of the tile in which the patch lies. Residuals of one tile are taken as correlated."""
    distance_mm: Array
    """(n,): distance from A's surface along its normal."""
    normal_a: Array
    normal_b: Array
    sigma_mm: Array
    """Standard deviation of ``distance_mm`` by both scans' noise."""
    texture: Array
    """(n,): A's texture less B's; NaN where either is unknown."""
    gradient_a: Array
    gradient_b: Array
    texture_noise: Array
    texture_a: Array
    texture_b: Array
    missing: Bools
    """(m,): A's camera should see the patch, but A has no surface there."""
    front: Bools
    """(m,): the patch lies clearly in front of A's surface, where A's camera would have seen it."""
    tested: int


@dataclass(frozen=True, slots=True, eq=False)
class Resistance:
    """The resistance of a solved pose to a displacement, and the covariance of that pose."""

    stiffness: Array
    """(6, 6): S, 1/mm²."""
    inverse: Array
    """(6, 6): inverse of S, with a least eigenvalue for free directions."""
    meat: Array
    """(6, 6): covariance of the right-hand side, from the sums over tiles."""
    significance: Array
    """(6,): each eigenvalue of S over the standard deviation that noise alone would give it."""
    directions: Array
    """(6, 6): columns are the eigenvectors of S, softest first."""
    texture_share: float
    """Share of the softest direction's stiffness that is due to texture."""

    @property
    def covariance(self) -> Array:
        """Covariance (6, 6) of δ, mm²: the sandwich estimate with correlated tiles (H. White 1980)."""
        return np.asarray(self.inverse @ self.meat @ self.inverse)


@dataclass(frozen=True, slots=True, eq=False)
class System:
    """The equations of one round."""

    J: Array
    Z: Array
    r: Array
    w: Array
    cluster: NDArray[np.int64]
    of_texture: Bools
    middle: Array
    lever: float
    scatter_mm: float
    """Robust standard deviation of the distances."""

    @classmethod
    def of_planes(
        cls, x_mm: Array, distance_mm: Array, normals: tuple[Array, Array], sigma_mm: Array, tile: NDArray[np.int64]
    ) -> System:
        """Return the equations of n places by their distances along A's normals; ``normals``: A's and B's."""
        middle = x_mm.mean(axis=0)
        lever = max(float(np.sqrt(((x_mm - middle) ** 2).sum(axis=1).mean())), 1.0)
        J, Z = (_rows(x_mm - middle, lever, normal) for normal in normals)
        scatter = spread(distance_mm)
        variance = sigma_mm**2 + EXTRA_MM**2
        # Scatter beyond the expected noise is added to the variance of all distances.
        excess = max(scatter**2 - float(np.median(variance)), 0.0)
        w = _weights(distance_mm, variance + excess)
        return cls(J, Z, distance_mm, w, tile, np.zeros(len(distance_mm), bool), middle, lever, scatter)

    def step(self) -> Array:
        """Return the displacement δ (6,) that minimises the residuals; about zero along free directions."""
        plain = self.J.T @ (self.w[:, None] * self.J)
        mixed = self.Z.T @ (self.w[:, None] * self.J)
        rhs = 0.5 * (self.J + self.Z).T @ (self.w * self.r)
        value, vector = np.linalg.eigh(0.5 * (mixed + mixed.T))
        # A least stiffness keeps the step along free directions small.
        value = np.maximum(value, 1e-4 * np.trace(plain) / 6.0)
        step = -vector @ ((vector.T @ rhs) / value)
        size = float(np.linalg.norm(step))
        return np.asarray(step * min(1.0, 8.0 / size) if size > 0 else step)

    def moved(self, pose: Rigid, step: Array) -> Rigid:
        """Return ``pose`` displaced by ``step``, δ (6,)."""
        rotation = rotation_matrix(step[:3] / self.lever)
        return Rigid(rotation @ pose.rotation, rotation @ (pose.translation_mm - self.middle) + self.middle + step[3:])

    def resistance(self) -> Resistance:
        """Return the resistance to a displacement; the equations must be those at their solution."""
        labels, number = np.unique(self.cluster, return_inverse=True)
        mixed = self.Z.T @ (self.w[:, None] * self.J)
        S = 0.5 * (mixed + mixed.T)
        value, vector = np.linalg.eigh(S)
        # Without any stiffness each product is noise times noise; the difference of both factors shows how large.
        noise = 0.5 * ((self.Z - self.J) @ vector) ** 2
        deviation = NEIGHBOURS_ALIKE * np.sqrt(((self.w[:, None] * noise) ** 2).sum(axis=0))
        score = np.zeros((len(labels), 6))
        np.add.at(score, number, 0.5 * (self.J + self.Z) * (self.w * self.r)[:, None])
        count = len(labels)
        meat = score.T @ score * (count / max(count - 6.0, 1.0))
        floor = 1e-9 * max(value[-1], 1.0)
        inverse = vector @ np.diag(1.0 / np.maximum(value, floor)) @ vector.T
        soft, texture = vector[:, 0], self.of_texture
        by_texture = float(((self.Z[texture] @ soft) * (self.J[texture] @ soft) * self.w[texture]).sum())
        with np.errstate(divide="ignore"):
            significance = value / deviation
        return Resistance(S, inverse, meat, significance, vector, by_texture / value[0] if value[0] > 0 else 0.0)


def system_of(correspondences: Correspondences, with_texture: bool) -> System:
    """Return the equations of ``correspondences``; ``with_texture`` adds texture residuals."""
    of_planes = System.of_planes(
        correspondences.x_mm,
        correspondences.distance_mm,
        (correspondences.normal_a, correspondences.normal_b),
        correspondences.sigma_mm,
        correspondences.tile,
    )
    has_texture = np.isfinite(correspondences.texture)
    if not with_texture or np.count_nonzero(has_texture) < FEWEST:
        return of_planes
    p = correspondences.texture[has_texture]
    p = p - np.median(p)
    noise2 = correspondences.texture_noise[has_texture] ** 2 + EXTRA_TEXTURE**2
    excess = max(spread(p) ** 2 - float(np.median(noise2)), 0.0)
    arm, lever = correspondences.x_mm - of_planes.middle, of_planes.lever
    return replace(
        of_planes,
        J=np.concatenate([of_planes.J, _rows(arm, lever, correspondences.gradient_a)[has_texture]]),
        Z=np.concatenate([of_planes.Z, _rows(arm, lever, correspondences.gradient_b)[has_texture]]),
        r=np.concatenate([of_planes.r, p]),
        w=np.concatenate([of_planes.w, _weights(p, noise2 + excess)]),
        cluster=np.concatenate([correspondences.tile, correspondences.tile[has_texture]]),
        of_texture=np.concatenate([of_planes.of_texture, np.ones(len(p), bool)]),
    )


def _rows(arm: Array, lever: float, direction: Array) -> Array:
    return np.concatenate([np.cross(arm, direction) / lever, direction], axis=1)


def spread(values: Array) -> float:
    """Return a robust standard deviation: 1.4826 times the median distance from the median; 0 if empty."""
    return 1.4826 * float(np.median(np.abs(values - np.median(values)))) if len(values) else 0.0


def _weights(r: Array, variance: Array) -> Array:
    """Return 1/variance, less for outliers (Cauchy weights at three standard deviations)."""
    return np.asarray(1.0 / variance / (1.0 + r * r / (9.0 * variance)))
