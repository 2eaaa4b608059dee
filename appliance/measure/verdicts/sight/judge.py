"""Owns what the frames say of the object by themselves: whether it shows fringes, how much light it sends, where it
lies.

It is asked where decoding comes to nothing: a pixel needs 5 grey values of modulation, but the mean over a cell of some
hundred pixels tells fringes of half a grey value from noise. Fringes across the baseline are the object's alone: a ray
crosses many of them in the water, so that the water's light has none. Points are asked where they lie before any limit
of depth; where there are none, the fringes themselves.

It also owns how far something lies whose fringes are too faint to be decoded: at which depth both cameras see the same
patterns.

A pixel must tell 5 grey values of fringes from noise before it is decoded; a small window over all images across the
baseline tells a seventh of that. So windows of the left camera are laid over the right one where each depth would put
them, and their changes from image to image compared. Of Gray images only what changes within the window counts: an edge
is the object's, what is smooth may be the water's.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numba
import numpy as np
from numpy.typing import NDArray

from appliance.measure.light.model import StereoRig
from appliance.measure.light.noise import CameraNoise, StereoNoise
from appliance.measure.light.patterns import Direction, PatternSequence
from appliance.measure.light.sides import SIDES, of_side
from appliance.measure.points.quality import QualityLimits
from appliance.measure.points.table import Cloud
from appliance.measure.scan_images import ScanImages
from appliance.measure.verdict import Verdict
from appliance.measure.verdicts.water.beam import half_field, shape_of_glow

Array = NDArray[np.float64]
Floats = NDArray[np.float32]

WIDTH_PX = 400
"""About so wide are the images made before they are compared: that costs little and averages noise away."""
ROWS, COLUMNS = 5, 14
"""Size of a window in such images: two fringes wide; a surface that slants by 20° shifts them by less than a third
at its ends."""
WINDOWS = 120
"""Those with the strongest fringes."""
LEAST_SWING_DN, LEAST_SHARE = 0.8, 0.1
"""Twice the amplitude of a window's fringes, at least, and as a share of what the projector's white adds there: less
may be what is left of long fringes in the illuminated water, which is near."""
CLEAR_DN = 250.0
"""No image of a window may be brighter anywhere; nor of any place where the right camera might see it, for what is
saturated there may be the window itself, and the likest of the other places is then a wrong fringe."""
_NEAREST_MM, _FARTHEST_MM = 250.0, 1500.0
"""Depths, of the standard housing, between which windows are looked for."""
STEP_PX = 1.5
"""Distance from depth to depth, as the right camera sees it: a fifth of a fringe."""
LEAST_LIKE = 0.25
"""Correlation from which on a window is found again; chance makes 0.1 over all depths at most, fringes of 0.7 grey
values 0.4."""
BESIDE, DISTINCT = 3, 1.1
"""And by so much more than at any depth that is farther away than these steps: fringes repeat, Gray edges do not."""
MIN_WINDOWS = 12


def find_depths_mm(
    frames: Mapping[str, NDArray[np.uint8]],
    sequence: PatternSequence,
    noise: StereoNoise,
    rig: StereoRig,
    water_index: float,
) -> Array:
    """Return the depth of each window that is found again, in the left camera's frame; to half a per cent. Empty
    where fewer than ``MIN_WINDOWS`` are. ``frames``: (n, h, w) uint8 of ``left`` and ``right``."""
    none = np.empty(0)
    factor = max(1, rig.left.width_px // WIDTH_PX)
    left = _changes(frames["left"], sequence, factor)
    right = _changes(frames["right"], sequence, factor)
    v, u = _strongest(frames["left"], sequence, factor, left, noise.left)
    if len(v) < MIN_WINDOWS:
        return none
    depths_mm = candidate_depths_mm(rig, water_index)
    # What scales with an image is the place from its edge on, half a pixel before the first one's middle.
    half = 0.5 * np.array([COLUMNS, ROWS])
    seen = seen_at_depths(rig, water_index, factor * (np.stack([u, v], -1) + half) - 0.5, depths_mm)
    places = (seen + 0.5) / factor - half
    like = np.stack([_likeness(left, right, (int(v[k]), int(u[k])), places[k]) for k in range(len(v))])
    best = like.argmax(axis=1)
    beside = abs(np.arange(len(depths_mm)) - best[:, None]) > BESIDE
    sure = like.max(axis=1) >= np.maximum(LEAST_LIKE, DISTINCT * np.where(beside, like, 0.0).max(axis=1))
    sure &= _clear_everywhere(_brightest(frames["right"], sequence, factor), places)
    found = depths_mm[best[sure]]
    return found if len(found) >= MIN_WINDOWS else none


def _changes(frames: NDArray[np.uint8], sequence: PatternSequence, factor: int) -> Floats:
    """Return (channels, rows, columns) opposite sines' differences, then each Gray image against half way from dark
    to bright."""
    axis = sequence.axis(Direction.X)
    small = {k: _shrunk(frames[k], factor) for k in (sequence.bright, sequence.dark, *axis.sine, *axis.gray)}
    i0, i1, i2, i3 = (small[k] for k in axis.sine)
    both = small[sequence.bright] + small[sequence.dark]
    return np.stack([i0 - i2, i3 - i1, *(2.0 * small[k] - both for k in axis.gray)]).astype(np.float32)


def _shrunk(image: NDArray[np.uint8], factor: int) -> Floats:
    if factor == 1:
        return image.astype(np.float32)
    rows, columns = image.shape[0] // factor, image.shape[1] // factor
    boxes = image[: rows * factor, : columns * factor].reshape(rows, factor, columns, factor)
    return np.asarray(boxes.mean(axis=(1, 3), dtype=np.float32))


def _strongest(
    frames: NDArray[np.uint8], sequence: PatternSequence, factor: int, changes: Floats, noise: CameraNoise
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the upper left corners (rows, columns) of the windows that show most fringes beyond noise and are
    nowhere saturated."""
    sines = sequence.axis(Direction.X).sine
    level = np.mean([_shrunk(frames[k], factor) for k in sines], axis=0)
    chance = 4.0 * noise.variance_dn2(level) / factor**2
    excess = _tiled(changes[0] ** 2 + changes[1] ** 2 - chance).mean(axis=(1, 3))
    clear = _tiled(_brightest(frames, sequence, factor)).max(axis=(1, 3)) < CLEAR_DN
    light = _tiled(_shrunk(frames[sequence.bright], factor) - _shrunk(frames[sequence.dark], factor)).mean(axis=(1, 3))
    excess[~clear | (excess < np.maximum(LEAST_SWING_DN, LEAST_SHARE * light) ** 2)] = 0.0
    order = np.argsort(-excess, axis=None)[:WINDOWS]
    rows, columns = np.unravel_index(order[excess.ravel()[order] > 0.0], excess.shape)
    return rows * ROWS, columns * COLUMNS


