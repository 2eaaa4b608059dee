"""The projector's response (light as a function of the code), measured from one scan of a smooth surface."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from appliance.calibrate.determined import UndeterminedError, solve_symmetric
from appliance.measure import PHASE_STEPS, Direction, PatternSequence, Response, phase_error_rad

ORDER = 9
"""Highest harmonic; in a response without kinks, those beyond are below 1e-4 of the first."""
SHORTEST_PERIOD_PX = 32
"""Blur takes 13 % of the third harmonic of fringes of 32 px, 40 % of those of 16 px."""
FEWEST_PIXELS, MOST_PIXELS = 5_000, 100_000
"""Pixels needed in all, and most pixels used of each camera and direction; noise then leaves 1e-5 of the light."""
MOST_RESIDUAL = 0.03
"""Largest accepted RMS residual, as a fraction of the light of the bright frame; noise makes 0.01."""
ACROSS_PX = 5
"""Rows over which coordinates are smoothed across their direction, in an image 1600 px wide."""


class ResponseError(Exception):
    """Error of a scan that does not determine the response; the text says why and the remedy."""


@dataclass(frozen=True, slots=True)
class CameraImages:
    """Frames (n, h, w) uint8 of one camera, and pattern coordinates (h, w), NaN where masked."""

    frames: NDArray[np.uint8]
    p_px: NDArray[np.float32]
    q_px: NDArray[np.float32]


@dataclass(frozen=True, slots=True)
class MeasuredResponse:
    """The projector's response as measured from one scan."""

    response: Response
    fringe_harmonics: tuple[float, ...]
    """Harmonics of the light of the fringes as displayed; those of the response if the patterns were not corrected."""
    residual: float
    """RMS residual of the observed light, as a fraction of the light of the bright frame."""
    pixels: int

    @property
    def phase_error_rad(self) -> float:
        """Largest phase error in that scan."""
        return phase_error_rad(self.fringe_harmonics)


