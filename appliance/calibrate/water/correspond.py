"""Owns the subpixel correspondence that a calibration needs: both directions, averaged over small windows.

A cloud keeps one point where two rays come nearest and thereby forgets by how much they missed each other, which is
what tells a tilted port. Here the matched right pixel itself is found again, in phase maps, with less noise than a
single pixel has: a quadratic through a window on either side.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Map = NDArray[np.float32]

HALF_WINDOW_PX = 2
MAX_ROUGHNESS = 0.5
"""RMS of a window's phases about their quadratic, in projector px; more is an edge."""
ROUNDS = 3
APPROACHES = 3
FARTHEST_PX = 40.0
"""Ports that nobody has measured yet put the start some twenty pixels beside the match."""
BLOCK = 4096


def matched_right_px(
    left_pq: tuple[Map, Map], right_pq: tuple[Map, Map], left_px: NDArray[np.intp], right_start_px: Array
) -> tuple[Array, NDArray[np.bool_]]:
    """Return the right pixels (n, 2) that show what left pixels (n, 2) show, and which of them were found.

    ``left_pq`` and ``right_pq`` are the pattern coordinates (p, q) of every pixel, NaN where unknown;
    ``right_start_px`` says within some twenty pixels where to look. Points whose windows are not complete or not smooth are
    not found.
    """
    found_px = np.full((len(left_px), 2), np.nan)
    good = np.zeros(len(left_px), bool)
    for start in range(0, len(left_px), BLOCK):
        part = slice(start, start + BLOCK)
        found_px[part], good[part] = _match(left_pq, right_pq, left_px[part], right_start_px[part])
    return found_px, good


def _match(
    left_pq: tuple[Map, Map], right_pq: tuple[Map, Map], left_px: NDArray[np.intp], start_px: Array
) -> tuple[Array, NDArray[np.bool_]]:
    offsets = np.arange(-HALF_WINDOW_PX, HALF_WINDOW_PX + 1)
    v, u = (grid.ravel() for grid in np.meshgrid(offsets, offsets, indexing="ij"))
    terms = _terms(u / HALF_WINDOW_PX, v / HALF_WINDOW_PX)
    # Least squares of the six terms over a fixed window is one matrix for all pixels: coefficients = pinv · values. Row
    # 0 is the value at the middle.
    fit = np.asarray(np.linalg.pinv(terms), np.float64)
    mine, good = _window(left_pq, left_px, u, v)
    wanted = np.einsum("t,ntk->nk", fit[0], mine)
    good &= _smooth(terms, fit, mine)
    at = np.where(np.isfinite(start_px).all(axis=1, keepdims=True), start_px, -1e6)
    at = _approached(right_pq, wanted, at, u, v)
    middle = np.rint(at).astype(np.intp)
    for _ in range(ROUNDS):
        # Where the surface through the window around the nearest pixel has the wanted coordinates: Newton.
        middle = np.rint(at).astype(np.intp)
        other, complete = _window(right_pq, middle, u, v)
        surface = np.einsum("st,ntk->nsk", fit, other)
        x = (at - middle) / HALF_WINDOW_PX
        for _ in range(ROUNDS):
            slope = _slopes(x)
            miss = wanted - np.einsum("ns,nsk->nk", _terms(x[:, 0], x[:, 1]), surface)
            J = np.einsum("nsd,nsk->nkd", slope, surface)
            step, solvable = _solved(J, miss, complete)
            # Beyond the window the quadratic is extrapolation; without the bound Newton leaves the image where the
            # slope vanishes.
            x = np.clip(x + step, -5.0, 5.0)
        at = np.where(solvable[:, None], middle + x * HALF_WINDOW_PX, at)
        smooth = _smooth(terms, fit, other)
    good &= solvable & smooth & (np.abs(at - middle).max(axis=1) <= 1.0)
    return np.where(good[:, None], at, np.nan), good


def _approached(right_pq: tuple[Map, Map], wanted: Array, at: Array, u: NDArray[np.intp], v: NDArray[np.intp]) -> Array:
    """Return starts moved near to where the wanted coordinates are. Far away a window's bend means nothing: its slope
    does."""
    flat = np.asarray(np.linalg.pinv(np.stack([np.ones(len(u)), u, v], -1)), np.float64)
    for _ in range(APPROACHES):
        middle = np.rint(at).astype(np.intp)
        other, complete = _window(right_pq, middle, u, v)
        surface = np.einsum("st,ntk->nsk", flat, other)
        step, solvable = _solved(np.swapaxes(surface[:, 1:], 1, 2), wanted - surface[:, 0], complete)
        at = np.where(solvable[:, None], middle + np.clip(step, -FARTHEST_PX, FARTHEST_PX), at)
    return at


def _solved(J: Array, miss: Array, complete: NDArray[np.bool_]) -> tuple[Array, NDArray[np.bool_]]:
    """Return steps (n, 2) that J (n, 2, 2: coordinate, axis) maps to ``miss`` (n, 2), and where there is one;
    elsewhere zero."""
    # Cramer's rule for all pixels at once.
    det = J[:, 0, 0] * J[:, 1, 1] - J[:, 0, 1] * J[:, 1, 0]
    solvable = complete & (np.abs(det) > 1e-6)
    across = J[:, 1, 1] * miss[:, 0] - J[:, 0, 1] * miss[:, 1]
    down = J[:, 0, 0] * miss[:, 1] - J[:, 1, 0] * miss[:, 0]
    step = np.stack([across, down], -1) / np.where(solvable, det, 1.0)[:, None]
    return np.where(solvable[:, None], step, 0.0), solvable


def _window(
    pq: tuple[Map, Map], middle: NDArray[np.intp], u: NDArray[np.intp], v: NDArray[np.intp]
) -> tuple[Array, NDArray[np.bool_]]:
    """Return coordinates (n, window, 2) around pixels, and which windows are complete; zeros in those that are not."""
    height, width = pq[0].shape
    h = HALF_WINDOW_PX
    within = np.all((middle >= h) & (middle < [width - h, height - h]), axis=1)
    safe = np.where(within[:, None], middle, h)
    rows, columns = safe[:, 1:] + v, safe[:, :1] + u
    values = np.stack([pq[0][rows, columns], pq[1][rows, columns]], -1).astype(np.float64)
    complete = within & np.isfinite(values).all(axis=(1, 2))
    values[~complete] = 0.0
    return values, complete


def _smooth(terms: Array, fit: Array, values: Array) -> NDArray[np.bool_]:
    rest = values - np.einsum("ts,nsk->ntk", terms @ fit, values)
    return np.asarray(np.sqrt(np.mean(rest**2, axis=(1, 2))) < MAX_ROUGHNESS)


def _terms(x: Array, y: Array) -> Array:
    return np.stack([np.ones_like(x), x, y, x * x, x * y, y * y], -1)


def _slopes(xy: Array) -> Array:
    """Return derivatives (n, 6, 2) of the terms by x and y."""
    x, y = xy[:, 0], xy[:, 1]
    zero, one = np.zeros_like(x), np.ones_like(x)
    return np.stack(
        [np.stack([zero, one, zero, 2 * x, y, zero], -1), np.stack([zero, zero, one, zero, x, 2 * y], -1)], -1
    )
