"""The board's vertical syncs are matched to the projector's flips by the clock's own arithmetic, however far apart they are."""

from __future__ import annotations

import pytest

from appliance.capture.sync import map_vsync
from drivers.api import Flip, Vsync

PERIOD_NS = 1e9 / 60
BLANK_NS = 7_000_000_000
"""Host time of the flip, which is the board's vertical sync 200."""
BOARD_LATER_NS = 2_000_000_000
"""The host's clock shows this much more than the board's."""
FLIP = Flip(-1, 1000, BLANK_NS)


def answer(periods_after: int, sent_ns: int, answered_after_ns: int, took_ns: int) -> Vsync:
    """What a board says about its latest vertical sync, ``periods_after`` the flip, when it reads its clock
    ``answered_after_ns`` after the question of ``sent_ns`` and the answer is there after ``took_ns``."""
    synced_ns = BLANK_NS + round(periods_after * PERIOD_NS)
    now_ns = sent_ns + answered_after_ns
    return Vsync(
        count=200 + periods_after,
        board_time_us=(synced_ns - BOARD_LATER_NS) // 1000,
        board_now_us=(now_ns - BOARD_LATER_NS) // 1000,
        host_sent_ns=sent_ns,
        host_received_ns=sent_ns + took_ns,
    )


@pytest.mark.parametrize("periods", [-7, -1, 0, 1, 2, 30])
def test_a_sync_that_is_periods_away_from_the_flip_is_counted_back_to_it(periods: int) -> None:
    sent_ns = BLANK_NS + round(periods * PERIOD_NS) + 3_000_000
    found = map_vsync(FLIP, answer(periods, sent_ns, 200_000, 400_000), PERIOD_NS)
    assert found is not None
    assert found.count == 200, "the flip's own vertical sync"
    assert found.phase_error == pytest.approx(0.0, abs=0.001)
    assert found.host_ns(5_000_000) == pytest.approx(5_000_000_000 + BOARD_LATER_NS, abs=2000)


@pytest.mark.parametrize("answered_after_ns", [0, 3_000_000, 6_000_000])
def test_the_clocks_are_never_further_off_than_half_of_what_the_answer_took(answered_after_ns: int) -> None:
    """The board may read its clock at once and answer late, or the other way round: nobody knows which."""
    took_ns = 6_000_000
    found = map_vsync(FLIP, answer(1, BLANK_NS + 20_000_000, answered_after_ns, took_ns), PERIOD_NS)
    assert found is not None
    assert found.count == 200
    off_ns = found.host_minus_board_ns - BOARD_LATER_NS
    assert off_ns == pytest.approx(took_ns // 2 - answered_after_ns, abs=2000)
    assert abs(off_ns) <= took_ns // 2 + 2000


@pytest.mark.parametrize(("phase", "fits"), [(0.0, True), (0.25, True), (-0.25, True), (0.35, False), (-0.35, False)])
def test_a_sync_that_is_not_the_projectors_supports_no_map(phase: float, fits: bool) -> None:
    synced_ns = BLANK_NS + round(phase * PERIOD_NS)
    now_ns = BLANK_NS + 18_000_000
    vsync = Vsync(
        200, (synced_ns - BOARD_LATER_NS) // 1000, (now_ns - BOARD_LATER_NS) // 1000, now_ns - 50_000, now_ns + 50_000
    )
    found = map_vsync(FLIP, vsync, PERIOD_NS)
    assert (found is not None) == fits
    if found is not None:
        assert (found.count, round(found.phase_error, 2)) == (200, phase)


@pytest.mark.parametrize(("took", "fits"), [(0.45, True), (0.55, False)])
def test_an_answer_that_took_half_a_period_says_nothing(took: float, fits: bool) -> None:
    took_ns = round(took * PERIOD_NS)
    found = map_vsync(FLIP, answer(0, BLANK_NS + 1_000_000, took_ns // 2, took_ns), PERIOD_NS)
    assert (found is not None) == fits
