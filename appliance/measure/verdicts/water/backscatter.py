"""The backscatter of a scan, separated from the object's light by the Gray stripes; specks; flicker.

A camera's ray crosses the projector's beam for hundreds of millimetres, so that fine stripes across the baseline
illuminate half of the water along it, independent of the pixel at its end. In the middle of a dark stripe a pixel shows
half of its backscatter (above the dark frame); in the middle of an illuminated one half of it is missing (below the
bright frame). Response, blurred fringes, albedo and steady ambient light cancel in these differences. Stripes of the
other direction run along the rays through the beam and are not used.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numba
import numpy as np
from numpy.typing import NDArray

from appliance.measure.decode.decoder import CameraDecoder, Mask
from appliance.measure.light.noise import FULL_DN, MAD_TO_SIGMA, CameraNoise
from appliance.measure.light.patterns import Direction, PatternSequence
from appliance.measure.points.quality import median
from appliance.measure.scan_images import PixelGrid

Array = NDArray[np.float64]
Floats = NDArray[np.float32]

CELLS = (16, 12)
"""Columns and rows of cells over the image: within one, backscatter and distance hardly change."""
SAMPLES = 60_000
"""Largest number of pixels, on an even grid."""
STRIPES_PX = (32.0, 64.0)
"""Widths of the stripes that are used, pattern px: fine for the water, wide compared with the blur of their borders."""
FROM_EDGE = 0.35
"""Least distance from a stripe's borders, in widths: half is its middle. 11 px for a stripe of 32."""
MIN_PER_CELL = 25
OUTLIER_SIGMAS = 4.0
MIN_OBJECT_DN = 6.0
"""Least change of a pixel by the stripes on an object that could be measured."""
OBJECT_SIGMAS = 4.0
"""Least change of a pixel by the stripes in standard deviations of noise: in bright light, noise alone is
``MIN_OBJECT_DN``."""
USUAL_CONTRAST = 0.8
"""Contrast of fringes in turbid water, used if it cannot be measured."""
SPECK_SIGMAS = 6.0
"""Limit of the four steps' disagreement in standard deviations: noise exceeds it once in 500 million."""
_FULL, _NO_REASON, _SATURATED = np.uint8(FULL_DN), np.uint8(Mask.VALID), np.uint8(Mask.SATURATED)
_MOST_OFF = 2 * FULL_DN
"""Largest difference of the sums of opposite steps."""


@dataclass(frozen=True, slots=True)
class Cells:
    """Means of the n cells with enough pixels; light in grey values (DN)."""

    number: NDArray[np.intp]
    """(n,): row · CELLS[0] + column."""
    pixels: Array
    """(n,): number of pixels."""
    uv_px: Array
    """(n, 2): mean image point of these pixels."""
    backscatter_dn: Array
    """(n,): of the bright frame."""
    sigma_dn: Array
    """(n,): standard error of ``backscatter_dn`` by the noise within the cell."""
    signal_dn: Array
    """(n,): light of the object in the bright frame."""
    dark_dn: Array
    """(n,): of the dark frame."""


@dataclass(frozen=True, slots=True)
class BackscatterSample:
    """Effects of the water in one camera's frames."""

    cells: Cells
    backscatter_share: float | None
    """Backscatter as a share of the projected light in the object's pixels, 0..1; ``None``: no pixel could be used."""
    object_pixels: int
    """Number of sampled pixels that show an object and are not saturated."""
    object_share: float
    """These as a share of all sampled pixels."""
    masked_share: float | None
    """Share of these without coordinates."""
    hidden_share: float | None
    """Share of these that have no coordinates and, by their weak fringes, more backscatter than light of the object."""
    fringe_contrast: float | None
    """Modulation over half of the object's light; blur and the projector's response reduce it."""
    flicker_dn: float
    """Change of the ambient light on the object between frames, RMS, by the sums of opposite steps."""
    speck_share: float | None
    """Share of the pixels with coordinates in which the four steps of a direction disagree."""


def water_grid(sequence: PatternSequence) -> PixelGrid:
    """Return the grid of pixels for the judge of water: bright, dark, some Gray images, all sines."""
    across = sequence.axis(Direction.X)
    gray = [across.gray[bit] for bit, _ in _useful_stripes(sequence.period_px, len(across.gray))]
    sines = [k for direction in Direction for k in sequence.axis(direction).sine]

    def steps(rows: int, columns: int) -> tuple[int, int]:
        across_px = max(1, int(math.sqrt(rows * columns / SAMPLES)))
        return max(1, math.ceil(rows * columns / SAMPLES / across_px)), across_px

    return PixelGrid([sequence.bright, sequence.dark, *gray, *sines], steps)


