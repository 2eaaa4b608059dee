"""The displacement of the albedo in each Gray image against the bright frame, one vector for an image.

Where a Gray image is illuminated, it shows the same as the bright frame, some frames later. Least squares of their
difference on the bright frame's gradients give the displacement in between. There is only one vector for an image, but
one for each frame, so that shaking can be detected.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numba
import numpy as np
from numpy.typing import NDArray

from appliance.measure.decode.decoder import CameraDecoder
from appliance.measure.light.patterns import Direction, PatternSequence

BESIDE_PX = 8.0
"""Least distance from an edge of the stripes, pattern px; nearer, the image is neither bright nor dark."""
SAMPLES = 12_000
"""Approximate number of pixels of a camera that are used."""
WIDTH_PX = 400
"""Gradients are taken over two px of an image of this width."""
# Symbols of the kernel. x = (light, 1, ∂bright/∂u, ∂bright/∂v) are the terms of the fit of the Gray image less the dark
# one, y: y = a · light + b − shift · gradient. sums holds the upper triangle of x xᵀ, then x y, y², the count, and the
# variance of a gradient by noise alone.

_TERMS = 4
MIN_PIXELS = 300
MIN_CONTRAST = 2.0
"""Least square of the gradients over that of their noise, in the direction with the smaller gradients."""

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class AlbedoShifts:
    """Displacements of the albedo in one camera's images, in its px."""

    shift_px: Array
    """(frames of the sequence, 2): right and down, against the bright frame; NaN: unknown."""
    sd_px: Array
    """(frames,): standard deviation of each component."""

    def mean_way2(self, frames: int) -> float | None:
        """Return the mean square displacement of the albedo over ``frames``, px², less that of noise.

        ``None``: unknown.
        """
        apart = self.shift_px[frames:] - self.shift_px[:-frames]
        is_known = np.isfinite(apart).all(-1)
        if not is_known.any():
            return None
        noise = 2.0 * (self.sd_px[frames:] ** 2 + self.sd_px[:-frames] ** 2)
        return max(float(np.mean((np.sum(apart**2, -1) - noise)[is_known])), 0.0)


