"""Owns the backscatter of a scan: light that the water throws back, told from the object's by what Gray stripes do to
both.

A camera's ray crosses the projector's beam for hundreds of millimetres, so that fine stripes across the baseline light
half of the water along it, whatever pixel they light at its end. In the middle of a dark stripe a pixel shows half of
its backscatter (above the dark reference), in the middle of an illuminated one half of it is missing (below the bright
one): no projector's response, no soft fringe, no albedo and no steady daylight is in these differences. Fringes of the
other direction run along the rays' way through the beam and are not asked.
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
"""Pixels asked, at most; on an even grid."""
STRIPES_PX = (32.0, 64.0)
"""Widths of the stripes that are asked, pattern px: fine for the water, wide for what blurs their borders."""
FROM_EDGE = 0.35
"""Distance from a stripe's borders, in widths: half is its middle. 11 px of a stripe of 32."""
MIN_PER_CELL = 25
OUTLIER_SIGMAS = 4.0
MIN_OBJECT_DN = 6.0
"""Stripes that change a pixel by less light no object that could be measured."""
OBJECT_SIGMAS = 4.0
"""Standard deviations of noise that stripes must change a pixel by: in bright light photons alone scatter by
``MIN_OBJECT_DN``."""
USUAL_CONTRAST = 0.8
"""Contrast of fringes in turbid water, where no pixel tells."""
SPECK_SIGMAS = 6.0
"""Standard deviations of the four steps' disagreement: one in 500 million by noise alone."""
_FULL, _NO_REASON, _SATURATED = np.uint8(FULL_DN), np.uint8(Mask.VALID), np.uint8(Mask.SATURATED)
_MOST_OFF = 2 * FULL_DN
"""Largest difference of the sums of opposite steps."""


@dataclass(frozen=True, slots=True)
class Cells:
    """Means of the cells in which enough pixels could be asked, n of them; light in grey values (DN)."""

    number: NDArray[np.intp]
    """(n,): row · CELLS[0] + column."""
    pixels: Array
    """(n,): how many."""
    uv_px: Array
    """(n, 2): mean image point of the pixels asked."""
    backscatter_dn: Array
    """(n,): of the bright frame."""
    sigma_dn: Array
    """(n,): standard error of ``backscatter_dn`` by the scatter within the cell."""
    signal_dn: Array
    """(n,): what the object adds to the bright frame."""
    dark_dn: Array
    """(n,): of the dark frame."""


@dataclass(frozen=True, slots=True)
class BackscatterSample:
    """One camera's frames as the water left them."""

    cells: Cells
    backscatter_share: float | None
    """Backscatter as a share of the projected light that the object's pixels show, 0..1; ``None`` where nothing
    could be asked."""
    object_pixels: int
    """Sampled pixels that show an object and are not saturated."""
    object_share: float
    """Share of all sampled pixels that these are."""
    masked_share: float | None
    """Share of them without coordinates."""
    hidden_share: float | None
    """Share of them that have no coordinates and show, by their weak fringes, more backscatter than object."""
    fringe_contrast: float | None
    """Modulation of the fringes in halves of the object's light: what blur and the projector's response leave of it."""
    flicker_dn: float
    """Ambient light on the object from one frame to another, rms, as the sums of opposite steps tell it."""
    speck_share: float | None
    """Share of the pixels with coordinates in which the four steps of a direction disagree."""


def water_grid(sequence: PatternSequence) -> PixelGrid:
    """Return the grid of pixels by which the water is judged: bright, dark, the Gray images that are asked, the sines
    of X and Y."""
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
    """Sample one camera's sequence, of which ``grid`` was taken (``water_grid``) and whose grey values scatter by
    ``noise``."""
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
    """Return how many pixels (h, w) show an object; of those without coordinates twice the modulation and the light,
    (2, n); of those with coordinates the cell (m,) and the sines (8, m); and of those between stripes (6, k): cell,
    column, row, backscatter, light, dark.

    ``grey`` (2 + stripes + 8, h, w): bright, dark, Gray images with stripes of ``widths_px``, sines. ``least_dn``
    (511,): the swing that an object's pixel has at least, by the sum of bright and dark. The cell is the sum of
    ``cell_row`` and ``cell_column``.
    """
    rows, columns = mask.shape
    stripes, room = widths_px.size, mask.size
    lost, between = np.empty((2, room), np.float32), np.empty((6, room), np.float32)
    cell, steps = np.empty(room, np.int64), np.empty((8, room), np.uint8)
    half, in_middle, two = np.float32(0.5), np.float32(0.5 - FROM_EDGE), np.float32(2.0)
    # How many pixels of each kind there are by now.
    objects, n, m, told = 0, 0, 0, 0
    for j in range(rows):
        for i in range(columns):
            bright, dark = np.float32(grey[0, j, i]), np.float32(grey[1, j, i])
            swing = np.float32(0.0)
            for k in range(stripes):
                swing += abs(two * np.float32(grey[2 + k, j, i]) - (bright + dark))
            # An object is what stripes change by more than noise.
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
            # What has coordinates is remembered with its fringes.
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
                    here = np.float32(grey[2 + k, j, i])
                    total += bright - here if int(stripe) % 2 == 0 else here - dark
                    count += np.float32(1.0)
            # Both stripes' halves count alike.
            if count > np.float32(0.0):
                between[0, told], between[1, told], between[2, told] = cell[m - 1], i, j
                between[3, told], between[4, told], between[5, told] = two * total / count, bright - dark, dark
                told += 1
    return objects, lost[:, :n].copy(), cell[:m].copy(), steps[:, :m].copy(), between[:, :told].copy()


