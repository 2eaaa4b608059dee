"""Owns the search for a board that nobody described: its dictionary, layout, squares and markers, and its corners.

What a picture shows is found by trying: every predefined dictionary of OpenCV, and every number of squares that puts
the markers seen, in the order of their numbers, on a plane. Only the size of a square cannot be seen.
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
    flipped,
)
from appliance.calibrate.air.calibrate import AirCalibrationError

Array = NDArray[np.float64]
Numbers = NDArray[np.intp]
Image = NDArray[np.uint8]

SQUARES = (3, 60)
SEARCHED = 250
"""Markers of each dictionary that are looked for until it is known which it is: time grows with their number."""
BELONG = 0.6
"""Least share of the markers seen that the layout must put on one plane."""
LOOKED_AT = 4
"""Pictures in which a board is searched for, spread over the folder."""
OFF_SQUARES = 0.25
"""A marker that is further off the plane than this is none of the board's. The bend of a lens stays below it."""
TRIES = 200
"""Sets of four markers through which a plane is laid: one without a mistaken marker is among so many even if half are
mistaken."""
LIKELY = 3
"""Numbers of squares across that are tried."""
STRAIGHT = 0.25
"""Largest part of the way down by which a marker may be off to the side and still be the one below."""
ALONG = 0.9
"""Least cosine between a marker's edges and the squares': without it, a board of which one corner is seen fits sheared.
"""
SIZE_OFF = 0.1
"""Largest difference between the markers' size as told and as seen, in parts of a square."""


class BoardNotFoundError(AirCalibrationError):
    """No picture shows a board of a kind that is known; the text says what was tried, what was seen and what to do."""


@dataclass(frozen=True, slots=True)
class Wanted:
    """The owner's description of a board; ``None`` where it is to be found."""

    square_mm: float
    across: int | None = None
    """Squares across. ``across`` and ``down`` may be exchanged: people differ in which they say first."""
    down: int | None = None
    marker_mm: float | None = None


