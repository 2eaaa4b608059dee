"""Owns the map of phase drift: how far the fringes move from one sine image to the next, place by place.

Four steps of 90° leave one combination that holds no phase, C = I₀ − I₁ + I₂ − I₃. On a thing at rest it is noise, but
for what daylight adds between images (in proportion to the modulation) and for the second harmonic of the projector's
light (cos 2φ). A fringe that drifts by ε from image to image makes C = 2 ε B (sin φ − cos φ). Least squares over a cell
of the pattern therefore tell ε, signed. Flickering and drifting daylight adds a part of the mean light and of the
modulation to each image, and the projector's second harmonic a cos 2φ: all three are terms of the fit. So is its sixth,
the only other one below the tenth that is left in C: a light that is made of bit planes and seen for a part of a frame
has steps, and these have harmonics. Depth steps, shadows and edges of albedo at rest give the same C as any other
pixel: nothing. Cells are squares of the *pattern*, so that both cameras' cells are the same place on the thing,
whatever its shape.

It also owns where the edges of the Gray stripes stood, frame by frame, against the phase that the sine images found
afterwards.

A pixel's grey value between dark and bright says on which side of a stripe's edge it is, and near the edge how far. The
phase says the same, some frames later. What the edges have moved in between is the movement over that time: less
precise than the drift within the sine images, but frame by frame, so that a tremor differs from a steady movement.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numba
import numpy as np
from numpy.typing import NDArray

from appliance.measure.decode.decoder import CameraDecoder
from appliance.measure.light.patterns import Direction, PatternSequence
from appliance.measure.verdicts.motion.cells import (
    APART_NOISE,
    APART_SCALE,
    CELL_PX,
    COUNT,
    INVERSE,
    LIGHT,
    SLOPE,
    SLOPES,
    TERMS,
    TEXTURE,
    TEXTURES,
    CellSums,
    RunSums,
    U,
    V,
    cell_sums,
)

LEAST_LEFT = 0.3
"""Least share of the drift's terms that is left in C, whatever the second harmonic takes of them."""
DRIFT_PIXELS = 40
"""Fewer in a cell tell nothing."""


@dataclass(frozen=True, slots=True)
class DriftMap:
    """One camera's cells; arrays (rows, columns) float64 of the pattern's cells, NaN where there are too few pixels."""

    drift_px: NDArray[np.float64]
    """Drift of the fringes ε, pattern px per frame; positive: a pixel's coordinate grows."""
    cosine_px: NDArray[np.float64]
    """The same by the images of 0° and 180° alone, which give the cosine of the phase."""
    sine_px: NDArray[np.float64]
    """The same by those of 90° and 270°, which give its sine: of a steady movement, no other."""
    sd_px: NDArray[np.float64]
    """Standard deviation of it from what the fit leaves."""
    u_px: NDArray[np.float64]
    """Mean place in the image."""
    v_px: NDArray[np.float64]
    slope_per_px: NDArray[np.float64]
    """Pattern px per image px to the right."""
    noise_rad2: NDArray[np.float64]
    """Variance of the phase from the cameras' noise."""
    texture_per_px2: NDArray[np.float64]
    """Mean square of how much the light changes per pattern px across the fringes, in modulations."""
    uneven_rad2: NDArray[np.float64]
    """Mean square difference, from one pixel to that below, of the phase error that moving albedo makes."""
    second2: NDArray[np.float64]
    """Square of the second harmonic's share of the first, of the projector's light as it was recorded."""


def drift_map(
    frames: NDArray[np.uint8],
    decoded: CameraDecoder,
    sequence: PatternSequence,
    variance_dn2: tuple[float, float],
    runs: RunSums | None = None,
) -> DriftMap:
    """Measure the drift in one camera's frames (n, h, w) uint8, by the sine images across which depth moves the
    pattern.

    ``variance_dn2``: of the cameras' noise as (dark, per grey value), see ``CameraNoise``. ``runs``: what
    ``cells.run_sums`` returned, where it was asked while the frames arrived.
    """
    sums = cell_sums(frames, decoded.p_px, decoded.q_px, sequence, variance_dn2, runs)
    pair_frames = sequence.axis(Direction.X).pair_frames
    return _drift_of_sums(sums, sequence.period_px / (2.0 * np.pi), variance_dn2, pair_frames)


