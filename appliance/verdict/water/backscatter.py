"""Owns the backscatter of a scan: light that the water throws back, told from the object's by what Gray stripes do to both.

A camera's ray crosses the projector's beam for hundreds of millimetres, so that fine stripes across the baseline light half
of the water along it, whatever pixel they light at its end. In the middle of a dark stripe a pixel shows half of its backscatter
(above the dark reference), in the middle of an illuminated one half of it is missing (below the bright one): no projector's
response, no soft fringe, no albedo and no steady daylight is in these differences. Fringes of the other direction run along
the rays' way through the beam and are not asked.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from appliance.patterns.sequence import Direction, PatternSequence
from appliance.reconstruct.decode.decoder import CameraDecoder, Mask
from appliance.scan.noise import FULL_DN, MAD_TO_SIGMA, CameraNoise

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
"""Standard deviations of noise that stripes must change a pixel by: in bright light photons alone scatter by ``MIN_OBJECT_DN``."""
USUAL_CONTRAST = 0.8
"""Contrast of fringes in turbid water, where no pixel tells."""
SPECK_SIGMAS = 6.0
"""Standard deviations of the four steps' disagreement: one in 500 million by noise alone."""


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


def measure_backscatter(
    sequence: PatternSequence, frames: NDArray[np.uint8], decoded: CameraDecoder, noise: CameraNoise
) -> BackscatterSample:
    """Sample one camera's ``frames`` (n, h, w) uint8, whose grey values scatter by ``noise``."""
    rows, columns = decoded.p_px.shape
    across_px = max(1, int(math.sqrt(rows * columns / SAMPLES)))
    down_px = max(1, math.ceil(rows * columns / SAMPLES / across_px))
    at = (slice(down_px // 2, None, down_px), slice(across_px // 2, None, across_px))

    def seen(frame: int) -> Floats:
        return np.asarray(frames[frame][at], np.float32)

    bright, dark, mask = seen(sequence.bright), seen(sequence.dark), decoded.mask[at]
    shape = bright.shape
    across = sequence.axis(Direction.X)
    stripes = _useful_stripes(sequence.period_px, len(across.gray))
    gray = [seen(across.gray[bit]) for bit, _ in stripes]
    sums = bright + dark
    swing = sum((np.abs(2.0 * one - sums) for one in gray), np.zeros(shape, np.float32))
    # One swing is twice a frame less two others, so that its variance is six times that of a frame.
    scatter = np.sqrt(6.0 * len(stripes) * noise.variance_dn2(0.5 * sums))
    changed = swing > np.maximum(MIN_OBJECT_DN * len(stripes), OBJECT_SIGMAS * scatter)
    seen_object = changed & (bright < FULL_DN) & (mask != Mask.SATURATED)
    objects = int(np.count_nonzero(seen_object))
    valid = mask == Mask.VALID
    pixels = np.flatnonzero(valid & seen_object)
    j, i = np.divmod(pixels, shape[1])
    cell = cell_of(i, j, shape)
    p_px = decoded.p_px[at].ravel()[pixels]
    light, black = bright.ravel()[pixels], dark.ravel()[pixels]
    total, count = np.zeros(len(pixels), np.float32), np.zeros(len(pixels), np.float32)
    for (_, width_px), image in zip(stripes, gray, strict=True):
        place = (p_px + np.float32(0.5)) / np.float32(width_px) - np.float32(0.5)
        stripe = np.floor(place)
        here = image.ravel()[pixels]
        # Half of the backscatter: missing in the middle of an illuminated stripe, left in the middle of a dark one.
        half = np.where(stripe % 2.0 == 0.0, light - here, here - black)
        good = np.abs(place - stripe - np.float32(0.5)) < np.float32(0.5 - FROM_EDGE)
        total += good * half
        count += good
    judged = np.flatnonzero(count)
    u, v = i * across_px + across_px // 2, j * down_px + down_px // 2
    cells = _by_cell(
        cell[judged], np.stack([u, v], -1)[judged], 2.0 * total[judged] / count[judged],
        (light - black)[judged], black[judged],
    )  # fmt: skip
    # All projected light on the object's pixels: its own and the backscatter.
    of_light = float(cells.pixels @ (cells.signal_dn + cells.backscatter_dn))
    sines = [[seen(k) for k in sequence.axis(direction).sine] for direction in Direction]
    steps = [[one.ravel()[pixels] for one in axis] for axis in sines]
    flicker_dn, speck_share = _passing(cell, steps)
    contrast = _contrast(steps[0], cells)
    i0, i1, i2, i3 = sines[0]
    fringe_dn = np.hypot(i0 - i2, i3 - i1) / np.float32(contrast or USUAL_CONTRAST)
    hidden = int(np.count_nonzero(seen_object & ~valid & (2.0 * fringe_dn < bright - dark)))
    return BackscatterSample(
        cells,
        float(np.clip(cells.pixels @ cells.backscatter_dn / of_light, 0.0, 1.0)) if of_light > 0.0 else None,
        objects,
        objects / seen_object.size,
        1.0 - len(pixels) / objects if objects else None,
        hidden / objects if objects else None,
        contrast,
        flicker_dn,
        speck_share,
    )


def _useful_stripes(period_px: int, bits: int) -> list[tuple[int, float]]:
    """Return (bit, stripe width in px) of the Gray images whose stripes are neither too fine nor too coarse."""
    widths = [(bit, float(period_px * 2 ** (bits - 1 - bit))) for bit in range(bits)]
    chosen = [(bit, width) for bit, width in widths if STRIPES_PX[0] <= width <= STRIPES_PX[1]]
    return chosen or [widths[-1]]


def cell_of(u: NDArray[np.intp], v: NDArray[np.intp], shape: tuple[int, int]) -> NDArray[np.intp]:
    """Return the numbers (n,) of the cells of pixels (n,) of an image (h, w)."""
    return v * CELLS[1] // shape[0] * CELLS[0] + u * CELLS[0] // shape[1]


def _by_cell(cell: NDArray[np.intp], uv: NDArray[np.intp], backscatter: Floats, light: Floats, dark: Floats) -> Cells:
    size = CELLS[0] * CELLS[1]

    def mean(values: NDArray[Any], among: NDArray[np.intp], count: Array) -> Array:
        return np.asarray(np.bincount(among, values, size) / np.maximum(count, 1.0))

    count = np.bincount(cell, minlength=size).astype(np.float64)
    # One round of clipping; then means and standard errors of what is kept.
    off = backscatter - mean(backscatter, cell, count).astype(np.float32)[cell]
    spread = np.sqrt(mean(off * off, cell, count))
    keep = np.abs(off) <= (OUTLIER_SIGMAS * spread).astype(np.float32)[cell]
    among, backscatter = cell[keep], backscatter[keep]
    count = np.bincount(among, minlength=size).astype(np.float64)
    centre = mean(backscatter, among, count)
    spread = np.sqrt(np.maximum(mean(backscatter * backscatter, among, count) - centre**2, 0.0))
    enough = np.flatnonzero(count >= MIN_PER_CELL)
    return Cells(
        enough,
        count[enough],
        np.stack([mean(uv[keep, k], among, count)[enough] for k in (0, 1)], -1),
        centre[enough],
        spread[enough] / np.sqrt(count[enough]),
        (mean(light[keep], among, count) - centre)[enough],
        mean(dark[keep], among, count)[enough],
    )


def _contrast(steps: list[Floats], cells: Cells) -> float | None:
    if not len(cells.number):
        return None
    i0, i1, i2, i3 = steps
    modulation = 0.5 * float(np.mean(np.hypot(i0 - i2, i3 - i1)))
    signal = float(cells.pixels @ cells.signal_dn / cells.pixels.sum())
    return 2.0 * modulation / signal if signal > 0.0 else None


def _passing(cell: NDArray[np.intp], directions: list[list[Floats]]) -> tuple[float, float | None]:
    """Return flicker and share of specks, by how far opposite steps have different sums: a pure fringe has none.

    What all pixels share is flicker. The second harmonic of the projector's response, softer here and there, is fitted
    cell by cell. The scale of what remains is its own, so that what is alike everywhere (motion) is no speck.
    """
    if not len(cell):
        return 0.0, None
    size = CELLS[0] * CELLS[1]
    struck = np.zeros(len(cell), np.bool_)
    common = []
    for i0, i1, i2, i3 in directions:
        even, odd = i0 + i2, i1 + i3
        off = even - odd
        common.append(float(np.median(off)))
        off -= np.float32(common[-1])
        # Second harmonic: cos 2φ in the units of the steps, fitted by least squares in each cell.
        cosine, sine = i0 - i2, i3 - i1
        second = (cosine - sine) * (cosine + sine) / np.hypot(cosine, sine)
        of_cell = np.bincount(cell, off * second, size) / np.maximum(np.bincount(cell, second * second, size), 1.0)
        off -= of_cell.astype(np.float32)[cell] * second
        # Photons: the scatter grows with the root of the light.
        scaled = np.abs(off) / np.sqrt(even + odd + np.float32(1.0))
        struck |= scaled > np.float32(SPECK_SIGMAS * MAD_TO_SIGMA) * np.median(scaled)
    return 0.5 * math.sqrt(sum(one**2 for one in common) / len(common)), float(np.mean(struck))