def _brightest(frames: NDArray[np.uint8], sequence: PatternSequence, factor: int) -> Floats:
    """Return a small image of the brightest grey value that each pixel has in the bright image and the sines."""
    bright = (sequence.bright, *sequence.axis(Direction.X).sine)
    return _shrunk(np.maximum.reduce([frames[k] for k in bright]), factor)


def _clear_everywhere(brightest: Floats, places: Array) -> NDArray[np.bool_]:
    """Return (n,) whether nothing is too bright in any of the windows at ``places`` (n, depths, 2: column, row)
    within the image."""
    clear = np.asarray((_windows(brightest) < CLEAR_DN).all(axis=(2, 3)))
    at, inside = _within(places, clear.shape)
    return np.asarray((clear[at[..., 1], at[..., 0]] | ~inside).all(axis=1), np.bool_)


def _windows(images: Floats) -> Floats:
    """Return (…, rows, columns, ROWS, COLUMNS): the window at each corner, without a copy."""
    return np.lib.stride_tricks.sliding_window_view(images, (ROWS, COLUMNS), axis=(-2, -1))


def _within(places: Array, corners: tuple[int, ...]) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
    """Return ``places`` as whole numbers, and which of them are among so many ``corners`` (rows, columns); 0 for the
    others."""
    at = np.rint(places)
    inside = np.asarray(((at >= 0.0) & (at < corners[::-1])).all(axis=-1))
    return np.where(inside[..., None], at, 0.0).astype(np.int64), inside


