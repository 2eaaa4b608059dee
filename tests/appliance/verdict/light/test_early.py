"""What the images of X alone say of the light is made while Y is recorded, and changes no number of the verdict."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from appliance.patterns.sequence import Direction
from appliance.scan.exposure import Exposure
from appliance.scan.noise import TYPICAL
from appliance.verdict.light.changes import EarlyFit, fit_early, measure_changes
from appliance.verdict.light.levels import sample
from tests.support.photographed import Wall, photograph, wall

BLOCK = (3, 4)
"""Row and column of one of the 6 × 8 blocks."""
NUMBER = 8 * BLOCK[0] + BLOCK[1]
Frames = NDArray[np.uint8]


@pytest.fixture(name="taken", scope="module")
def _taken() -> tuple[Frames, Frames]:
    """Frames in which all good pixels of X are good ones of Y, and the same with a glint over a part of one block's Y."""
    images = photograph(Wall(wall(3, 0.1, 0.6), 0.1), Exposure(12_000), 3)
    frames = images.frames["left"]
    glint = frames.copy()
    height, width = frames.shape[1] // 6, frames.shape[2] // 8
    v, u = BLOCK[0] * height, BLOCK[1] * width
    glint[list(images.sequence.axis(Direction.Y).sine), v : v + height // 3, u + 2 : u + width - 2] = 250
    return frames, glint


def said(frames: Frames, early: bool, spoil: int | None = None) -> str:
    sequence = photograph(Wall(wall(3, 0.1, 0.6), 0.1), Exposure(12_000), 3).sequence
    taken = sample(frames, sequence)
    fitted: EarlyFit | None = fit_early(taken.grey, sequence) if early else None
    if fitted is not None and spoil is not None:
        found = fitted.found.copy()
        found[0, spoil] += 1.0
        fitted = replace(fitted, found=found)
    return repr(measure_changes(taken, sequence, TYPICAL, fitted))


def test_every_number_is_the_same_to_the_last_digit(taken: tuple[Frames, Frames]) -> None:
    clear, glint = taken
    assert said(clear, early=True) == said(clear, early=False)
    assert said(glint, early=True) == said(glint, early=False)
    assert said(glint, early=False) != said(clear, early=False)


def test_only_a_block_that_lost_a_pixel_since_is_fitted_anew(taken: tuple[Frames, Frames]) -> None:
    clear, glint = taken
    for frames, anew in ((clear, False), (glint, True)):
        assert (said(frames, early=True, spoil=NUMBER) == said(frames, early=True)) == anew
        assert said(frames, early=True, spoil=NUMBER + 1) != said(frames, early=True)
