"""Search for an undescribed board in pictures: dictionary, layout, squares and markers.

Every predefined dictionary of OpenCV is tried, and every number of squares that puts the visible markers, in the order
of their numbers, on a plane. Only the size of a square cannot be seen.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from appliance.base import Progress
from appliance.calibrate.air.board import (
    FAMILIES,
    LEAST_MARKERS,
    BoardDesign,
    Markers,
    dictionary_name,
    dictionary_number,
    find_markers,
    mirror,
)
from appliance.calibrate.air.calibrate import AirCalibrationError

Array = NDArray[np.float64]
Numbers = NDArray[np.intp]
Image = NDArray[np.uint8]

SQUARES = (3, 60)
SEARCHED = 250
"""Markers of each dictionary that are searched for until the right one is known; time grows with their number."""
BELONG = 0.6
"""Least share of the visible markers that the layout puts on one plane."""
LOOKED_AT = 4
"""Number of pictures in which a board is searched for, spread over the folder."""
OFF_SQUARES = 0.25
"""Distance from the plane, in squares, above which a marker does not belong to the board. Distortion causes less."""
TRIES = 200
"""Number of sets of four markers that RANSAC tries: one is without a mistaken marker even if half are mistaken."""
LIKELY = 3
"""Count of the likeliest numbers of squares across that are tried."""
STRAIGHT = 0.25
"""Largest offset to the side, as a share of the distance down, of a marker that counts as the one below."""
ALONG = 0.9
"""Least cosine between the edges of markers and squares: without it, one visible corner of a board fits a sheared one.
"""
SIZE_OFF = 0.1
"""Largest difference between the stated and the visible size of the markers, in squares."""


class BoardNotFoundError(AirCalibrationError):
    """Error of pictures none of which shows a known kind of board.

    The text says what was tried, what was visible and the remedy.
    """


@dataclass(frozen=True, slots=True)
class BoardDescription:
    """Description of a board by its owner; ``None`` for each number that is to be found."""

    square_mm: float
    across: int | None = None
    """Squares across. ``across`` and ``down`` may be exchanged, because owners differ in which they name first."""
    down: int | None = None
    marker_mm: float | None = None


def search_board(
    pictures: Sequence[tuple[str, Callable[[], Image]]],
    description: BoardDescription,
    progress: Progress,
) -> BoardDesign:
    """Return the board that pictures show, each given by its name and a function that reads it.

    Raises BoardNotFoundError.
    """
    step = max(1, len(pictures) // LOOKED_AT)
    chosen = [(name, read()) for name, read in pictures[::step][:LOOKED_AT]]
    most_markers: dict[str, int] = {}
    # All pictures as they are first, because a search for mirrored ones takes the same time again.
    for mirrored in (False, True):
        for k, (name, image) in enumerate(chosen):
            shown = mirror(image) if mirrored else image
            for family in FAMILIES:
                progress(f"searching {family} in {name}", k / len(chosen))
                first = find_markers(shown, family, SEARCHED)
                if not mirrored:
                    most_markers[family] = max(most_markers.get(family, 0), len(first.ids))
                if len(first.ids) < LEAST_MARKERS or _best_grid([first]) is None:
                    continue
                if mirrored:
                    raise BoardNotFoundError(
                        f"{name}: the image is mirrored: only left to right does it show a board; give the "
                        "images as the cameras recorded them"
                    )
                markers = [first, *(find_markers(other_image, family) for n, other_image in chosen if n != name)]
                return _design_of(markers, family, description)
    counts = ", ".join(f"{count} of {family}" for family, count in most_markers.items() if count) or "no marker of any"
    where = f"{len(chosen)} pictures"
    if len(chosen) < len(pictures):
        where = (
            f"the {len(chosen)} of {len(pictures)} images that were searched ({', '.join(name for name, _ in chosen)})"
        )
    raise BoardNotFoundError(
        f"no ChArUco board in {where}; tried were the dictionaries {', '.join(FAMILIES)}, in the layouts "
        f"before and since OpenCV 4.6, with {SQUARES[0]} to {SQUARES[1]} squares across; found: {counts}; "
        "give sharp, evenly lit images of a ChArUco board whose markers count from 0 (not of a plain chessboard)"
    )


# ------------------------------------------------------------------------------------------ layout


@dataclass(frozen=True, slots=True, eq=False)
class _Grid:
    """Candidate layout: squares across, and whether the first square has a marker, with the markers that fit it."""

    across: int
    white_first: bool
    on_plane: int
    """Number of markers on the plane of their picture, over all pictures."""
    visible: int
    """Number of visible markers."""
    rows: int
    """Rows of squares down to the last one with a marker."""
    marker: float
    """Side of a marker in squares."""


def _design_of(markers: Sequence[Markers], family: str, description: BoardDescription) -> BoardDesign:
    stated = {n for n in (description.across, description.down) if n is not None}
    best = _best_grid(markers)
    if best is None:
        count = max(len(m.ids) for m in markers)
        raise BoardNotFoundError(
            f"{count} markers of {family} in one image, but no ChArUco board of {SQUARES[0]} to "
            f"{SQUARES[1]} squares across has them in this order; give a board whose markers count from 0, row by row"
        )
    if stated and best.across not in stated:
        raise BoardNotFoundError(
            f"--board {description.across}x{description.down}: the markers ({family}) are those of a board of "
            f"{best.across} "
            "squares "
            f"across and {best.rows} or more down; give that, or leave --board out"
        )
    down = best.rows
    # The first square is a marker's only in the old layout with an even number of rows: the last then was out of view.
    if best.white_first and down % 2:
        down += 1
    if description.across is not None and description.down is not None:
        stated_down = description.down if best.across == description.across else description.across
        if stated_down < best.rows or (best.white_first and stated_down % 2):
            raise BoardNotFoundError(
                f"--board {description.across}x{description.down}: the markers ({family}) are those of a board of "
                f"{best.across} squares "
                f"across and {down} or more down; give that, or leave --board out"
            )
        down = stated_down
    size = best.marker if description.marker_mm is None else description.marker_mm / description.square_mm
    if abs(size - best.marker) > SIZE_OFF:
        raise BoardNotFoundError(
            f"--board: markers of {description.marker_mm:g} mm: in the images a marker's side is {best.marker:.3f} "
            "of a "
            "square's, which are "
            f"{best.marker * description.square_mm:.3g} mm of {description.square_mm:g} mm; measure the "
            "board, or leave out the markers' size"
        )
    plain = BoardDesign(best.across, max(down, SQUARES[0]), description.square_mm, size * description.square_mm)
    return replace(plain, dictionary=dictionary_number(dictionary_name(family, plain)), legacy=best.white_first)


def _best_grid(markers_by_picture: Sequence[Markers]) -> _Grid | None:
    """Return the layout that puts most markers on planes; ``None`` where none puts enough."""
    usable = [m for m in markers_by_picture if len(m.ids) >= LEAST_MARKERS]
    # Two rows of squares have as many markers as a row has squares. By so much the number grows from a marker to the
    # one two squares below, in either layout.
    votes = Counter(int(step) for markers in usable for step in _number_steps_down(markers))
    likely = [across for across, _ in votes.most_common(LIKELY)]
    grids = [_grid(usable, across, white) for across in likely for white in (False, True)]
    best = max(grids, key=lambda grid: grid.on_plane, default=None)
    if best is None or best.on_plane < LEAST_MARKERS or best.on_plane < BELONG * best.visible:
        return None
    return best


def _number_steps_down(markers: Markers) -> Numbers:
    """Return how much the number grows from each marker to the next one straight below it.

    Only steps in the allowed range of squares across are returned.
    """
    edges = np.stack(
        [markers.outlines_px[:, 1] - markers.outlines_px[:, 0], markers.outlines_px[:, 3] - markers.outlines_px[:, 0]],
        2,
    )
    is_regular = np.abs(np.linalg.det(edges)) > 1.0
    offset_px = markers.centres_px[None, is_regular] - markers.centres_px[is_regular, None]
    # From marker i to marker j, in sides of i: a along its upper edge, b along its left one.
    a, b = np.moveaxis(np.einsum("ikl,ijl->ijk", np.linalg.inv(edges[is_regular]), offset_px), 2, 0)
    b = np.where((b > 1.0) & (np.abs(a) < STRAIGHT * b), b, np.inf)
    if not b.size:
        return np.empty(0, np.intp)
    below, ids = b.argmin(axis=1), markers.ids[is_regular]
    steps = (ids[below] - ids)[np.isfinite(b.min(axis=1))]
    return np.asarray(steps[(steps >= SQUARES[0]) & (steps <= SQUARES[1])], np.intp)


def _grid(markers_by_picture: Sequence[Markers], across: int, white_first: bool) -> _Grid:
    on_plane = visible = rows = 0
    sides: list[float] = []
    for markers in markers_by_picture:
        squares = _squares(int(markers.ids.max()) + 1, across, white_first)[markers.ids]
        is_on_plane, size = _on_plane(markers, squares)
        visible += len(is_on_plane)
        if np.count_nonzero(is_on_plane) < LEAST_MARKERS:
            continue
        on_plane += int(np.count_nonzero(is_on_plane))
        rows = max(rows, int(squares[is_on_plane, 1].max()) + 1)
        sides.append(size)
    return _Grid(across, white_first, on_plane, visible, rows, float(np.median(sides)) if sides else 0.0)


def _squares(count: int, across: int, white_first: bool) -> Numbers:
    """Return column and row (count, 2) of the squares of the first markers: row by row, every second square."""
    rows = 2 * count // across + 3
    row, column = np.mgrid[0:rows, 0:across]
    has_marker = (row + column) % 2 == (0 if white_first else 1)
    return np.stack([column[has_marker], row[has_marker]], 1)[:count].astype(np.intp)


def _on_plane(markers: Markers, squares: Numbers) -> tuple[NDArray[np.bool_], float]:
    """Return which markers lie on one plane if they are in these squares (n, 2), and their median side in squares."""
    nothing = np.zeros(len(squares), np.bool_), 0.0
    # With one row, every number of squares across would fit.
    if np.ptp(squares[:, 0]) == 0 or np.ptp(squares[:, 1]) == 0:
        return nothing
    side_px = float(np.median(np.linalg.norm(markers.outlines_px[:, 1] - markers.outlines_px[:, 0], axis=1)))
    middles = squares + 0.5
    to_px, _ = cv2.findHomography(middles, markers.centres_px, cv2.RANSAC, max(OFF_SQUARES * side_px, 1.0), None, TRIES)
    if to_px is None or abs(np.linalg.det(to_px)) < 1e-12:
        return nothing
    outlines = cv2.perspectiveTransform(
        markers.outlines_px.reshape(-1, 1, 2), np.asarray(np.linalg.inv(to_px), np.float64)
    ).reshape(-1, 4, 2)
    is_near = np.linalg.norm(outlines.mean(axis=1) - middles, axis=1) < OFF_SQUARES
    # As the board has it, a marker's upper edge runs along x and its left one along y.
    upper, left = outlines[:, 1] - outlines[:, 0], outlines[:, 3] - outlines[:, 0]
    lengths = np.linalg.norm(upper, axis=1), np.linalg.norm(left, axis=1)
    is_near &= (upper[:, 0] > ALONG * lengths[0]) & (left[:, 1] > ALONG * lengths[1])
    if not is_near.any():
        return nothing
    return is_near, float(np.median(np.concatenate([length[is_near] for length in lengths])))
