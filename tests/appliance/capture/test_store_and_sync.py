"""Two processes see the same frames, and a board's vertical sync counts only when two queries agree about it."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import chain, repeat
from multiprocessing.shared_memory import SharedMemory
from pathlib import Path
from typing import cast

import numpy as np
import pytest

from appliance.capture.store import FrameStore
from appliance.capture.sync import SyncError, synchronise
from drivers.api import Board, Flip, Vsync

FRAMES, HEIGHT_PX, WIDTH_PX = 3, 4, 5
PERIOD_NS = 1e9 / 60
FLIP = Flip(-1, 1000, 7_000_000_000)


def test_every_frame_of_either_side_and_sequence_has_its_own_place_in_both_processes() -> None:
    with FrameStore(FRAMES, HEIGHT_PX, WIDTH_PX, sequences=2) as store:
        with FrameStore(FRAMES, HEIGHT_PX, WIDTH_PX, attach_to=store.name) as other:
            assert (store.sequences, other.sequences) == (2, 2)
            places = [(side, second) for side in ("left", "right") for second in (False, True)]
            for value, (side, second) in enumerate(places, start=1):
                slots = store.frames(side, second=second)
                assert slots.shape == (FRAMES, HEIGHT_PX, WIDTH_PX)
                assert not slots.any(), "nothing of another place, and nothing of before"
                slots[:] = value
            for value, (side, second) in enumerate(places, start=1):
                assert np.all(other.frames(side, second=second) == value)
        assert np.all(store.frames("right") == 3), "who only looked at it does not take it away"


def test_a_store_of_one_sequence_has_no_second() -> None:
    with FrameStore(FRAMES, HEIGHT_PX, WIDTH_PX) as store:
        assert store.sequences == 1
        with pytest.raises(KeyError):
            store.frames("left", second=True)


def test_the_memory_is_given_back_by_its_maker_and_only_once() -> None:
    store = FrameStore(FRAMES, HEIGHT_PX, WIDTH_PX)
    name = store.name
    SharedMemory(name).close()
    assert name in Path("/proc/self/maps").read_text()
    store.close()
    store.close()
    with pytest.raises(FileNotFoundError):
        SharedMemory(name)
    assert name not in Path("/proc/self/maps").read_text(), "184 MB must not stay mapped"
    with pytest.raises(KeyError):
        store.frames("left")


def test_leaving_the_store_gives_its_memory_back() -> None:
    with FrameStore(FRAMES, HEIGHT_PX, WIDTH_PX) as store:
        name = store.name
    with pytest.raises(FileNotFoundError):
        SharedMemory(name)


def test_every_page_is_there_before_the_first_scan() -> None:
    """A page that is only promised is found while frames arrive, or is not found at all."""
    with FrameStore(FRAMES, 100, 200, sequences=2) as store:
        assert Path("/dev/shm", store.name).stat().st_blocks * 512 >= 2 * 2 * FRAMES * 100 * 200


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
    [
        ((200, 200), 200, 2),
        ((199, 200, 200), 200, 3),
        ((200, 199, 200), 200, 3),
        ((200, None, None, 200), 200, 4),
        ((1, 2, 3, 4, 5, 6, 7, 8, 9, 9), 9, 10),
    ],
)
def test_two_queries_must_agree(counts: tuple[int | None, ...], found: int, queries: int) -> None:
    board = Answers(iter(counts))
    assert synchronise(cast("Board", board), FLIP, PERIOD_NS).count == found
    assert board.queries == queries


def test_a_board_that_never_agrees_with_itself_is_asked_ten_times() -> None:
    board = Answers(chain(range(50), repeat(None)))
    with pytest.raises(SyncError, match=r"10 queries gave the vertical sync numbers \[0, 1, 2, 3, 4, 5, 6, 7, 8, 9\]"):
        synchronise(cast("Board", board), FLIP, PERIOD_NS)
    assert board.queries == 10
