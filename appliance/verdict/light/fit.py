"""Owns the fit, block by block, of how far light that is not the projector's shifts the circle of the sine images.

A weighted robust regression in each of some fifty blocks and either direction: small systems, for which calling a library
costs more than solving them. ``changes`` says what is fitted and why.
"""

from __future__ import annotations

import numba
import numpy as np
from numpy.typing import NDArray

from appliance.scan.noise import MAD_TO_SIGMA

Floats = NDArray[np.float64]

ROUNDS = 2
CLIP = 3.0
"""Residuals beyond so many of their usual size are edges of the texture."""
RIDGE = 1e-9
"""Share of the normal equations' trace that is added to their diagonal."""
STRONGEST = 0.9
"""Contrasts above this quantile weigh no more than it."""
BINS = 2000
"""Bins per unit of contrast, into which stripes are counted."""
STRIPE_EDGE = 0.3
"""Share of the contrast below which a pixel lies in a dark stripe, and above one minus which it lies in an
illuminated one."""
SHIFT_TERMS, TWICE_TERMS = 11, 7
COSINE, SINE, THIRD, SIGMA, EXPECTED = range(5)
"""Rows of what ``fit_blocks`` finds."""


def warm_up() -> None:
    """Run every kernel on next to nothing."""
    some, place, ends = np.ones(4), np.arange(4), np.array([4])
    fit_blocks(np.eye(4), some, place, place, place, ends)
    common_of_neighbours(some, some, place, place, place, ends)
    stripe_levels(np.ones((2, 4), np.float32), np.array([1]), 0, place, some, 1)


# Symbols. (c, s) is the direction of the vector (I0 − I2, I3 − I1), (c2, s2) that of twice its angle; length is its
# radius over the contrast, third is (I0 − I1 + I2 − I3) over the contrast. (x, y) is the pixel's place in its block,
# from −1 to 1. shift and twice hold the terms of the two regressions row by row, with one column for each pixel of the
# block.


@numba.njit(nogil=True, cache=True, error_model="numpy")
def fit_blocks(
    four: Floats,
    contrast: Floats,
    row: NDArray[np.intp],
    column: NDArray[np.intp],
    order: NDArray[np.intp],
    ends: NDArray[np.intp],
) -> tuple[Floats, Floats]:
    """Fit n pixels' four sine images (4, n) block by block: return what was found in each block, (5, blocks), and what
    is left of each pixel's third difference over ``contrast`` (n,); outside of blocks, all of it.

    The pixels of block k are ``order[ends[k − 1]:ends[k]]``; ``row`` and ``column`` (n,) are their places.
    """
    found = np.empty((5, ends.size))
    rest = (four[0] - four[1] + four[2] - four[3]) / contrast
    begin = 0
    for k in range(ends.size):
        # The block's pixels, and their places in it from −1 to 1: small systems stay well conditioned.
        block = order[begin : ends[k]]
        begin = ends[k]
        n = block.size
        first_y, span_y = _span(row, block)
        first_x, span_x = _span(column, block)
        shift, twice = np.empty((SHIFT_TERMS, n)), np.empty((TWICE_TERMS, n))
        length, third, light = np.empty(n), np.empty(n), np.empty(n)
        usual = np.mean(contrast[block])
        for j in range(n):
            at = block[j]
            cosine, sine = four[0, at] - four[2, at], four[3, at] - four[1, at]
            radius = np.sqrt(cosine * cosine + sine * sine)
            light[j] = contrast[at]
            length[j] = radius / light[j]
            third[j] = rest[at]
            # (c, s) = (cos φ, sin φ) by four steps of 90°; length is the circle's radius over the light.
            c, s = cosine / radius, sine / radius
            # cos 2φ and sin 2φ by the double-angle formulas.
            c2, s2 = c * c - s * s, 2.0 * c * s
            y, x = (2.0 * row[at] - first_y) / span_y, (2.0 * column[at] - first_x) / span_x
            # length = a·(c, s) + third harmonics (seen at 4 φ) + a smooth surface + backscatter: a is the shift
            # that is looked for.
            shift[0, j], shift[1, j], shift[2, j], shift[3, j] = c, s, c2 * c2 - s2 * s2, 2.0 * c2 * s2
            shift[4, j], shift[5, j], shift[6, j] = 1.0, x, y
            shift[7, j], shift[8, j], shift[9, j] = x * x, x * y, y * y
            # The water's backscatter is in the contrast, and has no fringes: a larger share of it before what is dark.
            shift[10, j] = usual / light[j]
            # Harmonics 2, 6 and 10: those that four steps of 90° leave in the third difference. Beyond the second they come from
            # an exposure that sees a part of the projector's bit planes, which makes steps of the sine.
            twice[0, j], twice[1, j], twice[2, j] = 1.0, c2, s2
            c4, s4 = c2 * c2 - s2 * s2, 2.0 * c2 * s2
            c6, s6 = c4 * c2 - s4 * s2, s4 * c2 + c4 * s2
            twice[3, j], twice[4, j] = c6, s6
            twice[5, j], twice[6, j] = c6 * c4 - s6 * s4, s6 * c4 + c6 * s4
        of_shift, found[SIGMA, k], found[EXPECTED, k] = regress(length, shift, light)
        found[COSINE, k], found[SINE, k] = of_shift[0], of_shift[1]
        # The third difference: its mean is a change of light, its terms at 2, 6 and 10 φ are the projector's harmonics.
        of_twice, _, _ = regress(third, twice, light)
        found[THIRD, k] = of_twice[0]
        for j in range(n):
            left = third[j]
            for a in range(TWICE_TERMS):
                left -= of_twice[a] * twice[a, j]
            rest[block[j]] = left
    return found, rest


