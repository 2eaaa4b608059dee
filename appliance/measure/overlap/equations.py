"""Owns the equations of laying one surface upon another: what resists a displacement, the step that they ask for, and
what is known after it.

Each patch of B that lies on A gives two residuals: its distance from A's plane, and the difference of paint. What
resists a displacement is their stiffness, a 6 × 6 matrix. Noise in normals and gradients would add stiffness of its own
where there is none: a bare pipe would seem to be held along its axis, with a residual as good as everywhere. So each
product of the matrix takes one factor from A and one from B, whose noise is independent: along a direction that nothing
holds it is zero in the mean, and how far it scatters is known. An estimate with such products is that of instrumental
variables (Durbin 1954).

Symbols: R, t  rotation and translation that map B's points into A's frame;  x  a patch of B in A's frame
         δ = (ω, τ)  a small turn (as mm at the lever's end) about the overlap's middle, and a shift, mm
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
"""Fewest patches in common."""
NEIGHBOURS_ALIKE = 2.0
"""Standard deviation of a stiffness of noise, over that for independent patches: target planes are means of four."""
EXTRA_MM = 0.006
"""Least standard deviation of a distance between two scans: what calibrations leave between places of the image."""
EXTRA_PAINT = 0.01
"""The same of paint: light is not regressed away to better than a hundredth."""


@dataclass(frozen=True, slots=True, eq=False)
class Laid:
    """Patches of B laid upon A: n of them that meet a patch of A, in A's frame."""

    x_mm: Array
    source: NDArray[np.int64]
    """(n,): which of B's patches; of patches on a grid its flat index."""
    tile: NDArray[np.int64]
    """(n,): label of the tile that the patch lies in. Residuals of one tile are taken to err together."""
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
class Resistance:
    """The resistance to a displacement of the pose found, and how certain that pose is."""

    stiffness: Array
    """(6, 6): S, 1/mm²."""
    inverse: Array
    """(6, 6): of S, with a floor for what nothing holds."""
    meat: Array
    """(6, 6): covariance of the right-hand side, from the sums over tiles."""
    held: Array
    """(6,): each eigenvalue of S over the standard deviation that noise alone would give it."""
    directions: Array
    """(6, 6): columns are the eigenvectors of S, softest first."""
    paint_share: float
    """Share of the softest direction's stiffness that is paint's."""

    @property
    def covariance(self) -> Array:
        """(6, 6) of δ, mm², robust: residuals of a tile may err together (the sandwich estimate, H. White 1980)."""
        return np.asarray(self.inverse @ self.meat @ self.inverse)


