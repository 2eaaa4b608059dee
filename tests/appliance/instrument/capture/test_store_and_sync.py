"""Two processes see the same frames; a board's vertical sync counts only when it fits and two queries agree; and how long is waited."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import chain, repeat
from multiprocessing.shared_memory import SharedMemory
from pathlib import Path
from typing import cast

import numpy as np
import pytest

from appliance.instrument.capture.grabber import Timeouts
from appliance.instrument.capture.ledger import SyncError, map_vsync, synchronise
from appliance.instrument.capture.store import FrameStore
from drivers.api import Board, Flip, Vsync

FRAMES, HEIGHT_PX, WIDTH_PX = 3, 4, 5
PERIOD_NS = 1e9 / 60
FLIP = Flip(-1, 1000, 7_000_000_000)
"""The board's vertical sync 200."""
BOARD_LATER_NS = 2_000_000_000
"""The host's clock shows this much more than the board's."""


def test_every_frame_of_either_side_and_sequence_has_its_own_place_in_both_processes() -> None:
    places = [(side, second) for side in ("left", "right") for second in (False, True)]
    with FrameStore(FRAMES, HEIGHT_PX, WIDTH_PX, sequences=2) as store:
        with FrameStore(FRAMES, HEIGHT_PX, WIDTH_PX, attach_to=store.name) as other:
            assert (store.sequences, other.sequences) == (2, 2)
            for value, (side, second) in enumerate(places, start=1):
                slots = store.frames(side, second=second)
                assert slots.shape == (FRAMES, HEIGHT_PX, WIDTH_PX)
                assert not slots.any(), "nothing of another place, and nothing of before"
                slots[:] = value
            for value, (side, second) in enumerate(places, start=1):
                assert np.all(other.frames(side, second=second) == value)
        assert np.all(store.frames("right") == 3), "who only looked at it does not take it away"
    with FrameStore(FRAMES, HEIGHT_PX, WIDTH_PX) as store, pytest.raises(KeyError):
        store.frames("left", second=True)


def test_every_page_is_there_from_the_start_and_given_back_by_its_maker_and_only_once() -> None:
    store = FrameStore(FRAMES, 100, 200, sequences=2)
    name, mapped = store.name, Path("/proc/self/maps")
    assert Path("/dev/shm", name).stat().st_blocks * 512 >= 2 * 2 * FRAMES * 100 * 200
    SharedMemory(name).close()
    assert name in mapped.read_text()
    for _ in range(2):
        store.close()
    assert name not in mapped.read_text(), "184 MB must not stay mapped"
    with pytest.raises(FileNotFoundError):
        SharedMemory(name)
    with pytest.raises(KeyError):
        store.frames("left")


