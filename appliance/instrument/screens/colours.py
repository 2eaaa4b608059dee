"""Owns the colours of values: one table, ordered by lightness."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray


def colour_table() -> NDArray[np.uint8]:
    """Return 256 colours (256, 3) uint8 RGB from dark to bright, even to the eye: viridis without its darkest eighth.

    Lightness alone orders it, so that it can be read in grey and by the colour-blind.
    """
    ramp = np.linspace(32, 255, 256).astype(np.uint8)[np.newaxis, :]
    bgr = np.asarray(cv2.applyColorMap(ramp, cv2.COLORMAP_VIRIDIS), np.uint8)
    return np.ascontiguousarray(bgr[0, :, ::-1])
