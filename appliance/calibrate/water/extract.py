"""Owns how a scanned artefact becomes a recording: which pixels are fit to calibrate with, and their matches.

The artefact is found in the cloud as evaluation finds it; then each pixel's match is looked up anew in the phase maps
of both cameras, because a cloud has forgotten by how much the two rays missed each other. Left out is what would bend
a calibration without being noticed: neighbours of edges and of masked (dark, saturated) pixels, grazing views, and
pixels where the albedo changes, which shifts the phase of a blurred fringe.

It also owns the subpixel correspondence that a calibration needs: both directions, averaged over small windows.

A cloud keeps one point where two rays come nearest and thereby forgets by how much they missed each other, which is
what tells a tilted port. Here the matched right pixel itself is found again, in phase maps, with less noise than a
single pixel has: a quadratic through a window on either side.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import cv2
import numpy as np
from numpy.typing import NDArray

from appliance.calibrate.recordings import MIN_POINTS, ArtefactKind, Recording
from appliance.measure import (
    BallBar,
    Calibration,
    NotFound,
    PointSource,
    Water,
    find_ball_bar,
    fit_plane,
)

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
    ``right_start_px`` says within some twenty pixels where to look. Points whose windows are not complete or not smooth
    are not found.
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


Flags = NDArray[np.bool_]
Pixels = NDArray[np.intp]

CALIBRATING_GAP_MM = 15.0
"""Limit of the ray gap for scans that calibrate: with ports that nobody has measured, true rays miss by millimetres.

Two ports tilted by 2° away from each other make 9 mm; 5 mm left an instrument like the paper's without a single point.
"""
GUARD_PX = HALF_WINDOW_PX + 2
"""A pixel is used if all within this distance are measured: beside the window, what an edge's blur may reach."""
MAX_CONTRAST = 0.08
"""Relative RMS of the smoothed modulation in a window; more is a change of albedo."""
LARGEST_BOW_MM = 1.0
"""RMS of a plane's points about it; ports as drawn bend a plane by some tenths. More is something else."""
POINTS_PER_SURFACE = 4000
"""Wanted; a surface that fills the image gives about so many, evenly spread."""
UNSTATED_RADIUS_SD_MM = 0.2
"""Standard deviation of a radius that no certificate states and that is taken from the cloud of a calibration yet to be
made."""


@dataclass(frozen=True, slots=True)
class BarCertificate:
    """Certified dimensions of a ball bar. Lengths in mm."""

    length_mm: float
    """Distance between the centres."""
    length_sd_mm: float = 0.003
    """Standard uncertainty of the distance (half of the expanded one)."""
    radius_mm: float | None = None
    """Radius of both balls; ``None``: not stated, it is estimated."""
    radius_sd_mm: float = 0.01


class DecodedImage(Protocol):
    """One camera's decoded scan; ``appliance.measure.decode.decoder.CameraDecoder`` is one."""

    p_px: NDArray[np.float32]
    """(h, w) pattern column, NaN where it is unknown."""
    q_px: NDArray[np.float32]
    modulation_half_dn: NDArray[np.uint8]


