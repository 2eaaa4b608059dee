"""Extraction of a recording from a scan of an artefact: usable pixels and their correspondences.

The artefact is found in the cloud as evaluation finds it. Then the correspondence of each pixel is searched again in
the pattern coordinate maps of both cameras, because a cloud does not keep the ray gaps. Pixels that would falsify a
calibration without a sign are left out: neighbours of depth discontinuities and of masked pixels, grazing incidence,
and pixels where the albedo changes, which shifts the phase of a blurred fringe.

    matched_right_px    subpixel correspondences in both directions, by a quadratic through a window in each camera.
                        A point of a cloud lies where two rays come nearest; it does not keep the ray gap, which shows a
                        tilted port. A window has less noise than a single pixel.
    extract             the recording of a scan
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
"""Largest RMS residual of a window's pattern coordinates from their quadratic, in projector px; more is an edge."""
ROUNDS = 3
APPROACHES = 3
FARTHEST_PX = 40.0
"""Largest step. Uncalibrated ports put the start some twenty pixels beside the correspondence."""
BLOCK = 4096


def matched_right_px(
    left_pq: tuple[Map, Map], right_pq: tuple[Map, Map], left_px: NDArray[np.intp], right_start_px: Array
) -> tuple[Array, NDArray[np.bool_]]:
    """Return the right pixels (n, 2) that correspond to left pixels (n, 2), and which of them were found.

    ``left_pq`` and ``right_pq`` are the pattern coordinates (p, q) of every pixel, NaN where masked; ``right_start_px``
    is within some twenty pixels of the correspondence. Points whose windows are not complete or not smooth are not
    found.
    """
    right_px = np.full((len(left_px), 2), np.nan)
    is_found = np.zeros(len(left_px), bool)
    for start in range(0, len(left_px), BLOCK):
        part = slice(start, start + BLOCK)
        right_px[part], is_found[part] = _match(left_pq, right_pq, left_px[part], right_start_px[part])
    return right_px, is_found


def _match(
    left_pq: tuple[Map, Map], right_pq: tuple[Map, Map], left_px: NDArray[np.intp], start_px: Array
) -> tuple[Array, NDArray[np.bool_]]:
    offsets = np.arange(-HALF_WINDOW_PX, HALF_WINDOW_PX + 1)
    v, u = (grid.ravel() for grid in np.meshgrid(offsets, offsets, indexing="ij"))
    terms = _terms(u / HALF_WINDOW_PX, v / HALF_WINDOW_PX)
    # Least squares of the six terms over a fixed window is one matrix for all pixels: coefficients = pinv · values. Row
    # 0 is the value at the middle.
    fit = np.asarray(np.linalg.pinv(terms), np.float64)
    left_values, is_good = _window(left_pq, left_px, u, v)
    target_pq = np.einsum("t,ntk->nk", fit[0], left_values)
    is_good &= _smooth(terms, fit, left_values)
    right_px = np.where(np.isfinite(start_px).all(axis=1, keepdims=True), start_px, -1e6)
    right_px = _approach(right_pq, target_pq, right_px, u, v)
    middle = np.rint(right_px).astype(np.intp)
    for _ in range(ROUNDS):
        # Newton: find where the surface through the window around the nearest pixel has the target coordinates.
        middle = np.rint(right_px).astype(np.intp)
        right_values, complete = _window(right_pq, middle, u, v)
        surface = np.einsum("st,ntk->nsk", fit, right_values)
        x = (right_px - middle) / HALF_WINDOW_PX
        for _ in range(ROUNDS):
            slope = _slopes(x)
            residual = target_pq - np.einsum("ns,nsk->nk", _terms(x[:, 0], x[:, 1]), surface)
            J = np.einsum("nsd,nsk->nkd", slope, surface)
            step, solvable = _solve_2x2(J, residual, complete)
            # Beyond the window the quadratic is extrapolated; without the limit, Newton leaves the image where the
            # slope vanishes.
            x = np.clip(x + step, -5.0, 5.0)
        right_px = np.where(solvable[:, None], middle + x * HALF_WINDOW_PX, right_px)
        smooth = _smooth(terms, fit, right_values)
    is_good &= solvable & smooth & (np.abs(right_px - middle).max(axis=1) <= 1.0)
    return np.where(is_good[:, None], right_px, np.nan), is_good


def _approach(
    right_pq: tuple[Map, Map], target_pq: Array, right_px: Array, u: NDArray[np.intp], v: NDArray[np.intp]
) -> Array:
    """Return starts moved near to the target coordinates, by planes through windows.

    Far from the solution the curvature of a window has no meaning, only its slope.
    """
    flat = np.asarray(np.linalg.pinv(np.stack([np.ones(len(u)), u, v], -1)), np.float64)
    for _ in range(APPROACHES):
        middle = np.rint(right_px).astype(np.intp)
        right_values, complete = _window(right_pq, middle, u, v)
        surface = np.einsum("st,ntk->nsk", flat, right_values)
        step, solvable = _solve_2x2(np.swapaxes(surface[:, 1:], 1, 2), target_pq - surface[:, 0], complete)
        right_px = np.where(solvable[:, None], middle + np.clip(step, -FARTHEST_PX, FARTHEST_PX), right_px)
    return right_px