def measure_response(
    sequence: PatternSequence, images: Sequence[CameraImages], drawn_for: Response | None = None
) -> MeasuredResponse:
    """Return the response of the projector that lit a scan of a smooth surface, for example a plane.

    ``drawn_for`` is the response for which the patterns of that scan were corrected. Raises ResponseError.
    """
    if sequence.period_px < SHORTEST_PERIOD_PX:
        raise ResponseError(
            f"the scan's fringe period is {sequence.period_px} px; allowed are {SHORTEST_PERIOD_PX} px and "
            "more, since blur removes the harmonics of shorter ones; set scan.period_px = 64 in the rig "
            "file and record again"
        )
    codes = _Sums(ORDER)
    phases = _Sums(ORDER)
    for image in images:
        for direction, coordinate in ((Direction.X, image.p_px), (Direction.Y, image.q_px)):
            # The phase error from harmonics repeats every 90° of phase and has mean zero over a fringe. So the mean
            # over one fringe period is the true coordinate of a smooth surface.
            smooth = _period_mean(coordinate, direction, sequence.period_px)
            for step, light, coordinate_px in _sine_samples(sequence, image, direction, smooth):
                pixels = np.arange(sequence.axis(direction).size_px)
                # Patterns without correction: the exact sine, without rounding to codes.
                drawn = (
                    np.cos(_phase_rad(pixels, sequence, step))
                    if drawn_for is None
                    else drawn_for.drawn(len(pixels), sequence.period_px, step)
                )
                x = np.interp(coordinate_px, pixels, drawn)
                codes.add(np.arccos(np.clip(x, -1.0, 1.0)), light)
                # The same light against the displayed phase: with corrected patterns, these are the harmonics that
                # remain.
                phases.add(_phase_rad(coordinate_px, sequence, step), light)
    if codes.count < FEWEST_PIXELS * PHASE_STEPS:
        raise ResponseError(
            f"{codes.count // PHASE_STEPS} pixels see a smooth surface over a whole fringe period; needed are "
            f"{FEWEST_PIXELS}; fill the image with a plane, without glare"
        )
    harmonics, residual = codes.solve()
    if residual > MOST_RESIDUAL:
        raise ResponseError(
            f"no response fits the frames: the residual is {residual:.3f} of the bright light; allowed is "
            f"{MOST_RESIDUAL}; record a still plane without glare"
        )
    try:
        response = Response(_normalise(harmonics))
    except ValueError as error:
        raise ResponseError(f"{error}; record a still plane without glare") from error
    return MeasuredResponse(response, tuple(float(b) for b in phases.solve()[0]), residual, codes.count // PHASE_STEPS)


def _period_mean(coordinate: NDArray[np.float32], direction: Direction, period_px: int) -> NDArray[np.float64]:
    """Return the mean over one fringe period along the direction; NaN where a coordinate is missing."""
    valid = np.isfinite(coordinate)
    filled = np.where(valid, coordinate, 0.0).astype(np.float64)
    slope = np.abs(np.diff(coordinate, axis=1 if direction is Direction.X else 0))
    px_per_px = float(np.nanmedian(slope)) if np.isfinite(slope).any() else 1.0
    along = 2 * round(0.5 * period_px / max(px_per_px, 1e-3)) + 1
    across = max(3, 2 * round(0.5 * ACROSS_PX * coordinate.shape[1] / 1600.0) + 1)
    size = (along, across) if direction is Direction.X else (across, along)
    if size[0] >= coordinate.shape[1] or size[1] >= coordinate.shape[0]:
        return np.full(coordinate.shape, np.nan)
    mean = cv2.boxFilter(filled, -1, size, borderType=cv2.BORDER_CONSTANT)
    is_complete = cv2.erode(valid.astype(np.uint8), np.ones(size[::-1], np.uint8), borderValue=0) > 0
    return np.where(is_complete, mean, np.nan)


def _sine_samples(
    sequence: PatternSequence, images: CameraImages, direction: Direction, smooth: NDArray[np.float64]
) -> list[tuple[int, NDArray[np.float64], NDArray[np.float64]]]:
    """Return step, light and coordinate of the usable pixels in each of the four sine frames."""
    bright, dark = (images.frames[k].astype(np.float64) for k in (sequence.bright, sequence.dark))
    pixels = np.flatnonzero(np.isfinite(smooth) & (bright < 250.0) & (bright - dark >= 40.0))
    pixels = pixels[:: max(1, pixels.size // MOST_PIXELS)]
    black = dark.reshape(-1)[pixels]
    coordinate_px, span = smooth.reshape(-1)[pixels], bright.reshape(-1)[pixels] - black
    sines = sequence.axis(direction).sine
    return [
        (step, (images.frames[k].reshape(-1)[pixels] - black) / span, coordinate_px) for step, k in enumerate(sines)
    ]


def _phase_rad(
    at_px: NDArray[np.floating] | NDArray[np.integer], sequence: PatternSequence, step: int
) -> NDArray[np.float64]:
    """Return the phase of a sine pattern at pattern coordinates."""
    return np.asarray(2.0 * np.pi * (at_px + 0.5) / sequence.period_px + step * np.pi / 2.0)


def _normalise(harmonics: NDArray[np.float64]) -> tuple[float, ...]:
    """Scale harmonics to light 0 at the first and 1 at the last code of the fringes."""
    ends = np.polynomial.chebyshev.chebval([-1.0, 1.0], harmonics)
    scaled = harmonics / (ends[1] - ends[0])
    scaled[0] -= ends[0] / (ends[1] - ends[0])
    return tuple(float(b) for b in scaled)


class _Sums:
    """Normal equations of light = Σ b_k cos kθ."""

    def __init__(self, order: int) -> None:
        self._matrix = np.zeros((order + 1, order + 1))
        self._vector = np.zeros(order + 1)
        self._squares = 0.0
        self.count = 0

    def add(self, angle: NDArray[np.float64], light: NDArray[np.float64]) -> None:
        basis = np.cos(np.arange(len(self._vector))[:, None] * angle[None, :])
        self._matrix += basis @ basis.T
        self._vector += basis @ light
        self._squares += float(light @ light)
        self.count += light.size

    def solve(self) -> tuple[NDArray[np.float64], float]:
        """Return the coefficients and the RMS residual. Raises ResponseError where the angles do not determine them."""
        names = [f"harmonic {k}" for k in range(len(self._vector))]
        try:
            b = solve_symmetric(self._matrix, self._vector, names)
        except UndeterminedError as error:
            raise ResponseError(
                f"the scan has too few codes to determine {', '.join(error.names)}; fill the image with a "
                "plane, so that many fringes fall on it"
            ) from error
        # Σ(light − basis b)² = Σ light² − bᵀv at the minimum, without a second pass over the pixels.
        unexplained = self._squares - float(np.dot(b, self._vector))
        return b, math.sqrt(max(unexplained, 0.0) / self.count)
