"""Owns the veil of a scan: light that the water throws back, told from the object's by what Gray stripes do to both.

A camera's ray crosses the projector's beam for hundreds of millimetres, so that fine stripes across the baseline light half
of the water along it, whatever pixel they light at its end. In the middle of a dark stripe a pixel shows half of its veil
(above the dark reference), in the middle of a lit one half of it is missing (below the bright one): no projector's
response, no soft fringe, no albedo and no steady daylight is in these differences. Fringes of the other direction run along
the rays' way through the beam and are not asked.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from appliance.patterns.sequence import Direction, PatternSequence
from appliance.reconstruct.decode import CameraDecoder, Mask

Array = NDArray[np.float64]
Floats = NDArray[np.float32]

CELLS = (16, 12)
"""Columns and rows of cells over the image: within one, veil and distance hardly change."""
SAMPLES = 80_000
"""Pixels asked, at most; on an even grid."""
STRIPES_PX = (32.0, 64.0)
"""Widths of the stripes that are asked, pattern px: fine for the water, wide for what blurs their borders."""
FROM_EDGE = 0.35
"""Distance from a stripe's borders, in widths: half is its middle. 11 px of a stripe of 32."""
MIN_PER_CELL = 25
OUTLIER_SIGMAS = 4.0
MIN_OBJECT_DN = 6.0
"""Stripes that change a pixel by less light no object that could be measured."""
SATURATED_DN = 255.0
SPECK_SIGMAS = 6.0
"""Of the four steps' disagreement: one in 500 million by noise alone."""


@dataclass(frozen=True, slots=True)
class Cells:
    """Means of the cells in which enough pixels could be asked, n of them; light in grey values (DN)."""

    number: NDArray[np.intp]
    """(n,): row · CELLS[0] + column."""
    uv_px: Array
    """(n, 2): mean image point of the pixels asked."""
    veil_dn: Array
    """(n,): of the bright frame."""
    sigma_dn: Array
    """(n,): standard error of ``veil_dn`` by the scatter within the cell."""
    signal_dn: Array
    """(n,): what the object adds to the bright frame."""
    dark_dn: Array
    """(n,): of the dark frame."""


@dataclass(frozen=True, slots=True)
class Looked:
    """One camera's frames as the water left them."""

    cells: Cells
    veil_share: float | None
    """Of the projected light that the object's pixels show, 0..1; ``None`` where nothing could be asked."""
    object_pixels: int
    """Sampled pixels that show an object and are not saturated."""
    masked_share: float | None
    """Of them, those without coordinates."""
    fringe_contrast: float | None
    """Modulation of the fringes in halves of the object's light: what blur and the projector's response leave of it."""
    flicker_dn: float
    """Ambient light on the object from one frame to another, rms, as the sums of opposite steps tell it."""
    speck_share: float | None
    """Of pixels with coordinates, those in which the four steps of a direction disagree."""


