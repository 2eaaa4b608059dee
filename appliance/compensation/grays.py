"""Owns what the Gray images say of the motion: under full light, an element is as bright in one as in another.

Sine frames whose steps have shrunk can tell paint from phase no longer, and those of the two directions lie far apart. The
Gray images lie between and around them. Which of them an element is lit in, away from stripes' borders, follows from where
it is; its mean over those is its paint, and what each differs from it says where it truly was.
"""

from __future__ import annotations

from typing import NamedTuple

import numba
import numpy as np
from numpy.typing import NDArray

from appliance.compensation.residuals import Samples, look
from appliance.patterns.sequence import Direction, PatternSequence

Array = NDArray[np.float64]

PER_FRAME = 7
"""Three of shift, three of turn, one of gain."""


class Stripes(NamedTuple):
    """Images that show every element full light or none."""

    frames: NDArray[np.int64]
    """(n,): their numbers in the recorded sequence."""
    axes: NDArray[np.int64]
    """(n,): 0 where they vary along p, 1 along q."""
    widths_px: Array
    """(n,): of their stripes, in the pattern."""


def stripes_of(sequence: PatternSequence, least_px: float) -> Stripes:
    """The Gray images whose stripes are at least that wide, in the order in which they are shown."""
    found = []
    for number, direction in enumerate((Direction.X, Direction.Y)):
        gray = sequence.axis(direction).gray
        for k, frame in enumerate(gray):
            width_px = sequence.period_px * 2.0 ** (len(gray) - 1 - k)
            if width_px >= least_px:
                found.append((frame, number, width_px))
    frames, axes, widths = zip(*sorted(found), strict=True) if found else ((), (), ())
    return Stripes(np.array(frames, np.int64), np.array(axes, np.int64), np.array(widths, np.float64))


@numba.njit(nogil=True, cache=True, error_model="numpy")
def lit_there(shown_px: float, width_px: float, clear_px: float) -> int:
    """Whether a place of the pattern, counted from its edge, is lit (1) or not (0) by stripes of that width; −1 closer than
    ``clear_px`` to a border."""
    turns = shown_px / width_px + 0.5
    number = np.floor(turns)
    inside = turns - number
    if min(inside, 1.0 - inside) * width_px < clear_px:
        return -1
    return int(number) & 1


@numba.njit(nogil=True, cache=True, error_model="numpy")
def accumulate_gray(
    samples: Samples, pattern_px: Array, pictures: NDArray[np.float32], stripes: Stripes, period_px: float,
    clear_px: float, motion_mm: Array, gains: Array, scale: float, matrix: Array, vector: Array, residual: Array,
) -> None:  # fmt: skip
    """Add one camera's samples to the normal equations ``matrix`` (7 n, 7 n), ``vector`` (7 n,) of n images' motions (n, 6)
    and gains (n,).

    ``pattern_px`` (m, 2): where the projector lights the samples; ``scale``: robust scale of what differs, as a share of the
    paint; ``residual`` (m,) gets its root mean square, NaN where nothing was compared.
    """
    uv, J, e, G, eg, lever, _smooth = samples
    height, width = pictures.shape[1], pictures.shape[2]
    count = stripes.frames.size
    rows, grey = np.empty((count, PER_FRAME)), np.empty(count)
    which = np.empty(count, np.int64)
    px_per_rad = period_px / (2.0 * np.pi)
    for i in range(uv.shape[0]):
        n = 0
        for k in range(count):
            m = motion_mm[k]
            d0 = m[0] + m[4] * lever[i, 2] - m[5] * lever[i, 1]
            d1 = m[1] + m[5] * lever[i, 0] - m[3] * lever[i, 2]
            d2 = m[2] + m[3] * lever[i, 1] - m[4] * lever[i, 0]
            axis = stripes.axes[k]
            near_p = px_per_rad / (1.0 + eg[i, 0] * d0 + eg[i, 1] * d1 + eg[i, 2] * d2)
            shown = pattern_px[i, axis] + 0.5 + near_p * (G[i, axis, 0] * d0 + G[i, axis, 1] * d1 + G[i, axis, 2] * d2)
            if lit_there(shown, stripes.widths_px[k], clear_px) != 1:
                continue
            near = 1.0 / (1.0 + e[i, 0] * d0 + e[i, 1] * d1 + e[i, 2] * d2)
            u = uv[i, 0] + near * (J[i, 0, 0] * d0 + J[i, 0, 1] * d1 + J[i, 0, 2] * d2)
            v = uv[i, 1] + near * (J[i, 1, 0] * d0 + J[i, 1, 1] * d1 + J[i, 1, 2] * d2)
            if not (u >= 1.0 and v >= 1.0 and u < width - 2.0 and v < height - 2.0):
                continue
            value, by_u, by_v = look(pictures[k], u, v)
            gain = 1.0 / (1.0 + gains[k])
            g0 = gain * near * (by_u * J[i, 0, 0] + by_v * J[i, 1, 0])
            g1 = gain * near * (by_u * J[i, 0, 1] + by_v * J[i, 1, 1])
            g2 = gain * near * (by_u * J[i, 0, 2] + by_v * J[i, 1, 2])
            rows[n, 0], rows[n, 1], rows[n, 2] = g0, g1, g2
            rows[n, 3] = lever[i, 1] * g2 - lever[i, 2] * g1
            rows[n, 4] = lever[i, 2] * g0 - lever[i, 0] * g2
            rows[n, 5] = lever[i, 0] * g1 - lever[i, 1] * g0
            grey[n] = value * gain
            rows[n, 6] = -grey[n]
            which[n] = k
            n += 1
        residual[i] = np.nan
        if n < 2:
            continue
        mean = 0.0
        for a in range(n):
            mean += grey[a] / n
        if not mean > 5.0:
            continue
        square = 0.0
        for a in range(n):
            grey[a] = (grey[a] - mean) / mean
            square += grey[a] * grey[a]
            for t in range(PER_FRAME):
                rows[a, t] /= mean
        residual[i] = np.sqrt(square / (n - 1))
        weight = 1.0 / (scale * scale + 0.16 * square / (n - 1))
        for a in range(n):
            at_a = PER_FRAME * which[a]
            for s in range(PER_FRAME):
                vector[at_a + s] += weight * rows[a, s] * grey[a]
            for b in range(n):
                part = weight * ((1.0 if a == b else 0.0) - 1.0 / n)
                at_b = PER_FRAME * which[b]
                for s in range(PER_FRAME):
                    for t in range(PER_FRAME):
                        matrix[at_a + s, at_b + t] += part * rows[a, s] * rows[b, t]
