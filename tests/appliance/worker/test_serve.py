"""The child's end of the worker: what it loads in the pauses, and that no scan waits for it."""

from __future__ import annotations

import multiprocessing
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from multiprocessing.connection import Connection

import numpy as np
import pytest
from numpy.typing import NDArray

from appliance.capture.store import FrameStore
from appliance.patterns.sequence import build_sequence
from appliance.processing.procedure import SequenceProcessor
from appliance.reconstruct.pipeline import Pipeline
from appliance.reconstruct.table import PointTable
from appliance.scan.acquisition import AcquisitionSettings
from appliance.scan.overlap import Overlap
from appliance.scan.sides import SIDES
from appliance.worker.live_picture import LivePicture, behind_picture
from appliance.worker.messages import (
    Begin,
    Drop,
    Finish,
    FrameStored,
    Loaded,
    LookAt,
    LookedAt,
    OverlapFound,
    Ping,
    Pong,
    Spoiled,
)
from appliance.worker.neighbours import NeighbourAnswer, Neighbours
from appliance.worker.onlooker import Onlooker
from appliance.worker.serve import Server
from appliance.worker.warm import compiler_watched
from tests.support import synthetic

WIDTH_PX, HEIGHT_PX = 96, 72
TIMEOUT_S = 60.0


@contextmanager
def serving(
    left: list[Callable[[], object]],
    *first: object,
    neighbours: Neighbours | None = None,
    aiming: tuple[Onlooker, LivePicture] | None = None,
) -> Iterator[Connection]:
    """The parent's end of a server for dark frames, told ``first`` before it listens."""
    calibration, sequence = synthetic.calibration(WIDTH_PX, HEIGHT_PX), build_sequence(16)
    ours, theirs = multiprocessing.Pipe()
    with (
        FrameStore(len(sequence), HEIGHT_PX, WIDTH_PX) as store,
        Pipeline(calibration, synthetic.WATER, sequence) as pipeline,
    ):
        processor, coarse = SequenceProcessor(pipeline, calibration, synthetic.WATER), PointTable(WIDTH_PX * HEIGHT_PX)
        server = Server(theirs, processor, store, coarse, left, neighbours, aiming)
        for message in first:
            ours.send(message)

        def serve() -> None:
            with pytest.raises((EOFError, OSError)):
                server.serve()

        thread = threading.Thread(target=serve)
        thread.start()
        try:
            yield ours
        finally:
            ours.close()
            thread.join(TIMEOUT_S)


def heard(pipe: Connection) -> object:
    assert pipe.poll(TIMEOUT_S), "it says nothing"
    return pipe.recv()


def a_whole_sequence() -> list[object]:
    frames = [FrameStored(side, k) for k in range(len(build_sequence(16))) for side in SIDES]
    return [Begin(1, AcquisitionSettings()), *frames, Finish()]


def test_a_scan_that_is_there_at_once_does_not_wait_for_what_only_some_scans_need() -> None:
    ran: list[str] = []
    with serving([lambda: ran.append("first"), lambda: ran.append("second")], *a_whole_sequence()) as pipe:
        assert isinstance(heard(pipe), Spoiled), "dark frames show no patterns"
        assert heard(pipe) == Loaded()
        assert ran == ["first", "second"]
        pipe.send(Ping())
        assert heard(pipe) == Pong(), "it is said once"


def test_nothing_is_loaded_between_two_frames_of_a_scan() -> None:
    ran: list[str] = []
    begin, first, *_ = a_whole_sequence()
    with serving([lambda: ran.append("once")], begin, first, Ping()) as pipe:
        assert heard(pipe) == Pong()
        time.sleep(0.05)  # the pause between two frames
        pipe.send(Ping())
        assert heard(pipe) == Pong()
        assert ran == []
        pipe.send(Drop())
        assert heard(pipe) == Loaded()
        assert ran == ["once"]


def test_what_had_to_be_compiled_is_told_from_what_was_there() -> None:
    import numba

    @numba.njit()
    def new(values: NDArray[np.float64]) -> float:
        return float(values[0])

    with compiler_watched() as compiled:
        assert not compiled()
        new(np.zeros(1))
        assert compiled()
    with compiler_watched() as compiled:
        new(np.zeros(2))
        assert not compiled()