def _tiled(image: Floats) -> Floats:
    rows, columns = image.shape[0] // ROWS, image.shape[1] // COLUMNS
    return np.asarray(image[: rows * ROWS, : columns * COLUMNS].reshape(rows, ROWS, columns, COLUMNS))


def candidate_depths_mm(rig: StereoRig, water_index: float) -> Array:
    """Return depths so close to each other that the right camera sees the image's middle move by ``STEP_PX`` of a
    small image's."""
    nearest_mm, farthest_mm = rig.volume.scaled(_NEAREST_MM), rig.volume.scaled(_FARTHEST_MM)
    near, far = 1.0 / nearest_mm, 1.0 / farthest_mm
    middle = np.array([[0.5 * (rig.left.width_px - 1), 0.5 * (rig.left.height_px - 1)]])
    ends = seen_at_depths(rig, water_index, middle, np.array([nearest_mm, farthest_mm]))[0, :, 0]
    count = int(abs(ends[1] - ends[0]) * WIDTH_PX / rig.left.width_px / STEP_PX) + 2
    return np.asarray(1.0 / np.linspace(near, far, count))


def seen_at_depths(rig: StereoRig, water_index: float, uv_px: Array, depths_mm: Array) -> Array:
    """Return (n, depths, 2) where the right camera sees what the left one sees at ``uv_px`` (n, 2), were it at each
    depth."""
    origins, directions = rig.left.rays(uv_px, water_index)
    far = (depths_mm[None, :] - origins[:, None, 2]) / directions[:, None, 2]
    return rig.right.project(origins[:, None, :] + far[..., None] * directions[:, None, :], water_index)


def _likeness(left: Floats, right: Floats, corner: tuple[int, int], places: Array) -> Floats:
    """Return the correlation of the left window with the right ones at ``places`` (depths, 2: column, row); 0
    outside of the image."""
    v, u = corner
    mine = _own(left[None, :, v : v + ROWS, u : u + COLUMNS])[0]
    windows = _windows(right)
    at, inside = _within(places, windows.shape[1:3])
    theirs = _own(windows[:, at[inside, 1], at[inside, 0]].swapaxes(0, 1))
    like = np.zeros(len(places), np.float32)
    power = np.sqrt(np.einsum("dcij,dcij->d", theirs, theirs) * float(np.sum(mine * mine)))
    like[inside] = np.einsum("dcij,cij->d", theirs, mine) / np.maximum(power, np.float32(1e-6))
    return like


def _own(windows: Floats) -> Floats:
    """Return ``windows`` (n, channels, rows, columns) without what the Gray images do not change within them."""
    gray = windows[:, 2:]
    return np.concatenate([windows[:, :2], gray - gray.mean(axis=(2, 3), keepdims=True)], axis=1)


NAME = "sight"
CELLS = (16, 12)
"""Columns and rows of cells over the image."""
SAMPLES = 120_000
"""Pixels asked, at most; on an even grid."""
MIN_PER_CELL = 40
LEAST_FRINGE_DN, FRINGE_SIGMAS = 0.4, 4.0
"""A cell shows fringes from this amplitude on, and from this many standard errors of its square."""
ROUNDING_DN2 = 1.0 / 12.0
MIN_POINTS = 40
"""Fewer do not say where the object lies; then windows of faint fringes do …"""
ROUGHLY = 0.03
"""… or the parallax of the stripes, which is known so well."""
CELL = np.dtype([(name, np.float64) for name in ("count", "excess", "excess2", "added")])
"""Sums of a cell's clear pixels: how many, what their fringes have beyond noise, its square, and what white adds."""


@dataclass(frozen=True, slots=True)
class VisibleFringes:
    """One camera's cells."""

    light_dn: float
    """Mean over the image of what the projector's white adds."""
    cells: float
    """Share of the cells that show fringes, 0..1."""
    fringe_dn: float | None
    """Amplitude of the fringes in the ninth tenth of these; ``None``: none shows any."""
    object_share: float | None
    """Share of the light in these that carries fringes (median): the rest is the water's; above 1 by shot noise."""
    top_dn: float
    """Grey values that the projector's white adds in the brightest cell."""
    glow_dn: Array
    """(CELLS[0] · CELLS[1],): what the projector's white adds, by cell; NaN where too few pixels are clear."""