def extract(
    name: str,
    certificate: BarCertificate | None,
    cloud: PointSource,
    left: DecodedImage,
    right: DecodedImage,
    start: Calibration,
    water: Water,
) -> Recording | NotFound:
    """Return the recording that a scan makes: of a ball bar with its certificate, of a plane with ``None``.

    ``cloud`` was reconstructed from the same maps with ``start`` and the wide gap limit ``CALIBRATING_GAP_MM``. The
    answer is ``NotFound`` with the reason in words where the artefact is not seen well enough. Deterministic.
    """
    bar: BallBar | None = None
    if certificate is None:
        plane = fit_plane(cloud)
        if isinstance(plane, NotFound):
            return plane
        if plane.used.rms_mm > LARGEST_BOW_MM:
            return NotFound(
                f"{name}: the points lie {plane.used.rms_mm:.1f} mm (RMS) about the nearest plane; only a flat face "
                f"calibrates; see whether the list names the right artefact"
            )
        surfaces = {"plane": np.sort(plane.used.indices)}
    else:
        found = find_ball_bar(cloud)
        if isinstance(found, NotFound):
            return found
        bar = found
        surfaces = {
            f"{which} ball": ball.seen_from(np.asarray(start.rig.right.translation_mm), cloud)
            for which, ball in (("first", bar.first), ("second", bar.second))
        }
    width_px = left.p_px.shape[1]
    clean_left, clean_right = _clean(left), _clean(right)
    chosen, labels = [], []
    for label, rows in enumerate(surfaces.values()):
        v, u = np.divmod(cloud.pixel[rows].astype(np.intp), width_px)
        chosen.append(rows[_even(u, v) & clean_left[v, u]])
        labels.append(np.full(len(chosen[-1]), label, np.intp))
    rows, sphere = np.concatenate(chosen), np.concatenate(labels)
    v, u = np.divmod(cloud.pixel[rows].astype(np.intp), width_px)
    left_px = np.stack([u, v], -1)
    # The point is projected rather than the match looked up: the cloud does not keep the right pixel, and the search is
    # wide enough for ports as drawn.
    guess = start.rig.right.project(cloud.points_mm[rows].astype(np.float64), water.index)
    right_px, good = matched_right_px((left.p_px, left.q_px), (right.p_px, right.q_px), left_px, guess)
    nearest = np.rint(np.where(good[:, None], right_px, 0.0)).astype(np.intp)
    good &= clean_right[nearest[:, 1], nearest[:, 0]]
    # A fringe that is blurred over a change of albedo is a mean with unequal weights: its phase moves towards the
    # brighter side, and by the same way in every image.
    good &= _even_albedo(left, left_px) & _even_albedo(right, nearest)
    for label, (what, on_surface) in enumerate(surfaces.items()):
        count = int(np.count_nonzero(good & (sphere == label)))
        if count < MIN_POINTS:
            return NotFound(
                f"{name}: of {len(on_surface)} points on the {what} only {count} are fit to calibrate with, "
                f"{MIN_POINTS} "
                f"are needed; clean the artefact, avoid glare, and bring it whole into the picture of both cameras"
            )
    picked = left_px[good].astype(np.float64), right_px[good]
    if certificate is None or bar is None:
        return Recording(name, ArtefactKind.PLANE, *picked, water, sphere[good])
    stated = certificate.radius_mm
    radius_mm = stated if stated is not None else 0.5 * (bar.first.sphere.radius_mm + bar.second.sphere.radius_mm)
    return Recording(
        name,
        ArtefactKind.BALL_BAR,
        *picked,
        water,
        sphere[good],
        length_mm=certificate.length_mm,
        length_sd_mm=certificate.length_sd_mm,
        radius_mm=radius_mm,
        radius_sd_mm=certificate.radius_sd_mm if stated is not None else UNSTATED_RADIUS_SD_MM,
    )


def _clean(image: DecodedImage) -> Flags:
    """Return (h, w): pixels with nothing unknown within the guard distance; the image's border counts as unknown."""
    known = (np.isfinite(image.p_px) & np.isfinite(image.q_px)).astype(np.uint8)
    # Erosion of the known pixels by the guard; unknown outside of the image.
    box = np.ones((2 * GUARD_PX + 1, 2 * GUARD_PX + 1), np.uint8)
    return np.asarray(cv2.erode(known, box, borderType=cv2.BORDER_CONSTANT, borderValue=0) == 1)


def _even(u: Pixels, v: Pixels) -> Flags:
    """Return pixels on a square grid so wide that about the wanted number remains and windows share little."""
    step = max(HALF_WINDOW_PX + 1, int((len(u) / POINTS_PER_SURFACE) ** 0.5))
    return np.asarray((u % step == 0) & (v % step == 0))


def _even_albedo(image: DecodedImage, px: Pixels) -> Flags:
    """Tell whether the modulation around pixels (n, 2), all inside the guard, is the same all over the window."""
    offsets = np.arange(-HALF_WINDOW_PX, HALF_WINDOW_PX + 1)
    v, u = (grid.ravel() for grid in np.meshgrid(offsets, offsets, indexing="ij"))
    height, width = image.modulation_half_dn.shape
    rows = np.clip(px[:, 1:] + v, 0, height - 1)
    columns = np.clip(px[:, :1] + u, 0, width - 1)
    window = image.modulation_half_dn[rows, columns].astype(np.float64)
    # Two orthonormal slopes of the window; their RMS is that of the plane through the modulation.
    slopes = np.stack([u, v], -1) / float(np.sqrt(np.sum(u * u)))
    # Only the gradient: two numbers of twenty-five keep the noise of a dark picture from looking like a pattern.
    rms = np.linalg.norm(window @ slopes, axis=1) / len(u) ** 0.5
    return np.asarray(rms <= MAX_CONTRAST * window.mean(axis=1))