def warm_up() -> None:
    """Run the kernel that a scan of nothing does not need."""
    disagreement(np.zeros((4, 1), np.uint8), np.zeros(1, np.intp), 1)


def _useful_stripes(period_px: int, bits: int) -> list[tuple[int, float]]:
    """Return (bit, stripe width in px) of the Gray images whose stripes are neither too fine nor too coarse."""
    widths = [(bit, float(period_px * 2 ** (bits - 1 - bit))) for bit in range(bits)]
    chosen = [(bit, width) for bit, width in widths if STRIPES_PX[0] <= width <= STRIPES_PX[1]]
    return chosen or [widths[-1]]


def cell_of(u: NDArray[np.intp], v: NDArray[np.intp], shape: tuple[int, int]) -> NDArray[np.intp]:
    """Return the numbers (n,) of the cells of pixels (n,) of an image (h, w)."""
    return v * CELLS[1] // shape[0] * CELLS[0] + u * CELLS[0] // shape[1]


def _by_cell(between: Floats, grid: PixelGrid) -> Cells:
    """Return the cells of what ``_ask`` found between stripes."""
    count, sums, squares = sum_cells(between, CELLS[0] * CELLS[1])
    enough = np.flatnonzero(count >= MIN_PER_CELL)
    pixels = count[enough]
    column, row, centre, light, dark = sums[:, enough] / pixels
    spread = np.sqrt(np.maximum(squares[enough] / pixels - centre**2, 0.0))
    # From places on the grid to pixels of the image.
    u = grid.across_px * column + grid.across_px // 2
    v = grid.down_px * row + grid.down_px // 2
    return Cells(enough, pixels, np.stack([u, v], -1), centre, spread / np.sqrt(pixels), light - centre, dark)


@numba.njit(nogil=True, cache=True, error_model="numpy")
def sum_cells(between: Floats, cells: int) -> tuple[Array, Array, Array]:
    """Return of each cell the number of pixels, the sums (5, cells) of the rows of ``between`` (6, n) behind its first
    one, which names their cells, and that of the backscatter's squares; pixels too far from their cell's mean are left
    out."""
    total, number, scatter = np.zeros(cells), np.zeros(cells), np.zeros(cells)
    n = between.shape[1]
    for i in range(n):
        k = int(between[0, i])
        number[k] += 1.0
        total[k] += between[3, i]
    # One round of clipping; then the sums of what is kept.
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
    """Return (n,) twice the modulation by four steps (4, n)."""
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
    """Return flicker and share of specks, by how far opposite steps have different sums: a pure fringe has none.

    What all pixels share is flicker. The second harmonic of the projector's response, softer here and there, is fitted
    cell by cell. The scale of what remains is its own, so that what is alike everywhere (motion) is no speck.
    """
    if not len(cell):
        return 0.0, None
    struck = np.zeros(len(cell), np.bool_)
    common = []
    for steps in directions:
        flicker, scaled = disagreement(steps, cell, CELLS[0] * CELLS[1])
        common.append(flicker)
        struck |= scaled > np.float32(SPECK_SIGMAS * MAD_TO_SIGMA * median(scaled))
    return 0.5 * math.sqrt(sum(one**2 for one in common) / len(common)), float(np.mean(struck))


@numba.njit(nogil=True, cache=True, error_model="numpy")
def disagreement(steps: NDArray[np.uint8], cell: NDArray[np.intp], cells: int) -> tuple[float, Floats]:
    """Return how far the opposite ``steps`` (4, n) have different sums in the median, and what of that each pixel has
    beyond median and second harmonic, over the root of its light (n,)."""
    n = cell.size
    # I0 + I2 − I1 − I3 is a whole number, whose median is counted.
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
        # Of an even number of values there are two middle ones.
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
        # Photons: the scatter grows with the root of the light.
        rest = np.float32(off[i]) - np.float32(common) - of_cell * second[i]
        scaled[i] = abs(rest) / np.sqrt(light + np.float32(1.0))
    return common, scaled
