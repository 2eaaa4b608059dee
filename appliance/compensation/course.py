"""Owns the motion of all frames of a scan as one Gaussian: what a hand can do, and what the Gray images say of it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from appliance.compensation.grays import PER_FRAME, Stripes, accumulate_gray, stripes_of
from appliance.compensation.hand import SHIFT, TURN, displacement_covariance_mm2
from appliance.compensation.residuals import Samples
from appliance.patterns.sequence import PatternSequence

Array = NDArray[np.float64]
Pictures = Mapping[str, NDArray[np.uint8]]

ROUNDS = ((6.0, 18.0, 3), (3.0, 10.0, 3))
"""Blur in px of pictures 800 px wide, how far from a stripe's border an element counts in the pattern, and iterations."""
SHRUNK_WIDTH_PX = 400
EVERY = 4
"""Of the samples."""
GAIN_SD = 0.03
GAIN_MEAN_SD = 1e-4
START_SCALE, LEAST_SCALE = 0.1, 0.005
TRUST = 0.1
"""Of the information that samples would have if they erred one by one: what makes them err is larger than their distance."""


@dataclass(frozen=True, slots=True)
class Course:
    """Displacements of all n frames: 6 n numbers, frame by frame."""

    mean_mm: Array
    covariance_mm2: Array

    def at(self, frames: tuple[int, ...]) -> tuple[Array, Array]:
        """Mean and covariance of some frames alone."""
        place = _places(frames)
        return self.mean_mm[place], self.covariance_mm2[np.ix_(place, place)]

    def given(self, frames: tuple[int, ...], motion_mm: Array) -> Array:
        """(n, 6): the most likely motion of all frames when that of some is ``motion_mm`` (m, 6)."""
        place = _places(frames)
        mean, covariance = self.at(frames)
        told = np.linalg.solve(covariance, motion_mm.ravel() - mean)
        return np.asarray(self.mean_mm + self.covariance_mm2[:, place] @ told).reshape(-1, 6)

    def shift_sd_mm(self, frames: tuple[int, ...], motion_covariance_mm2: Array, of: tuple[int, ...]) -> float:
        """Root mean square uncertainty of a shift sideways, in the frames ``of``, where ``frames``' motion is known with that
        covariance (6 m, 6 m)."""
        place = _places(frames)
        known = self.covariance_mm2[np.ix_(place, place)]
        through = np.linalg.solve(known, self.covariance_mm2[place]).T
        variance = np.diag(self.covariance_mm2 + through @ (motion_covariance_mm2 - known) @ through.T)
        return float(np.sqrt(np.mean(variance.reshape(-1, 6)[list(of), :2].clip(0.0))))


def hands_course(times_s: Array, reference_s: float) -> Array:
    """Precision (6 n, 6 n) before anything was seen."""
    n = len(times_s)
    precision = np.zeros((6 * n, 6 * n))
    for hand, parts in ((SHIFT, (0, 1, 2)), (TURN, (3, 4, 5))):
        one = np.linalg.inv(displacement_covariance_mm2(hand, times_s, reference_s))
        for part in parts:
            at = part + 6 * np.arange(n)
            precision[np.ix_(at, at)] = one
    return precision