@numba.njit(nogil=True, cache=True, error_model="numpy")
def common_of_neighbours(
    rest: Floats,
    contrast: Floats,
    row: NDArray[np.intp],
    column: NDArray[np.intp],
    order: NDArray[np.intp],
    ends: NDArray[np.intp],
) -> Floats:
    """Return each block's mean square of what a pixel and those next to it have in common of ``rest`` (n,): what noise
    has not, and light has.

    Pairs weigh as their noise allows: in grey values, ``rest`` · ``contrast``, it is about the same everywhere. Pixels
    come row by row, from left to right.
    """
    found = np.zeros(ends.size)
    value = rest * contrast
    # Light that is usual before dark pixels is many grey values before bright ones; noise is not. Either is no edge.
    most_dn = CLIP * MAD_TO_SIGMA * np.median(np.abs(value))
    most_share = CLIP * MAD_TO_SIGMA * np.median(np.abs(rest))
    # Each pixel learns its block, and its value is clipped: one edge must not outweigh a block.
    block = np.full(rest.size, -1)
    begin = 0
    for k in range(ends.size):
        for at in order[begin : ends[k]]:
            block[at] = k
            most = max(most_dn, most_share * contrast[at])
            value[at] = min(max(value[at], -most), most)
        begin = ends[k]
    sums, weights = np.zeros(ends.size), np.zeros(ends.size)
    # Pairs beside and below each other; below runs ahead through the sorted pixels, so that all is one pass.
    below = 0
    for at in range(rest.size):
        k = block[at]
        while below < rest.size and (
            row[below] < row[at] + 1 or (row[below] == row[at] + 1 and column[below] < column[at])
        ):
            below += 1
        # Both pixels must lie in a block; a pair across a border counts for the block of its first.
        for other in (at + 1, below):
            if other >= rest.size or k < 0 or block[other] < 0:
                continue
            beside = row[other] == row[at] and column[other] == column[at] + 1
            under = row[other] == row[at] + 1 and column[other] == column[at]
            if beside or under:
                # Least squares of v_a v_b = m · c_a c_b over the pairs: m = Σ v_a v_b c_a c_b / Σ (c_a c_b)².
                both = contrast[at] * contrast[other]
                sums[k] += value[at] * value[other] * both
                weights[k] += both * both
    # A block without any pair has nothing in common: 0.
    for k in range(ends.size):
        found[k] = sums[k] / max(weights[k], 1e-12)
    return found


@numba.njit(nogil=True, cache=True, error_model="numpy")
def stripe_levels(
    grey: NDArray[np.float32],
    numbers: NDArray[np.int64],
    dark: int,
    pixels: NDArray[np.intp],
    contrast: Floats,
    least: int,
) -> Floats:
    """Return the level of each image in ``numbers``: half way between the medians of its dark and of its illuminated
    stripes, from dark (0) to bright (1); NaN where fewer than ``least`` pixels are either. ``grey`` (images, n) and
    what ``pixels`` of them have as ``contrast``."""
    found = np.full(numbers.size, np.nan)
    count = np.empty(2 * BINS, np.int64)
    for j in range(numbers.size):
        # Two histograms in one array: dark stripes in its first half, illuminated ones in the second.
        count[:] = 0
        image = grey[numbers[j]]
        for i in range(pixels.size):
            share = (image[pixels[i]] - grey[dark, pixels[i]]) / contrast[i]
            if share < STRIPE_EDGE:
                count[min(max(int((share - STRIPE_EDGE) * BINS + BINS), 0), BINS - 1)] += 1
            elif share > 1.0 - STRIPE_EDGE:
                count[BINS + min(int((share - 1.0 + STRIPE_EDGE) * BINS), BINS - 1)] += 1
        low, high = _median_bin(count[:BINS], least), _median_bin(count[BINS:], least)
        # From bins back to shares of the contrast, then half way between the two medians.
        found[j] = 0.5 * (STRIPE_EDGE - 1.0 + low / BINS + 1.0 - STRIPE_EDGE + high / BINS)
    return found


