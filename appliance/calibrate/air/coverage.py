"""Owns the question which boards are still missing: where in the images no corner was seen, and how none was leant."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from appliance.calibrate.air.linearised import BoardView
from appliance.measure import SIDES

Array = NDArray[np.float64]

REGIONS = (
    ("at the top left", "at the top", "at the top right"),
    ("at the left", "in the middle", "at the right"),
    ("at the bottom left", "at the bottom", "at the bottom right"),
)
"""Thirds of an image, rows from the top."""
EDGES = {"left": (0, False), "right": (0, True), "top": (1, False), "bottom": (1, True)}
"""Coordinate, and whether it counts from the far end."""
EDGE_SHARE = 1 / 8
"""Part of the image along each edge that must be seen, too: beyond the outermost corners a lens is only guessed."""
ENOUGH_CORNERS = 6
"""Least number of corners in a region, over all views."""
LEAST_LEAN_DEG = 12.0
LEAST_TILT_DEG, LEAST_TILTS = 5.0, 2
"""A board that leans by less tells no principal distance: it might as well be larger and farther away.

Principal distance and point are three numbers, and each other tilt gives two equations (Zhang 2000).
"""
GUESSED_PRINCIPAL_DISTANCE = 1.6
"""Principal distance in image widths that is assumed: good enough to tell how a board leans."""
LEANS = {
    "with its left edge away": (0, -1.0),
    "with its right edge away": (0, 1.0),
    "with its top edge away": (1, -1.0),
    "with its bottom edge away": (1, 1.0),
}
"""Component of the board's slope as the camera sees it, and its sign."""


@dataclass(frozen=True, slots=True, eq=False)
class Coverage:
    """Coverage of image regions, distances and tilts by a set of views."""

    corners: dict[str, NDArray[np.int64]]
    """(3, 3) per side: corners in each region."""
    missing: tuple[str, ...]
    """Missing views, as sentences for the person who holds the board; empty when nothing is missing."""


def coverage(views: Sequence[BoardView], width_px: int, height_px: int) -> Coverage:
    """Determine what ``views`` cover and what they lack. A lean counts whichever camera saw it."""
    corners, missing = {}, []
    for side in SIDES:
        seen = [view.sighting(side)[1] for view in views]
        counts = np.zeros((3, 3), np.int64)
        for uv in seen:
            column = np.clip(uv[:, 0] * 3 // width_px, 0, 2).astype(np.intp)
            row = np.clip(uv[:, 1] * 3 // height_px, 0, 2).astype(np.intp)
            np.add.at(counts, (row, column), 1)
        corners[side] = counts
        places = [REGIONS[r][c] for r in range(3) for c in range(3) if counts[r, c] < ENOUGH_CORNERS]
        every = np.concatenate([np.empty((0, 2)), *seen])
        for edge, (axis, far_end) in EDGES.items():
            size = (width_px, height_px)[axis]
            off = (size - 1 - every[:, axis]) if far_end else every[:, axis]
            if np.count_nonzero(off < EDGE_SHARE * size) < ENOUGH_CORNERS:
                places.append(f"near the {edge} edge")
        if places:
            missing.append(f"no corners yet {', '.join(places)} of the {side} image")
    leant = [view.sighting("left" if view.has("left").any() else "right") for view in views]
    slopes = [slope for slope in (_slope(*one, width_px, height_px) for one in leant) if slope is not None]
    least = np.tan(np.radians(LEAST_LEAN_DEG))
    leans = [name for name, (axis, sign) in LEANS.items() if not any(sign * s[axis] > least for s in slopes)]
    if leans:
        missing.append(f"no board yet {' or '.join(leans)}: lean it by 20° to 35°")
    return Coverage(corners, tuple(missing))


def check_tilts(views: Sequence[BoardView], width_px: int, height_px: int) -> tuple[str, bool]:
    """Return in words how boards lean before each camera, and whether that is enough for a principal distance at all.

    A corner that a camera does not see is NaN.
    """
    words, enough = [], True
    for side in SIDES:
        told: list[Array] = []
        # Each tilt that is none of those before it; the first is that of a board that faces the camera.
        tilts: list[Array] = [np.zeros(2)]
        for view in views:
            slope = _slope(*view.sighting(side), width_px, height_px) if view.has(side).any() else None
            if slope is None:
                continue
            told.append(slope)
            if all(np.linalg.norm(slope - other) > np.tan(np.radians(LEAST_TILT_DEG)) for other in tilts):
                tilts.append(slope)
        leans_deg = np.degrees(np.arctan(np.linalg.norm(np.array([*told, *([] if told else tilts)]), axis=1)))
        words.append(
            f"before the {side} camera the board leans in {len(tilts) - 1} different ways by {LEAST_TILT_DEG:g}° or more "
            f"({leans_deg.min():.1f}° to {leans_deg.max():.1f}° in {len(told)} views)"
        )
        enough &= len(tilts) > LEAST_TILTS
    return (
        f"{', '.join(words)}; {LEAST_TILTS} ways are needed and more are better: lean the board by 20° to 35° to each side",
        enough,
    )


def _slope(corners_mm: Array, seen_px: Array, width_px: int, height_px: int) -> Array | None:
    """Estimate the slope of the board's distance along the image's x and y, (2,); ``None`` where it cannot be told."""
    f_px = GUESSED_PRINCIPAL_DISTANCE * width_px
    lens = np.array([[f_px, 0.0, (width_px - 1) / 2], [0.0, f_px, (height_px - 1) / 2], [0.0, 0.0, 1.0]])
    done, turn, _ = cv2.solvePnP(corners_mm, seen_px.reshape(-1, 1, 2), lens, np.zeros(5))
    if not done:
        return None
    normal = np.asarray(cv2.Rodrigues(turn)[0], np.float64)[:, 2]
    if abs(normal[2]) < 0.1:
        return None
    return np.asarray(-normal[:2] / normal[2])
