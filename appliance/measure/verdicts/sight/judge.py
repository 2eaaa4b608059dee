"""The verdict ``sight``: fringes, light and depth of the object, also if it cannot be decoded.

look              the verdict, from points without limits of depth and from both cameras' fringes
see               visible fringes and light of one camera, cell by cell
find_depths_mm    depths of surfaces whose fringes are too faint for decoding

Decoding needs a modulation of 5 grey values. The mean over a cell of some hundred pixels detects fringes of half a grey
value. Only the object shows fringes across the baseline: a ray in water crosses many of them, so that backscatter has
none.

For depths, windows of the left camera are compared with the right image where each depth would put them, by their
changes over all images across the baseline. This needs a seventh of the modulation for decoding. Of Gray images only
changes within the window count: an edge belongs to the object, a smooth image may be backscatter.
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
"""Approximate width to which the images are reduced before comparison: that is quick and averages noise."""
ROWS, COLUMNS = 5, 14
"""Size of a window in reduced images: two fringes wide; a surface that is inclined by 20° shifts them by less than a
third at its ends."""
WINDOWS = 120
"""Number of windows; those with the strongest fringes are used."""
LEAST_SWING_DN, LEAST_SHARE = 0.8, 0.1
"""Least double modulation of a window's fringes, absolute and as a share of the projector's white there: weaker fringes
may be backscatter of near water."""
CLEAR_DN = 250.0
"""Largest grey value of a window in any image, and of all its candidates in the right image: a saturated candidate may
be the true one, and the best of the others is then a wrong fringe."""
_NEAREST_MM, _FARTHEST_MM = 250.0, 1500.0
"""Limits of the candidate depths in the standard housing."""
STEP_PX = 1.5
"""Distance from depth to depth in the right image: a fifth of a fringe."""
LEAST_LIKE = 0.25
"""Least correlation of a match; chance makes 0.1 at most over all depths, fringes of 0.7 grey values 0.4."""
BESIDE, DISTINCT = 3, 1.1
"""Number of depth steps, and least ratio to the correlation at any depth farther away than these: fringes repeat, Gray
edges do not."""
MIN_WINDOWS = 12


def find_depths_mm(
    frames: Mapping[str, NDArray[np.uint8]],
    sequence: PatternSequence,
    noise: StereoNoise,
    rig: StereoRig,
    water_index: float,
) -> Array:
    """Return the depth of each matched window in the left camera frame, to half a per cent.

    The array is empty if fewer than ``MIN_WINDOWS`` are matched. ``frames``: (n, h, w) uint8 of ``left`` and ``right``.
    """
    no_depths = np.empty(0)
    factor = max(1, rig.left.width_px // WIDTH_PX)
    left = _changes(frames["left"], sequence, factor)
    right = _changes(frames["right"], sequence, factor)
    v, u = _strongest(frames["left"], sequence, factor, left, noise.left)
    if len(v) < MIN_WINDOWS:
        return no_depths
    depths_mm = candidate_depths_mm(rig, water_index)
    # Positions scale from the edge of the image, which is half a pixel before the centre of the first pixel.
    half = 0.5 * np.array([COLUMNS, ROWS])
    right_px = seen_at_depths(rig, water_index, factor * (np.stack([u, v], -1) + half) - 0.5, depths_mm)
    places = (right_px + 0.5) / factor - half
    like = np.stack([_likeness(left, right, (int(v[k]), int(u[k])), places[k]) for k in range(len(v))])
    best = like.argmax(axis=1)
    beside = abs(np.arange(len(depths_mm)) - best[:, None]) > BESIDE
    sure = like.max(axis=1) >= np.maximum(LEAST_LIKE, DISTINCT * np.where(beside, like, 0.0).max(axis=1))
    sure &= _clear_everywhere(_brightest(frames["right"], sequence, factor), places)
    matched_mm = depths_mm[best[sure]]
    return matched_mm if len(matched_mm) >= MIN_WINDOWS else no_depths


def _changes(frames: NDArray[np.uint8], sequence: PatternSequence, factor: int) -> Floats:
    """Return the changes of the images (channels, rows, columns).

    They are the differences of opposite sines, then each Gray image against the mean of dark and bright.
    """
    axis = sequence.axis(Direction.X)
    small = {k: _shrunk(frames[k], factor) for k in (sequence.bright, sequence.dark, *axis.sine, *axis.gray)}
    i0, i1, i2, i3 = (small[k] for k in axis.sine)
    reference = small[sequence.bright] + small[sequence.dark]
    return np.stack([i0 - i2, i3 - i1, *(2.0 * small[k] - reference for k in axis.gray)]).astype(np.float32)


def _shrunk(image: NDArray[np.uint8], factor: int) -> Floats:
    if factor == 1:
        return image.astype(np.float32)
    rows, columns = image.shape[0] // factor, image.shape[1] // factor
    boxes = image[: rows * factor, : columns * factor].reshape(rows, factor, columns, factor)
    return np.asarray(boxes.mean(axis=(1, 3), dtype=np.float32))


def _strongest(
    frames: NDArray[np.uint8], sequence: PatternSequence, factor: int, changes: Floats, noise: CameraNoise
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the upper left corners (rows, columns) of the unsaturated windows with the strongest fringes."""
    sines = sequence.axis(Direction.X).sine
    level = np.mean([_shrunk(frames[k], factor) for k in sines], axis=0)
    noise_dn2 = 4.0 * noise.variance_dn2(level) / factor**2
    excess = _tiled(changes[0] ** 2 + changes[1] ** 2 - noise_dn2).mean(axis=(1, 3))
    clear = _tiled(_brightest(frames, sequence, factor)).max(axis=(1, 3)) < CLEAR_DN
    light = _tiled(_shrunk(frames[sequence.bright], factor) - _shrunk(frames[sequence.dark], factor)).mean(axis=(1, 3))
    excess[~clear | (excess < np.maximum(LEAST_SWING_DN, LEAST_SHARE * light) ** 2)] = 0.0
    order = np.argsort(-excess, axis=None)[:WINDOWS]
    rows, columns = np.unravel_index(order[excess.ravel()[order] > 0.0], excess.shape)
    return rows * ROWS, columns * COLUMNS


