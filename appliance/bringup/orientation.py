"""Owns which way round the picture lies on the scene as each camera sees it, and which of the two cameras is the left one.

The upper left of the projector's picture must be the upper left of both images: projector and cameras look the same way. Of two
cameras that are turned inwards the left one is nearer to the left part of what lies before them, and sees it larger.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import Enum

import numpy as np
from numpy.typing import NDArray

from appliance.bringup.bench import Image

QUARTERS = (0.25, 0.5, 0.75)
SURE = 0.005
"""Least difference of the cameras' logarithmic ratios of scale from which they are told apart."""


class Orientation(Enum):
    """Orientation of a picture in an image."""

    UPRIGHT = "upright"
    MIRRORED = "mirrored left to right"
    UPSIDE_DOWN = "mirrored top to bottom"
    TURNED = "turned by 180°"
    ON_ITS_SIDE = "turned by 90°"
    UNSEEN = "not seen"


@dataclass(frozen=True, slots=True)
class SeenPicture:
    """The projector's picture as one camera sees it."""

    orientation: Orientation
    scale_ratio: float | None
    """Width of the second quarter of the picture over that of the third, as the camera sees them; ``None``: not told."""
    px_per_px: float | None = None
    """Camera pixels per projector pixel across."""


def marker_pictures(size_px: tuple[int, int]) -> list[NDArray[np.uint8]]:
    """Return white, black, the left quarter, half and three quarters, the upper half, and an L for a person's eyes, each (h, w)."""
    width, height = size_px
    white, black = np.full((height, width), 255, np.uint8), np.zeros((height, width), np.uint8)
    pictures = [white, black]
    for share in QUARTERS:
        part = black.copy()
        part[:, : round(share * width)] = 255
        pictures.append(part)
    upper = black.copy()
    upper[: height // 2] = 255
    letter = black.copy()
    # An L is the same neither mirrored nor turned.
    letter[height // 8 : -height // 8, width // 8 : width // 4] = 255
    letter[-height // 4 : -height // 8, width // 8 : width // 2] = 255
    return [*pictures, upper, letter]


def see_orientation(frames: Image, width_px: int) -> SeenPicture:
    """Tell from a camera's images (7, h, w) of ``marker_pictures`` of that width which way round they lie."""
    white, black, first, half, third, upper = (frame.astype(np.float64) for frame in frames[:6])
    light = white - black
    lit = light > 0.3 * float(np.quantile(light, 0.99))
    if lit.mean() < 0.01 or float(np.quantile(light, 0.99)) < 8.0:
        return SeenPicture(Orientation.UNSEEN, None)

    def share(part: NDArray[np.float64]) -> NDArray[np.float64]:
        found: NDArray[np.float64] = np.where(lit, np.clip((part - black) / np.where(lit, light, 1.0), 0.0, 1.0), 0.0)
        return found

    # Centres of light instead of borders: they tell the side however oblique, blurred or partly outside the picture lies.
    left, top = share(half), share(upper)
    across, down = _towards(left, lit), _towards(top, lit)
    if abs(across[1]) > abs(across[0]) or abs(down[0]) > abs(down[1]):
        return SeenPicture(Orientation.ON_ITS_SIDE, None)
    found = {
        (True, True): Orientation.UPRIGHT,
        (False, True): Orientation.MIRRORED,
        (True, False): Orientation.UPSIDE_DOWN,
        (False, False): Orientation.TURNED,
    }[across[0] < 0.0, down[1] < 0.0]
    second, fourth = share(half) - share(first), share(third) - share(half)
    rows = lit.mean(axis=1) > 0.5 * lit.mean(axis=1).max()
    # Areas over whole rows: to a few hundredths of a pixel, however blurred the borders are.
    widths = [float(part[rows].sum()) for part in (second, fourth)]
    if min(widths) <= 1.0:
        return SeenPicture(found, None)
    return SeenPicture(found, widths[0] / widths[1], sum(widths) / float(rows.sum()) / (0.5 * width_px))


def exchanged(left: SeenPicture, right: SeenPicture) -> bool | None:
    """Return whether left and right camera are exchanged; ``None``: it cannot be told.

    A picture that both see mirrored is taken for mirrored by the projector, as cameras mirror only where they are told to. One that is turned by 180° may be
    turned by either.
    """
    if left.scale_ratio is None or right.scale_ratio is None or left.orientation is not right.orientation:
        return None
    # Of two ratios, since a plane that stands askew changes both cameras' alike.
    difference = math.log(left.scale_ratio / right.scale_ratio)
    if left.orientation is Orientation.TURNED:
        return None
    if left.orientation is Orientation.MIRRORED:
        # What is left in the picture lies right on the wall.
        difference = -difference
    return None if abs(difference) < SURE else difference < 0.0


def _towards(part: NDArray[np.float64], lit: NDArray[np.bool_]) -> tuple[float, float]:
    """Return where ``part`` lies against the rest of what is lit, (x, y) in px."""
    y, x = np.indices(part.shape)
    rest = lit - part
    inside, outside = max(part.sum(), 1e-9), max(rest.sum(), 1e-9)
    return (
        float((part * x).sum() / inside - (rest * x).sum() / outside),
        float((part * y).sum() / inside - (rest * y).sum() / outside),
    )