def look_at_veil(sequence: PatternSequence, frames: NDArray[np.uint8], decoded: CameraDecoder) -> Looked:
    """Sample one camera's ``frames`` (n, h, w) uint8."""
    rows, columns = decoded.p_px.shape
    across_px = max(1, int(math.sqrt(rows * columns / SAMPLES)))
    down_px = max(1, math.ceil(rows * columns / SAMPLES / across_px))
    at = (slice(down_px // 2, None, down_px), slice(across_px // 2, None, across_px))

    def seen(frame: int) -> Floats:
        return np.asarray(frames[frame][at], np.float32)

    bright, dark = seen(sequence.bright), seen(sequence.dark)
    mask, p_px = decoded.mask[at], decoded.p_px[at]
    lit_dn = bright - dark
    unsaturated = bright < SATURATED_DN
    across = sequence.axis(Direction.X)
    total, count = np.zeros(p_px.shape, np.float32), np.zeros(p_px.shape, np.uint8)
    swing = np.zeros(p_px.shape, np.float32)
    asked = _asked(sequence.period_px, len(across.gray))
    known = np.nan_to_num(p_px, nan=-1e6) + np.float32(0.5)
    for bit, width_px in asked:
        gray = seen(across.gray[bit])
        place = np.mod(known - np.float32(0.5 * width_px), np.float32(2.0 * width_px))
        lit = place < width_px
        inside = np.mod(place, np.float32(width_px)) / np.float32(width_px)
        good = (np.abs(inside - np.float32(0.5)) < 0.5 - FROM_EDGE) & (known > 0.0) & unsaturated
        half = np.where(lit, bright - gray, gray - dark)
        total += np.where(good, half, np.float32(0.0))
        count += good
        swing += np.abs(2.0 * gray - bright - dark)
    seen_object = (swing > MIN_OBJECT_DN * len(asked)) & unsaturated & (mask != Mask.SATURATED)
    objects = int(np.count_nonzero(seen_object))
    valid = mask == Mask.VALID
    chosen = np.flatnonzero((count > 0) & valid)
    veil_dn: Floats = np.divide(total.ravel()[chosen], 0.5 * count.ravel()[chosen], dtype=np.float32)
    j, i = np.divmod(chosen, p_px.shape[1])
    u, v = i * across_px + across_px // 2, j * down_px + down_px // 2
    cells = _by_cell(u, v, (rows, columns), veil_dn, lit_dn.ravel()[chosen], dark.ravel()[chosen])
    of_light = float(np.sum(cells.signal_dn + cells.veil_dn))
    sines = [seen(frame) for frame in across.sine]
    flicker_dn, speck_share = _passing(valid, [sines, [seen(frame) for frame in sequence.axis(Direction.Y).sine]])
    return Looked(
        cells,
        float(np.clip(np.sum(cells.veil_dn) / of_light, 0.0, 1.0)) if of_light > 0.0 else None,
        objects,
        1.0 - float(np.count_nonzero(seen_object & valid)) / objects if objects else None,
        _contrast(sines, cells, chosen),
        flicker_dn,
        speck_share,
    )


def _asked(period_px: int, bits: int) -> list[tuple[int, float]]:
    """(bit, stripe width in px) of the Gray images whose stripes are neither too fine nor too coarse."""
    widths = [(bit, float(period_px * 2 ** (bits - 1 - bit))) for bit in range(bits)]
    chosen = [(bit, width) for bit, width in widths if STRIPES_PX[0] <= width <= STRIPES_PX[1]]
    return chosen or [widths[-1]]


def cell_of(u: NDArray[np.intp], v: NDArray[np.intp], shape: tuple[int, int]) -> NDArray[np.intp]:
    """Numbers (n,) of the cells of pixels (n,) of an image (h, w)."""
    return v * CELLS[1] // shape[0] * CELLS[0] + u * CELLS[0] // shape[1]


def _by_cell(
    u: NDArray[np.intp], v: NDArray[np.intp], shape: tuple[int, int], veil: Floats, lit: Floats, dark: Floats
) -> Cells:
    cell = cell_of(u, v, shape)
    size = CELLS[0] * CELLS[1]

    def mean(values: NDArray[np.floating] | NDArray[np.intp], among: NDArray[np.intp], count: Array) -> Array:
        return np.asarray(np.bincount(among, values, size) / np.maximum(count, 1.0))

    count = np.bincount(cell, minlength=size).astype(np.float64)
    centre = mean(veil, cell, count)
    off = veil - centre[cell]
    spread = np.sqrt(mean(off * off, cell, count))
    keep = np.abs(off) <= OUTLIER_SIGMAS * spread[cell]
    among = cell[keep]
    count = np.bincount(among, minlength=size).astype(np.float64)
    centre = mean(veil[keep], among, count)
    off = veil[keep] - centre[among]
    spread = np.sqrt(mean(off * off, among, count))
    enough = np.flatnonzero(count >= MIN_PER_CELL)
    uv = np.stack([mean(u[keep], among, count), mean(v[keep], among, count)], -1)
    return Cells(
        enough,
        uv[enough],
        centre[enough],
        spread[enough] / np.sqrt(count[enough]),
        (mean(lit[keep], among, count) - centre)[enough],
        mean(dark[keep], among, count)[enough],
    )


def _contrast(sines: list[Floats], cells: Cells, chosen: NDArray[np.intp]) -> float | None:
    if not len(cells.number) or not len(chosen):
        return None
    i0, i1, i2, i3 = (sine.ravel()[chosen] for sine in sines)
    modulation = 0.5 * float(np.mean(np.hypot(i0 - i2, i3 - i1)))
    signal = float(np.mean(cells.signal_dn))
    return 2.0 * modulation / signal if signal > 0.0 else None


def _passing(valid: NDArray[np.bool_], directions: list[list[Floats]]) -> tuple[float, float | None]:
    """Flicker and share of specks, by how far opposite steps have different sums: a pure fringe has none.

    What all pixels share is flicker. The second harmonic of the projector's response, softer here and there, is fitted cell
    by cell. The scale of what remains is its own, so that what is alike everywhere (motion) is no speck.
    """
    if not valid.any():
        return 0.0, None
    v, u = np.nonzero(valid)
    cell = cell_of(u, v, valid.shape)
    size = CELLS[0] * CELLS[1]
    struck = np.zeros(len(cell), np.bool_)
    common = []
    for i0, i1, i2, i3 in directions:
        even, odd = (i0 + i2)[valid], (i1 + i3)[valid]
        off = even - odd
        common.append(float(np.median(off)))
        off -= np.float32(common[-1])
        cosine, sine = (i0 - i2)[valid], (i3 - i1)[valid]
        second = (cosine - sine) * (cosine + sine) / np.hypot(cosine, sine)
        of_cell = np.bincount(cell, off * second, size) / np.maximum(np.bincount(cell, second * second, size), 1.0)
        off -= of_cell.astype(np.float32)[cell] * second
        # Photons: the scatter grows with the root of the light.
        scaled = np.abs(off) / np.sqrt(even + odd + np.float32(1.0))
        struck |= scaled > np.float32(SPECK_SIGMAS * 1.4826) * np.median(scaled)
    return 0.5 * math.sqrt(sum(one**2 for one in common) / len(common)), float(np.mean(struck))
