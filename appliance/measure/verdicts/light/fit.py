"""The fit, block by block, of the shift of the sine images' circle by changes of the ambient light.

It is a weighted robust regression in each of some fifty blocks and in each direction. The systems are small: a call of
a library costs more than solving them. The model is described in ``changes``.
"""

from __future__ import annotations

import numba
import numpy as np
from numpy.typing import NDArray

from appliance.measure.light.noise import MAD_TO_SIGMA

Floats = NDArray[np.float64]

ROUNDS = 2
CLIP = 3.0
"""Limit of the residuals in standard deviations; larger ones are edges of the texture."""
RIDGE = 1e-9
"""Share of the normal equations' trace that is added to their diagonal."""
STRONGEST = 0.9
"""Quantile of the contrast; larger contrasts have the weight of this one."""
FEW = 24
"""Number of values up to which a quantile is found by sorting."""
BINS = 2000
"""Largest number of bins for a quantile."""
SHIFT_TERMS, TWICE_TERMS = 11, 7


def warm_up() -> None:
    """Run every kernel once on a few values."""
    ones, index, ends = np.ones(4), np.arange(4), np.array([4])
    fit_blocks(np.eye(4), ones, index, index, index, ends)
    common_of_neighbours(ones, ones, index, index, index, ends, 1.0, 1.0)
    in_blocks(np.ones((2, 2), np.bool_), (1, 1), 1)
    medians_of(ones, index, ends)


# Symbols. (c, s) is the direction of the vector (I0 − I2, I3 − I1), (c2, s2) that of twice its angle; length is its
# radius over the contrast, third is (I0 − I1 + I2 − I3) over the contrast. (x, y) is the pixel's position in its block,
# from −1 to 1. shift and twice hold the terms of the two regressions row by row, with one column for each pixel of the
# block.


@numba.njit(nogil=True, cache=True, error_model="numpy")
def in_blocks(
    good: NDArray[np.bool_], blocks: tuple[int, int], least: int
) -> tuple[NDArray[np.intp], NDArray[np.intp], NDArray[np.intp], NDArray[np.intp], NDArray[np.intp]]:
    """Return the ``good`` pixels (n,) of an image, their rows and columns, ``order`` and ``ends``.

    The last two assign them to blocks as in ``fit_blocks``. ``blocks``: numbers of rows and columns of blocks; blocks
    with fewer pixels than ``least`` are left out.
    """
    height, width = good.shape
    counts = np.zeros(blocks[0] * blocks[1], np.intp)
    # The block of each row and column, so that no pixel has to be divided.
    down, across = np.empty(height, np.intp), np.empty(width, np.intp)
    for v in range(height):
        down[v] = v * blocks[0] // height * blocks[1]
    for u in range(width):
        across[u] = u * blocks[1] // width
    # How many pixels each block has.
    for v in range(height):
        for u in range(width):
            counts[down[v] + across[u]] += good[v, u]
    # Where the pixels of each block begin; −1 for small blocks, which are left out.
    begins, total, inside, count = np.empty(counts.size, np.intp), 0, 0, 0
    for k in range(counts.size):
        total += counts[k]
        if counts[k] >= least:
            begins[k] = inside
            inside += counts[k]
            count += 1
        else:
            begins[k] = -1
    # Blocks that are kept follow each other.
    ends, order = np.empty(count, np.intp), np.empty(inside, np.intp)
    count = 0
    for k in range(counts.size):
        if begins[k] >= 0:
            ends[count] = begins[k] + counts[k]
            count += 1
    # Each pixel goes to the next place of its block.
    pixels, rows, columns = np.empty(total, np.intp), np.empty(total, np.intp), np.empty(total, np.intp)
    n = 0
    for v in range(height):
        for u in range(width):
            if good[v, u]:
                pixels[n], rows[n], columns[n] = v * width + u, v, u
                k = down[v] + across[u]
                if begins[k] >= 0:
                    order[begins[k]] = n
                    begins[k] += 1
                n += 1
    return pixels, rows, columns, order, ends


