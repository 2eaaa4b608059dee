"""Checks of a live view: whether the board rested during the pictures, and whether its pose is new."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from appliance.calibrate.air.board import BoardDesign, NoBoard, find_board, find_corners
from appliance.calibrate.air.linearised import MIN_CORNERS, BoardView

Array = NDArray[np.float64]
Image = NDArray[np.uint8]

REST_PX = 0.1
"""Largest RMS motion of the corners from the first picture to the last; noise alone causes a third of it."""
NEW_PLACE = 1 / 40
"""Least motion of a board since each earlier view, as a share of the image's width; a smaller one adds nothing."""


def view_of(
    name: str, left: Image, right: Image, earlier_views: Sequence[BoardView], design: BoardDesign
) -> BoardView | NoBoard:
    """Return the view of a board in pictures (n, h, w) uint8 that both cameras took one after the other.

    Corners are those of the pictures' mean. Returns ``NoBoard`` unless the board rested in a pose that differs from
    ``earlier_views``.
    """
    view, reasons = find_board(name, {"left": mean_of(left), "right": mean_of(right)}, design, strict=True)
    if reasons:
        return NoBoard(reasons[0])
    if (common := np.count_nonzero(view.has("left") & view.has("right"))) < MIN_CORNERS:
        return NoBoard(
            f"{name}: both cameras see only {common} common corners, {MIN_CORNERS} are needed; hold the "
            "board in the middle between them, unobstructed"
        )
    for side, pictures in (("left", left), ("right", right)):
        first, last = (find_corners(pictures[k], design, strict=True) for k in (0, -1))
        if isinstance(first, NoBoard) or isinstance(last, NoBoard):
            return NoBoard(f"{name}: the board left the {side} image during recording; hold it still")
        moved_px = _moved_px(first, last)
        if moved_px is None or moved_px > REST_PX:
            distance = "far" if moved_px is None else f"{moved_px:.2f} px"
            return NoBoard(f"{name}: the board moved by {distance} in the {side} image during recording; hold it still")
    for view_before in earlier_views:
        apart = _apart_px(view, view_before)
        if apart is not None and apart < NEW_PLACE * left.shape[2]:
            return NoBoard(f"{name}: the board has the pose of view {view_before.name}; move it, or lean it")
    return view


def mean_of(pictures: Image) -> Image:
    """Return the rounded mean (h, w) uint8 of pictures (n, h, w), which has less noise than each."""
    return np.asarray(np.rint(pictures.mean(axis=0, dtype=np.float32)), np.uint8)


def _moved_px(first: Mapping[int, Array], last: Mapping[int, Array]) -> float | None:
    numbers = sorted(first.keys() & last.keys())
    if not numbers:
        return None
    return float(np.sqrt(np.mean([(last[i] - first[i]) ** 2 for i in numbers])))


def _apart_px(view: BoardView, earlier: BoardView) -> float | None:
    """Return the RMS distance of the left image's corners that both views have; ``None`` without any."""
    view_px, earlier_px = (
        {tuple(corner): px for corner, px in zip(corners_mm.tolist(), seen_px, strict=True)}
        for corners_mm, seen_px in (view.sighting("left"), earlier.sighting("left"))
    )
    offsets_px = [view_px[corner] - earlier_px[corner] for corner in view_px.keys() & earlier_px.keys()]
    return float(np.sqrt(np.mean(np.sum(np.square(offsets_px), axis=1)))) if offsets_px else None
