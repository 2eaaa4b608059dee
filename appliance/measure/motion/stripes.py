"""Owns what the Gray images say of the motion: under full light, an element is as bright in one as in another.

Sine frames whose steps have shrunk can tell albedo from phase no longer, and those of the two directions lie far apart
in time. The Gray images lie between and around them. In which of them an element is illuminated, away from stripes'
borders, follows from where it is; its mean over those is its albedo, and what each differs from it says where the
element truly was. Together with the prior of a hand they make one Gaussian of the motion of all frames: the
``Trajectory``.

Legend of the kernel, per sample i and image k (the symbols of ``residuals`` apply)::

    shown      place in the pattern that lights the displaced point, px from its edge
    y_k        grey value read there, over the image's gain; ȳ the mean over the n images that light the sample
    r_k        (y_k − ȳ) / ȳ
    rows[k]    ∂y_k / ∂(shift, turn, gain of image k), over ȳ
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from typing import NamedTuple

import cv2
import numba
import numpy as np
from numpy.typing import NDArray

from appliance.measure.light.noise import MAD_TO_SIGMA
from appliance.measure.light.patterns import Direction, PatternSequence
from appliance.measure.motion.prior import Trajectory, parameters_of
from appliance.measure.motion.residuals import CAUCHY, FRAME_UNKNOWNS, Samples, read_cubic

Array = NDArray[np.float64]
Images = Mapping[str, NDArray[np.uint8]]

ROUNDS = ((6.0, 18.0, 3), (3.0, 10.0, 3))
"""Each round's blur (σ, px of pictures 800 px wide), clearance from a stripe's border (pattern px), and iterations."""
SHRUNK_WIDTH_PX = 400
"""Width to which pictures are shrunk before they are blurred."""
EVERY = 4
"""Every so many samples are looked at."""
LEAST_MEAN_DN = 5.0
"""Darker elements have no albedo to compare."""
GAIN_SD = 0.03
"""Prior of an image's gain, as a share."""
GAIN_MEAN_SD = 1e-4
"""Prior of all gains' mean: only their differences mean anything."""
START_SCALE, LEAST_SCALE = 0.1, 0.005
"""Robust scale of r at the start, and the least one that is believed."""
TRUST = 0.1
"""Share of the samples' information that is believed: what makes them err reaches farther than from one to the next."""


class Stripes(NamedTuple):
    """Images that show every element full light or none."""

    frames: NDArray[np.int64]
    """(n,): their numbers in the sequence."""
    axes: NDArray[np.int64]
    """(n,): 0 where they vary along p, 1 along q."""
    widths_px: Array
    """(n,): widths of their stripes in the pattern."""


def stripes_of(sequence: PatternSequence) -> Stripes:
    """Return the Gray images of both directions, in the order in which they are shown."""
    found = []
    for number, direction in enumerate((Direction.X, Direction.Y)):
        gray = sequence.axis(direction).gray
        found += [(frame, number, sequence.period_px * 2.0 ** (len(gray) - 1 - k)) for k, frame in enumerate(gray)]
    frames, axes, widths = zip(*sorted(found), strict=True)
    return Stripes(np.array(frames, np.int64), np.array(axes, np.int64), np.array(widths, np.float64))


@numba.njit(nogil=True, cache=True, error_model="numpy")
def illuminated_at(shown_px: float, width_px: float, clear_px: float) -> int:
    """Return whether stripes of that width light a place of the pattern, counted from its edge: 1 or 0.

    −1 where a border is closer than ``clear_px``.
    """
    # The first border lies half a stripe from the edge.
    turns = shown_px / width_px + 0.5
    number = np.floor(turns)
    inside = turns - number
    lit = int(number - 2.0 * np.floor(0.5 * number))
    return lit if min(inside, 1.0 - inside) * width_px >= clear_px else -1


