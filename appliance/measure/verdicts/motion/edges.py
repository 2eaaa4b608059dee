"""The shifts of the Gray stripes' edges, frame by frame, against the phase of the sine images.

A pixel's grey value between dark and bright says on which side of a stripe's edge it is, and near the edge how far
away. The phase says the same, some frames later. The difference is the motion in between. It is less precise than the
drift within the sine images, but known for each frame, so that shaking can be distinguished from a steady motion.
"""

from __future__ import annotations

from functools import lru_cache

import numba
import numpy as np
from numpy.typing import NDArray

from appliance.measure.decode.decoder import CameraDecoder
from appliance.measure.light.patterns import Direction, PatternSequence
from appliance.measure.verdicts.motion.cells import CELL_PX

INNER_PX, REACH_PX = 4.5, 7.5
"""Distances from an edge, pattern px: within the first, light that an edge has moved is summed; from there to the
second, the levels of its sides. Blur stays within the first; the next edge is 16 px away at least."""
SAMPLES = 60_000
"""Approximate number of pixels of a camera that are used."""
# Symbols of the kernel. sign is +1 where light begins at the edge, −1 where it ends; beside is the distance from the
# edge towards the light, pattern px; brightness is the image's value from dark (0) to bright (1). The sums hold, for
# the inner part and for the dark and the bright side, how many pixels there are and their light; and the light of an
# ideal, unmoved edge.

SUMS = np.dtype([(name, np.float64) for name in (
    "inner", "inner_lit", "inner_step", "inner_way", "low", "low_lit", "high", "high_lit",
)])  # fmt: skip
EDGE_PIXELS, MIN_HEIGHT = 10, 0.3
"""Least number of pixels in each of the three parts; and least step from dark to light, as a share of bright less
dark."""


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
    sums: NDArray[np.void],
) -> None:
    """Add every ``stride``-th row and column of the images ``gray`` to ``sums`` (images, rows, columns).

    ``edges_px`` and ``rises`` (images, width) are the nearest edge of each pattern column (NaN: too far) and +1 if
    light begins there, −1 if it ends. ``references``: bright and dark. All images at once, since the values of the maps
    and the references are far apart in memory and are read only once so.
    """
    height, width = p_px.shape
    bright, dark = frames[references[0]], frames[references[1]]
    for v in range(stride // 2, height, stride):
        for u in range(stride // 2, width, stride):
            p, q = p_px[v, u], q_px[v, u]
            if not (p >= 0.0 and q >= 0.0):
                continue
            # Each Gray image's nearest edge, by the pixel's pattern column from the sine images.
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
                sign = np.float64(rises[k, place])
                beside = sign * (np.float64(p) - edge)
                # Both sides of an edge belong to its cell: edges of the coarse bits lie where cells meet.
                s = sums[k, row, int(edge / cell_px)]
                # Around the edge: Σ ±light; and Σ ±1 on the illuminated side, which is the sum of an unmoved edge.
                if abs(beside) <= INNER_PX:
                    s.inner += 1.0
                    s.inner_lit += sign * brightness
                    s.inner_step += sign if beside > 0.0 else 0.0
                    s.inner_way += sign
                # Away from it: the levels of the two sides.
                elif beside < 0.0:
                    s.low += 1.0
                    s.low_lit += brightness
                else:
                    s.high += 1.0
                    s.high_lit += brightness


def edge_shifts(frames: NDArray[np.uint8], decoded: CameraDecoder, sequence: PatternSequence) -> NDArray[np.float64]:
    """Return the shifts of the edges in one camera's frames (n, h, w) uint8, in the Gray images of X.

    (images, rows, columns) of the pattern's cells: excess of the pixels' coordinates in that image over those in the
    sine images, pattern px; NaN: no edge there.
    """
    axis = sequence.axis(Direction.X)
    height_px, width_px = decoded.p_px.shape
    stride = max(1, round((height_px * width_px / SAMPLES) ** 0.5))
    shape = (-(-sequence.height_px // CELL_PX), -(-sequence.width_px // CELL_PX))
    sums = np.zeros((len(axis.gray), *shape), SUMS)
    edges_px, rises = edges_of(sequence)
    _accumulate(
        frames, (sequence.bright, sequence.dark), np.array(axis.gray, np.int64), decoded.p_px, decoded.q_px, edges_px, rises,
        stride, float(CELL_PX), sums,
    )  # fmt: skip
    return _shifts_of_sums(sums)


@lru_cache(maxsize=4)
def edges_of(sequence: PatternSequence) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Return the nearest edges and their signs (images, width), by ``_edges``, in all Gray images of X.

    They are the same in every scan. Do not write to them.
    """
    edges_px, rises = zip(*(_edges(sequence.patterns[k].codes()) for k in sequence.axis(Direction.X).gray), strict=True)
    return np.stack(edges_px), np.stack(rises)


def _edges(codes: NDArray[np.uint8]) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Return the nearest edge of each pattern column, and whether light begins (+1) or ends (−1) there.

    NaN: no edge within reach.
    """
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


def _shifts_of_sums(sums: NDArray[np.void]) -> NDArray[np.float64]:
    """Return the shifts of the edges: each px of shift changes the light by that of a px."""
    count, low, high = sums["inner"], sums["low"], sums["high"]
    with np.errstate(invalid="ignore", divide="ignore"):
        # The step between both sides scales the light; the excess over that of an unmoved edge is the shift.
        dark = sums["low_lit"] / low
        height = sums["high_lit"] / high - dark
        is_known = (np.minimum(count, np.minimum(low, high)) >= EDGE_PIXELS) & (height > MIN_HEIGHT)
        moved = (sums["inner_lit"] - dark * sums["inner_way"]) / height - sums["inner_step"]
        return np.where(is_known, 2.0 * INNER_PX * moved / count, np.nan)
