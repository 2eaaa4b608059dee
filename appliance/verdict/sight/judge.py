"""Owns what the frames say of the object by themselves: whether it shows fringes, how much light it sends, where it lies.

It is asked where decoding comes to nothing: a pixel needs 5 grey values of modulation, but the mean over a cell of some
hundred pixels tells fringes of half a grey value from noise. Fringes across the baseline are the object's alone: a ray crosses
many of them in the water, so that the water's light has none. Points are asked where they lie before any limit of depth; where
there are none, the stripes that a saturated object still shows (``stripes``), or else the fringes themselves (``distance``).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from appliance.optics.model import StereoRig
from appliance.patterns.sequence import Direction, PatternSequence
from appliance.reconstruct.quality import QualityLimits
from appliance.reconstruct.table import Cloud
from appliance.scan.noise import CameraNoise, StereoNoise
from appliance.scan.sides import SIDES, of_side
from appliance.scan.verdict import Verdict
from appliance.verdict.sight.distance import find_depths_mm
from appliance.verdict.sight.stripes import find_depths_by_stripes_mm
from appliance.verdict.water.beam import half_field, shape_of_glow

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
    at = (slice(step // 2, None, step), slice(step // 2, None, step))
    bright, dark = (frames[k][at].astype(np.float32) for k in (sequence.bright, sequence.dark))
    i0, i1, i2, i3 = (frames[k][at].astype(np.float32) for k in sequence.axis(Direction.X).sine)
    clear = np.maximum.reduce([bright, i0, i1, i2, i3]) < CLEAR_DN
    v, u = np.mgrid[0 : bright.shape[0], 0 : bright.shape[1]]
    cell = (v * CELLS[1] // bright.shape[0] * CELLS[0] + u * CELLS[0] // bright.shape[1])[clear]
    size = CELLS[0] * CELLS[1]
    count = np.bincount(cell, minlength=size).astype(np.float64)

    def mean(values: Floats) -> Array:
        return np.asarray(np.bincount(cell, values[clear], size) / np.maximum(count, 1.0))

    # |(I0 − I2) + i (I3 − I1)|² is (2 A)² of fringes of amplitude A, and the noise of four images.
    level = 0.25 * (i0 + i1 + i2 + i3)
    photons = np.maximum(level - np.float32(noise.black_dn), 0.0)
    expected = np.float32(4.0) * (np.float32(noise.read_dn**2 + ROUNDING_DN2) + np.float32(noise.dn_per_e) * photons)
    excess = (i0 - i2) ** 2 + (i3 - i1) ** 2 - expected
    squared = mean(excess)
    error = np.sqrt(np.maximum(mean(excess * excess) - squared**2, 1e-12) / np.maximum(count, 1.0))
    fringe = 0.5 * np.sqrt(np.maximum(squared, 0.0))
    light = mean(bright - dark)
    enough = count >= MIN_PER_CELL
    shows = enough & (fringe >= LEAST_FRINGE_DN) & (squared > FRINGE_SIGMAS * error)
    some = bool(shows.any())
    return VisibleFringes(
        float(np.mean(bright - dark)),
        float(np.count_nonzero(shows)) / size,
        float(np.quantile(fringe[shows], 0.9)) if some else None,
        float(np.median(2.0 * fringe[shows] / np.maximum(light[shows], 0.5))) if some else None,
        float(light[enough].max()) if enough.any() else 0.0,
        np.where(enough, light, np.nan),
    )


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