@numba.njit(nogil=True, cache=True, error_model="numpy")
def accumulate_gray(
    samples: Samples, pattern_px: Array, pictures: NDArray[np.float32], stripes: Stripes, period_px: float,
    clear_px: float, motion_mm: Array, gains: Array, scale: float, matrix: Array, vector: Array, residual: Array,
) -> None:  # fmt: skip
    """Add one camera's samples to the normal equations ``matrix`` (7 n, 7 n), ``vector`` (7 n,) of n images'
    displacements ``motion_mm`` (n, 6) and ``gains`` (n,).

    ``pattern_px`` (m, 2) is where the projector lights the samples, ``pictures`` (n, h, w) are the blurred images,
    ``scale`` is the robust scale of r; ``residual`` (m,) gets the root mean square of r per sample, NaN where nothing
    was compared.
    """
    uv, J, e, G, eg, lever, _basis = samples
    height, width = pictures.shape[1], pictures.shape[2]
    count = stripes.frames.size
    rows, grey = np.empty((count, FRAME_UNKNOWNS)), np.empty(count)
    which = np.empty(count, np.int64)
    px_per_rad = period_px / (2.0 * np.pi)
    for i in range(uv.shape[0]):
        n = 0
        for k in range(count):
            # d = shift + turn × lever
            m = motion_mm[k]
            d0 = m[0] + m[4] * lever[i, 2] - m[5] * lever[i, 1]
            d1 = m[1] + m[5] * lever[i, 0] - m[3] * lever[i, 2]
            d2 = m[2] + m[3] * lever[i, 1] - m[4] * lever[i, 0]
            # Where the pattern lights the displaced point: only images count in which it is surely bright.
            axis = stripes.axes[k]
            near_p = px_per_rad / (1.0 + eg[i, 0] * d0 + eg[i, 1] * d1 + eg[i, 2] * d2)
            shown = pattern_px[i, axis] + 0.5 + near_p * (G[i, axis, 0] * d0 + G[i, axis, 1] * d1 + G[i, axis, 2] * d2)
            if illuminated_at(shown, stripes.widths_px[k], clear_px) != 1:
                continue
            # u(X + d) = u(X) + J d / (1 + e·d)
            near = 1.0 / (1.0 + e[i, 0] * d0 + e[i, 1] * d1 + e[i, 2] * d2)
            u = uv[i, 0] + near * (J[i, 0, 0] * d0 + J[i, 0, 1] * d1 + J[i, 0, 2] * d2)
            v = uv[i, 1] + near * (J[i, 1, 0] * d0 + J[i, 1, 1] * d1 + J[i, 1, 2] * d2)
            if not (u >= 1.0 and v >= 1.0 and u < width - 2.0 and v < height - 2.0):
                continue
            value, by_u, by_v = read_cubic(pictures[k], u, v)
            gain = 1.0 / (1.0 + gains[k])
            # ∂y/∂shift by the picture's gradient; ∂y/∂turn = lever × ∂y/∂shift; ∂y/∂gain = −y.
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
        # One image says nothing: it is its own mean.
        residual[i] = np.nan
        if n < 2:
            continue
        mean = 0.0
        for a in range(n):
            mean += grey[a] / n
        if not mean > LEAST_MEAN_DN:
            continue
        # r_k = (y_k − ȳ)/ȳ and its derivatives over ȳ: bright and dark elements count alike.
        square = 0.0
        for a in range(n):
            grey[a] = (grey[a] - mean) / mean
            square += grey[a] * grey[a]
            for t in range(FRAME_UNKNOWNS):
                rows[a, t] /= mean
        residual[i] = np.sqrt(square / (n - 1))
        # Cauchy weight of the sample as a whole: images of it err together.
        weight = 1.0 / (scale * scale + CAUCHY * square / (n - 1))
        # The mean is eliminated: Rᵀ (I − 1 1ᵀ/n) R, where R are the rows.
        for a in range(n):
            at_a = FRAME_UNKNOWNS * which[a]
            for s in range(FRAME_UNKNOWNS):
                vector[at_a + s] += weight * rows[a, s] * grey[a]
            for b in range(n):
                part = weight * ((1.0 if a == b else 0.0) - 1.0 / n)
                at_b = FRAME_UNKNOWNS * which[b]
                for s in range(FRAME_UNKNOWNS):
                    for t in range(FRAME_UNKNOWNS):
                        matrix[at_a + s, at_b + t] += part * rows[a, s] * rows[b, t]


class Information(NamedTuple):
    """The normal equations of m frames' displacements, by measurements alone, without any prior."""

    frames: tuple[int, ...]
    matrix: Array
    """(6 m, 6 m) mm⁻²."""
    vector: Array
    """(6 m,) mm⁻¹."""


