"""What stands in the place of a lost frame is what the camera would have seen, and what cannot be told is refused."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from appliance.patterns.sequence import Direction, build_sequence
from appliance.service.salvage import _make_up
from appliance.storage.scan import ScanError

SEQUENCE = build_sequence(16)
SINES = SEQUENCE.axis(Direction.X).sine


def recorded() -> NDArray[np.uint8]:
    """Frames (n, 1, 64) of an even surface: fringes of 40 DN about 100 DN, four steps of 90° in each direction."""
    frames = np.full((len(SEQUENCE), 1, 64), 100, np.uint8)
    for direction in Direction:
        for step, k in enumerate(SEQUENCE.axis(direction).sine):
            frames[k, 0] = np.round(100.0 + 40.0 * np.cos(2.0 * np.pi * (np.arange(64) / 16.0 - step / 4.0)))
    return frames


@pytest.mark.parametrize("step", range(4))
def test_a_lost_sine_image_is_what_the_other_three_say(step: int) -> None:
    frames, said = recorded(), list[str]()
    before = frames[SINES[step]].astype(int)
    frames[SINES[step]] = 0
    assert _make_up(frames, SEQUENCE, (SINES[step],), "left", said) == 3.0
    assert np.abs(frames[SINES[step]] - before).max() <= 2
    assert len(said) == 1


def test_two_sine_images_of_one_direction_are_too_many() -> None:
    with pytest.raises(ScanError, match="two of the four sine images of a direction are lost; bring the folder back"):
        _make_up(recorded(), SEQUENCE, (SINES[0], SINES[1]), "left", [])


def test_one_of_each_direction_is_not() -> None:
    other = SEQUENCE.axis(Direction.Y).sine
    said = list[str]()
    _make_up(recorded(), SEQUENCE, (SINES[0], other[2]), "left", said)
    assert len(said) == 2


def test_bright_and_dark_image_cannot_both_be_missed() -> None:
    with pytest.raises(ScanError, match="bright and dark image are both lost"):
        _make_up(recorded(), SEQUENCE, (SEQUENCE.bright, SEQUENCE.dark), "left", [])


def test_a_gray_image_cannot_be_missed() -> None:
    with pytest.raises(ScanError, match="which fringe a pixel sees"):
        _make_up(recorded(), SEQUENCE, (SEQUENCE.axis(Direction.X).gray[0],), "left", [])