@numba.njit(nogil=True, cache=True, error_model="numpy")
def medians_of(values: Floats, order: NDArray[np.intp], ends: NDArray[np.intp]) -> Floats:
    """Return the median of each block's ``values`` (n,); ``order`` and ``ends`` as in ``fit_blocks``."""
    medians = np.empty(ends.size)
    begin = 0
    for k in range(ends.size):
        medians[k] = quantile_of(values[order[begin : ends[k]]], 0.5)
        begin = ends[k]
    return medians


@numba.njit(nogil=True, cache=True, error_model="numpy")
def fit_blocks(
    four: Floats,
    contrast: Floats,
    row: NDArray[np.intp],
    column: NDArray[np.intp],
    order: NDArray[np.intp],
    ends: NDArray[np.intp],
) -> tuple[Floats, Floats]:
    """Fit the four sine images (4, n) of n pixels block by block.

    Returns coefficients (5, blocks) and residuals (n,). Coefficients: cosine and sine of the shift, third difference,
    sigma, and the sigma expected for a noise of one grey value. Residuals: those of each pixel's third difference over
    ``contrast`` (n,); outside of blocks, all of it. The pixels of block k are ``order[ends[k − 1]:ends[k]]``; ``row``
    and ``column`` (n,) are their positions.
    """
    coefficients = np.empty((5, ends.size))
    residuals = (four[0] - four[1] + four[2] - four[3]) / contrast
    begin = 0
    for k in range(ends.size):
        block = order[begin : ends[k]]
        begin = ends[k]
        n = block.size
        cosine, sine, light, third = np.empty(n), np.empty(n), np.empty(n), np.empty(n)
        shift, twice = np.empty((SHIFT_TERMS, n)), np.empty((TWICE_TERMS, n))
        # The pixels' positions in their block, from −1 to 1: small systems stay well conditioned.
        first_y, span_y = _span(row, block)
        first_x, span_x = _span(column, block)
        for j in range(n):
            pixel = block[j]
            cosine[j], sine[j] = four[0, pixel] - four[2, pixel], four[3, pixel] - four[1, pixel]
            light[j], third[j] = contrast[pixel], residuals[pixel]
            shift[6, j], shift[5, j] = (2.0 * row[pixel] - first_y) / span_y, (2.0 * column[pixel] - first_x) / span_x
        # From here on in loops so short that the compiler vectorises them.
        # (c, s) = (cos φ, sin φ) by four steps of 90°; length is the circle's radius over the light.
        radius, length, c, s = np.empty(n), np.empty(n), shift[0], shift[1]
        for j in range(n):
            radius[j] = np.sqrt(cosine[j] * cosine[j] + sine[j] * sine[j])
        _over(radius, light, length)
        _over(cosine, radius, c)
        _over(sine, radius, s)
        # length = a·(c, s) + third harmonics (seen at 4 φ) + a smooth surface + backscatter: a is the desired shift.
        c2, s2, c4, s4 = twice[1], twice[2], shift[2], shift[3]
        _sum_of_angles(c, s, c, s, c2, s2)
        _sum_of_angles(c2, s2, c2, s2, c4, s4)
        shift[4], x, y = 1.0, shift[5], shift[6]
        for j in range(n):
            shift[7, j], shift[8, j], shift[9, j] = x[j] * x[j], x[j] * y[j], y[j] * y[j]
        # The backscatter is in the contrast and has no fringes: before dark surfaces its share is larger.
        usual = np.mean(light)
        for j in range(n):
            shift[10, j] = usual / light[j]
        # Harmonics 2, 6 and 10 are those that four steps of 90° leave in the third difference. The latter two come from
        # an exposure that sees only some of the projector's bit planes, which makes steps of the sine.
        twice[0] = 1.0
        _sum_of_angles(c4, s4, c2, s2, twice[3], twice[4])
        _sum_of_angles(twice[3], twice[4], c4, s4, twice[5], twice[6])
        # The weights are inverse to the variance of the fitted values.
        weight = np.minimum(light, quantile_of(light, STRONGEST)) ** 2
        of_shift, sigma, expected = regress(length, shift, light, weight)
        # The third difference: its mean is a change of light, its terms at 2, 6 and 10 φ are the projector's harmonics.
        of_twice, _, _ = regress(third, twice, light, weight)
        coefficients[0, k], coefficients[1, k], coefficients[2, k] = of_shift[0], of_shift[1], of_twice[0]
        coefficients[3, k], coefficients[4, k] = sigma, expected
        for j in range(n):
            residual = third[j]
            for a in range(TWICE_TERMS):
                residual -= of_twice[a] * twice[a, j]
            residuals[block[j]] = residual
    return coefficients, residuals