def trajectory_from_stripes(
    sequence: PatternSequence,
    images: Images,
    samples: Mapping[str, Samples],
    pattern_px: Array,
    prior: Array,
    sines: Information,
    pool: ThreadPoolExecutor,
) -> Trajectory:
    """Return the trajectory that the Gray images and the precision ``prior`` (6 n, 6 n) together make likely.

    ``images`` are the sequence of each side (n, h, w); the px of ``samples`` are those of images shrunk to 800 px, and
    ``pattern_px`` (m, 2) is where the projector lights them. ``sines`` only shows where to begin: it is no part of the
    result.
    """
    stripes, pattern = stripes_of(sequence), np.ascontiguousarray(pattern_px[::EVERY])
    names = tuple(int(k) for k in stripes.frames)
    at, n = parameters_of(names), len(names)
    start, start_at = prior.copy(), parameters_of(sines.frames)
    vector = np.zeros(len(prior))
    start[np.ix_(start_at, start_at)] += sines.matrix
    vector[start_at] += sines.vector
    motion: Array = np.asarray(np.linalg.solve(start, vector), np.float64)
    gains, scale = np.zeros(n), START_SCALE
    own, own_vector = np.zeros((6 * n, 6 * n)), np.zeros(6 * n)
    for blur_px, clear_px, iterations in ROUNDS:
        blurred = {side: _blurred(images[side], stripes, blur_px) for side in samples}
        few = {side: _thinned(samples[side], blurred[side].shape[2], images[side].shape[2]) for side in samples}
        for _ in range(iterations):

            def equations(side: str) -> tuple[Array, Array, Array]:
                unknowns = FRAME_UNKNOWNS * n
                matrix, gradient = np.zeros((unknowns, unknowns)), np.zeros(unknowns)
                residual = np.full(len(few[side].uv_px), np.nan)  # noqa: B023
                accumulate_gray(
                    few[side], pattern, blurred[side], stripes, float(sequence.period_px), clear_px,  # noqa: B023
                    motion[at].reshape(n, 6), gains, scale, matrix, gradient, residual,  # noqa: B023
                )  # fmt: skip
                return matrix, gradient, residual

            both = list(pool.map(equations, samples))
            matrix, gradient = (np.sum([one[k] for one in both], axis=0) for k in (0, 1))
            residual = np.concatenate([one[2] for one in both])
            known = residual[np.isfinite(residual)]
            if not known.size:
                return _combined(prior, np.zeros_like(prior), np.zeros(len(prior)))
            scale = max(MAD_TO_SIGMA * float(np.median(known)), LEAST_SCALE)
            own, own_vector, gains_of = _without_gains(matrix, gradient, motion[at], gains, n)
            # Gauss-Newton step with the start's information, too: it keeps the search where the sines saw the motion.
            whole, right = start.copy(), vector.copy()
            whole[np.ix_(at, at)] += own
            right[at] += own_vector
            motion = np.asarray(np.linalg.solve(whole, right), np.float64)
            gains = gains_of(motion[at])
    information, information_vector = np.zeros_like(prior), np.zeros(len(prior))
    information[np.ix_(at, at)] += TRUST * own
    information_vector[at] += TRUST * own_vector
    return _combined(prior, information, information_vector)


def _combined(prior: Array, information: Array, vector: Array) -> Trajectory:
    """Return the Gaussian of precision ``prior + information`` whose mean solves (prior + information) μ = vector."""
    covariance = np.asarray(np.linalg.inv(prior + information), np.float64)
    return Trajectory(covariance @ vector, covariance)


def _without_gains(
    matrix: Array, gradient: Array, motion: Array, gains: Array, n: int
) -> tuple[Array, Array, Callable[[Array], Array]]:
    """Eliminate the gains from normal equations (Schur complement).

    Returns the information on the motion alone, matrix (6 n, 6 n) and vector (6 n,), and the gains that belong to a
    motion.
    """
    at = np.arange(FRAME_UNKNOWNS * n).reshape(n, FRAME_UNKNOWNS)
    m, g = at[:, :6].ravel(), at[:, 6]
    # Gradient at the current values → right side of the normal equations for the values themselves.
    vector = matrix @ np.concatenate([motion.reshape(n, 6), gains[:, None]], 1).ravel() - gradient
    whole = matrix[np.ix_(g, g)] + np.eye(n) / GAIN_SD**2 + 1.0 / GAIN_MEAN_SD**2
    cross = matrix[np.ix_(m, g)] @ np.linalg.inv(whole)
    own = matrix[np.ix_(m, m)] - cross @ matrix[np.ix_(g, m)]

    def gains_of(motion: Array) -> Array:
        return np.asarray(np.linalg.solve(whole, vector[g] - matrix[np.ix_(g, m)] @ motion))

    return own, vector[m] - cross @ vector[g], gains_of


def _blurred(images: NDArray[np.uint8], stripes: Stripes, blur_px: float) -> NDArray[np.float32]:
    """Return the stripes' images (n, h, w), shrunk to about ``SHRUNK_WIDTH_PX`` and blurred by ``blur_px`` of 800 px."""
    height, width = images.shape[1:]
    times = max(1, width // SHRUNK_WIDTH_PX)
    size = (width // times, height // times)
    sigma = blur_px * size[0] / 800.0
    found = []
    for k in stripes.frames:
        small = cv2.resize(images[k], size, interpolation=cv2.INTER_AREA)
        found.append(cv2.GaussianBlur(small.astype(np.float32), (0, 0), sigma))
    return np.stack(found)


def _thinned(samples: Samples, width_px: int, full_px: int) -> Samples:
    """Return every ``EVERY``-th sample, in px of pictures ``width_px`` wide; the camera's are ``full_px`` wide."""
    few = Samples(*(np.ascontiguousarray(values[::EVERY]) for values in samples))
    # Samples are counted in pictures shrunk to about 800 px; a pixel's middle is at a whole number.
    times = full_px // max(1, full_px // 800) / width_px
    return few._replace(uv_px=(few.uv_px + 0.5) / times - 0.5, jacobian=few.jacobian / times)