def _brightest(frames: NDArray[np.uint8], sequence: PatternSequence, factor: int) -> Floats:
    """Return a reduced image of the largest grey value of each pixel in the bright image and the sines."""
    bright = (sequence.bright, *sequence.axis(Direction.X).sine)
    return _shrunk(np.maximum.reduce([frames[k] for k in bright]), factor)


def _clear_everywhere(brightest: Floats, places: Array) -> NDArray[np.bool_]:
    """Return (n,) whether all windows of a row of ``places`` are unsaturated.

    ``places``: (n, depths, 2: column, row). Windows outside of the image do not count.
    """
    clear = np.asarray((_windows(brightest) < CLEAR_DN).all(axis=(2, 3)))
    corner, inside = _within(places, clear.shape)
    return np.asarray((clear[corner[..., 1], corner[..., 0]] | ~inside).all(axis=1), np.bool_)


def _windows(images: Floats) -> Floats:
    """Return a view of the window at each corner, (…, rows, columns, ROWS, COLUMNS)."""
    return np.lib.stride_tricks.sliding_window_view(images, (ROWS, COLUMNS), axis=(-2, -1))


def _within(places: Array, corners: tuple[int, ...]) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
    """Return ``places`` as integers, 0 outside of ``corners`` (rows, columns), and which are inside."""
    rounded = np.rint(places)
    inside = np.asarray(((rounded >= 0.0) & (rounded < corners[::-1])).all(axis=-1))
    return np.where(inside[..., None], rounded, 0.0).astype(np.int64), inside


def _tiled(image: Floats) -> Floats:
    rows, columns = image.shape[0] // ROWS, image.shape[1] // COLUMNS
    return np.asarray(image[: rows * ROWS, : columns * COLUMNS].reshape(rows, ROWS, columns, COLUMNS))


