"""Refracted epipolar curves: where the right camera sees the points along each ray of the left one.

Behind plane ports they are no lines. Along a ray both image coordinates are smooth functions of 1/z: polynomials of
degree 4 to 12 in s, which runs from −1 at the nearest to 1 at the farthest depth and is linear in 1/z. Polynomials and
rays are traced exactly at nodes about ``NODE_PX`` apart, and interpolated between them by cubics, whose error is far
below a ten thousandth of a pixel.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from appliance.measure.light.model import HousedCamera, StereoRig
from appliance.measure.light.pinhole import fold
from appliance.measure.light.port import air_directions

Array = NDArray[np.float64]

NODE_PX = 16.0
"""Greatest distance of two nodes in the left image."""
LEAST_NODES = 4
"""Least number of nodes across or down: a cubic needs four."""
DEPTHS, FIRST_DEPTHS = 25, 129
"""Number of depths at which each node's ray is projected into the right image. The second number is for some rays that
are projected first, to find the depths that the right camera sees."""
FIRST_NODES = 9
"""Number of these rays across and down."""
DEGREES = (4, 5, 6, 8, 10, 12)
"""Degrees of the polynomials, in the order of the trials."""
GOAL_PX, TOLERANCE_PX = 3e-4, 3e-3
"""Largest error of a polynomial, in px of the right image, at which a degree is accepted, and for the last degree: 0.1
and 1 µm in depth on the default rig. Refraction alone needs degree 6; a rough image correction has 0.001 px at degree
8."""
MARGIN = 0.25
"""Share of the right image's size by which a curve is continued beyond its edges, so that polynomials of neighbouring
rays cover the same piece."""
OUTSIDE = 1e-3
"""Weight of places beyond the image's edge in the fit, over those inside."""
RAY_TERMS = 4
"""Numbers of a node before its polynomials: x0, y0 in mm and sx, sy of the left ray (x, y) = (x0, y0) + (sx, sy)·z."""


class CurveError(ValueError):
    """The depths have no curves; the text says which depths have some."""


@dataclass(frozen=True, slots=True, eq=False)
class EpipolarCurves:
    """The curves of all pixels of a left image ``size_px`` (width, height)."""

    size_px: tuple[int, int]
    z_mm: tuple[float, float]
    """Nearest and farthest depth that the right camera sees of any ray, left camera frame."""
    degree: int
    nodes: Array
    """(rows, columns, 4 + 2·(degree + 1)) float64: x0, y0, sx, sy of the left ray, then the coefficients of u and those
    of v in px, the constant first. NaN where the right camera does not see the ray."""
    seen: Array
    """(rows, columns, 2) float64: least and greatest s at which the ray is in the right image or its margin."""
    error_px: float
    """Largest error of a polynomial."""

    @property
    def spacing_px(self) -> tuple[float, float]:
        """Distance of two nodes across and down."""
        rows, columns = self.nodes.shape[:2]
        return (self.size_px[0] - 1) / (columns - 1), (self.size_px[1] - 1) / (rows - 1)

    def depth_mm(self, s: Array) -> Array:
        """Return the depth at s, of any shape."""
        return _depths(s, self.z_mm)


def inverse_depths(z_mm: tuple[float, float]) -> tuple[float, float]:
    """Return a and b of 1/z = a + b s, per mm."""
    near, far = 1.0 / z_mm[0], 1.0 / z_mm[1]
    return 0.5 * (near + far), 0.5 * (far - near)