def search_board(
    pictures: Sequence[tuple[str, Callable[[], Image]]],
    wanted: Wanted,
    progress: Progress,
) -> BoardDesign:
    """Find the board that pictures show, each a name and how to read it. Raises BoardNotFoundError."""
    step = max(1, len(pictures) // LOOKED_AT)
    chosen = [(name, read()) for name, read in pictures[::step][:LOOKED_AT]]
    most: dict[str, int] = {}
    # Upright in all pictures first: to look for mirrored ones takes as long again.
    for mirrored in (False, True):
        for k, (name, image) in enumerate(chosen):
            shown = flipped(image) if mirrored else image
            for family in FAMILIES:
                progress(f"looking for {family} in {name}", k / len(chosen))
                first = find_markers(shown, family, SEARCHED)
                if not mirrored:
                    most[family] = max(most.get(family, 0), len(first.ids))
                if len(first.ids) < LEAST_MARKERS or _best_grid([first]) is None:
                    continue
                if mirrored:
                    raise BoardNotFoundError(
                        f"{name}: the picture is mirrored: turned over left to right, it shows a board; give the "
                        "pictures as the "
                        f"cameras saw them"
                    )
                every = [first, *(find_markers(other, family) for n, other in chosen if n != name)]
                return _described(every, family, wanted)
    seen = ", ".join(f"{count} of {family}" for family, count in most.items() if count) or "no marker of any"
    where = f"{len(chosen)} pictures"
    if len(chosen) < len(pictures):
        where = f"the {len(chosen)} of {len(pictures)} pictures that were looked at ({', '.join(name for name, _ in chosen)})"
    raise BoardNotFoundError(
        f"no ChArUco board in {where}; tried were the dictionaries {', '.join(FAMILIES)}, each in the layout "
        f"of before and since OpenCV 4.6, and {SQUARES[0]} to {SQUARES[1]} squares across; seen were {seen}; give "
        "sharp, "
        f"evenly lit pictures of a ChArUco board whose markers count from 0 (chessboards without markers are not read)"
    )


# ------------------------------------------------------------------------------------------ layout


@dataclass(frozen=True, slots=True, eq=False)
class _Grid:
    """Squares across, and whether the first square is a marker's, with what that puts on planes."""

    across: int
    white_first: bool
    belong: int
    """Markers on their picture's plane, over all pictures."""
    of: int
    """Markers seen."""
    rows: int
    """Rows of squares down to the last one with a marker."""
    marker: float
    """The markers' side in squares."""


def _described(every: Sequence[Markers], family: str, wanted: Wanted) -> BoardDesign:
    told = {n for n in (wanted.across, wanted.down) if n is not None}
    best = _best_grid(every)
    if best is None:
        count = max(len(m.ids) for m in every)
        raise BoardNotFoundError(
            f"{count} markers of {family} in one picture, but no ChArUco board of {SQUARES[0]} to {SQUARES[1]} squares "
            "across "
            f"has them on one plane in that order; its markers must count from 0, row by row"
        )
    if told and best.across not in told:
        raise BoardNotFoundError(
            f"--board {wanted.across}x{wanted.down}: the markers seen ({family}) lie as on a board of {best.across} "
            "squares "
            f"across and {best.rows} or more down; give that, or leave --board out"
        )
    down = best.rows
    # The first square is a marker's only in the old layout with an even number of rows: the last then was out of view.
    if best.white_first and down % 2:
        down += 1
    if wanted.across is not None and wanted.down is not None:
        other = wanted.down if best.across == wanted.across else wanted.across
        if other < best.rows or (best.white_first and other % 2):
            raise BoardNotFoundError(
                f"--board {wanted.across}x{wanted.down}: the markers seen ({family}) lie as on a board of "
                f"{best.across} squares "
                f"across and {down} or more down; give that, or leave --board out"
            )
        down = other
    size = best.marker if wanted.marker_mm is None else wanted.marker_mm / wanted.square_mm
    if abs(size - best.marker) > SIZE_OFF:
        raise BoardNotFoundError(
            f"--board: markers of {wanted.marker_mm:g} mm: in the pictures a marker's side is {best.marker:.3f} of a "
            "square's, which are "
            f"{best.marker * wanted.square_mm:.3g} mm of {wanted.square_mm:g} mm; measure the board, or leave it out"
        )
    plain = BoardDesign(best.across, max(down, SQUARES[0]), wanted.square_mm, size * wanted.square_mm)
    return replace(plain, dictionary=dictionary_number(dictionary_name(family, plain)), legacy=best.white_first)


def _best_grid(every: Sequence[Markers]) -> _Grid | None:
    """Return the number of squares across that puts most markers on planes; ``None`` where none puts enough."""
    enough = [m for m in every if len(m.ids) >= LEAST_MARKERS]
    # Two rows of squares have as many markers as a row has squares: so much larger is the number of the marker two
    # squares below another, whatever the layout.
    votes = Counter(int(step) for markers in enough for step in _steps_down(markers))
    likely = [across for across, _ in votes.most_common(LIKELY)]
    grids = [_grid(enough, across, white) for across in likely for white in (False, True)]
    best = max(grids, key=lambda grid: grid.belong, default=None)
    if best is None or best.belong < LEAST_MARKERS or best.belong < BELONG * best.of:
        return None
    return best


def _steps_down(markers: Markers) -> Numbers:
    """Return by how much the number grows from each marker to the next one straight below it, where that may be."""
    edges = np.stack(
        [markers.outlines_px[:, 1] - markers.outlines_px[:, 0], markers.outlines_px[:, 3] - markers.outlines_px[:, 0]],
        2,
    )
    sound = np.abs(np.linalg.det(edges)) > 1.0
    apart = markers.centres_px[None, sound] - markers.centres_px[sound, None]
    # From marker i to marker j, in sides of i: a along its upper edge, b along its left one.
    a, b = np.moveaxis(np.einsum("ikl,ijl->ijk", np.linalg.inv(edges[sound]), apart), 2, 0)
    b = np.where((b > 1.0) & (np.abs(a) < STRAIGHT * b), b, np.inf)
    if not b.size:
        return np.empty(0, np.intp)
    below, ids = b.argmin(axis=1), markers.ids[sound]
    steps = (ids[below] - ids)[np.isfinite(b.min(axis=1))]
    return np.asarray(steps[(steps >= SQUARES[0]) & (steps <= SQUARES[1])], np.intp)


def _grid(every: Sequence[Markers], across: int, white_first: bool) -> _Grid:
    belong = of = rows = 0
    sides: list[float] = []
    for markers in every:
        squares = _squares(int(markers.ids.max()) + 1, across, white_first)[markers.ids]
        on, size = _on_plane(markers, squares)
        of += len(on)
        if np.count_nonzero(on) < LEAST_MARKERS:
            continue
        belong += int(np.count_nonzero(on))
        rows = max(rows, int(squares[on, 1].max()) + 1)
        sides.append(size)
    return _Grid(across, white_first, belong, of, rows, float(np.median(sides)) if sides else 0.0)


def _squares(count: int, across: int, white_first: bool) -> Numbers:
    """Return the squares (count, 2), column and row, that the first markers lie in: row by row, every second square."""
    rows = 2 * count // across + 3
    row, column = np.mgrid[0:rows, 0:across]
    lit = (row + column) % 2 == (0 if white_first else 1)
    return np.stack([column[lit], row[lit]], 1)[:count].astype(np.intp)


def _on_plane(markers: Markers, squares: Numbers) -> tuple[NDArray[np.bool_], float]:
    """Return which markers lie on one plane in these squares (n, 2), and their median side in squares."""
    none = np.zeros(len(squares), np.bool_), 0.0
    # With one row, every number of squares across would fit.
    if np.ptp(squares[:, 0]) == 0 or np.ptp(squares[:, 1]) == 0:
        return none
    side_px = float(np.median(np.linalg.norm(markers.outlines_px[:, 1] - markers.outlines_px[:, 0], axis=1)))
    middles = squares + 0.5
    to_px, _ = cv2.findHomography(middles, markers.centres_px, cv2.RANSAC, max(OFF_SQUARES * side_px, 1.0), None, TRIES)
    if to_px is None or abs(np.linalg.det(to_px)) < 1e-12:
        return none
    outlines = cv2.perspectiveTransform(
        markers.outlines_px.reshape(-1, 1, 2), np.asarray(np.linalg.inv(to_px), np.float64)
    ).reshape(-1, 4, 2)
    near = np.linalg.norm(outlines.mean(axis=1) - middles, axis=1) < OFF_SQUARES
    # As the board has it, a marker's upper edge runs along x and its left one along y.
    upper, left = outlines[:, 1] - outlines[:, 0], outlines[:, 3] - outlines[:, 0]
    lengths = np.linalg.norm(upper, axis=1), np.linalg.norm(left, axis=1)
    near &= (upper[:, 0] > ALONG * lengths[0]) & (left[:, 1] > ALONG * lengths[1])
    if not near.any():
        return none
    return near, float(np.median(np.concatenate([length[near] for length in lengths])))