def _drift_of_sums(
    sums: CellSums, px_per_rad: float, variance_dn2: tuple[float, float], pair_frames: tuple[int, int]
) -> DriftMap:
    """Solve for the drift; ``pair_frames`` as ``Axis`` says."""
    ones = sums.ones
    count = ones[..., COUNT]
    enough = count >= DRIFT_PIXELS
    normal, right = sums.here[..., :TERMS, :TERMS], sums.here[..., TERMS, :TERMS]
    # A little of the trace keeps cells with few fringes solvable; it is far below what any cell can tell.
    trace = np.trace(normal, axis1=-2, axis2=-1)
    normal = normal + (1e-6 * np.maximum(trace, 1.0))[..., None, None] * np.eye(TERMS)
    inverse = np.linalg.inv(normal)
    fit = (inverse @ right[..., None])[..., 0]
    # Residual variance of the fit: (Σ C² − fit · right) / degrees of freedom.
    rest = np.maximum(sums.here[..., TERMS, TERMS] - np.sum(fit * right, -1), 0.0) / np.maximum(count - TERMS, 1.0)
    # C = ε B (m sin φ − n cos φ), with m frames from 0° to 180° and n from 90° to 270°: least squares of ε.
    m, n = pair_frames
    both = float(m * m + n * n)
    drift = (m * fit[..., 2] - n * fit[..., 1]) / both
    # A second harmonic κ puts 4 κ cos 2φ into C, and a drift bends φ itself, by 2 ε κ sin 2φ (cos φ − sin φ): of the
    # drift's own terms, 4 κ² are then missing from C.
    second2 = (fit[..., 3] ** 2 + fit[..., 4] ** 2) / 16.0
    px = px_per_rad / np.maximum(1.0 - 4.0 * second2, LEAST_LEFT)
    of_both = n * n * inverse[..., 1, 1] + m * m * inverse[..., 2, 2] - 2.0 * m * n * inverse[..., 1, 2]
    variance = rest * of_both / both**2
    # Σ (C − fit · x)² of differences from one pixel to that below, which a drift does not make: down an x-fringe the
    # phase hardly changes. What the light's own steps leave of the fit, which follows the phase, is none of it, and
    # neither is noise.
    left = np.concatenate([-fit, np.ones((*count.shape, 1))], -1)
    apart = np.sum(left * (sums.apart @ left[..., None])[..., 0], -1)

    with np.errstate(invalid="ignore", divide="ignore"):
        # Σ I of fringes that drift holds ε B (m sin φ + n cos φ), which is no texture. Where the steps rise, what it
        # adds to the harm is a hundredth of the ripple.
        leak = 0.0 if m == n else (drift / px_per_rad) ** 2 * both / 32.0
        mean = np.where(enough[..., None], ones[..., U : LIGHT + 1] / count[..., None], np.nan)
        dark, per_dn = variance_dn2
        noise = dark + per_dn * mean[..., LIGHT - U]
        return DriftMap(
            np.where(enough, px * drift, np.nan),
            np.where(enough, px * fit[..., 2] / m, np.nan),
            np.where(enough, px * -fit[..., 1] / n, np.nan),
            np.where(enough, px * np.sqrt(variance), np.nan),
            mean[..., 0],
            mean[..., V - U],
            np.where(enough, ones[..., SLOPE] / ones[..., SLOPES], np.nan),
            0.5 * noise * mean[..., INVERSE - U],
            np.where(enough, np.maximum(ones[..., TEXTURE] / ones[..., TEXTURES] - leak, 0.0), np.nan),
            # A cell without a pair of pixels knows nothing.
            np.where(enough, (apart - ones[..., APART_NOISE]) / ones[..., APART_SCALE], np.nan),
            np.where(enough, second2, np.nan),
        )


INNER_PX, REACH_PX = 4.5, 7.5
"""Pattern px beside an edge: within the first, the light that an edge has moved is added up; from there to the second,
how dark and how light its sides are. Blur stays within the first; the next edge is 16 px away at least."""
SAMPLES = 60_000
"""Pixels of a camera that are looked at, about."""
# Symbols of the kernel. way is +1 where light begins at the edge, −1 where it ends; beside is the distance from the
# edge towards the light, pattern px; brightness is the image's value from dark (0) to bright (1). The sums hold, for
# the inner part and for the dark and the bright side, how many pixels there are and their light; and the light of an
# ideal, unmoved edge.

_COLUMNS = 8
_INNER, _INNER_LIT, _INNER_STEP, _INNER_WAY, _LOW, _LOW_LIT, _HIGH, _HIGH_LIT = range(_COLUMNS)
EDGE_PIXELS, MIN_HEIGHT = 10, 0.3
"""Least number of pixels in each of the three parts; and least step from dark to light, as a share of bright less
dark."""


@dataclass(frozen=True, slots=True)
class EdgeShifts:
    """One camera's edges; arrays (frames, rows, columns) float64 of the Gray images and the pattern's cells."""

    shift_px: NDArray[np.float64]
    """Excess of the pixels' coordinates in that frame over those in the sine images, pattern px; NaN: no edge there."""


