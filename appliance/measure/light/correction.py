"""The image correction: displacements of pixels by lens and port beyond the camera model.

It is a uniform bicubic B-spline s over the image. Pixel (u, v) sees what the ideal pixel (u, v) − s(u, v) would see.
The displacements are at most some tenths of a pixel and change slowly, so that they are inverted by repeated
substitution.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

CORRECTION_INTERVALS = (6, 5)
"""Intervals across and down the image: the coarsest that fit lenses beyond five distortion coefficients."""
SUBSTITUTIONS = 12
TOLERANCE_PX = 1e-11


@dataclass(frozen=True, slots=True)
class ImageCorrection:
    """Displacements of pixels as a bicubic B-spline, in px.

    ``coefficients_px`` holds (s_u, s_v) per node, row by row: (down+3)·(across+3)·2. Raises ValueError for another
    number.
    """

    width_px: int
    height_px: int
    intervals: tuple[int, int]
    """Intervals across, down."""
    coefficients_px: tuple[float, ...]

    def __post_init__(self) -> None:
        count = 2 * node_count(self.intervals)
        if len(self.coefficients_px) != count:
            raise ValueError(
                f"image correction with {len(self.coefficients_px)} coefficients; {self.intervals[0]} × "
                f"{self.intervals[1]} intervals need {count}; calibrate again"
            )

    def shift_px(self, uv_px: Array) -> Array:
        """Return the displacement s in px at pixels (..., 2); beyond the image it is that of the edge."""
        return surface(uv_px, (self.width_px, self.height_px), self.intervals, self.coefficients_px)

    def to_ideal(self, uv_px: Array) -> Array:
        """Return the ideal pixels (..., 2) of real ones (..., 2)."""
        return np.asarray(np.asarray(uv_px, np.float64) - self.shift_px(uv_px))

    def to_real(self, ideal_px: Array) -> Array:
        """Return the real pixels (..., 2) of ideal ones (..., 2): the inverse of ``to_ideal``; NaN stays NaN."""
        ideal = np.asarray(ideal_px, np.float64)
        finite = np.isfinite(ideal).all(axis=-1, keepdims=True)
        start = np.where(finite, ideal, 0.0)
        real = start
        # real = ideal + s(real), by substitution: s changes by far less than a pixel per pixel.
        for _ in range(SUBSTITUTIONS):
            step = start + self.shift_px(real) - real
            real = real + step
            if float(np.max(np.abs(step), initial=0.0)) < TOLERANCE_PX:
                break
        return np.where(finite, real, np.nan)


def surface(
    uv_px: Array, size_px: tuple[int, int], intervals: tuple[int, int], coefficients: tuple[float, ...]
) -> Array:
    """Return a two-component B-spline surface (..., 2) at pixels (..., 2).

    ``coefficients`` hold both components per node, row by row.
    """
    uv = np.asarray(uv_px, np.float64)
    columns, rows = intervals
    iu, wu = basis(uv[..., 0], size_px[0], columns)
    iv, wv = basis(uv[..., 1], size_px[1], rows)
    nodes = np.reshape(coefficients, (rows + 3, columns + 3, 2))
    value = np.zeros_like(uv)
    for j in range(4):
        for i in range(4):
            value += (wv[..., j] * wu[..., i])[..., None] * nodes[iv + j, iu + i]
    return value


def node_count(intervals: tuple[int, int]) -> int:
    """Return the number of nodes of a bicubic B-spline with ``intervals`` (across, down)."""
    return (intervals[0] + 3) * (intervals[1] + 3)


def basis(at_px: Array, size_px: int, intervals: int) -> tuple[NDArray[np.intp], Array]:
    """Return the first node (...,) and the four cubic B-spline weights (..., 4) at coordinates (...,)."""
    # Clipped: beyond the edge the value is that of the edge.
    t = np.clip((np.asarray(at_px, np.float64) + 0.5) / size_px, 0.0, 1.0) * intervals
    # The last edge belongs to the last interval.
    first = np.minimum(t.astype(np.intp), intervals - 1)
    f = t - first
    weights = np.stack(
        [
            (1.0 - f) ** 3,
            3.0 * f**3 - 6.0 * f**2 + 4.0,
            -3.0 * f**3 + 3.0 * f**2 + 3.0 * f + 1.0,
            f**3,
        ],
        axis=-1,
    )
    return first, weights / 6.0


@dataclass(frozen=True, slots=True)
class SplineGrid:
    """The nodes of a bicubic B-spline over an image, numbered row by row."""

    size_px: tuple[int, int]
    """Width and height of the image."""
    intervals: tuple[int, int] = CORRECTION_INTERVALS
    """Intervals across, down."""

    @property
    def count(self) -> int:
        """Number of nodes."""
        return node_count(self.intervals)

    def entries(self, uv_px: Array) -> tuple[NDArray[np.intp], Array]:
        """Return the sixteen nodes (n, 16) that influence pixels (n, 2), and their weights (n, 16)."""
        columns, rows = self.intervals
        iu, wu = basis(uv_px[:, 0], self.size_px[0], columns)
        iv, wv = basis(uv_px[:, 1], self.size_px[1], rows)
        across, down = np.arange(4), np.arange(4)[:, None] * (columns + 3)
        nodes = (iv * (columns + 3) + iu)[:, None, None] + down + across
        weights = wv[:, :, None] * wu[:, None, :]
        return nodes.reshape(-1, 16), weights.reshape(-1, 16)

    def matrix(self, uv_px: Array) -> Array:
        """Return the weights (n, nodes) of all nodes at pixels (n, 2)."""
        nodes, weights = self.entries(uv_px)
        matrix = np.zeros((len(uv_px), self.count))
        np.put_along_axis(matrix, nodes, weights, axis=1)
        return matrix

    def correction(self, nodes_px: NDArray[np.floating]) -> ImageCorrection:
        """Return the image correction with nodes (n, 2), in px."""
        return ImageCorrection(*self.size_px, self.intervals, tuple(nodes_px.ravel().tolist()))
