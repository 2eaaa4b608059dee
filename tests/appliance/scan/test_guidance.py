"""Which overlap asks for which move, and that no guidance is given without one."""

from __future__ import annotations

import pytest

from appliance.scan.guidance import LOST, Guidance, Move
from appliance.scan.overlap import UNKNOWN, Overlap


@pytest.mark.parametrize(
    ("share", "move"),
    [(0.0, Move.GO_BACK), (0.39, Move.GO_BACK), (0.41, Move.SCAN_NOW), (0.59, Move.SCAN_NOW), (0.61, Move.GO_ON)],
)
def test_half_is_good_less_asks_back_and_more_asks_on(share: float, move: Move) -> None:
    assert Guidance(Overlap(share)).move is move


def test_what_cannot_be_told_is_no_guidance() -> None:
    with pytest.raises(ValueError, match="give no guidance"):
        Guidance(UNKNOWN)
    assert LOST.move is Move.GO_BACK
