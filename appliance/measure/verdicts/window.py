"""The verdict ``windows``: where the port of one camera reduces the contrast of its fringes.

Fog, a scratch or dirt on a port scatters light: fringes lose contrast there, the mean grey value hardly changes.
Contrast is also lost on the object (light from one part of it on another, a blurred projector) and in the water. But
both cameras see the loss on the object at the same pattern coordinates. So both are compared, cell by cell of the
pattern. The backscatter differs between them, but smoothly over the image; so a plane is subtracted first. The residual
in a cell of the image is due to the port if it stays there while the scene changes, which
``appliance.instrument.service.worker_reports`` watches.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numba
import numpy as np
from numpy.typing import NDArray

from appliance.measure.decode.decoder import Mask
from appliance.measure.light.noise import FULL_DN
from appliance.measure.light.patterns import Direction, PatternSequence
from appliance.measure.light.sides import SIDES
from appliance.measure.scan_images import PixelGrid, ScanImages
from appliance.measure.verdict import Verdict
from appliance.measure.verdicts.light.fit import medians_of

Array = NDArray[np.float64]
Floats = NDArray[np.float32]

NAME = "windows"
CELLS = (8, 6)
"""Columns and rows of cells over each image; a smaller spot on the port is blurred over one."""
PLACES = (24, 18)
"""Columns and rows of cells over the pattern, by which the cameras are compared."""
SAMPLES = 40_000
"""Number of pixels of each camera, at most."""
MIN_PER_CELL, MIN_PER_PLACE = 40, 12
MIN_CELLS = 12
"""Least number of cells for detecting a local loss of contrast."""
MIN_LIGHT_DN = 16.0
"""Least bright minus dark; below, the contrast is noise."""
ROUNDS, TUNED = 6, 0.03
"""Iterations of the robust fit, and the loss of contrast from which on a cell counts less."""
SLACK = 0.08
"""Loss of contrast that is allowed in every cell: three times that of a clean port for any object in clear water."""
USUAL_QUANTILE, USUAL = 0.65, 2.0
"""Quantile of the cells' losses, and its factor that is allowed: in turbid water the pattern of the backscatter
remains."""
_FULL, _NO_REASON = np.uint8(FULL_DN), np.uint8(Mask.VALID)


@dataclass(frozen=True, slots=True)
class Windows:
    """Contrast of one scan by side ``left`` and ``right``; arrays (CELLS[0] · CELLS[1],), cells by row."""

    falls: Mapping[str, Array]
    """Share of the contrast that is missing in each cell; NaN where it is unknown."""
    wholes: Mapping[str, float | None]
    """The same of the port as a whole, compared with the other one; ``None`` if it is unknown."""
    forgiven: Mapping[str, float]
    """Loss of contrast that is allowed in this scan."""
    light: Mapping[str, Array]
    """Mean light of the object in each cell, DN; 0 where no object is seen. It distinguishes scenes."""

    def verdict(self) -> Verdict:
        """Return the verdict to store; ``passed`` is always None, since one scan does not decide."""
        numbers: dict[str, float | None] = {}
        parts = []
        for side in SIDES:
            falls = self.falls[side]
            is_known = bool(np.isfinite(falls).any())
            worst = int(np.nanargmax(falls)) if is_known else 0
            whole_fall = self.wholes[side]
            numbers[f"{side}_fall_percent"] = 100.0 * float(falls[worst]) if is_known else None
            numbers[f"{side}_column"] = float(worst % CELLS[0]) if is_known else None
            numbers[f"{side}_row"] = float(worst // CELLS[0]) if is_known else None
            numbers[f"{side}_whole_percent"] = None if whole_fall is None else 100.0 * whole_fall
            numbers[f"{side}_forgiven_percent"] = 100.0 * self.forgiven[side]
            if is_known:
                parts.append(f"{side} at most {100.0 * float(falls[worst]):.0f} % softer in a cell")
        return Verdict(NAME, None, numbers, ", ".join(parts) or "too few points of both cameras to judge the windows")


def window_grid(sequence: PatternSequence) -> PixelGrid:
    """Return the grid of pixels by which ports are judged: bright, dark, the sines of X and Y."""
    sines = [k for direction in Direction for k in sequence.axis(direction).sine]

    def steps(rows: int, columns: int) -> tuple[int, int]:
        step = max(1, math.ceil(math.sqrt(rows * columns / SAMPLES)))
        return step, step

    return PixelGrid([sequence.bright, sequence.dark, *sines], steps)


def look_at_windows(images: ScanImages, grids: Mapping[str, PixelGrid] | None = None) -> Windows:
    """Compare the contrast of the cameras' fringes, cell by cell of the pattern.

    ``grids``: those of both sides if they were filled while the frames arrived.
    """
    grids = grids or {side: window_grid(images.sequence).take_all(images.frames[side]) for side in SIDES}
    samples = {side: _look(images, side, grids[side]) for side in SIDES}
    falls: dict[str, Array] = {}
    wholes: dict[str, float | None] = {}
    forgiven: dict[str, float] = {}
    for side, other_side in (SIDES, SIDES[::-1]):
        falls[side], wholes[side] = _falls(samples[side], samples[other_side])
        finite = falls[side][np.isfinite(falls[side])]
        usual = float(np.quantile(np.abs(finite), USUAL_QUANTILE)) if len(finite) else 0.0
        forgiven[side] = max(SLACK, USUAL * usual)
    return Windows(falls, wholes, forgiven, {side: samples[side].light for side in SIDES})


@dataclass(frozen=True, slots=True)
class _PixelSample:
    """Sampled pixels of one camera that have coordinates, n of them."""

    contrast: Floats
    cell: NDArray[np.intp]
    place: NDArray[np.intp]
    light: Array
    """Mean light of the object by cell, DN."""


def _look(images: ScanImages, side: str, grid: PixelGrid) -> _PixelSample:
    decoded, sequence = images.decoded[side], images.sequence
    mask = decoded.mask[grid.at]
    row, column = (np.arange(n) * m // n for n, m in zip(mask.shape, CELLS[::-1], strict=True))
    places_per_px = (np.float32(PLACES[0] / sequence.width_px), np.float32(PLACES[1] / sequence.height_px))
    contrast, cell, place, total = ask(
        grid.grey, mask, decoded.p_px[grid.at], decoded.q_px[grid.at], CELLS[0] * row, column, places_per_px
    )
    return _PixelSample(contrast, cell, place, total / max(1.0, mask.size / len(total)))


@numba.njit(nogil=True, cache=True, error_model="numpy")
def ask(
    grey: NDArray[np.uint8],
    mask: NDArray[np.uint8],
    p_px: Floats,
    q_px: Floats,
    cell_row: NDArray[np.int64],
    cell_column: NDArray[np.int64],
    places_per_px: tuple[np.float32, np.float32],
) -> tuple[Floats, NDArray[np.int64], NDArray[np.int64], Array]:
    """Return contrast, image cell and pattern cell of the pixels (h, w) with coordinates and enough light.

    Each is (n,); the fourth result is the sum of light of each image cell. ``grey`` (10, h, w): bright, dark, sines.
    The image cell is the sum of ``cell_row`` and ``cell_column``.
    """
    rows, columns = mask.shape
    contrast = np.empty(mask.size, np.float32)
    cell, place = np.empty(mask.size, np.int64), np.empty(mask.size, np.int64)
    total = np.zeros(CELLS[0] * CELLS[1])
    n = 0
    for j in range(rows):
        for i in range(columns):
            light = np.float32(grey[0, j, i]) - np.float32(grey[1, j, i])
            if mask[j, i] != _NO_REASON or grey[0, j, i] >= _FULL or not light > np.float32(MIN_LIGHT_DN):
                continue
            # 2 B of each direction; over twice the light it is the contrast.
            swing = np.float32(0.0)
            for k in (2, 6):
                cosine = np.float32(grey[k, j, i]) - np.float32(grey[k + 2, j, i])
                sine = np.float32(grey[k + 1, j, i]) - np.float32(grey[k + 3, j, i])
                swing += np.sqrt(cosine * cosine + sine * sine)
            contrast[n] = np.float32(0.5) * swing / light
            cell[n] = cell_row[j] + cell_column[i]
            total[cell[n]] += light
            # The cell of the pattern; pixels a little beyond its borders belong to the outermost cells.
            across = min(max(int(p_px[j, i] * places_per_px[0]), 0), PLACES[0] - 1)
            down = min(max(int(q_px[j, i] * places_per_px[1]), 0), PLACES[1] - 1)
            place[n] = down * PLACES[0] + across
            n += 1
    return contrast[:n].copy(), cell[:n].copy(), place[:n].copy(), total


def _falls(mine: _PixelSample, theirs: _PixelSample) -> tuple[Array, float | None]:
    """Return the share of contrast that these fringes lack against the other camera's, by cell and in all.

    Both are compared in the same cell of the pattern. The cells (cells,) are NaN, and the value of all is ``None``,
    where they are unknown.
    """
    count = np.bincount(theirs.place, minlength=PLACES[0] * PLACES[1])
    mean = np.bincount(theirs.place, theirs.contrast, PLACES[0] * PLACES[1]) / np.maximum(count, 1)
    is_known = count[mine.place] >= MIN_PER_PLACE
    cell, ratio = mine.cell[is_known], mine.contrast[is_known] / mean[mine.place[is_known]]
    size = CELLS[0] * CELLS[1]
    ratios, falls = np.full(size, np.nan), np.full(size, np.nan)
    order = np.argsort(cell.astype(np.uint8), kind="stable")  # a byte is sorted by counting
    borders = np.searchsorted(cell[order], np.arange(size + 1))
    pixels = np.diff(borders)
    enough = pixels >= MIN_PER_CELL
    ratios[enough] = medians_of(ratio, order[np.repeat(enough, pixels)], np.cumsum(pixels[enough]))
    judged = np.flatnonzero(np.isfinite(ratios))
    if len(judged) < MIN_CELLS:
        return falls, None
    falls[judged] = 1.0 - ratios[judged] / _smooth(judged, ratios[judged])
    return falls, 1.0 - float(np.median(ratios[judged]))


def _smooth(cells: NDArray[np.intp], ratios: Array) -> Array:
    """Return a robust fit of a plane over the image to the ratios of the cells."""
    x, y = cells % CELLS[0] / (CELLS[0] - 1.0) - 0.5, cells // CELLS[0] / (CELLS[1] - 1.0) - 0.5
    A = np.stack([np.ones_like(x), x, y], -1)
    fit = np.full(len(cells), np.median(ratios))
    for _ in range(ROUNDS):
        # Cauchy weights: a cell that lacks contrast hardly pulls the plane.
        weight = 1.0 / (1.0 + ((ratios / fit - 1.0) / TUNED) ** 2)
        rooted = np.sqrt(weight)
        fit = A @ np.linalg.lstsq(A * rooted[:, None], ratios * rooted, rcond=None)[0]
        fit = np.maximum(fit, 0.1)
    return np.asarray(fit)
