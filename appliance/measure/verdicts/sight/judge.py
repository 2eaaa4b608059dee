"""Owns what the frames say of the object by themselves: whether it shows fringes, how much light it sends, where it lies.

It is asked where decoding comes to nothing: a pixel needs 5 grey values of modulation, but the mean over a cell of some
hundred pixels tells fringes of half a grey value from noise. Fringes across the baseline are the object's alone: a ray crosses
many of them in the water, so that the water's light has none. Points are asked where they lie before any limit of depth; where
there are none, the stripes that a saturated object still shows (``stripes``), or else the fringes themselves (``distance``).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numba
import numpy as np
from numpy.typing import NDArray

from appliance.measure.light.model import StereoRig
from appliance.measure.light.noise import CameraNoise, StereoNoise
from appliance.measure.light.sequence import Direction, PatternSequence
from appliance.measure.light.sides import SIDES, of_side
from appliance.measure.points.quality import QualityLimits
from appliance.measure.points.table import Cloud
from appliance.measure.verdict import Verdict
from appliance.measure.verdicts.sight.distance import find_depths_mm
from appliance.measure.verdicts.sight.stripes import find_depths_by_stripes_mm
from appliance.measure.verdicts.water.beam import half_field, shape_of_glow

Array = NDArray[np.float64]
Floats = NDArray[np.float32]

NAME = "sight"
CELLS = (16, 12)
"""Columns and rows of cells over the image."""
SAMPLES = 120_000
"""Pixels asked, at most; on an even grid."""
MIN_PER_CELL = 40
CLEAR_DN = 250.0
"""No image of a pixel that is asked may be brighter."""
LEAST_FRINGE_DN, FRINGE_SIGMAS = 0.4, 4.0
"""A cell shows fringes from this amplitude on, and from this many standard errors of its square."""
ROUNDING_DN2 = 1.0 / 12.0
MIN_POINTS = 40
"""Fewer do not say where the object lies; then stripes or windows of faint fringes do …"""
ROUGHLY = 0.03
"""… or the parallax of the stripes, which is known so well."""
_SUMS = 4
_COUNT, _EXCESS, _EXCESS2, _ADDED = range(_SUMS)
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
    frames: Mapping[str, NDArray[np.uint8]],
    sequence: PatternSequence,
    noise: StereoNoise,
    rig: StereoRig,
    water_index: float,
    loose: Cloud,
    limits: QualityLimits,
    parallax_percent: float | None = None,
    visible: Mapping[str, VisibleFringes] | None = None,
) -> Verdict:
    """Return the verdict ``sight`` on ``frames`` (n, h, w) uint8 by side, and on the points of ``loose``, found without
    limits of depth.

    It passes nothing and fails nothing: ``causes`` weighs its numbers. ``fringe_dn`` and ``object_percent`` are
    ``None`` where no fringes are seen, ``glow_per_m`` (attenuation as the glow's shape suggests it) where any are. ``visible``:
    what ``see`` said of both sides, where it was asked while the frames arrived.
    """
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
        depth_mm = find_depths_by_stripes_mm(frames, sequence, rig, water_index)
        if not len(depth_mm) and best.cells > 0.0:
            depth_mm = find_depths_mm(frames, sequence, noise, rig, water_index)
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
    sums, added = np.zeros((size, _SUMS)), np.empty((down.size, across.size), np.float32)
    levels = (np.float32(noise.black_dn), np.float32(noise.read_dn**2 + ROUNDING_DN2), np.float32(noise.dn_per_e))
    shown = np.array([sequence.bright, sequence.dark, *sequence.axis(Direction.X).sine], np.int64)
    _sum_cells(frames, shown, step, levels, cell_row, cell_column, sums, added)
    count = sums[:, _COUNT]
    squared, squares, light = (sums[:, k] / np.maximum(count, 1.0) for k in (_EXCESS, _EXCESS2, _ADDED))
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
    sums: Array,
    added: Floats,
) -> None:
    """Add every ``step``-th pixel of ``frames`` (n, h, w) that is clear to its cell's row of ``sums`` (cells, _SUMS), and write to ``added`` (rows,
    columns) what the projector's white adds to each, clear or not.

    ``shown``: bright, dark and the four sines. ``levels``: black, variance without light, variance per grey value. The cell is the sum of
    ``cell_row`` and ``cell_column``.
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
            cell = cell_row[j] + cell_column[i]
            sums[cell, _COUNT] += 1.0
            sums[cell, _EXCESS] += excess
            sums[cell, _EXCESS2] += excess * excess
            sums[cell, _ADDED] += added[j, i]


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
