"""Owns the questions whether a board rested while it was recorded, and whether it is somewhere new."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from appliance.calibrate.air.board import BoardDesign, NoBoard, find_board, find_corners
from appliance.calibrate.air.linearised import MIN_CORNERS, BoardView

Array = NDArray[np.float64]
Image = NDArray[np.uint8]

REST_PX = 0.1
"""RMS motion of the corners from the first picture to the last; noise alone makes a third of it."""
NEW_PLACE = 1 / 40
"""Share of the image's width that a board must have moved since an earlier view: after less, it tells nothing new."""


def view_of(
    name: str, left: Image, right: Image, known: Sequence[BoardView], design: BoardDesign
) -> BoardView | NoBoard:
    """Return the board in pictures (n, h, w) uint8 that both cameras took one after the other, if it rested somewhere
    new.

    Corners are those of the pictures' mean.
    """
    view, reasons = find_board(name, {"left": mean_of(left), "right": mean_of(right)}, design, strict=True)
    if reasons:
        return NoBoard(reasons[0])
    if (both := np.count_nonzero(view.has("left") & view.has("right"))) < MIN_CORNERS:
        return NoBoard(
            f"{name}: only {both} corners are seen by both cameras, {MIN_CORNERS} are needed; "
            f"hold the board in the middle between them, with nothing before it"
        )
    for side, pictures in (("left", left), ("right", right)):
        first, last = (find_corners(pictures[k], design, strict=True) for k in (0, -1))
        if isinstance(first, NoBoard) or isinstance(last, NoBoard):
            return NoBoard(f"{name}: the board went out of the {side} image while it was recorded; let it rest")
        moved_px = _moved_px(first, last)
        if moved_px is None or moved_px > REST_PX:
            by = "far" if moved_px is None else f"{moved_px:.2f} px"
            return NoBoard(f"{name}: the board moved by {by} in the {side} image while it was recorded; let it rest")
    for other in known:
        apart = _apart_px(view, other)
        if apart is not None and apart < NEW_PLACE * left.shape[2]:
            return NoBoard(f"{name}: the board is where it was in view {other.name}; hold it elsewhere, or lean it")
    return view


def mean_of(pictures: Image) -> Image:
    """Return the mean (h, w) uint8 of pictures (n, h, w), rounded: less noise than each has."""
    return np.asarray(np.rint(pictures.mean(axis=0, dtype=np.float32)), np.uint8)


def _moved_px(first: Mapping[int, Array], last: Mapping[int, Array]) -> float | None:
    both = sorted(first.keys() & last.keys())
    if not both:
        return None
    return float(np.sqrt(np.mean([(last[i] - first[i]) ** 2 for i in both])))


def _apart_px(one: BoardView, other: BoardView) -> float | None:
    """Return the RMS distance of the left image's common corners; ``None`` where there are none."""
    mine, theirs = (
        {tuple(corner): px for corner, px in zip(corners_mm.tolist(), seen_px, strict=True)}
        for corners_mm, seen_px in (one.sighting("left"), other.sighting("left"))
    )
    apart = [mine[corner] - theirs[corner] for corner in mine.keys() & theirs.keys()]
    return float(np.sqrt(np.mean(np.sum(np.square(apart), axis=1)))) if apart else None
