"""Owns how bright each surface element is under full light: from the Gray images near the sines, followed to where it was.

A Gray image shows every element either full light or none, and the motion says which. So it tells paint without asking for
a phase: what the sines need when a point that moves along with the fringes sees nearly the same phase in all of them.
"""

from __future__ import annotations

import cv2
import numba
import numpy as np
from numpy.typing import NDArray

from appliance.compensation.grays import Stripes, lit_there
from appliance.compensation.lookup import at, cubic, spread
from appliance.compensation.ways import FIRST_WAY, P_OF_T, PER_FRAME, Q_OF_T, Ways

Picture = NDArray[np.float32]

CLEAR_PX = 3.0
"""From a stripe's border in the pattern: defocus and what moves during an exposure blur it."""
_NAN = np.float32(np.nan)


@numba.njit(nogil=True, cache=True, error_model="numpy")
def gather(
    frames: NDArray[np.uint8], stripes: Stripes, places: NDArray[np.int64], ways: Ways, depth: Picture, period_px: np.float32, start: int, stop: int,
    lit: Picture, lit_count: Picture, dark: Picture, dark_count: Picture,
) -> None:  # fmt: skip
    """Means under full light and under none, and of how many images, for rows ``start`` to ``stop`` − 1 of pixels at
    ``depth`` (t); NaN where no image tells. ``places``: of the images among what is followed."""
    height, width = depth.shape
    nodes, step = ways.nodes, ways.step_px
    count = nodes.shape[2]
    pixels = frames.reshape(frames.size)
    upper = np.empty((nodes.shape[1], count), np.float32)
    c = np.empty(count, np.float32)
    for row in range(start, stop):
        spread(nodes, step, row, upper)
        for x in range(width):
            lit[row, x], dark[row, x] = _NAN, _NAN
            lit_count[row, x], dark_count[row, x] = 0.0, 0.0
            t = depth[row, x]
            if not (abs(t) < 2.5):
                continue
            i = x // step
            part = np.float32((x - i * step) / step)
            for k in range(count):
                c[k] = upper[i, k] + part * (upper[i + 1, k] - upper[i, k])
            p, q = at(c, P_OF_T, t) + np.float32(0.5), at(c, Q_OF_T, t) + np.float32(0.5)
            bright, dim, brights, dims = np.float32(0.0), np.float32(0.0), 0, 0
            for m in range(stripes.frames.size):
                way = FIRST_WAY + PER_FRAME * places[m]
                u, v = np.float32(x) + at(c, way, t), np.float32(row) + at(c, way + 3, t)
                if not (u >= 1.0 and v >= 1.0 and u < width - 2.0 and v < height - 2.0):
                    continue
                shown = (p if stripes.axes[m] == 0 else q) + period_px * at(c, way + 6, t)
                light = lit_there(float(shown), stripes.widths_px[m], CLEAR_PX)
                if light < 0:
                    continue
                grey = cubic(pixels, stripes.frames[m] * (height * width), width, u, v)
                if grey != grey:
                    continue
                if light == 1:
                    bright += grey
                    brights += 1
                else:
                    dim += grey
                    dims += 1
            if brights > 0:
                lit[row, x], lit_count[row, x] = bright / np.float32(brights), brights
            if dims > 0:
                dark[row, x], dark_count[row, x] = dim / np.float32(dims), dims


def known_smooth(values: Picture, window_px: int) -> Picture:
    """Mean of what is known around each pixel; NaN where nothing is."""
    known = np.isfinite(values)
    share = cv2.boxFilter(known.astype(np.float32), -1, (window_px, window_px))
    total = cv2.boxFilter(np.where(known, values, np.float32(0.0)), -1, (window_px, window_px))
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.asarray(np.where(share > 1e-6, total / share, _NAN), np.float32)


def evened(grey: Picture, variance: Picture, window_px: int) -> tuple[Picture, Picture]:
    """``grey`` with noise of ``variance`` taken out where it varies no more than that, and the variance that is left.

    The local-statistics filter: J.-S. Lee, IEEE PAMI 2 (1980) 165.
    """
    mean = known_smooth(grey, window_px)
    around = known_smooth((grey - mean) ** 2, window_px)
    noise = known_smooth(variance, window_px)
    with np.errstate(invalid="ignore", divide="ignore"):
        own = np.clip(1.0 - 1.5 * noise / around, 0.0, 1.0).astype(np.float32)
    return mean + own * (grey - mean), variance * own**2 + (1 - own**2) * noise / window_px**2
