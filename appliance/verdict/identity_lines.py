"""Owns which pixels the identity check looks at: a few whole rows and columns, where one stripe follows the next."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from appliance.patterns.sequence import Direction, PatternSequence
from appliance.reconstruct.noise import CameraNoise

LINES = 32
"""Rows, and columns: each crosses each stripe's edge once."""
SAMPLES = 400
"""Along a line, about: what is seen at full resolution and on a small camera is then the same."""
MIN_SWING_DN = 8.0
"""A sample that changes by less over the sequence sees nothing of the projector."""
MIN_SWING_SIGMA = 8.0
"""The same in units of noise, which alone spreads 24 frames over four."""
MIN_PERIOD_PX = 4.0
"""A fringe must be this long in the image, or its steps cannot be followed from one pixel to the next."""


@dataclass(frozen=True, slots=True)
class Lines:
    """Samples along parallel lines of one camera's image; ``along`` is the direction in which they run."""

    along: Direction
    values: NDArray[np.uint8]
    """(n, lines, samples): each frame's."""
    low: NDArray[np.uint8]
    """(lines, samples): the darkest frame's. Which one that is says nothing: any frame may be in the wrong place."""
    high: NDArray[np.uint8]
    """(lines, samples): the brightest frame's."""
    lit: NDArray[np.bool_]
    """(lines, samples): changes by more than noise."""


def can_follow(sequence: PatternSequence, width_px: int) -> bool:
    """Are the fringes long enough in an image ``width_px`` wide? Camera and projector have about the same field."""
    return sequence.period_px * width_px / sequence.width_px >= MIN_PERIOD_PX


def take_lines(frames: NDArray[np.uint8], sequence: PatternSequence, noise: CameraNoise) -> Mapping[Direction, Lines]:
    """Rows and columns of ``frames`` (n, h, w) uint8, evenly spread; an eighth of a fringe or less between samples."""
    _, height_px, width_px = frames.shape
    eighth_px = sequence.period_px * width_px / sequence.width_px / 8.0
    step = max(1, min(int(eighth_px), width_px // SAMPLES))
    rows, columns = (
        np.unique(((np.arange(LINES) + 0.5) * size / LINES).astype(np.intp)) for size in (height_px, width_px)
    )
    across = np.ascontiguousarray(frames[:, rows, ::step])
    down = np.ascontiguousarray(frames[:, ::step, columns].transpose(0, 2, 1))
    return {Direction.X: _lines(Direction.X, across, noise), Direction.Y: _lines(Direction.Y, down, noise)}


def _lines(along: Direction, values: NDArray[np.uint8], noise: CameraNoise) -> Lines:
    low, high = values.min(axis=0), values.max(axis=0)
    levels = np.arange(256.0)
    sigma = np.sqrt(noise.read_dn**2 + noise.dn_per_e * np.maximum(levels - noise.black_dn, 0.0))
    least = np.minimum(np.maximum(MIN_SWING_DN, MIN_SWING_SIGMA * sigma), 255.0).astype(np.uint8)
    return Lines(along, values, low, high, high - low >= least[high])