@numba.njit(nogil=True, cache=True, error_model="numpy")
def _over(value: Floats, divisor: Floats, quotient: Floats) -> None:
    for j in range(quotient.size):
        quotient[j] = value[j] / divisor[j]


@numba.njit(nogil=True, cache=True, error_model="numpy")
def _sum_of_angles(c: Floats, s: Floats, d: Floats, t: Floats, cosine: Floats, sine: Floats) -> None:
    """Write cosine and sine of the sum of two angles that have (c, s) and (d, t)."""
    for j in range(cosine.size):
        cosine[j] = c[j] * d[j] - s[j] * t[j]
    for j in range(sine.size):
        sine[j] = s[j] * d[j] + c[j] * t[j]


@numba.njit(nogil=True, cache=True, error_model="numpy")
def common_of_neighbours(
    residuals: Floats,
    contrast: Floats,
    row: NDArray[np.intp],
    column: NDArray[np.intp],
    order: NDArray[np.intp],
    ends: NDArray[np.intp],
    most_dn: float,
    most_share: float,
) -> Floats:
    """Return each block's mean product of the ``residuals`` (n,) of neighbouring pixels.

    Only light contributes. Noise of neighbouring pixels has no common part. Values are clipped at the larger of
    ``most_share`` and ``most_dn`` over the contrast. Pairs have weights by their noise, which is about the same
    everywhere in grey values (``residuals`` · ``contrast``). Pixels come row by row, from left to right.
    """
    common = np.zeros(ends.size)
    value = residuals * contrast
    # Assign each pixel its block, and clip its value: one edge must not outweigh a block.
    block = np.empty(residuals.size, np.intp)
    for pixel in range(residuals.size):
        block[pixel] = -1
    begin = 0
    for k in range(ends.size):
        for pixel in order[begin : ends[k]]:
            block[pixel] = k
            limit = max(most_dn, most_share * contrast[pixel])
            value[pixel] = min(max(value[pixel], -limit), limit)
        begin = ends[k]
    # Both sums of each block's least squares.
    sums, weights = np.zeros(ends.size), np.zeros(ends.size)
    # Pairs beside and below each other; below runs ahead through the sorted pixels, so that all is one pass.
    below = 0
    for pixel in range(residuals.size):
        k = block[pixel]
        while below < residuals.size and (
            row[below] < row[pixel] + 1 or (row[below] == row[pixel] + 1 and column[below] < column[pixel])
        ):
            below += 1
        # Both pixels must lie in a block; a pair across a border counts for the block of its first.
        for neighbour in (pixel + 1, below):
            if neighbour >= residuals.size or k < 0 or block[neighbour] < 0:
                continue
            beside = row[neighbour] == row[pixel] and column[neighbour] == column[pixel] + 1
            under = row[neighbour] == row[pixel] + 1 and column[neighbour] == column[pixel]
            if beside or under:
                # Least squares of v_a v_b = m · c_a c_b over the pairs: m = Σ v_a v_b c_a c_b / Σ (c_a c_b)².
                product = contrast[pixel] * contrast[neighbour]
                sums[k] += value[pixel] * value[neighbour] * product
                weights[k] += product * product
    # A block without any pair has no common part: 0.
    for k in range(ends.size):
        common[k] = sums[k] / max(weights[k], 1e-12)
    return common