@numba.njit(nogil=True, cache=True, error_model="numpy")
def _accumulate(
    frames: NDArray[np.uint8],
    references: tuple[int, int],
    gray: NDArray[np.int64],
    coordinate_px: NDArray[np.float32],
    illuminated: NDArray[np.bool_],
    reach: int,
    stride: int,
    noise_dn2: tuple[float, float],
    sums: Array,
) -> None:
    """Add every ``stride``-th row and column to ``sums`` (images, …).

    For each of the images ``gray`` they hold the upper triangle of the normal matrix of light, 1 and both gradients,
    their products with the image, its square, and the count. ``references``: bright and dark; ``illuminated`` (images,
    pattern px). All images at once, since the dozen values that they share are far apart in memory and are read only
    once so.
    """
    bright, dark = frames[references[0]], frames[references[1]]
    height, width = bright.shape
    x = np.empty(_TERMS)
    for v in range(reach + stride // 2, height - reach, stride):
        for u in range(reach + stride // 2, width - reach, stride):
            place = coordinate_px[v, u]
            if not (place >= 0.0 and place < illuminated.shape[1] - 1):
                continue
            white, black = np.float64(bright[v, u]), np.float64(dark[v, u])
            light = white - black
            if light < 16.0 or bright[v, u] == 255:
                continue
            # Not beside an occluding contour, which is no albedo.
            if not (
                coordinate_px[v, u - reach] >= 0.0
                and coordinate_px[v, u + reach] >= 0.0
                and coordinate_px[v - reach, u] >= 0.0
                and coordinate_px[v + reach, u] >= 0.0
            ):
                continue
            # y = a · light + b − shift · gradient: the terms x of the least squares.
            x[0], x[1] = light, 1.0
            # Central differences over twice the reach; their noise is that of two pixels over its square.
            x[2] = (np.float64(bright[v, u + reach]) - np.float64(bright[v, u - reach])) / (2.0 * reach)
            x[3] = (np.float64(bright[v + reach, u]) - np.float64(bright[v - reach, u])) / (2.0 * reach)
            # Only images whose stripes illuminate the place.
            for image in range(gray.size):
                if not illuminated[image, int(place)]:
                    continue
                y = np.float64(frames[gray[image], v, u]) - black
                # Normal equations: upper triangle of Σ x xᵀ, then Σ x y, Σ y² and the count.
                s, k = sums[image], 0
                for i in range(_TERMS):
                    for j in range(i, _TERMS):
                        s[k] += x[i] * x[j]
                        k += 1
                for i in range(_TERMS):
                    s[k + i] += x[i] * y
                s[k + _TERMS] += y * y
                s[k + _TERMS + 1] += 1.0
                # A gradient's variance by noise: 2 σ² / (2 reach)².
                s[k + _TERMS + 2] += (noise_dn2[0] + noise_dn2[1] * white) / (2.0 * reach * reach)


def albedo_shifts(
    frames: NDArray[np.uint8], decoded: CameraDecoder, sequence: PatternSequence, variance_dn2: tuple[float, float]
) -> AlbedoShifts:
    """Measure the displacements of the albedo in one camera's frames (n, h, w) uint8.

    ``variance_dn2``: variance of the camera's noise at grey value 0 and per grey value.
    """
    shift, sd = np.full((len(sequence), 2), np.nan), np.full(len(sequence), np.nan)
    height_px, width_px = decoded.p_px.shape
    reach = max(1, round(width_px / WIDTH_PX))
    stride = max(1, round((height_px * width_px / SAMPLES) ** 0.5))
    for direction, coordinate_px in ((Direction.X, decoded.p_px), (Direction.Y, decoded.q_px)):
        gray = sequence.axis(direction).gray
        sums = np.zeros((len(gray), _TERMS * (_TERMS + 1) // 2 + _TERMS + 3))
        _accumulate(
            frames,
            (sequence.bright, sequence.dark),
            np.array(gray, np.int64),
            coordinate_px,
            well_illuminated(sequence, direction),
            reach,
            stride,
            variance_dn2,
            sums,
        )
        shift[list(gray)], sd[list(gray)] = _solve(sums)
    return AlbedoShifts(shift, sd)


@lru_cache(maxsize=8)
def well_illuminated(sequence: PatternSequence, direction: Direction) -> NDArray[np.bool_]:
    """Return where each Gray image of a direction is bright and far from all edges of its stripes.

    (images, pattern px). It is the same in every scan. Do not write to it.
    """
    return np.stack([_well_illuminated(sequence.patterns[k].codes()) for k in sequence.axis(direction).gray])


def _well_illuminated(codes: NDArray[np.uint8]) -> NDArray[np.bool_]:
    """Return where the pattern is bright and far from all edges of the stripes, (pattern px,)."""
    illuminated = codes.astype(np.bool_)
    edges = np.flatnonzero(np.diff(illuminated.astype(np.int8))) + 0.5
    if not edges.size:
        return illuminated
    columns = np.arange(codes.size, dtype=np.float64)
    after = np.searchsorted(edges, columns)
    beside = np.minimum(
        np.abs(columns - edges[np.maximum(after - 1, 0)]), np.abs(columns - edges[np.minimum(after, edges.size - 1)])
    )
    return np.asarray(illuminated & (beside > BESIDE_PX))


def _solve(sums: Array) -> tuple[Array, Array]:
    """Return the displacement (images, 2) of the albedo, and its standard deviation (images,).

    NaN: unknown.
    """
    shift, sd = np.full((len(sums), 2), np.nan), np.full(len(sums), np.nan)
    products = _TERMS * (_TERMS + 1) // 2
    count = sums[:, products + _TERMS + 1]
    normal = np.zeros((len(sums), _TERMS, _TERMS))
    row, column = np.triu_indices(_TERMS)
    normal[:, row, column] = normal[:, column, row] = sums[:, :products]
    # Sum of the squared gradients by noise.
    noise_gradients2 = sums[:, products + _TERMS + 2]
    gradients = np.linalg.eigvalsh(normal[:, 2:, 2:])
    known_images = np.flatnonzero((count >= MIN_PIXELS) & ~(gradients[:, 0] < MIN_CONTRAST * noise_gradients2))
    normal, sums, count, noise_gradients2 = (
        normal[known_images],
        sums[known_images],
        count[known_images],
        noise_gradients2[known_images],
    )
    # Errors in the variables: noise inflates Σ gradient², and would make every shift too small.
    normal[:, 2, 2] -= noise_gradients2
    normal[:, 3, 3] -= noise_gradients2
    right = sums[:, products : products + _TERMS]
    inverse = np.linalg.inv(normal)
    fit = (inverse @ right[..., None])[..., 0]
    residual2 = np.maximum(sums[:, products + _TERMS] - np.sum(fit * right, -1), 0.0) / (count - _TERMS)
    # A texture that moves right by one px is darker by its gradient.
    shift[known_images] = -fit[:, 2:]
    sd[known_images] = np.sqrt(0.5 * residual2 * np.maximum(inverse[:, 2, 2] + inverse[:, 3, 3], 0.0))
    return shift, sd