def _solve_2x2(J: Array, residual: Array, complete: NDArray[np.bool_]) -> tuple[Array, NDArray[np.bool_]]:
    """Return the steps (n, 2) that solve J step = ``residual`` (n, 2), and where they exist; elsewhere zero.

    J is (n, 2, 2: coordinate, axis).
    """
    # Cramer's rule for all pixels at once.
    det = J[:, 0, 0] * J[:, 1, 1] - J[:, 0, 1] * J[:, 1, 0]
    solvable = complete & (np.abs(det) > 1e-6)
    across = J[:, 1, 1] * residual[:, 0] - J[:, 0, 1] * residual[:, 1]
    down = J[:, 0, 0] * residual[:, 1] - J[:, 1, 0] * residual[:, 0]
    step = np.stack([across, down], -1) / np.where(solvable, det, 1.0)[:, None]
    return np.where(solvable[:, None], step, 0.0), solvable


def _window(
    pq: tuple[Map, Map], middle: NDArray[np.intp], u: NDArray[np.intp], v: NDArray[np.intp]
) -> tuple[Array, NDArray[np.bool_]]:
    """Return coordinates (n, window, 2) around pixels, and which windows are complete; zeros in incomplete ones."""
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
    residual = values - np.einsum("ts,nsk->ntk", terms @ fit, values)
    return np.asarray(np.sqrt(np.mean(residual**2, axis=(1, 2))) < MAX_ROUGHNESS)


def _terms(x: Array, y: Array) -> Array:
    return np.stack([np.ones_like(x), x, y, x * x, x * y, y * y], -1)


def _slopes(xy: Array) -> Array:
    """Return derivatives (n, 6, 2) of the terms by x and y."""
    x, y = xy[:, 0], xy[:, 1]
    zeros, ones = np.zeros_like(x), np.ones_like(x)
    return np.stack(
        [np.stack([zeros, ones, zeros, 2 * x, y, zeros], -1), np.stack([zeros, zeros, ones, zeros, x, 2 * y], -1)], -1
    )


Flags = NDArray[np.bool_]
Pixels = NDArray[np.intp]

CALIBRATING_GAP_MM = 15.0
"""Limit of the ray gap for scans that calibrate: with uncalibrated ports, ray gaps of true correspondences are
millimetres.

Two ports tilted by 2° away from each other cause 9 mm; a limit of 5 mm left an instrument like that of the paper
without a point.
"""
GUARD_PX = HALF_WINDOW_PX + 2
"""A pixel is used if all within this distance are measured: the window, and beyond it the reach of a blurred edge."""
MAX_CONTRAST = 0.08
"""Largest relative RMS of the modulation's gradient in a window; more is a change of albedo."""
LARGEST_BOW_MM = 1.0
"""Largest RMS residual of a plane's points; nominal ports bend a plane by some tenths, and more is another object."""
POINTS_PER_SURFACE = 4000
"""Approximate number of points, evenly spread, of a surface that fills the image."""
UNSTATED_RADIUS_SD_MM = 0.2
"""Standard deviation of a radius without certificate, measured in the cloud of the uncalibrated instrument."""


@dataclass(frozen=True, slots=True)
class BarCertificate:
    """Certified dimensions of a ball bar, in mm."""

    length_mm: float
    """Distance between the centres."""
    length_sd_mm: float = 0.003
    """Standard uncertainty of the distance (half of the expanded one)."""
    radius_mm: float | None = None
    """Radius of both balls; ``None``: not stated, it is estimated."""
    radius_sd_mm: float = 0.01