def epipolar_curves(rig: StereoRig, water_index: float, z_mm: tuple[float, float]) -> EpipolarCurves:
    """Trace the curves of ``rig`` between two depths of the left camera frame.

    Cameras in air are the same with ``lens_in_water``, or with ``water_index`` 1 and ports of index 1. Raises
    CurveError for depths that are no range, that lie behind the left port, that the right camera does not see, or along
    which curves bend more than polynomials can.
    """
    near_mm, far_mm = z_mm
    if not 0.0 < near_mm < far_mm < math.inf:
        raise CurveError(
            f"depths {near_mm:g} to {far_mm:g} mm are no range; give the nearest one first, both positive and finite"
        )
    left, right = rig.left, rig.right
    uv = _node_pixels(left)
    start, slope = _left_rays(left, water_index, uv, near_mm)
    # Depths that the right camera does not see would use up most of the polynomials' degrees of freedom.
    some = np.ix_(*(np.linspace(0, count - 1, min(count, FIRST_NODES)).astype(int) for count in uv.shape[:2]))
    s = np.linspace(-1.0, 1.0, FIRST_DEPTHS)
    _, visible = _seen(right, water_index, start[some], slope[some], _depths(s, z_mm))
    if not visible.any():
        raise CurveError(
            f"the right camera sees nothing between {near_mm:g} and {far_mm:g} mm of the left one; give other depths"
        )
    places = np.flatnonzero(visible.any(axis=(0, 1)))
    within = _depths(s[[max(places[0] - 1, 0), min(places[-1] + 1, FIRST_DEPTHS - 1)]], z_mm)
    z_mm = (float(within[0]), float(within[1]))
    # Chebyshev nodes, between which a polynomial has the least error.
    s = np.cos(np.pi * (np.arange(DEPTHS) + 0.5) / DEPTHS)[::-1]
    seen_uv, visible = _seen(right, water_index, start, slope, _depths(s, z_mm))
    coefficients, degree, error_px = _fit(s, seen_uv, visible, _in_image(right, seen_uv), z_mm)
    nodes = np.concatenate([start, slope, coefficients.reshape(*uv.shape[:2], -1)], axis=-1)
    seen_range = _range(s, visible & np.isfinite(coefficients[..., :1, 0]))
    return EpipolarCurves(
        (left.width_px, left.height_px), z_mm, degree, np.ascontiguousarray(nodes), seen_range, error_px
    )


def _depths(s: Array, z_mm: tuple[float, float]) -> Array:
    """Return the depths at s between two depths."""
    middle, half = inverse_depths(z_mm)
    return np.asarray(1.0 / (middle + half * s))


def _left_rays(camera: HousedCamera, water_index: float, uv_px: Array, near_mm: float) -> tuple[Array, Array]:
    """Return x0, y0 in mm and sx, sy (..., 2) each of the rays (x, y) = (x0, y0) + (sx, sy)·z of pixels.

    Raises CurveError.
    """
    origin, direction = camera.rays(uv_px, water_index)
    if float(np.nanmin(direction[..., 2])) < 1e-3 or float(np.nanmax(origin[..., 2])) >= near_mm:
        raise CurveError(
            f"not all rays of the left camera begin before {near_mm:g} mm; begin farther away, or check the calibration"
        )
    slope = direction[..., :2] / direction[..., 2:]
    return origin[..., :2] - slope * origin[..., 2:], slope


def _seen(
    camera: HousedCamera, water_index: float, start_mm: Array, slope: Array, z_mm: Array
) -> tuple[Array, NDArray[np.bool_]]:
    """Return the places (rows, columns, depths, 2) px of points in ``camera``, and which it sees.

    The points are on rays (rows, columns, 2).
    """
    flat = start_mm[..., None, :] + slope[..., None, :] * z_mm[:, None]
    points = np.concatenate([flat, np.broadcast_to(z_mm[:, None], (*flat.shape[:-1], 1))], axis=-1)
    uv = camera.project(points, water_index)
    return uv, _in_view(camera, water_index, points, uv)


def _node_pixels(camera: HousedCamera) -> Array:
    """Return the pixels (rows, columns, 2) of the nodes: from the first to the last pixel in equal steps."""
    columns, rows = (
        max(LEAST_NODES, math.ceil((size - 1) / NODE_PX) + 1) for size in (camera.width_px, camera.height_px)
    )
    v, u = np.meshgrid(
        np.linspace(0.0, camera.height_px - 1.0, rows), np.linspace(0.0, camera.width_px - 1.0, columns), indexing="ij"
    )
    return np.stack([u, v], axis=-1)