def look(
    images: ScanImages,
    rig: StereoRig,
    water_index: float,
    loose: Cloud,
    limits: QualityLimits,
    parallax_percent: float | None = None,
    visible: Mapping[str, VisibleFringes] | None = None,
) -> Verdict:
    """Return the verdict ``sight`` on the images, and on the points of ``loose``, found without
    limits of depth.

    It passes nothing and fails nothing: ``causes`` weighs its numbers. ``fringe_dn`` and ``object_percent`` are
    ``None`` where no fringes are seen, ``glow_per_m`` (attenuation as the glow's shape suggests it) where any are.
    ``visible``: what ``see`` said of both sides, where it was asked while the frames arrived.
    """
    frames, sequence, noise = images.frames, images.sequence, images.noise
    both = visible or {side: see(frames[side], sequence, of_side(noise, side)) for side in SIDES}
    best = max(both.values(), key=lambda one: one.cells)
    numbers: dict[str, float | None] = {
        "light_dn": best.light_dn,
        "top_dn": best.top_dn,
        "fringe_cells_percent": 100.0 * best.cells,
        "fringe_dn": best.fringe_dn,
        "object_percent": None if best.object_share is None else 100.0 * best.object_share,
        "glow_per_m": None if best.cells > 0.0 else shape_of_glow(both["left"].glow_dn, CELLS, rig, water_index),
    }
    depth_mm = np.asarray(loose.points_mm[:, 2], np.float64)
    if len(depth_mm) < MIN_POINTS:
        depth_mm = find_depths_mm(frames, sequence, noise, rig, water_index) if best.cells > 0.0 else np.empty(0)
    by_parallax = None if parallax_percent is None else distance_of(parallax_percent, rig, water_index)
    numbers |= _places(depth_mm, limits, by_parallax)
    return Verdict(NAME, None, numbers, _text(numbers))