@numba.njit(nogil=True, cache=True, error_model="numpy")
def _span(position: NDArray[np.intp], block: NDArray[np.intp]) -> tuple[int, int]:
    """Return the sum and the difference of the greatest and the least position, for scaling to −1..1."""
    low, high = position[block[0]], position[block[0]]
    for pixel in block:
        low, high = min(low, position[pixel]), max(high, position[pixel])
    return low + high, max(high - low, 1)


@numba.njit(nogil=True, cache=True, error_model="numpy")
def regress(value: Floats, terms: Floats, contrast: Floats, weight: Floats) -> tuple[Floats, float, float]:
    """Return the coefficients of a robust fit of ``terms`` (k, n), and two standard deviations.

    ``weight``: (n,). The first is the larger sigma of the first two coefficients, the second the one expected if
    ``value`` · ``contrast`` (n,) had a noise of 1.
    """
    size, n = terms.shape
    # Normal equations of weighted least squares: X W Xᵀ b = X W y, with the terms X and the values y.
    normal, right = _normal(value, terms, weight)
    used = np.ones(n, np.bool_)
    residual, off = np.empty(n), np.empty(n)
    for number in range(ROUNDS):
        inverse = _inverse(_ridged(normal))
        coefficients = _times(inverse, right)
        # A loop, since assigning an array to an array takes a second of compiling, for the message on unequal shapes.
        for j in range(n):
            residual[j] = value[j]
        for a in range(size):
            for j in range(n):
                residual[j] -= coefficients[a] * terms[a, j]
        if number == ROUNDS - 1:
            break
        # Large residuals are at edges of the texture: leave these pixels out and repeat the fit. They are few, so that
        # subtracting them from the normal equations is quicker than summing all others again.
        for j in range(n):
            off[j] = abs(residual[j]) * contrast[j]
        limit = CLIP * max(MAD_TO_SIGMA * quantile_of(off, 0.5), 1e-3)
        count = 0
        for j in range(n):
            count += off[j] > limit
        far, count = np.empty(count, np.intp), 0
        for j in range(n):
            if off[j] > limit and used[j]:
                far[count] = j
                used[j] = False
                count += 1
        far = far[:count]
        outlier_normal, outlier_right = _normal(value[far], terms[:, far], weight[far])
        normal -= outlier_normal
        right -= outlier_right
    # Σ w r² of the used pixels over the degrees of freedom: the variance of a residual.
    squares, count = 0.0, 0
    for j in range(n):
        if used[j]:
            squares += weight[j] * residual[j] ** 2
            count += 1
    # Covariance of weighted least squares, for a noise of one grey value and for the measured one.
    expected = np.sqrt(max(inverse[0, 0], inverse[1, 1]))
    return coefficients, expected * np.sqrt(squares / max(count - size, 1)), expected


@numba.njit(nogil=True, cache=True, error_model="numpy", fastmath={"reassoc", "contract"})
def _dot(a: Floats, b: Floats) -> float:
    """Return the dot product, with the summation order left to the compiler."""
    total = 0.0
    for j in range(a.size):
        total += a[j] * b[j]
    return total


@numba.njit(nogil=True, cache=True, error_model="numpy")
def quantile_of(values: Floats, share: float) -> float:
    """Return the quantile ``share`` of the finite ``values``, interpolated between two of them.

    Values are counted into bins, and only the bin with the quantile is divided again. A partition would take longer
    than the fit of a block of some hundred pixels, since its branches cannot be predicted.
    """
    position = share * (values.size - 1)
    rank = int(position)
    all_values, fraction = values, position - rank
    counts = np.empty(BINS, np.int64)
    while True:
        low, high = _ends(values)
        bins = min(BINS, values.size)
        scale = bins / (high - low)
        if values.size <= FEW or not scale < np.inf:  # too near to each other for bins
            break
        counts[:bins] = 0
        for i in range(values.size):
            counts[_bin(values[i], low, scale, bins)] += 1
        target, below = 0, 0
        while below + counts[target] <= rank:
            below += counts[target]
            target += 1
        inside, n = np.empty(counts[target]), 0
        for i in range(values.size):
            if _bin(values[i], low, scale, bins) == target:
                inside[n] = values[i]
                n += 1
        values, rank = inside, rank - below
    ordered = _in_order(values)
    if not fraction > 0.0:
        return float(ordered[rank])
    following = np.inf
    if rank + 1 < ordered.size:
        following = ordered[rank + 1]
    else:
        # The next value lies in another bin, which is rare. Equal values share a bin.
        for i in range(all_values.size):
            following = min(following, all_values[i] if all_values[i] > ordered[rank] else np.inf)
    return float(ordered[rank] + fraction * (following - ordered[rank]))


