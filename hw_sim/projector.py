"""Owns what the projector makes of 8-bit codes: nonlinear light, black level, blur that grows away from the focus."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

FOCUS_MM = 522.5
BLUR_FOCUS_PX, BLUR_FAR_PX = 0.45, 1.3
"""Gaussian sigma in projector px in focus, and ``FAR_MM`` away from it."""
FAR_MM = 120.0
BLACK = 0.0025
"""Light of code 0 against code 255."""


def response() -> NDArray[np.float32]:
    """Light 0..1 of each code, (256,) float32: measured-like, monotone, with a toe and a shoulder; no pure gamma."""
    x = np.arange(256) / 255.0
    light = 0.75 * x**1.35 + 0.25 * (3.0 * x**2 - 2.0 * x**3)
    return (BLACK + (1.0 - BLACK) * light).astype(np.float32)


def light_fields(image: NDArray[np.float32]) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """The projected light (h, w) float32 blurred as in focus and as far from it."""
    sharp = cv2.GaussianBlur(image, (0, 0), BLUR_FOCUS_PX, borderType=cv2.BORDER_REPLICATE)
    soft = cv2.GaussianBlur(image, (0, 0), BLUR_FAR_PX, borderType=cv2.BORDER_REPLICATE)
    return np.asarray(sharp, np.float32), np.asarray(soft, np.float32)