def see(frames: NDArray[np.uint8], sequence: PatternSequence, noise: CameraNoise) -> VisibleFringes:
    """Look at one camera's ``frames`` (n, h, w) uint8, cell by cell. Those of Y may still be missing."""
    rows, columns = frames.shape[1:]
    step = max(1, int((rows * columns / SAMPLES) ** 0.5))
    down, across = np.arange(step // 2, rows, step), np.arange(step // 2, columns, step)
    size = CELLS[0] * CELLS[1]
    cell_row = np.arange(down.size) * CELLS[1] // down.size * CELLS[0]
    cell_column = np.arange(across.size) * CELLS[0] // across.size
    sums, added = np.zeros(size, CELL), np.empty((down.size, across.size), np.float32)
    levels = (np.float32(noise.black_dn), np.float32(noise.read_dn**2 + ROUNDING_DN2), np.float32(noise.dn_per_e))
    shown = np.array([sequence.bright, sequence.dark, *sequence.axis(Direction.X).sine], np.int64)
    _sum_cells(frames, shown, step, levels, cell_row, cell_column, sums, added)
    count = sums["count"]
    squared, squares, light = (sums[name] / np.maximum(count, 1.0) for name in ("excess", "excess2", "added"))
    error = np.sqrt(np.maximum(squares - squared**2, 1e-12) / np.maximum(count, 1.0))
    fringe = 0.5 * np.sqrt(np.maximum(squared, 0.0))
    enough = count >= MIN_PER_CELL
    shows = enough & (fringe >= LEAST_FRINGE_DN) & (squared > FRINGE_SIGMAS * error)
    some = bool(shows.any())
    return VisibleFringes(
        float(np.mean(added)),
        float(np.count_nonzero(shows)) / size,
        float(np.quantile(fringe[shows], 0.9)) if some else None,
        float(np.median(2.0 * fringe[shows] / np.maximum(light[shows], 0.5))) if some else None,
        float(light[enough].max()) if enough.any() else 0.0,
        np.where(enough, light, np.nan),
    )


@numba.njit(nogil=True, cache=True, error_model="numpy")
def _sum_cells(
    frames: NDArray[np.uint8],
    shown: NDArray[np.int64],
    step: int,
    levels: tuple[np.float32, np.float32, np.float32],
    cell_row: NDArray[np.int64],
    cell_column: NDArray[np.int64],
    sums: NDArray[np.void],
    added: Floats,
) -> None:
    """Add every ``step``-th pixel of ``frames`` (n, h, w) that is clear to its cell of ``sums`` (cells,), and
    write to ``added`` (rows, columns) what the projector's white adds to each, clear or not.

    ``shown``: bright, dark and the four sines. ``levels``: black, variance without light, variance per grey value. The
    cell is the sum of ``cell_row`` and ``cell_column``.
    """
    black, least, per_dn = levels
    bright, dark = frames[shown[0]], frames[shown[1]]
    first, second, third, fourth = frames[shown[2]], frames[shown[3]], frames[shown[4]], frames[shown[5]]
    for j in range(added.shape[0]):
        v = step // 2 + j * step
        for i in range(added.shape[1]):
            u = step // 2 + i * step
            i0, i1 = np.float32(first[v, u]), np.float32(second[v, u])
            i2, i3 = np.float32(third[v, u]), np.float32(fourth[v, u])
            white = np.float32(bright[v, u])
            added[j, i] = white - np.float32(dark[v, u])
            if not max(white, max(max(i0, i1), max(i2, i3))) < CLEAR_DN:
                continue
            # |(I0 − I2) + i (I3 − I1)|² is (2 A)² of fringes of amplitude A, and the noise of four images.
            level = np.float32(0.25) * (i0 + i1 + i2 + i3)
            photons = max(level - black, np.float32(0.0))
            expected = np.float32(4.0) * (least + per_dn * photons)
            excess = (i0 - i2) * (i0 - i2) + (i3 - i1) * (i3 - i1) - expected
            cell = sums[cell_row[j] + cell_column[i]]
            cell.count += 1.0
            cell.excess += excess
            cell.excess2 += excess * excess
            cell.added += added[j, i]


def distance_of(parallax_percent: float, rig: StereoRig, water_index: float) -> float | None:
    """Return the depth in mm at which the cameras see stripes so far beside where they see them in the middle of the
    volume: roughly, but where all is saturated as well, since the borders of dark stripes are seen there, too.
    ``None``: behind everything."""
    middle_mm = float(rig.volume_centre_mm(water_index)[2])
    half_baseline_mm = 0.5 * float(np.linalg.norm(rig.right.translation_mm))
    field = 2.0 * half_field(rig.left, water_index)[0]
    inverse = 1.0 / middle_mm + 0.01 * parallax_percent * field / half_baseline_mm
    return 1.0 / inverse if inverse > 0.0 else None


def _places(depth_mm: Array, limits: QualityLimits, by_parallax_mm: float | None) -> dict[str, float | None]:
    """Return where the object lies, by points or windows; by parallax alone only where it is far outside."""
    if not len(depth_mm):
        near = by_parallax_mm is not None and by_parallax_mm < (1.0 - ROUGHLY) * limits.min_depth_mm
        far = by_parallax_mm is not None and by_parallax_mm > (1.0 + ROUGHLY) * limits.max_depth_mm
        if not near and not far:
            return {"distance_mm": None, "near_percent": None, "far_percent": None}
        return {"distance_mm": by_parallax_mm, "near_percent": 100.0 * near, "far_percent": 100.0 * far}
    return {
        "distance_mm": float(np.median(depth_mm)),
        "near_percent": 100.0 * float(np.mean(depth_mm < limits.min_depth_mm)),
        "far_percent": 100.0 * float(np.mean(depth_mm > limits.max_depth_mm)),
    }


def _text(numbers: Mapping[str, float | None]) -> str:
    fringe, distance = numbers["fringe_dn"], numbers["distance_mm"]
    if fringe is None:
        return f"no fringes are seen; white adds {numbers['light_dn']:.1f} DN"
    where = "" if distance is None else f", an object at {distance:.0f} mm"
    return f"fringes of {fringe:.1f} DN in {numbers['fringe_cells_percent']:.0f} % of the picture{where}"