@numba.njit(nogil=True, cache=True, error_model="numpy")
def _in_order(values: Floats) -> Floats:
    """Return ``values`` (n,) sorted by insertion: they are few or nearly equal."""
    ordered = values.copy()
    for i in range(1, ordered.size):
        value, index = ordered[i], i
        while index > 0 and value < ordered[index - 1]:
            ordered[index] = ordered[index - 1]
            index -= 1
        ordered[index] = value
    return ordered


@numba.njit(nogil=True, cache=True, error_model="numpy")
def _ends(values: Floats) -> tuple[float, float]:
    """Return the least and the greatest of ``values`` (n,), by four independent chains."""
    low0 = low1 = low2 = low3 = high0 = high1 = high2 = high3 = values[0]
    in_fours = values.size // 4 * 4
    for i in range(0, in_fours, 4):
        low0, high0 = min(low0, values[i]), max(high0, values[i])
        low1, high1 = min(low1, values[i + 1]), max(high1, values[i + 1])
        low2, high2 = min(low2, values[i + 2]), max(high2, values[i + 2])
        low3, high3 = min(low3, values[i + 3]), max(high3, values[i + 3])
    for i in range(in_fours, values.size):
        low0, high0 = min(low0, values[i]), max(high0, values[i])
    return min(min(low0, low1), min(low2, low3)), max(max(high0, high1), max(high2, high3))


@numba.njit(nogil=True, cache=True, error_model="numpy")
def _bin(value: float, low: float, scale: float, bins: int) -> int:
    """Return the bin of a value; the last one for the greatest value and for NaN."""
    place = (value - low) * scale
    return int(place) if place < bins else bins - 1


@numba.njit(nogil=True, cache=True, error_model="numpy")
def _normal(value: Floats, terms: Floats, weight: Floats) -> tuple[Floats, Floats]:
    """Return the matrix and the right side of the normal equations."""
    size = terms.shape[0]
    normal, right = np.empty((size, size)), np.empty(size)
    weighted = np.empty(value.size)
    for a in range(size):
        for j in range(value.size):
            weighted[j] = weight[j] * terms[a, j]
        right[a] = _dot(weighted, value)
        for b in range(a + 1):
            normal[a, b] = normal[b, a] = _dot(weighted, terms[b])
    return normal, right


@numba.njit(nogil=True, cache=True, error_model="numpy")
def _ridged(normal: Floats) -> Floats:
    """Return ``normal`` with a ridge on its diagonal."""
    ridged, trace = normal.copy(), np.trace(normal)
    for a in range(ridged.shape[0]):
        ridged[a, a] += RIDGE * trace
    return ridged


@numba.njit(nogil=True, cache=True, error_model="numpy")
def _times(matrix: Floats, vector: Floats) -> Floats:
    product = np.zeros(vector.size)
    for a in range(vector.size):
        for b in range(vector.size):
            product[a] += matrix[a, b] * vector[b]
    return product


@numba.njit(nogil=True, cache=True, error_model="numpy")
def _inverse(matrix: Floats) -> Floats:
    """Invert a symmetric positive definite matrix by Gauss and Jordan: with a ridge it needs no pivots."""
    size = matrix.shape[0]
    left, right = matrix.copy(), np.eye(size)
    for a in range(size):
        inverse_pivot = 1.0 / left[a, a]
        for b in range(size):
            left[a, b] *= inverse_pivot
            right[a, b] *= inverse_pivot
        for c in range(size):
            factor = left[c, a]
            if c != a and factor != 0.0:
                for b in range(size):
                    left[c, b] -= factor * left[a, b]
                    right[c, b] -= factor * right[a, b]
    return right
