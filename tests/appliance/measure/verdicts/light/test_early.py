"""What the images of X alone say of the light is made while Y is recorded, and changes no number of the verdict."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from appliance.measure.light.exposure import Exposure
from appliance.measure.light.noise import TYPICAL
from appliance.measure.light.patterns import Direction
from appliance.measure.verdicts.light.changes import fit_early, measure_changes
from appliance.measure.verdicts.light.levels import sample
from tests.support.photographed import Wall, photograph, wall

BLOCK = (3, 4)
"""Row and column of one of the 6 × 8 blocks."""
NUMBER = 8 * BLOCK[0] + BLOCK[1]
Frames = NDArray[np.uint8]
IMAGES = photograph(Wall(wall(3, 0.1, 0.6), 0.1), Exposure(12_000), 3)
"""All good pixels of X are good ones of Y."""


def glinting() -> Frames:
    """The same with a glint over a part of one block's Y."""
    glint = IMAGES.frames["left"].copy()
    height, width = glint.shape[1] // 6, glint.shape[2] // 8
    v, u = BLOCK[0] * height, BLOCK[1] * width
    glint[list(IMAGES.sequence.axis(Direction.Y).sine), v : v + height // 3, u + 2 : u + width - 2] = 250
    return glint


def said(frames: Frames, early: bool, spoil: int | None = None) -> str:
    taken = sample(frames, IMAGES.sequence)
    fitted = fit_early(taken.grey, IMAGES.sequence) if early else None
    if fitted is not None and spoil is not None:
        coefficients = fitted.coefficients.copy()
        coefficients[0, spoil] += 1.0
        fitted = replace(fitted, coefficients=coefficients)
    return repr(measure_changes(taken, IMAGES.sequence, TYPICAL, fitted))


def test_every_number_is_the_same_to_the_last_digit_and_only_a_block_that_lost_a_pixel_since_is_fitted_anew() -> None:
    clear, glint = IMAGES.frames["left"], glinting()
    assert said(glint, early=False) != said(clear, early=False)
    for frames, anew in ((clear, False), (glint, True)):
        whole = said(frames, early=True)
        assert whole == said(frames, early=False)
        assert (said(frames, early=True, spoil=NUMBER) == whole) == anew
        assert said(frames, early=True, spoil=NUMBER + 1) != whole