class Recorded(Neighbours):
    """Comparisons of as many pieces as are given, each of which waits to be let through."""

    def __init__(self, pieces: int) -> None:
        super().__init__(synthetic.calibration(WIDTH_PX, HEIGHT_PX), synthetic.WATER, build_sequence(16), 4)
        self.pieces, self.done = pieces, 0
        self.begun: list[int | None] = []
        self.reached, self.go = threading.Semaphore(0), threading.Semaphore(0)

    @property
    def waits(self) -> bool:
        return self.done < self.pieces

    def begin(self, belongs_to: int | None) -> None:
        self.begun.append(belongs_to)

    def go_on(self) -> NeighbourAnswer | None:
        self.reached.release()
        assert self.go.acquire(timeout=TIMEOUT_S)
        self.done += 1
        return NeighbourAnswer(Overlap(0.5), 0.1) if self.done == self.pieces else None


class Watched(Onlooker):
    """Looks of as many pieces as are given, each of which waits to be let through."""

    def __init__(self, pieces: int) -> None:
        calibration = synthetic.calibration(WIDTH_PX, HEIGHT_PX)
        super().__init__(calibration, synthetic.WATER, Recorded(0))
        self.pieces, self.done, self.number = pieces, 0, 0
        self.pictures: list[NDArray[np.uint8]] = []
        self.reached, self.go = threading.Semaphore(0), threading.Semaphore(0)

    @property
    def waits(self) -> bool:
        return bool(self.pictures) and self.done < self.pieces

    def begin(self) -> None:
        self.pieces = 0

    def look(self, order: LookAt, picture: NDArray[np.uint8]) -> None:
        self.number = order.number
        self.pictures.append(picture)

    def go_on(self) -> LookedAt | None:
        self.reached.release()
        assert self.go.acquire(timeout=TIMEOUT_S)
        self.done += 1
        return LookedAt(self.number, None, 0.1) if self.done == self.pieces else None


def shown(picture: NDArray[np.uint8]) -> LivePicture:
    """The place of a live picture, which shows ``picture``."""
    place = LivePicture(memoryview(bytearray(behind_picture(10))), 10)
    place.put(picture)
    return place


def test_a_live_picture_is_looked_at_in_the_pauses_and_the_answer_is_told() -> None:
    onlooker, picture = Watched(3), np.arange(12, dtype=np.uint8).reshape(3, 4)
    with serving([], aiming=(onlooker, shown(picture))) as pipe:
        assert heard(pipe) == Loaded()
        pipe.send(LookAt(5, (3, 4), 1))
        for _ in range(3):
            onlooker.go.release()
        assert heard(pipe) == LookedAt(5, None, 0.1)
        np.testing.assert_array_equal(onlooker.pictures, [picture])


def test_a_scan_that_begins_waits_for_one_piece_of_a_look_at_most_and_ends_it() -> None:
    neighbours, onlooker = Recorded(0), Watched(100)
    place = shown(np.zeros((3, 4), np.uint8))
    with serving([], neighbours=neighbours, aiming=(onlooker, place)) as pipe:
        assert heard(pipe) == Loaded()
        pipe.send(LookAt(5, (3, 4), 1))
        assert onlooker.reached.acquire(timeout=TIMEOUT_S)
        pipe.send(Begin(1, AcquisitionSettings(), belongs_to=2))
        pipe.send(Ping())
        onlooker.go.release()
        assert heard(pipe) == Pong()
        assert (onlooker.done, neighbours.begun) == (1, [2])
        pipe.send(Drop())
        onlooker.go.release()
        assert not onlooker.reached.acquire(timeout=0.2), "not even when that scan is over"


def test_a_scan_is_compared_before_what_is_aimed_at_is_looked_at() -> None:
    neighbours, onlooker = Recorded(2), Watched(1)
    place = shown(np.zeros((3, 4), np.uint8))
    with serving([], neighbours=neighbours, aiming=(onlooker, place)) as pipe:
        assert heard(pipe) == Loaded()
        assert neighbours.reached.acquire(timeout=TIMEOUT_S)
        pipe.send(LookAt(5, (3, 4), 1))
        onlooker.go.release()
        for _ in range(2):
            neighbours.go.release()
        assert heard(pipe) == OverlapFound(0, Overlap(0.5), 0.1)
        assert heard(pipe) == LookedAt(5, None, 0.1)
