"""Owns where the edges of the Gray stripes stood, frame by frame, against the phase that the sine images found afterwards.

A pixel's grey value between dark and bright says on which side of a stripe's edge it is, and near the edge how far. The
phase says the same, some frames later. What the edges have moved in between is the movement over that time: less precise
than the drift within the sine images, but frame by frame, so that a tremor differs from a steady movement.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numba
import numpy as np
from numpy.typing import NDArray

from appliance.measure.decode.decoder import CameraDecoder
from appliance.measure.light.sequence import Direction, PatternSequence
from appliance.measure.verdicts.motion.cells import CELL_PX

INNER_PX, REACH_PX = 4.5, 7.5
"""Pattern px beside an edge: within the first, the light that an edge has moved is added up; from there to the second, how
dark and how light its sides are. Blur stays within the first; the next edge is 16 px away at least."""
SAMPLES = 60_000
"""Pixels of a camera that are looked at, about."""
# Symbols of the kernel. way is +1 where light begins at the edge, −1 where it ends; beside is the distance from the
# edge towards the light, pattern px; brightness is the image's value from dark (0) to bright (1). The sums hold, for the inner
# part and for the dark and the bright side, how many pixels there are and their light; and the light of an ideal,
# unmoved edge.

_COLUMNS = 8
_INNER, _INNER_LIT, _INNER_STEP, _INNER_WAY, _LOW, _LOW_LIT, _HIGH, _HIGH_LIT = range(_COLUMNS)
MIN_PIXELS, MIN_HEIGHT = 10, 0.3
"""Least number of pixels in each of the three parts; and least step from dark to light, as a share of bright less
dark."""


@dataclass(frozen=True, slots=True)
class EdgeShifts:
    """One camera's edges; arrays (frames, rows, columns) float64 of the Gray images and the pattern's cells."""

    shift_px: NDArray[np.float64]
    """Excess of the pixels' coordinates in that frame over those in the sine images, pattern px; NaN: no edge there."""


@numba.njit(nogil=True, cache=True, error_model="numpy")
def _accumulate(
    frames: NDArray[np.uint8],
    references: tuple[int, int],
    gray: NDArray[np.int64],
    p_px: NDArray[np.float32],
    q_px: NDArray[np.float32],
    edges_px: NDArray[np.float32],
    rises: NDArray[np.float32],
    stride: int,
    cell_px: float,
    sums: NDArray[np.float64],
) -> None:
    """Add every ``stride``-th row and column of the images ``gray`` to ``sums`` (images, rows, columns, _COLUMNS); ``edges_px`` and
    ``rises`` (images, width) are each pattern column's nearest edge (NaN: too far) and +1 where light begins there, −1 where it ends.
    ``references``: bright and dark.

    All images at once: the maps and the references, which lie in memory far apart from pixel to pixel, are read once.
    """
    height, width = p_px.shape
    bright, dark = frames[references[0]], frames[references[1]]
    for v in range(stride // 2, height, stride):
        for u in range(stride // 2, width, stride):
            p, q = p_px[v, u], q_px[v, u]
            if not (p >= 0.0 and q >= 0.0):
                continue
            # Each Gray image's nearest edge, by the column that the sine images found at the pixel.
            place, row = int(p + np.float32(0.5)), int(q / cell_px)
            if place >= edges_px.shape[1] or row >= sums.shape[1]:
                continue
            low, high = np.float64(dark[v, u]), np.float64(bright[v, u])
            if high - low < 8.0:
                continue
            for k in range(gray.size):
                edge = edges_px[k, place]
                if np.isnan(edge):
                    continue
                # Dark and bright reference take albedo and steady ambient light out of the value.
                brightness = (np.float64(frames[gray[k], v, u]) - low) / (high - low)
                # Distance from the edge, positive on the side of the light.
                way = np.float64(rises[k, place])
                beside = way * (np.float64(p) - edge)
                # Both sides of an edge belong to its cell: edges of the coarse bits lie where cells meet.
                s = sums[k, row, int(edge / cell_px)]
                # Around the edge: Σ ±light, and beside it Σ ±1 on the illuminated side, what an edge gives that did not move.
                if abs(beside) <= INNER_PX:
                    s[_INNER] += 1.0
                    s[_INNER_LIT] += way * brightness
                    s[_INNER_STEP] += way if beside > 0.0 else 0.0
                    s[_INNER_WAY] += way
                # Away from it: how dark and how light the two sides are.
                elif beside < 0.0:
                    s[_LOW] += 1.0
                    s[_LOW_LIT] += brightness
                else:
                    s[_HIGH] += 1.0
                    s[_HIGH_LIT] += brightness


def edge_shifts(frames: NDArray[np.uint8], decoded: CameraDecoder, sequence: PatternSequence) -> EdgeShifts:
    """Measure the shifts in one camera's frames (n, h, w) uint8, by the Gray images across which depth moves the
    pattern."""
    axis = sequence.axis(Direction.X)
    height_px, width_px = decoded.p_px.shape
    stride = max(1, round((height_px * width_px / SAMPLES) ** 0.5))
    shape = (-(-sequence.height_px // CELL_PX), -(-sequence.width_px // CELL_PX))
    sums = np.zeros((len(axis.gray), *shape, _COLUMNS))
    edges_px, rises = edges_of(sequence)
    _accumulate(
        frames, (sequence.bright, sequence.dark), np.array(axis.gray, np.int64), decoded.p_px, decoded.q_px, edges_px, rises,
        stride, float(CELL_PX), sums,
    )  # fmt: skip
    return EdgeShifts(_solve(sums))


@lru_cache(maxsize=4)
def edges_of(sequence: PatternSequence) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Return the nearest edges and their ways (images, width) of all Gray images across which depth moves the pattern. They are
    the same in every scan, and not to be written to."""
    edges_px, rises = zip(*(_edges(sequence.patterns[k].codes()) for k in sequence.axis(Direction.X).gray), strict=True)
    return np.stack(edges_px), np.stack(rises)


def _edges(codes: NDArray[np.uint8]) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Return each pattern column's nearest edge within reach, and whether light begins (+1) or ends (−1) there."""
    brightness = codes.astype(np.int16)
    after = np.flatnonzero(np.diff(brightness))
    columns = np.arange(codes.size, dtype=np.float32)
    if not after.size:
        return np.full(codes.size, np.nan, np.float32), np.zeros(codes.size, np.float32)
    edges = after.astype(np.float32) + np.float32(0.5)
    nearest = np.argmin(np.abs(columns[:, None] - edges[None, :]), 1)
    edge_px = edges[nearest]
    edge_px[np.abs(columns - edge_px) > REACH_PX] = np.nan
    return edge_px, np.sign(np.diff(brightness)[after])[nearest].astype(np.float32)


def _solve(sums: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the shifts of the edges. An edge that moves by so many px takes so many px of light with it, whatever
    its blur."""
    count, low, high = sums[..., _INNER], sums[..., _LOW], sums[..., _HIGH]
    with np.errstate(invalid="ignore", divide="ignore"):
        # The step between both sides scales the light; what is more than an unmoved edge gives is the shift.
        dark = sums[..., _LOW_LIT] / low
        height = sums[..., _HIGH_LIT] / high - dark
        known = (np.minimum(count, np.minimum(low, high)) >= MIN_PIXELS) & (height > MIN_HEIGHT)
        moved = (sums[..., _INNER_LIT] - dark * sums[..., _INNER_WAY]) / height - sums[..., _INNER_STEP]
        return np.where(known, 2.0 * INNER_PX * moved / count, np.nan)
