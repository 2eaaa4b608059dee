"""Owns the pictures of a report: where a surface deviates, and how often by how much. PNG, in memory."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from appliance.measure.accept.points import Used

WIDEST_PX = 640
BARS = 61
HISTOGRAM_PX = (180, BARS * 8)
_BEHIND, _MIDDLE, _BEFORE = (np.array(c, np.float64) for c in ((178, 24, 43), (247, 247, 247), (33, 102, 172)))
_EMPTY = 32


def scale_mm(used: Used) -> float:
    """Return the deviation that gets full colour: three times the residuals' rms."""
    return 3.0 * max(used.rms_mm, 1e-6)


def deviation_map(used: Used, width_px: int) -> bytes:
    """Return the residuals as the left camera sees them, cut to the surface; red positive, blue negative, dark no
    point."""
    v, u = np.divmod(used.pixel.astype(np.int64), width_px)
    v, u = v - v.min(), u - u.min()
    # Whole pixels are averaged, so that neighbouring cells stand for equally many points.
    step = int(max(1, np.ceil((u.max() + 1) / WIDEST_PX), np.ceil((v.max() + 1) / WIDEST_PX)))
    height, width = int(v.max() // step) + 1, int(u.max() // step) + 1
    cell = (v // step) * width + u // step
    count = np.bincount(cell, minlength=height * width)
    mean = np.bincount(cell, used.residual_mm, minlength=height * width) / np.maximum(count, 1)
    part = np.clip(mean / scale_mm(used), -1.0, 1.0)[:, None]
    colour = _MIDDLE + np.where(part > 0, part * (_BEHIND - _MIDDLE), -part * (_BEFORE - _MIDDLE))
    image = np.where(count[:, None] > 0, colour, _EMPTY).reshape(height, width, 3)
    return _png(image.astype(np.uint8))


def histogram(used: Used) -> bytes:
    """Draw how many points have which residual, from minus to plus full colour; what lies beyond is in the outermost
    bars."""
    limit = scale_mm(used)
    counts, _ = np.histogram(np.clip(used.residual_mm, -limit, limit), BARS, (-limit, limit))
    height, width = HISTOGRAM_PX
    image = np.full((height, width, 3), 255, np.uint8)
    for k, bar in enumerate(np.rint(counts / max(1, counts.max()) * (height - 4)).astype(int)):
        image[height - bar :, k * 8 : k * 8 + 7] = 90
    image[:, width // 2] = (178, 24, 43)
    return _png(image)


def _png(rgb: NDArray[np.uint8]) -> bytes:
    done, data = cv2.imencode(".png", np.ascontiguousarray(rgb[:, :, ::-1]))
    if not done:
        raise ValueError(f"a picture of {rgb.shape} could not be encoded as PNG")
    return bytes(data)
