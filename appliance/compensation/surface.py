"""Owns where the surface roughly is, everywhere in a picture, before anything is decoded anew."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from appliance.compensation.solve import depth_rows
from appliance.compensation.ways import Ways

Picture = NDArray[np.float32]

BLOCKS_ACROSS = 100
FEWEST = 3
"""Pixels with a column that make a block's depth."""
MEDIAN_BLOCKS = 5


def rough_depth(p_px: Picture, way: Ways) -> Picture:
    """t (h, w) of decoded columns: medians of blocks, where a block has none those of larger ones, and linear between.

    Zero, the middle of the volume, where no column is known at all.
    """
    height, width = p_px.shape
    depth = np.empty((height, width), np.float32)
    depth_rows(p_px, way, 0, 0, height, depth)
    step = max(2, width // BLOCKS_ACROSS)
    rows, columns = height // step, width // step
    levels = [_medians(depth[: rows * step, : columns * step], step, FEWEST)]
    while max(levels[-1].shape) > 1:
        below = levels[-1]
        even = np.pad(below, [(0, n % 2) for n in below.shape], constant_values=np.nan)
        levels.append(_medians(even, 2, 1))
    full: Picture = np.nan_to_num(levels[-1]).astype(np.float32)
    for below in levels[-2::-1]:
        around = cv2.resize(full, below.shape[::-1], interpolation=cv2.INTER_LINEAR)
        full = np.asarray(np.where(np.isfinite(below), below, around), np.float32)
    full = np.asarray(cv2.medianBlur(full, MEDIAN_BLOCKS), np.float32)
    whole = cv2.resize(full, (columns * step, rows * step), interpolation=cv2.INTER_LINEAR)
    return np.asarray(
        cv2.copyMakeBorder(whole, 0, height - rows * step, 0, width - columns * step, cv2.BORDER_REPLICATE), np.float32
    )


def _medians(values: Picture, step: int, fewest: int) -> Picture:
    """Of blocks of ``step`` px; NaN where fewer than ``fewest`` are known."""
    rows, columns = values.shape[0] // step, values.shape[1] // step
    blocks = values.reshape(rows, step, columns, step).transpose(0, 2, 1, 3).reshape(rows, columns, step * step)
    known = np.isfinite(blocks).sum(-1)
    ordered = np.sort(blocks, axis=-1)
    # NaN come last.
    middle = np.take_along_axis(ordered, np.maximum(known - 1, 0)[..., None] // 2, -1)[..., 0]
    return np.where(known >= fewest, middle, np.float32(np.nan))