class Answers:
    """The answers of a board to one query after the other."""

    def __init__(self, counts: Iterator[int | None]) -> None:
        self._counts = counts
        self.queries = 0

    def vsync(self) -> Vsync:
        """Of the flip's blank by the count that is next; ``None``: an answer that took too long to say anything."""
        self.queries += 1
        count = next(self._counts)
        took_ns = 200_000 if count is not None else round(0.9 * PERIOD_NS)
        middle_ns = FLIP.time_ns + 2_000_000
        return Vsync(count or 0, 5_000_000, 5_002_000, middle_ns - took_ns // 2, middle_ns + took_ns // 2)


@pytest.mark.parametrize(
    ("counts", "found", "queries"),
    [((200, 200), 200, 2), ((199, 200, 200), 200, 3), ((200, 199, 200), 200, 3), ((200, None, None, 200), 200, 4)],
)
def test_two_queries_must_agree(counts: tuple[int | None, ...], found: int, queries: int) -> None:
    board = Answers(iter(counts))
    assert synchronise(cast("Board", board), FLIP, PERIOD_NS).count == found
    assert board.queries == queries


def test_a_board_that_never_agrees_with_itself_is_asked_ten_times() -> None:
    board = Answers(chain(range(9), (8,), repeat(None)))
    assert (synchronise(cast("Board", board), FLIP, PERIOD_NS).count, board.queries) == (8, 10)
    board = Answers(chain(range(50), repeat(None)))
    with pytest.raises(SyncError, match=r"\[0, 1, 2, 3, 4, 5, 6, 7, 8, 9\]"):
        synchronise(cast("Board", board), FLIP, PERIOD_NS)
    assert board.queries == 10


def answer(periods_after: float, sent_ns: int, answered_after_ns: int, took_ns: int) -> Vsync:
    """What a board says about its latest vertical sync, ``periods_after`` the flip, when it reads its clock
    ``answered_after_ns`` after the question of ``sent_ns`` and the answer is there after ``took_ns``."""
    synced_ns = FLIP.time_ns + round(periods_after * PERIOD_NS)
    now_ns = sent_ns + answered_after_ns
    on_board_us = (synced_ns - BOARD_LATER_NS) // 1000, (now_ns - BOARD_LATER_NS) // 1000
    return Vsync(200 + round(periods_after), *on_board_us, sent_ns, sent_ns + took_ns)


@pytest.mark.parametrize("periods", [-7, 0, 1, 30])
def test_a_sync_that_is_periods_away_from_the_flip_is_counted_back_to_it(periods: int) -> None:
    sent_ns = FLIP.time_ns + round(periods * PERIOD_NS) + 3_000_000
    found = map_vsync(FLIP, answer(periods, sent_ns, 200_000, 400_000), PERIOD_NS)
    assert found is not None
    assert found.count == 200, "the flip's own vertical sync"
    assert found.phase_error == pytest.approx(0.0, abs=0.001)
    assert found.host_ns(5_000_000) == pytest.approx(5_000_000_000 + BOARD_LATER_NS, abs=2000)


@pytest.mark.parametrize("answered_after_ns", [0, 6_000_000])
def test_the_clocks_are_never_further_off_than_half_of_what_the_answer_took(answered_after_ns: int) -> None:
    found = map_vsync(FLIP, answer(1, FLIP.time_ns + 20_000_000, answered_after_ns, 6_000_000), PERIOD_NS)
    assert found is not None
    assert found.count == 200
    assert found.host_minus_board_ns - BOARD_LATER_NS == pytest.approx(3_000_000 - answered_after_ns, abs=2000)


@pytest.mark.parametrize(
    ("phase", "took", "fits"),
    [
        (0.25, 0.0, True), (-0.25, 0.0, True), (0.35, 0.0, False), (-0.35, 0.0, False), (0.0, 0.45, True), (0.0, 0.55, False),
    ],
)  # fmt: skip
def test_a_sync_that_is_not_the_projectors_or_an_answer_of_half_a_period_supports_no_map(
    phase: float, took: float, fits: bool
) -> None:
    took_ns = round(took * PERIOD_NS) or 100_000
    found = map_vsync(FLIP, answer(phase, FLIP.time_ns + 18_000_000 * (not took), took_ns // 2, took_ns), PERIOD_NS)
    assert (found is not None) == fits
    assert found is None or (found.count, round(found.phase_error, 2)) == (200, phase)


@pytest.mark.parametrize(
    ("rate_hz", "waits_s"),
    [(60.0, (2.0, 2.0, 0.15, 0.035, 2.5, 0.25, 5.0)), (1.0, (12.0, 24.0, 9.0, 2.1, 12.0, 3.0, 40.0))],
)
def test_devices_are_waited_for_seconds_or_periods_where_these_are_longer(
    rate_hz: float, waits_s: tuple[float, ...]
) -> None:
    t = Timeouts(rate_hz)
    found = (t.ready_s, t.first_frame_s, t.next_frame_s, t.silence_s, t.collect_s, t.pulse_s, t.margin_s)
    assert found == pytest.approx(waits_s)