def candidate_depths_mm(rig: StereoRig, water_index: float) -> Array:
    """Return depths at which the left image's centre is ``STEP_PX`` apart in the reduced right image."""
    nearest_mm, farthest_mm = rig.volume.scaled(_NEAREST_MM), rig.volume.scaled(_FARTHEST_MM)
    near, far = 1.0 / nearest_mm, 1.0 / farthest_mm
    middle = np.array([[0.5 * (rig.left.width_px - 1), 0.5 * (rig.left.height_px - 1)]])
    ends = seen_at_depths(rig, water_index, middle, np.array([nearest_mm, farthest_mm]))[0, :, 0]
    count = int(abs(ends[1] - ends[0]) * WIDTH_PX / rig.left.width_px / STEP_PX) + 2
    return np.asarray(1.0 / np.linspace(near, far, count))


def seen_at_depths(rig: StereoRig, water_index: float, uv_px: Array, depths_mm: Array) -> Array:
    """Return the right image points (n, depths, 2) of the left pixels ``uv_px`` (n, 2) for each depth."""
    origins, directions = rig.left.rays(uv_px, water_index)
    far = (depths_mm[None, :] - origins[:, None, 2]) / directions[:, None, 2]
    return rig.right.project(origins[:, None, :] + far[..., None] * directions[:, None, :], water_index)


def _likeness(left: Floats, right: Floats, corner: tuple[int, int], places: Array) -> Floats:
    """Return the correlation of the left window with those at ``places`` of the right image.

    ``places``: (depths, 2: column, row). The correlation is 0 outside of the image.
    """
    v, u = corner
    mine = _own(left[None, :, v : v + ROWS, u : u + COLUMNS])[0]
    windows = _windows(right)
    corner_px, inside = _within(places, windows.shape[1:3])
    theirs = _own(windows[:, corner_px[inside, 1], corner_px[inside, 0]].swapaxes(0, 1))
    like = np.zeros(len(places), np.float32)
    power = np.sqrt(np.einsum("dcij,dcij->d", theirs, theirs) * float(np.sum(mine * mine)))
    like[inside] = np.einsum("dcij,cij->d", theirs, mine) / np.maximum(power, np.float32(1e-6))
    return like


def _own(windows: Floats) -> Floats:
    """Return ``windows`` (n, channels, rows, columns) with the mean of each Gray image subtracted."""
    gray = windows[:, 2:]
    return np.concatenate([windows[:, :2], gray - gray.mean(axis=(2, 3), keepdims=True)], axis=1)


NAME = "sight"
CELLS = (16, 12)
"""Columns and rows of cells over the image."""
SAMPLES = 120_000
"""Largest number of pixels, on an even grid."""
MIN_PER_CELL = 40
LEAST_FRINGE_DN, FRINGE_SIGMAS = 0.4, 4.0
"""Least modulation of a cell that shows fringes, and least number of standard errors of its square."""
ROUNDING_DN2 = 1.0 / 12.0
MIN_POINTS = 40
"""Least number of points for the distance; with fewer, it comes from windows of faint fringes or the parallax of the
stripes."""
ROUGHLY = 0.03
"""Relative error of the distance by the parallax."""
CELL = np.dtype([(name, np.float64) for name in ("count", "excess", "excess2", "added")])
"""Sums over a cell's unsaturated pixels: their number, the square of their fringes less noise, its square, and the
light of white."""


@dataclass(frozen=True, slots=True)
class VisibleFringes:
    """Fringes and light of one camera by cells of the image."""

    light_dn: float
    """Mean over the image of the grey values that the projector's white adds."""
    cells: float
    """Share of the cells that show fringes, 0..1."""
    fringe_dn: float | None
    """Upper decile of the modulation in these cells; ``None``: none shows fringes."""
    object_share: float | None
    """Share of the light in these that carries fringes (median); the other part is backscatter. By noise it may be
    above 1."""
    top_dn: float
    """Grey values that the projector's white adds in the brightest cell."""
    glow_dn: Array
    """(CELLS[0] · CELLS[1],): grey values that white adds, by cell; NaN where too few pixels are unsaturated."""