@numba.njit(nogil=True, cache=True, error_model="numpy")
def _accumulate(
    frames: NDArray[np.uint8],
    references: tuple[int, int],
    gray: NDArray[np.int64],
    p_px: NDArray[np.float32],
    q_px: NDArray[np.float32],
    edges_px: NDArray[np.float32],
    rises: NDArray[np.float32],
    stride: int,
    cell_px: float,
    sums: NDArray[np.float64],
) -> None:
    """Add every ``stride``-th row and column of the images ``gray`` to ``sums`` (images, rows, columns, _COLUMNS);
    ``edges_px`` and ``rises`` (images, width) are each pattern column's nearest edge (NaN: too far) and +1 where light
    begins there, −1 where it ends. ``references``: bright and dark.

    All images at once: the maps and the references, which lie in memory far apart from pixel to pixel, are read once.
    """
    height, width = p_px.shape
    bright, dark = frames[references[0]], frames[references[1]]
    for v in range(stride // 2, height, stride):
        for u in range(stride // 2, width, stride):
            p, q = p_px[v, u], q_px[v, u]
            if not (p >= 0.0 and q >= 0.0):
                continue
            # Each Gray image's nearest edge, by the column that the sine images found at the pixel.
            place, row = int(p + np.float32(0.5)), int(q / cell_px)
            if place >= edges_px.shape[1] or row >= sums.shape[1]:
                continue
            low, high = np.float64(dark[v, u]), np.float64(bright[v, u])
            if high - low < 8.0:
                continue
            for k in range(gray.size):
                edge = edges_px[k, place]
                if np.isnan(edge):
                    continue
                # Dark and bright reference take albedo and steady ambient light out of the value.
                brightness = (np.float64(frames[gray[k], v, u]) - low) / (high - low)
                # Distance from the edge, positive on the side of the light.
                way = np.float64(rises[k, place])
                beside = way * (np.float64(p) - edge)
                # Both sides of an edge belong to its cell: edges of the coarse bits lie where cells meet.
                s = sums[k, row, int(edge / cell_px)]
                # Around the edge: Σ ±light, and beside it Σ ±1 on the illuminated side, what an edge gives that did not
                # move.
                if abs(beside) <= INNER_PX:
                    s[_INNER] += 1.0
                    s[_INNER_LIT] += way * brightness
                    s[_INNER_STEP] += way if beside > 0.0 else 0.0
                    s[_INNER_WAY] += way
                # Away from it: how dark and how light the two sides are.
                elif beside < 0.0:
                    s[_LOW] += 1.0
                    s[_LOW_LIT] += brightness
                else:
                    s[_HIGH] += 1.0
                    s[_HIGH_LIT] += brightness


def edge_shifts(frames: NDArray[np.uint8], decoded: CameraDecoder, sequence: PatternSequence) -> EdgeShifts:
    """Measure the shifts in one camera's frames (n, h, w) uint8, by the Gray images across which depth moves the
    pattern."""
    axis = sequence.axis(Direction.X)
    height_px, width_px = decoded.p_px.shape
    stride = max(1, round((height_px * width_px / SAMPLES) ** 0.5))
    shape = (-(-sequence.height_px // CELL_PX), -(-sequence.width_px // CELL_PX))
    sums = np.zeros((len(axis.gray), *shape, _COLUMNS))
    edges_px, rises = edges_of(sequence)
    _accumulate(
        frames, (sequence.bright, sequence.dark), np.array(axis.gray, np.int64), decoded.p_px, decoded.q_px, edges_px, rises,
        stride, float(CELL_PX), sums,
    )  # fmt: skip
    return EdgeShifts(_shifts_of_sums(sums))


@lru_cache(maxsize=4)
def edges_of(sequence: PatternSequence) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Return the nearest edges and their ways (images, width) of all Gray images across which depth moves the pattern.

    They are the same in every scan, and not to be written to.
    """
    edges_px, rises = zip(*(_edges(sequence.patterns[k].codes()) for k in sequence.axis(Direction.X).gray), strict=True)
    return np.stack(edges_px), np.stack(rises)


def _edges(codes: NDArray[np.uint8]) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Return each pattern column's nearest edge within reach, and whether light begins (+1) or ends (−1) there."""
    brightness = codes.astype(np.int16)
    after = np.flatnonzero(np.diff(brightness))
    columns = np.arange(codes.size, dtype=np.float32)
    if not after.size:
        return np.full(codes.size, np.nan, np.float32), np.zeros(codes.size, np.float32)
    edges = after.astype(np.float32) + np.float32(0.5)
    nearest = np.argmin(np.abs(columns[:, None] - edges[None, :]), 1)
    edge_px = edges[nearest]
    edge_px[np.abs(columns - edge_px) > REACH_PX] = np.nan
    return edge_px, np.sign(np.diff(brightness)[after])[nearest].astype(np.float32)


def _shifts_of_sums(sums: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the shifts of the edges. An edge that moves by so many px takes so many px of light with it, whatever
    its blur."""
    count, low, high = sums[..., _INNER], sums[..., _LOW], sums[..., _HIGH]
    with np.errstate(invalid="ignore", divide="ignore"):
        # The step between both sides scales the light; what is more than an unmoved edge gives is the shift.
        dark = sums[..., _LOW_LIT] / low
        height = sums[..., _HIGH_LIT] / high - dark
        known = (np.minimum(count, np.minimum(low, high)) >= EDGE_PIXELS) & (height > MIN_HEIGHT)
        moved = (sums[..., _INNER_LIT] - dark * sums[..., _INNER_WAY]) / height - sums[..., _INNER_STEP]
        return np.where(known, 2.0 * INNER_PX * moved / count, np.nan)


Array = NDArray[np.float64]
