"""Owns the contact sheet of a set: its images with the role of each, and how much of it the description explains."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

WIDTH_PX, TEXT_PX, MOST_COLUMNS = 200, 22, 8
GOOD = 0.5
_PLAIN, _POOR = (235, 235, 235), (80, 160, 255)


def contact_sheet(images: Sequence[NDArray[Any]], words: Sequence[str], explained: Sequence[float]) -> bytes:
    """Return a PNG of ``images`` (h, w) with the words and the explained share (NaN: nothing) below each; poor shares
    are orange."""
    height_px = round(WIDTH_PX * images[0].shape[0] / images[0].shape[1])
    columns = min(MOST_COLUMNS, len(images))
    rows = -(-len(images) // columns)
    sheet = np.full((rows * (height_px + TEXT_PX), columns * WIDTH_PX, 3), 30, np.uint8)
    brightest = max(float(image.max()) for image in images)
    for k, (image, word, share) in enumerate(zip(images, words, explained, strict=True)):
        top, left = k // columns * (height_px + TEXT_PX), k % columns * WIDTH_PX
        small = cv2.resize(image, (WIDTH_PX - 2, height_px - 2), interpolation=cv2.INTER_AREA)
        grey = np.rint(small.astype(np.float32) * np.float32(255.0 / brightest)).astype(np.uint8)
        sheet[top : top + height_px - 2, left : left + WIDTH_PX - 2] = grey[..., None]
        told = f"{k + 1} {word}" + ("" if np.isnan(share) else f" {100 * share:.0f}%")
        colour = _PLAIN if np.isnan(share) or share > GOOD else _POOR
        cv2.putText(
            sheet, told, (left + 3, top + height_px + 14), cv2.FONT_HERSHEY_SIMPLEX, 0.42, colour, 1, cv2.LINE_AA
        )
    return bytes(cv2.imencode(".png", sheet)[1])