def look(
    images: ScanImages,
    rig: StereoRig,
    water_index: float,
    loose: Cloud,
    limits: QualityLimits,
    parallax_percent: float | None = None,
    visible: Mapping[str, VisibleFringes] | None = None,
) -> Verdict:
    """Return the verdict ``sight`` on the images and the points of ``loose``, without limits of depth.

    It is neither passed nor failed: ``causes`` weighs its numbers. ``fringe_dn`` and ``object_percent`` are ``None`` if
    no fringes are seen, ``glow_per_m`` (attenuation by the shape of the backscatter) if some are. ``visible``: the
    results of ``see`` of both sides, if they were computed while the frames arrived.
    """
    frames, sequence, noise = images.frames, images.sequence, images.noise
    visible_fringes = visible or {side: see(frames[side], sequence, of_side(noise, side)) for side in SIDES}
    best = max(visible_fringes.values(), key=lambda camera: camera.cells)
    numbers: dict[str, float | None] = {
        "light_dn": best.light_dn,
        "top_dn": best.top_dn,
        "fringe_cells_percent": 100.0 * best.cells,
        "fringe_dn": best.fringe_dn,
        "object_percent": None if best.object_share is None else 100.0 * best.object_share,
        "glow_per_m": None
        if best.cells > 0.0
        else shape_of_glow(visible_fringes["left"].glow_dn, CELLS, rig, water_index),
    }
    depth_mm = np.asarray(loose.points_mm[:, 2], np.float64)
    if len(depth_mm) < MIN_POINTS:
        depth_mm = find_depths_mm(frames, sequence, noise, rig, water_index) if best.cells > 0.0 else np.empty(0)
    by_parallax = None if parallax_percent is None else distance_of(parallax_percent, rig, water_index)
    numbers |= _places(depth_mm, limits, by_parallax)
    return Verdict(NAME, None, numbers, _text(numbers))


def see(frames: NDArray[np.uint8], sequence: PatternSequence, noise: CameraNoise) -> VisibleFringes:
    """Measure fringes and light of one camera's ``frames`` (n, h, w) uint8; Y may still be missing."""
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
    any_fringes = bool(shows.any())
    return VisibleFringes(
        float(np.mean(added)),
        float(np.count_nonzero(shows)) / size,
        float(np.quantile(fringe[shows], 0.9)) if any_fringes else None,
        float(np.median(2.0 * fringe[shows] / np.maximum(light[shows], 0.5))) if any_fringes else None,
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
    """Add every ``step``-th unsaturated pixel of ``frames`` (n, h, w) to its cell of ``sums`` (cells,).

    Write the light of the projector's white to ``added`` (rows, columns), also of saturated pixels. ``shown``: bright,
    dark and the four sines. ``levels``: black, variance without light, variance per grey value. The cell is the sum of
    ``cell_row`` and ``cell_column``.
    """
    black, dark_variance, per_dn = levels
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
            # |(I0 − I2) + i (I3 − I1)|² is (2 A)² of fringes of modulation A, plus the noise of four images.
            level = np.float32(0.25) * (i0 + i1 + i2 + i3)
            photons = max(level - black, np.float32(0.0))
            expected = np.float32(4.0) * (dark_variance + per_dn * photons)
            excess = (i0 - i2) * (i0 - i2) + (i3 - i1) * (i3 - i1) - expected
            cell = sums[cell_row[j] + cell_column[i]]
            cell.count += 1.0
            cell.excess += excess
            cell.excess2 += excess * excess
            cell.added += added[j, i]


def distance_of(parallax_percent: float, rig: StereoRig, water_index: float) -> float | None:
    """Return the depth in mm at which stripes have this parallax against the middle of the volume.

    It is rough, but known in saturated images as well, since the borders of dark stripes are visible there. ``None``:
    no finite depth.
    """
    middle_mm = float(rig.volume_centre_mm(water_index)[2])
    half_baseline_mm = 0.5 * float(np.linalg.norm(rig.right.translation_mm))
    field = 2.0 * half_field(rig.left, water_index)[0]
    inverse = 1.0 / middle_mm + 0.01 * parallax_percent * field / half_baseline_mm
    return 1.0 / inverse if inverse > 0.0 else None


def _places(depth_mm: Array, limits: QualityLimits, by_parallax_mm: float | None) -> dict[str, float | None]:
    """Return the numbers of the distance, by points or windows, or by parallax far outside of the limits."""
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
