"""Coverage of the images by views of a board: regions without corners, and tilts that are missing."""

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
"""Coordinate of each edge, and whether it is measured from the far end."""
EDGE_SHARE = 1 / 8
"""Part of the image along each edge that needs corners, because the lens is extrapolated beyond the outermost ones."""
ENOUGH_CORNERS = 6
"""Least number of corners in a region, over all views."""
LEAST_LEAN_DEG = 12.0
LEAST_TILT_DEG, LEAST_TILTS = 5.0, 2
"""A board with a smaller tilt does not determine the principal distance: it might as well be larger and farther away.

Principal distance and point are three numbers, and each different tilt gives two equations (Zhang 2000).
"""
GUESSED_PRINCIPAL_DISTANCE = 1.6
"""Assumed principal distance in image widths, good enough to estimate the tilt of a board."""
LEANS = {
    "with its left edge away": (0, -1.0),
    "with its right edge away": (0, 1.0),
    "with its top edge away": (1, -1.0),
    "with its bottom edge away": (1, 1.0),
}
"""Component of the board's slope in the camera frame, and its sign."""


@dataclass(frozen=True, slots=True, eq=False)
class Coverage:
    """Coverage of image regions, distances and tilts by a set of views."""

    corners: dict[str, NDArray[np.int64]]
    """(3, 3) per side: corners in each region."""
    missing: tuple[str, ...]
    """Missing views, as sentences for the person who holds the board; empty when nothing is missing."""


def coverage(views: Sequence[BoardView], width_px: int, height_px: int) -> Coverage:
    """Return which image regions and tilts ``views`` cover, and which are missing.

    A tilt counts if either camera saw it.
    """
    corners, missing = {}, []
    for side in SIDES:
        corners_px = [view.sighting(side)[1] for view in views]
        counts = np.zeros((3, 3), np.int64)
        for uv in corners_px:
            column = np.clip(uv[:, 0] * 3 // width_px, 0, 2).astype(np.intp)
            row = np.clip(uv[:, 1] * 3 // height_px, 0, 2).astype(np.intp)
            np.add.at(counts, (row, column), 1)
        corners[side] = counts
        regions = [REGIONS[r][c] for r in range(3) for c in range(3) if counts[r, c] < ENOUGH_CORNERS]
        all_px = np.concatenate([np.empty((0, 2)), *corners_px])
        for edge, (axis, far_end) in EDGES.items():
            size = (width_px, height_px)[axis]
            distance_px = (size - 1 - all_px[:, axis]) if far_end else all_px[:, axis]
            if np.count_nonzero(distance_px < EDGE_SHARE * size) < ENOUGH_CORNERS:
                regions.append(f"near the {edge} edge")
        if regions:
            missing.append(f"no corners yet {', '.join(regions)} of the {side} image")
    sightings = [view.sighting("left" if view.has("left").any() else "right") for view in views]
    slopes = [
        slope for slope in (_slope(*sighting, width_px, height_px) for sighting in sightings) if slope is not None
    ]
    min_slope = np.tan(np.radians(LEAST_LEAN_DEG))
    leans = [name for name, (axis, sign) in LEANS.items() if not any(sign * s[axis] > min_slope for s in slopes)]
    if leans:
        missing.append(f"no board yet {' or '.join(leans)}: lean it by 20° to 35°")
    return Coverage(corners, tuple(missing))


def check_tilts(views: Sequence[BoardView], width_px: int, height_px: int) -> tuple[str, bool]:
    """Return the tilts of the board before each camera in words, and whether they determine a principal distance.

    A corner that a camera does not see is NaN.
    """
    sentences, is_enough = [], True
    for side in SIDES:
        slopes: list[Array] = []
        # All different tilts; the first is that of a board that faces the camera.
        tilts: list[Array] = [np.zeros(2)]
        for view in views:
            slope = _slope(*view.sighting(side), width_px, height_px) if view.has(side).any() else None
            if slope is None:
                continue
            slopes.append(slope)
            if all(np.linalg.norm(slope - tilt) > np.tan(np.radians(LEAST_TILT_DEG)) for tilt in tilts):
                tilts.append(slope)
        leans_deg = np.degrees(np.arctan(np.linalg.norm(np.array([*slopes, *([] if slopes else tilts)]), axis=1)))
        sentences.append(
            f"before the {side} camera the board leans in {len(tilts) - 1} directions by {LEAST_TILT_DEG:g}° or more "
            f"({leans_deg.min():.1f}° to {leans_deg.max():.1f}° in {len(slopes)} views)"
        )
        is_enough &= len(tilts) > LEAST_TILTS
    sentence = (
        f"{', '.join(sentences)}; {LEAST_TILTS} directions are needed, and more are better: lean the board "
        "by 20° to 35° to each side"
    )
    return sentence, is_enough


def _slope(corners_mm: Array, corners_px: Array, width_px: int, height_px: int) -> Array | None:
    """Estimate the slope (2,) of the board's distance along the image's x and y; ``None`` without a solution."""
    f_px = GUESSED_PRINCIPAL_DISTANCE * width_px
    lens = np.array([[f_px, 0.0, (width_px - 1) / 2], [0.0, f_px, (height_px - 1) / 2], [0.0, 0.0, 1.0]])
    is_solved, rotation_vector, _ = cv2.solvePnP(corners_mm, corners_px.reshape(-1, 1, 2), lens, np.zeros(5))
    if not is_solved:
        return None
    normal = np.asarray(cv2.Rodrigues(rotation_vector)[0], np.float64)[:, 2]
    if abs(normal[2]) < 0.1:
        return None
    return np.asarray(-normal[:2] / normal[2])