def _in_view(camera: HousedCamera, water_index: float, points_mm: Array, uv_px: Array) -> NDArray[np.bool_]:
    """Return which points (..., depths, 3) at ``uv_px`` lie in the image or its margin, one piece per ray.

    A strong distortion folds points far outside of the field back into the image; these are not seen there.
    """
    inside = _in_image(camera, uv_px, MARGIN)
    with np.errstate(invalid="ignore"):
        local = (points_mm - np.asarray(camera.translation_mm)) @ np.asarray(camera.rotation)
        air = local if camera.lens_in_water else air_directions(camera.port, water_index, local)
        ahead = air[..., 2] > 0.0
        r2 = np.sum(air[..., :2] ** 2, axis=-1) / np.where(ahead, air[..., 2], 1.0) ** 2
        visible = inside & ahead & (r2 < fold(camera.lens.distortion))
    # Only the longest piece, to which the polynomial is fitted.
    best = np.zeros(visible.shape, np.bool_)
    length, longest = np.zeros(visible.shape[:-1], int), np.zeros(visible.shape[:-1], int)
    end = np.zeros(visible.shape[:-1], int)
    for k in range(visible.shape[-1]):
        length = np.where(visible[..., k], length + 1, 0)
        end = np.where(length > longest, k, end)
        longest = np.maximum(longest, length)
    place = np.arange(visible.shape[-1])
    best = (place <= end[..., None]) & (place > (end - longest)[..., None])
    return np.asarray(best)


def _in_image(camera: HousedCamera, uv_px: Array, margin: float = 0.0) -> NDArray[np.bool_]:
    """Return which places (..., 2) lie in the image, or beyond it by at most ``margin`` of its size."""
    size = np.array([camera.width_px, camera.height_px], float)
    with np.errstate(invalid="ignore"):
        return np.asarray(np.all((uv_px >= -0.5 - margin * size) & (uv_px <= (1.0 + margin) * size - 0.5), axis=-1))


def _fit(
    s: Array, uv_px: Array, visible: NDArray[np.bool_], inside: NDArray[np.bool_], z_mm: tuple[float, float]
) -> tuple[Array, int, float]:
    """Return coefficients (rows, columns, 2, degree + 1) in px, their degree and their largest error.

    The error is that within the image. NaN where no depth is visible.
    """
    count = visible.sum(axis=-1)
    target = np.where(visible[..., None], uv_px, 0.0)
    # Beyond the edge an image correction is constant: a bend there that the curve in the image need not have.
    weight = np.where(inside, 1.0, OUTSIDE) * visible
    for degree in DEGREES:
        enough = count >= degree + 2
        basis = np.polynomial.chebyshev.chebvander(s, degree)
        # Normal equations with the known depths only; a tiny weight on all coefficients keeps short pieces solvable.
        weighted = weight[..., None] * basis
        matrix = weighted.swapaxes(-1, -2) @ basis + 1e-13 * np.eye(degree + 1)
        chebyshev = np.linalg.solve(matrix, weighted.swapaxes(-1, -2) @ target)
        residual = np.where((visible & inside & enough[..., None])[..., None], basis @ chebyshev - target, 0.0)
        error_px = float(np.max(np.abs(residual), initial=0.0))
        if error_px <= (GOAL_PX if degree < DEGREES[-1] else TOLERANCE_PX):
            # From Chebyshev polynomials to powers: the same curve.
            to_powers = np.linalg.lstsq(np.vander(s, degree + 1, increasing=True), basis, rcond=None)[0]
            coefficients = np.where(enough[..., None, None], to_powers @ chebyshev, np.nan)
            return np.asarray(np.swapaxes(coefficients, -1, -2)), degree, error_px
    raise CurveError(
        f"between {z_mm[0]:g} and {z_mm[1]:g} mm the curves differ by {error_px:.2g} px from polynomials of degree "
        f"{DEGREES[-1]}; "
        "give a narrower range of depths"
    )


def _range(s: Array, visible: NDArray[np.bool_]) -> Array:
    """Return least and greatest s of each node's visible depths, up to −1 and 1 if the end is visible."""
    low = np.where(visible, s, np.inf).min(axis=-1)
    high = np.where(visible, s, -np.inf).max(axis=-1)
    low, high = np.where(visible[..., 0], -1.0, low), np.where(visible[..., -1], 1.0, high)
    return np.stack([low, high], axis=-1)
