"""Looks tell what an image shows where stripes are wide: the right words agree, exchanged ones less."""

from __future__ import annotations

import numpy as np
import pytest

from appliance.desk.foreign.appearance import agreement, look_at, words_by_looks
from appliance.desk.foreign.order import parse_order
from appliance.desk.foreign.problem import ForeignError

WORDS = ["bright", "dark", "gray-x", "~gray-x", "gray-y", *["sine-x"] * 4, *["sine-y"] * 4, "-"]
ROWS, COLUMNS = np.mgrid[:64, :64] / 64.0


def test_images_look_like_what_they_show() -> None:
    lit, even = (COLUMNS * 4 % 2 < 1).astype(float), np.ones_like(COLUMNS)
    sines = [0.5 + 0.5 * np.cos(2 * np.pi * (4 * place + k / 4)) for place in (COLUMNS, ROWS) for k in range(4)]
    looks = look_at(np.rint(20.0 + 200.0 * np.stack([even, 0.0 * even, lit, 1.0 - lit, lit.T, *sines, even])))
    assert words_by_looks(looks) == WORDS
    assert agreement(looks, parse_order(" ".join(WORDS), "order")) == pytest.approx(0.954, abs=0.005)
    for one, other in ((0, 1), (2, 4), (2, 5), (3, 4), (5, 9), (1, 6)):
        words = list(WORDS)
        words[one], words[other] = words[other], words[one]
        assert agreement(looks, parse_order(" ".join(words), "order")) < 0.9


def test_images_that_hardly_differ_are_no_sequence() -> None:
    dark = np.full((40, 40), 20, np.uint8)
    assert look_at(np.stack([dark, dark + 5])).mean.tolist() == [0.0, 1.0]
    with pytest.raises(ForeignError, match="the images hardly differ: 0 pixels change; give a folder with a whole"):
        look_at(np.stack([dark, dark + 4]))
