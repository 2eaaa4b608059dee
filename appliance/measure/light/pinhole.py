"""The lens in air: pixels to directions and back, with the distortion of OpenCV."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

MAX_ITERATIONS = 30
TOLERANCE = 1e-14


@dataclass(frozen=True, slots=True)
class Lens:
    """A pinhole with distortion. Normalised coordinates are x = X/Z, y = Y/Z in the camera frame."""

    f_px: tuple[float, float]
    """Principal distance (f_u, f_v) in px."""
    c_px: tuple[float, float]
    """Principal point (c_u, c_v) in px; (0, 0) is the centre of the top left pixel."""
    distortion: tuple[float, ...] = (0.0, 0.0, 0.0, 0.0, 0.0)
    """k1, k2, p1, p2, k3 as OpenCV defines them; foreign lenses may have its k4, k5, k6, s1, s2, s3, s4, too."""

    def to_pixels(self, xy: Array) -> Array:
        """Return the pixels (..., 2) of ideal normalised coordinates (..., 2)."""
        return np.asarray(distort(xy, self.distortion) * np.asarray(self.f_px) + np.asarray(self.c_px))

    def to_normalised(self, uv: Array) -> Array:
        """Return the ideal normalised coordinates (..., 2) of pixels (..., 2): inverts ``to_pixels`` to 1e-12."""
        return undistort((np.asarray(uv, np.float64) - np.asarray(self.c_px)) / np.asarray(self.f_px), self.distortion)

    def to_directions(self, uv: Array) -> Array:
        """Return unit directions in air (..., 3), camera frame, of pixels (..., 2)."""
        xy = self.to_normalised(uv)
        direction = np.concatenate([xy, np.ones_like(xy[..., :1])], axis=-1)
        return np.asarray(direction / np.linalg.norm(direction, axis=-1, keepdims=True))


class FoldingLens(Lens):
    """A foreign lens whose distortion may fold over within the image: pixels there have no direction, NaN."""

    __slots__ = ()

    def to_normalised(self, uv: Array) -> Array:
        """Return the same as ``Lens.to_normalised``; NaN if the distortion cannot be inverted before its fold."""
        xy_distorted = (np.asarray(uv, np.float64) - np.asarray(self.c_px)) / np.asarray(self.f_px)
        # Newton's method diverges there.
        with np.errstate(invalid="ignore", over="ignore"):
            xy = undistort(xy_distorted, self.distortion, strict=False)
            beyond = np.sum(xy * xy, axis=-1, keepdims=True) >= fold(self.distortion)
        return np.asarray(np.where(beyond, np.nan, xy))


def fold(distortion: tuple[float, ...]) -> float:
    """Return the squared radius at which the radial distortion turns back or has a pole; or infinity."""
    k1, k2, _, _, k3, k4, k5, k6 = (*distortion, 0.0, 0.0, 0.0)[:8]
    # Derivative of r A / B, polynomials in q = r²: (A B + 2 q (A' B - A B')) / B².
    A, B, q = np.poly1d([k3, k2, k1, 1.0]), np.poly1d([k6, k5, k4, 1.0]), np.poly1d([1.0, 0.0])
    roots = [*(A * B + 2.0 * q * (A.deriv() * B - A * B.deriv())).roots, *B.roots]
    real = [float(root.real) for root in roots if abs(root.imag) < 1e-9 and root.real > 0.0]
    return min(real, default=math.inf)


def distort(xy: Array, distortion: tuple[float, ...]) -> Array:
    """Return the distorted normalised coordinates (..., 2) of ideal ones (..., 2)."""
    _, _, p1, p2, _ = distortion[:5]
    x, y = np.asarray(xy, np.float64)[..., 0], np.asarray(xy, np.float64)[..., 1]
    r2 = x * x + y * y
    radial, _ = _radial(r2, distortion)
    u, v = (
        x * radial + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x),
        y * radial + p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y,
    )
    if len(distortion) > 5:
        s1, s2, s3, s4 = distortion[8:]
        u, v = u + r2 * (s1 + r2 * s2), v + r2 * (s3 + r2 * s4)
    return np.stack([u, v], axis=-1)


def _radial(r2: Array, distortion: tuple[float, ...]) -> tuple[Array, Array]:
    """Return the radial factor A / B and twice its derivative by r²."""
    k1, k2, _, _, k3 = distortion[:5]
    radial, slope = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3)), 2.0 * (k1 + r2 * (2.0 * k2 + 3.0 * r2 * k3))
    if len(distortion) == 5:
        return radial, slope
    k4, k5, k6 = distortion[5:8]
    below = 1.0 + r2 * (k4 + r2 * (k5 + r2 * k6))
    return radial / below, (slope - 2.0 * radial / below * (k4 + r2 * (2.0 * k5 + 3.0 * r2 * k6))) / below


def undistort(xy_distorted: Array, distortion: tuple[float, ...], *, strict: bool = True) -> Array:
    """Invert ``distort`` by Newton's method.

    If the lens folds over within the image: raises ValueError, or gives NaN unless ``strict``.
    """
    target = np.asarray(xy_distorted, np.float64)
    if not any(distortion):
        return target.copy()
    _, _, p1, p2, _ = distortion[:5]
    # Distortion moves a point by far less than the image's width: the distorted point is a good start.
    xy = target.copy()
    for _ in range(MAX_ITERATIONS):
        residual = distort(xy, distortion) - target
        if float(np.max(np.abs(residual), initial=0.0)) < TOLERANCE:
            return xy
        x, y = xy[..., 0], xy[..., 1]
        r2 = x * x + y * y
        radial, slope = _radial(r2, distortion)
        # Jacobian of ``distort``: xx, xy_, yy are ∂x_d/∂x, ∂x_d/∂y = ∂y_d/∂x, ∂y_d/∂y; thin prisms are negligible in
        # it.
        xx = radial + slope * x * x + 2.0 * p1 * y + 6.0 * p2 * x
        xy_ = slope * x * y + 2.0 * p1 * x + 2.0 * p2 * y
        yy = radial + slope * y * y + 6.0 * p1 * y + 2.0 * p2 * x
        det = xx * yy - xy_ * xy_
        with np.errstate(invalid="ignore", divide="ignore", over="ignore"):
            xy = xy - np.stack(
                [
                    (yy * residual[..., 0] - xy_ * residual[..., 1]) / det,
                    (xx * residual[..., 1] - xy_ * residual[..., 0]) / det,
                ],
                axis=-1,
            )
    # If Newton's method diverged, the error is NaN, which is no solution either.
    is_solution = np.abs(distort(xy, distortion) - target) <= 1e-9
    if not strict:
        return np.where(is_solution.all(axis=-1, keepdims=True), xy, np.nan)
    if not np.all(is_solution[np.isfinite(target)]):
        raise ValueError(
            f"lens distortion {distortion} cannot be inverted within the image; recalibrate the camera in air"
        )
    return xy