def follow_stripes(
    sequence: PatternSequence, frames: Pictures, samples: Mapping[str, Samples], pattern_px: Array, prior: Array,
    told: tuple[tuple[int, ...], Array, Array], pool: ThreadPoolExecutor,
) -> Course:  # fmt: skip
    """What the Gray images and ``prior`` (6 n, 6 n) together say; ``samples``' px are those of pictures ``frames`` shrunk to 800
    px. ``told``: frames, information matrix and vector of what else is known; it only shows where to look."""
    stripes, pattern = stripes_of(sequence, 0.0), np.ascontiguousarray(pattern_px[::EVERY])
    names = tuple(int(k) for k in stripes.frames)
    at, n = _places(names), len(names)
    start, start_at = prior.copy(), _places(told[0])
    vector = np.zeros(len(prior))
    start[np.ix_(start_at, start_at)] += told[1]
    vector[start_at] += told[2]
    motion: Array = np.asarray(np.linalg.solve(start, vector), np.float64)
    gains, scale = np.zeros(n), START_SCALE
    own, own_vector = np.zeros((6 * n, 6 * n)), np.zeros(6 * n)
    for blur_px, clear_px, iterations in ROUNDS:
        looked = {side: _blurred(frames[side], stripes, blur_px) for side in samples}
        few = {side: _shrunk(samples[side], looked[side].shape[2], frames[side].shape[2]) for side in samples}
        for _ in range(iterations):

            def ask(side: str) -> tuple[Array, Array, Array]:
                matrix, gradient = np.zeros((PER_FRAME * n, PER_FRAME * n)), np.zeros(PER_FRAME * n)
                residual = np.full(len(few[side].uv_px), np.nan)  # noqa: B023
                accumulate_gray(
                    few[side], pattern, looked[side], stripes, float(sequence.period_px), clear_px,  # noqa: B023
                    motion[at].reshape(n, 6), gains, scale, matrix, gradient, residual,  # noqa: B023
                )  # fmt: skip
                return matrix, gradient, residual

            asked = list(pool.map(ask, samples))
            matrix, gradient = (np.sum([one[k] for one in asked], axis=0) for k in (0, 1))
            residual = np.concatenate([a[2] for a in asked])
            known = residual[np.isfinite(residual)]
            if not known.size:
                return _course(prior, np.zeros_like(prior), np.zeros(len(prior)))
            scale = max(1.4826 * float(np.median(known)), LEAST_SCALE)
            own, own_vector, back = _without_gains(matrix, gradient, motion[at], gains, n)
            whole, right = start.copy(), vector.copy()
            whole[np.ix_(at, at)] += own
            right[at] += own_vector
            motion = np.asarray(np.linalg.solve(whole, right), np.float64)
            gains = back(motion[at])
    spread, spread_vector = np.zeros_like(prior), np.zeros(len(prior))
    spread[np.ix_(at, at)] += TRUST * own
    spread_vector[at] += TRUST * own_vector
    return _course(prior, spread, spread_vector)


def _course(prior: Array, told: Array, vector: Array) -> Course:
    covariance = np.asarray(np.linalg.inv(prior + told), np.float64)
    return Course(covariance @ vector, covariance)


def _places(frames: tuple[int, ...]) -> NDArray[np.int64]:
    return (6 * np.asarray(frames)[:, None] + np.arange(6)).ravel()


def _without_gains(
    matrix: Array, gradient: Array, motion: Array, gains: Array, n: int
) -> tuple[Array, Array, Callable[[Array], Array]]:
    """Information on the motion alone, matrix and vector, and the gains that belong to a motion."""
    at = np.arange(PER_FRAME * n).reshape(n, PER_FRAME)
    m, g = at[:, :6].ravel(), at[:, 6]
    vector = matrix @ np.concatenate([motion.reshape(n, 6), gains[:, None]], 1).ravel() - gradient
    whole = matrix[np.ix_(g, g)] + np.eye(n) / GAIN_SD**2 + 1.0 / GAIN_MEAN_SD**2
    cross = matrix[np.ix_(m, g)] @ np.linalg.inv(whole)
    own = matrix[np.ix_(m, m)] - cross @ matrix[np.ix_(g, m)]

    def gains_of(motion: Array) -> Array:
        return np.asarray(np.linalg.solve(whole, vector[g] - matrix[np.ix_(g, m)] @ motion))

    return own, vector[m] - cross @ vector[g], gains_of


def _blurred(frames: NDArray[np.uint8], stripes: Stripes, blur_px: float) -> NDArray[np.float32]:
    height, width = frames.shape[1:]
    times = max(1, width // SHRUNK_WIDTH_PX)
    size = (width // times, height // times)
    sigma = blur_px * size[0] / 800.0
    found = []
    for k in stripes.frames:
        small = cv2.resize(frames[k], size, interpolation=cv2.INTER_AREA)
        found.append(cv2.GaussianBlur(small.astype(np.float32), (0, 0), sigma))
    return np.stack(found)


def _shrunk(samples: Samples, width_px: int, full_px: int) -> Samples:
    few = Samples(*(np.ascontiguousarray(values[::EVERY]) for values in samples))
    times = samples_width(full_px) / width_px
    return few._replace(uv_px=(few.uv_px + 0.5) / times - 0.5, jacobian=few.jacobian / times)


def samples_width(full_px: int) -> int:
    """Of the pictures that samples are counted in."""
    return full_px // max(1, full_px // 800)