class DecodedImage(Protocol):
    """Decoded scan of one camera; ``appliance.measure.decode.decoder.CameraDecoder`` is one."""

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
    """Return the recording of a scan: of a ball bar with its certificate, of a plane with ``None``.

    ``cloud`` was reconstructed from the same maps with ``start`` and the wide gap limit ``CALIBRATING_GAP_MM``. Returns
    ``NotFound`` with the reason in words where too little of the artefact is visible. Deterministic.
    """
    bar: BallBar | None = None
    if certificate is None:
        plane = fit_plane(cloud)
        if isinstance(plane, NotFound):
            return plane
        if plane.used.rms_mm > LARGEST_BOW_MM:
            return NotFound(
                f"{name}: the points lie {plane.used.rms_mm:.1f} mm (RMS) about the nearest plane; a "
                "calibration needs a flat face; check the artefact in the list"
            )
        surfaces = {"plane": np.sort(plane.used.indices)}
    else:
        ball_bar = find_ball_bar(cloud)
        if isinstance(ball_bar, NotFound):
            return ball_bar
        bar = ball_bar
        surfaces = {
            f"{which} ball": ball.seen_from(np.asarray(start.rig.right.translation_mm), cloud)
            for which, ball in (("first", bar.first), ("second", bar.second))
        }
    width_px = left.p_px.shape[1]
    clean_left, clean_right = _usable_pixels(left), _usable_pixels(right)
    chosen, labels = [], []
    for label, rows in enumerate(surfaces.values()):
        v, u = np.divmod(cloud.pixel[rows].astype(np.intp), width_px)
        chosen.append(rows[_on_grid(u, v) & clean_left[v, u]])
        labels.append(np.full(len(chosen[-1]), label, np.intp))
    rows, sphere = np.concatenate(chosen), np.concatenate(labels)
    v, u = np.divmod(cloud.pixel[rows].astype(np.intp), width_px)
    left_px = np.stack([u, v], -1)
    # The search starts from the projected point, because the cloud does not keep the right pixel; it is wide enough for
    # nominal ports.
    guess = start.rig.right.project(cloud.points_mm[rows].astype(np.float64), water.index)
    right_px, is_good = matched_right_px((left.p_px, left.q_px), (right.p_px, right.q_px), left_px, guess)
    nearest = np.rint(np.where(is_good[:, None], right_px, 0.0)).astype(np.intp)
    is_good &= clean_right[nearest[:, 1], nearest[:, 0]]
    # A fringe that is blurred over a change of albedo is a mean with unequal weights: its phase shifts towards the
    # brighter side, and equally in every image.
    is_good &= _even_albedo(left, left_px) & _even_albedo(right, nearest)
    for label, (surface, on_surface) in enumerate(surfaces.items()):
        count = int(np.count_nonzero(is_good & (sphere == label)))
        if count < MIN_POINTS:
            return NotFound(
                f"{name}: of {len(on_surface)} points on the {surface} only {count} are good enough, "
                f"{MIN_POINTS} are needed; clean the artefact, avoid glare, and bring it fully into view of "
                "both cameras"
            )
    correspondences = left_px[is_good].astype(np.float64), right_px[is_good]
    if certificate is None or bar is None:
        return Recording(name, ArtefactKind.PLANE, *correspondences, water, sphere[is_good])
    stated_radius_mm = certificate.radius_mm
    radius_mm = (
        stated_radius_mm
        if stated_radius_mm is not None
        else 0.5 * (bar.first.sphere.radius_mm + bar.second.sphere.radius_mm)
    )
    return Recording(
        name,
        ArtefactKind.BALL_BAR,
        *correspondences,
        water,
        sphere[is_good],
        length_mm=certificate.length_mm,
        length_sd_mm=certificate.length_sd_mm,
        radius_mm=radius_mm,
        radius_sd_mm=certificate.radius_sd_mm if stated_radius_mm is not None else UNSTATED_RADIUS_SD_MM,
    )


def _usable_pixels(image: DecodedImage) -> Flags:
    """Return the pixels (h, w) without a masked one within the guard distance.

    Outside the image all pixels count as masked.
    """
    is_measured = (np.isfinite(image.p_px) & np.isfinite(image.q_px)).astype(np.uint8)
    # Erosion of the measured pixels by the guard distance.
    box = np.ones((2 * GUARD_PX + 1, 2 * GUARD_PX + 1), np.uint8)
    return np.asarray(cv2.erode(is_measured, box, borderType=cv2.BORDER_CONSTANT, borderValue=0) == 1)


def _on_grid(u: Pixels, v: Pixels) -> Flags:
    """Return which pixels are on a square grid that leaves about ``POINTS_PER_SURFACE`` of them.

    Windows around them overlap little.
    """
    step = max(HALF_WINDOW_PX + 1, int((len(u) / POINTS_PER_SURFACE) ** 0.5))
    return np.asarray((u % step == 0) & (v % step == 0))


def _even_albedo(image: DecodedImage, px: Pixels) -> Flags:
    """Tell around which pixels (n, 2) the modulation is uniform; all are inside the guard distance."""
    offsets = np.arange(-HALF_WINDOW_PX, HALF_WINDOW_PX + 1)
    v, u = (grid.ravel() for grid in np.meshgrid(offsets, offsets, indexing="ij"))
    height, width = image.modulation_half_dn.shape
    rows = np.clip(px[:, 1:] + v, 0, height - 1)
    columns = np.clip(px[:, :1] + u, 0, width - 1)
    window = image.modulation_half_dn[rows, columns].astype(np.float64)
    # Two orthonormal gradients of the window; their RMS is that of the plane through the modulation.
    slopes = np.stack([u, v], -1) / float(np.sqrt(np.sum(u * u)))
    # Two numbers from twenty-five pixels: the noise of a dark image does not look like a change of albedo then.
    rms = np.linalg.norm(window @ slopes, axis=1) / len(u) ** 0.5
    return np.asarray(rms <= MAX_CONTRAST * window.mean(axis=1))