@dataclass(frozen=True, slots=True, eq=False)
class System:
    """The equations of one round."""

    J: Array
    Z: Array
    r: Array
    w: Array
    cluster: NDArray[np.int64]
    of_paint: Bools
    middle: Array
    lever: float
    scatter_mm: float
    """Standard deviation of most of the distances."""

    @classmethod
    def of_planes(
        cls, x_mm: Array, apart_mm: Array, normals: tuple[Array, Array], sigma_mm: Array, tile: NDArray[np.int64]
    ) -> System:
        """Return the equations of n places by their distances along A's normal alone; ``normals`` (n, 3): A's and B's."""
        middle = x_mm.mean(axis=0)
        lever = max(float(np.sqrt(((x_mm - middle) ** 2).sum(axis=1).mean())), 1.0)
        J, Z = (_rows(x_mm - middle, lever, normal) for normal in normals)
        scatter = spread(apart_mm)
        variance = sigma_mm**2 + EXTRA_MM**2
        # Where distances scatter more than noise explains, all of them are believed less.
        excess = max(scatter**2 - float(np.median(variance)), 0.0)
        w = _weights(apart_mm, variance + excess)
        return cls(J, Z, apart_mm, w, tile, np.zeros(len(apart_mm), bool), middle, lever, scatter)

    def step(self) -> Array:
        """Return the displacement δ (6,) that makes the residuals least; none along what nothing holds."""
        plain = self.J.T @ (self.w[:, None] * self.J)
        mixed = self.Z.T @ (self.w[:, None] * self.J)
        rhs = 0.5 * (self.J + self.Z).T @ (self.w * self.r)
        value, vector = np.linalg.eigh(0.5 * (mixed + mixed.T))
        # Along what nothing holds, no step is taken: a thousandth of the mean stiffness stands in.
        value = np.maximum(value, 1e-4 * np.trace(plain) / 6.0)
        step = -vector @ ((vector.T @ rhs) / value)
        size = float(np.linalg.norm(step))
        return np.asarray(step * min(1.0, 8.0 / size) if size > 0 else step)

    def moved(self, pose: Rigid, step: Array) -> Rigid:
        """Return ``pose`` displaced by δ (6,)."""
        turn = rotation_matrix(step[:3] / self.lever)
        return Rigid(turn @ pose.rotation, turn @ (pose.translation_mm - self.middle) + self.middle + step[3:])

    def resistance(self) -> Resistance:
        """Return what resists a displacement, of equations at the pose that solves them."""
        labels, number = np.unique(self.cluster, return_inverse=True)
        mixed = self.Z.T @ (self.w[:, None] * self.J)
        S = 0.5 * (mixed + mixed.T)
        value, vector = np.linalg.eigh(S)
        # Under the hypothesis of no stiffness each product is noise times noise; how large that is, the difference of
        # both factors tells.
        noise = 0.5 * ((self.Z - self.J) @ vector) ** 2
        deviation = NEIGHBOURS_ALIKE * np.sqrt(((self.w[:, None] * noise) ** 2).sum(axis=0))
        score = np.zeros((len(labels), 6))
        np.add.at(score, number, 0.5 * (self.J + self.Z) * (self.w * self.r)[:, None])
        count = len(labels)
        meat = score.T @ score * (count / max(count - 6.0, 1.0))
        floor = 1e-9 * max(value[-1], 1.0)
        inverse = vector @ np.diag(1.0 / np.maximum(value, floor)) @ vector.T
        soft, paint = vector[:, 0], self.of_paint
        by_paint = float(((self.Z[paint] @ soft) * (self.J[paint] @ soft) * self.w[paint]).sum())
        with np.errstate(divide="ignore"):
            held = value / deviation
        return Resistance(S, inverse, meat, held, vector, by_paint / value[0] if value[0] > 0 else 0.0)


def system_of(laid: Laid, with_paint: bool) -> System:
    """Return the equations of patches as they lie; ``with_paint``: paint's beside those of the planes."""
    of_planes = System.of_planes(laid.x_mm, laid.apart_mm, (laid.normal_a, laid.normal_b), laid.sigma_mm, laid.tile)
    known = np.isfinite(laid.paint)
    if not with_paint or np.count_nonzero(known) < FEWEST:
        return of_planes
    p = laid.paint[known]
    p = p - np.median(p)
    noise2 = laid.paint_noise[known] ** 2 + EXTRA_PAINT**2
    more = max(spread(p) ** 2 - float(np.median(noise2)), 0.0)
    arm, lever = laid.x_mm - of_planes.middle, of_planes.lever
    return replace(
        of_planes,
        J=np.concatenate([of_planes.J, _rows(arm, lever, laid.gradient_a)[known]]),
        Z=np.concatenate([of_planes.Z, _rows(arm, lever, laid.gradient_b)[known]]),
        r=np.concatenate([of_planes.r, p]),
        w=np.concatenate([of_planes.w, _weights(p, noise2 + more)]),
        cluster=np.concatenate([laid.tile, laid.tile[known]]),
        of_paint=np.concatenate([of_planes.of_paint, np.ones(len(p), bool)]),
    )


def _rows(arm: Array, lever: float, direction: Array) -> Array:
    return np.concatenate([np.cross(arm, direction) / lever, direction], axis=1)


def spread(values: Array) -> float:
    """Return the standard deviation of most of the values (1.4826 times the median distance from their median); 0 for
    none."""
    return 1.4826 * float(np.median(np.abs(values - np.median(values)))) if len(values) else 0.0


def _weights(r: Array, variance: Array) -> Array:
    """Return 1/variance, falling for outliers (Cauchy at three standard deviations)."""
    return np.asarray(1.0 / variance / (1.0 + r * r / (9.0 * variance)))