@numba.njit(nogil=True, cache=True, error_model="numpy")
def _median_bin(count: NDArray[np.int64], least: int) -> float:
    """Return the median of the counted values, in bins; NaN for fewer than ``least``."""
    half = 0.5 * count.sum()
    if 2.0 * half < least:
        return np.nan
    below = 0.0
    for k in range(count.size):
        if below + count[k] >= half:
            return float(k + (half - below) / count[k])
        below += count[k]
    return float(count.size)


@numba.njit(nogil=True, cache=True, error_model="numpy")
def _span(place: NDArray[np.intp], block: NDArray[np.intp]) -> tuple[int, int]:
    """Return the sum of the least and the greatest place, and how far they are apart: what takes places to −1..1."""
    low, high = place[block[0]], place[block[0]]
    for at in block:
        low, high = min(low, place[at]), max(high, place[at])
    return low + high, max(high - low, 1)


@numba.njit(nogil=True, cache=True, error_model="numpy")
def regress(value: Floats, terms: Floats, contrast: Floats) -> tuple[Floats, float, float]:
    """Return the coefficients of a weighted robust fit of ``terms`` (k, n), the larger sigma of the first two, and
    what that would be for ``value`` · ``contrast`` (n,) with a noise of 1."""
    size, n = terms.shape
    most = np.quantile(contrast, STRONGEST)
    weight = np.minimum(contrast, most) ** 2
    residual = np.empty(n)
    coefficients, sigma, expected = np.zeros(size), np.inf, np.inf
    # Weighted least squares; then what is far off, at an edge of the texture, is left out and the fit repeated.
    for _ in range(ROUNDS):
        normal, right = _normal(value, terms, weight)
        inverse = _inverse(normal)
        coefficients = _times(inverse, right)
        residual[:] = value
        for a in range(size):
            for j in range(n):
                residual[j] -= coefficients[a] * terms[a, j]
        squares, used = 0.0, 0
        for j in range(n):
            squares += weight[j] * residual[j] ** 2
            used += 1 if weight[j] != 0.0 else 0
        # Covariance of weighted least squares, for a noise of one grey value and for the one that is found.
        expected = np.sqrt(max(inverse[0, 0], inverse[1, 1]))
        sigma = expected * np.sqrt(squares / max(used - size, 1))
        off = np.abs(residual) * contrast
        limit = CLIP * max(MAD_TO_SIGMA * np.median(off), 1e-3)
        for j in range(n):
            if off[j] > limit:
                weight[j] = 0.0
    return coefficients, sigma, expected


@numba.njit(nogil=True, cache=True, error_model="numpy", fastmath={"reassoc", "contract"})
def _dot(a: Floats, b: Floats) -> float:
    """Return the sum of products in whatever order is fastest."""
    total = 0.0
    for j in range(a.size):
        total += a[j] * b[j]
    return total


@numba.njit(nogil=True, cache=True, error_model="numpy")
def _normal(value: Floats, terms: Floats, weight: Floats) -> tuple[Floats, Floats]:
    size = terms.shape[0]
    normal, right = np.empty((size, size)), np.empty(size)
    trace = 0.0
    for a in range(size):
        weighted = weight * terms[a]
        right[a] = _dot(weighted, value)
        for b in range(a + 1):
            normal[a, b] = normal[b, a] = _dot(weighted, terms[b])
        trace += normal[a, a]
    for a in range(size):
        normal[a, a] += RIDGE * trace
    return normal, right


@numba.njit(nogil=True, cache=True, error_model="numpy")
def _times(matrix: Floats, vector: Floats) -> Floats:
    found = np.zeros(vector.size)
    for a in range(vector.size):
        for b in range(vector.size):
            found[a] += matrix[a, b] * vector[b]
    return found


@numba.njit(nogil=True, cache=True, error_model="numpy")
def _inverse(matrix: Floats) -> Floats:
    """Invert a symmetric positive definite matrix by Gauss and Jordan: with a ridge it needs no pivots."""
    size = matrix.shape[0]
    left, right = matrix.copy(), np.eye(size)
    for a in range(size):
        by = 1.0 / left[a, a]
        for b in range(size):
            left[a, b] *= by
            right[a, b] *= by
        for c in range(size):
            factor = left[c, a]
            if c != a and factor != 0.0:
                for b in range(size):
                    left[c, b] -= factor * left[a, b]
                    right[c, b] -= factor * right[a, b]
    return right