def measure_backscatter(
    sequence: PatternSequence, grid: PixelGrid, decoded: CameraDecoder, noise: CameraNoise
) -> BackscatterSample:
    """Measure the effects of the water by the ``grid`` (``water_grid``) of one camera with ``noise``."""
    mask, p_px = decoded.mask[grid.at], decoded.p_px[grid.at]
    stripes = _useful_stripes(sequence.period_px, len(sequence.axis(Direction.X).gray))
    widths_px = np.array([width_px for _, width_px in stripes], np.float32)
    # One swing is twice a frame less two others, so that its variance is six times that of a frame.
    levels_dn = 0.5 * np.arange(2.0 * FULL_DN + 1.0, dtype=np.float32)
    least_dn = np.maximum(
        MIN_OBJECT_DN * len(widths_px),
        OBJECT_SIGMAS * np.sqrt(6.0 * len(widths_px) * noise.variance_dn2(levels_dn)),
    ).astype(np.float32)
    cell_row, cell_column = (np.arange(n) * m // n for n, m in zip(mask.shape, CELLS[::-1], strict=True))
    objects, lost, cell, steps, between = _ask(
        grid.grey, mask, p_px, widths_px, least_dn, CELLS[0] * cell_row, cell_column
    )
    cells = _by_cell(between, grid)
    # All projected light on the object's pixels: its own and the backscatter.
    of_light = float(cells.pixels @ (cells.signal_dn + cells.backscatter_dn))
    flicker_dn, speck_share = _passing(cell, (steps[:4], steps[4:]))
    contrast = _contrast(steps[:4], cells)
    fringe_dn = lost[0] / np.float32(contrast or USUAL_CONTRAST)
    hidden = int(np.count_nonzero(2.0 * fringe_dn < lost[1]))
    return BackscatterSample(
        cells,
        float(np.clip(cells.pixels @ cells.backscatter_dn / of_light, 0.0, 1.0)) if of_light > 0.0 else None,
        objects,
        objects / mask.size,
        1.0 - len(cell) / objects if objects else None,
        hidden / objects if objects else None,
        contrast,
        flicker_dn,
        speck_share,
    )


@numba.njit(nogil=True, cache=True, error_model="numpy")
def _ask(
    grey: NDArray[np.uint8],
    mask: NDArray[np.uint8],
    p_px: Floats,
    widths_px: Floats,
    least_dn: Floats,
    cell_row: NDArray[np.int64],
    cell_column: NDArray[np.int64],
) -> tuple[int, Floats, NDArray[np.int64], NDArray[np.uint8], Floats]:
    """Sample the pixels (h, w) that show an object.

    Returns their number; twice the modulation and the light of those without coordinates, (2, n); cell (m,) and sines
    (8, m) of those with coordinates; and for those in the middle of a stripe (6, k): cell, column, row, backscatter,
    light, dark.

    ``grey`` (2 + stripes + 8, h, w): bright, dark, Gray images with stripes of ``widths_px``, sines. ``least_dn``
    (511,): least swing of an object's pixel, by the sum of bright and dark. The cell is the sum of ``cell_row`` and
    ``cell_column``.
    """
    rows, columns = mask.shape
    stripes, room = widths_px.size, mask.size
    lost, between = np.empty((2, room), np.float32), np.empty((6, room), np.float32)
    cell, steps = np.empty(room, np.int64), np.empty((8, room), np.uint8)
    half, in_middle, two = np.float32(0.5), np.float32(0.5 - FROM_EDGE), np.float32(2.0)
    # Numbers of pixels of each kind so far.
    objects, n, m, samples = 0, 0, 0, 0
    for j in range(rows):
        for i in range(columns):
            bright, dark = np.float32(grey[0, j, i]), np.float32(grey[1, j, i])
            swing = np.float32(0.0)
            for k in range(stripes):
                swing += abs(two * np.float32(grey[2 + k, j, i]) - (bright + dark))
            # Stripes change an object's pixels by more than noise.
            if not swing > least_dn[int(bright + dark)] or grey[0, j, i] >= _FULL or mask[j, i] == _SATURATED:
                continue
            objects += 1
            if mask[j, i] != _NO_REASON:
                # Twice the modulation of X: the length of (I0 − I2, I3 − I1).
                cosine = np.float32(grey[2 + stripes, j, i]) - np.float32(grey[4 + stripes, j, i])
                sine = np.float32(grey[5 + stripes, j, i]) - np.float32(grey[3 + stripes, j, i])
                lost[0, n], lost[1, n] = np.sqrt(cosine * cosine + sine * sine), bright - dark
                n += 1
                continue
            # Pixels with coordinates are kept with their fringes.
            cell[m] = cell_row[j] + cell_column[i]
            for k in range(8):
                steps[k, m] = grey[2 + stripes + k, j, i]
            m += 1
            # Half of the backscatter: missing in the middle of an illuminated stripe, left in the middle of a dark one.
            total, count = np.float32(0.0), np.float32(0.0)
            for k in range(stripes):
                place = (p_px[j, i] + half) / widths_px[k] - half
                stripe = np.floor(place)
                if abs(place - stripe - half) < in_middle:
                    stripe_dn = np.float32(grey[2 + k, j, i])
                    total += bright - stripe_dn if int(stripe) % 2 == 0 else stripe_dn - dark
                    count += np.float32(1.0)
            # The halves by all stripes have the same weight.
            if count > np.float32(0.0):
                between[0, samples], between[1, samples], between[2, samples] = cell[m - 1], i, j
                between[3, samples], between[4, samples], between[5, samples] = two * total / count, bright - dark, dark
                samples += 1
    return objects, lost[:, :n].copy(), cell[:m].copy(), steps[:, :m].copy(), between[:, :samples].copy()


def warm_up() -> None:
    """Run the kernel that an empty scan does not run."""
    disagreement(np.zeros((4, 1), np.uint8), np.zeros(1, np.intp), 1)


def _useful_stripes(period_px: int, bits: int) -> list[tuple[int, float]]:
    """Return (bit, stripe width in px) of the Gray images with stripes neither too fine nor too coarse."""
    widths = [(bit, float(period_px * 2 ** (bits - 1 - bit))) for bit in range(bits)]
    chosen = [(bit, width) for bit, width in widths if STRIPES_PX[0] <= width <= STRIPES_PX[1]]
    return chosen or [widths[-1]]


def cell_of(u: NDArray[np.intp], v: NDArray[np.intp], shape: tuple[int, int]) -> NDArray[np.intp]:
    """Return the numbers (n,) of the cells of pixels (n,) of an image (h, w)."""
    return v * CELLS[1] // shape[0] * CELLS[0] + u * CELLS[0] // shape[1]


def _by_cell(between: Floats, grid: PixelGrid) -> Cells:
    """Return the cells of the pixels in the middle of stripes, as ``_ask`` gives them."""
    count, sums, squares = sum_cells(between, CELLS[0] * CELLS[1])
    enough = np.flatnonzero(count >= MIN_PER_CELL)
    pixels = count[enough]
    column, row, centre, light, dark = sums[:, enough] / pixels
    spread = np.sqrt(np.maximum(squares[enough] / pixels - centre**2, 0.0))
    # From positions on the grid to pixels of the image.
    u = grid.across_px * column + grid.across_px // 2
    v = grid.down_px * row + grid.down_px // 2
    return Cells(enough, pixels, np.stack([u, v], -1), centre, spread / np.sqrt(pixels), light - centre, dark)


@numba.njit(nogil=True, cache=True, error_model="numpy")
def sum_cells(between: Floats, cells: int) -> tuple[Array, Array, Array]:
    """Return number of pixels, sums (5, cells) and sum of the backscatter's squares of each cell.

    The sums are those of the rows of ``between`` (6, n) after the first one, which has the cells. Pixels too far from
    the mean of their cell are left out.
    """
    total, number, scatter = np.zeros(cells), np.zeros(cells), np.zeros(cells)
    n = between.shape[1]
    for i in range(n):
        k = int(between[0, i])
        number[k] += 1.0
        total[k] += between[3, i]
    # Remove outliers once, then sum.
    for i in range(n):
        k = int(between[0, i])
        off = between[3, i] - np.float32(total[k] / number[k])
        scatter[k] += off * off
    count, sums, squares = np.zeros(cells), np.zeros((5, cells)), np.zeros(cells)
    for i in range(n):
        k = int(between[0, i])
        off = between[3, i] - np.float32(total[k] / number[k])
        if abs(off) <= np.float32(OUTLIER_SIGMAS * np.sqrt(scatter[k] / number[k])):
            count[k] += 1.0
            squares[k] += between[3, i] * between[3, i]
            for a in range(5):
                sums[a, k] += between[1 + a, i]
    return count, sums, squares


def _swing(steps: NDArray[np.uint8]) -> Floats:
    """Return twice the modulation (n,) by four steps (4, n)."""
    i0, i1, i2, i3 = steps.astype(np.float32)
    return np.asarray(np.sqrt((i0 - i2) ** 2 + (i3 - i1) ** 2), np.float32)


def _contrast(steps: NDArray[np.uint8], cells: Cells) -> float | None:
    if not len(cells.number):
        return None
    modulation = 0.5 * float(np.mean(_swing(steps)))
    signal = float(cells.pixels @ cells.signal_dn / cells.pixels.sum())
    return 2.0 * modulation / signal if signal > 0.0 else None


def _passing(
    cell: NDArray[np.intp], directions: tuple[NDArray[np.uint8], NDArray[np.uint8]]
) -> tuple[float, float | None]:
    """Return flicker and share of specks by differing sums of opposite steps, which are equal for sines.

    The part common to all pixels is flicker. The second harmonic of the projector's response, which differs by blur, is
    fitted cell by cell. Residuals are compared with their own median, so that an even residual (by motion) is no speck.
    """
    if not len(cell):
        return 0.0, None
    struck = np.zeros(len(cell), np.bool_)
    common = []
    for steps in directions:
        flicker, scaled = disagreement(steps, cell, CELLS[0] * CELLS[1])
        common.append(flicker)
        struck |= scaled > np.float32(SPECK_SIGMAS * MAD_TO_SIGMA * median(scaled))
    return 0.5 * math.sqrt(sum(flicker_dn**2 for flicker_dn in common) / len(common)), float(np.mean(struck))


@numba.njit(nogil=True, cache=True, error_model="numpy")
def disagreement(steps: NDArray[np.uint8], cell: NDArray[np.intp], cells: int) -> tuple[float, Floats]:
    """Return the median difference of the sums of opposite ``steps`` (4, n), and its residuals (n,).

    A residual is the difference less median and second harmonic, over the root of the pixel's light.
    """
    n = cell.size
    # I0 + I2 − I1 − I3 is an integer: find its median by counting.
    off, count = np.empty(n, np.int64), np.zeros(2 * _MOST_OFF + 1, np.int64)
    second = np.empty(n, np.float32)
    for i in range(n):
        i0, i1, i2, i3 = np.int64(steps[0, i]), np.int64(steps[1, i]), np.int64(steps[2, i]), np.int64(steps[3, i])
        off[i] = i0 + i2 - i1 - i3
        count[off[i] + _MOST_OFF] += 1
        # cos 2φ in the units of the steps.
        cosine, sine = np.float32(i0 - i2), np.float32(i3 - i1)
        second[i] = (cosine - sine) * (cosine + sine) / np.sqrt(cosine * cosine + sine * sine)
    lower, upper, below = 0, 0, 0
    for value in range(count.size):
        # An even number of values has two middle ones.
        if 2 * below <= n - 1 < 2 * (below + count[value]):
            lower = value
        if 2 * below <= n < 2 * (below + count[value]):
            upper = value
        below += count[value]
    common = 0.5 * (lower + upper) - _MOST_OFF
    # The second harmonic is fitted by least squares in each cell.
    products, squares = np.zeros(cells), np.zeros(cells)
    for i in range(n):
        products[cell[i]] += (np.float32(off[i]) - np.float32(common)) * second[i]
        squares[cell[i]] += second[i] * second[i]
    scaled = np.empty(n, np.float32)
    for i in range(n):
        of_cell = np.float32(products[cell[i]] / max(squares[cell[i]], 1.0))
        light = np.float32(steps[0, i]) + np.float32(steps[1, i]) + np.float32(steps[2, i]) + np.float32(steps[3, i])
        # Photons: the noise grows with the root of the light.
        residual = np.float32(off[i]) - np.float32(common) - of_cell * second[i]
        scaled[i] = abs(residual) / np.sqrt(light + np.float32(1.0))
    return common, scaled
