"""The child's end of the worker: what it loads, compares and looks at in the pauses, and that no scan waits for it."""

from __future__ import annotations

import multiprocessing
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from multiprocessing.connection import Connection
from typing import Any

import numba
import numpy as np
import pytest
from numpy.typing import NDArray

from appliance.instrument.capture.store import FrameStore
from appliance.instrument.worker import messages as say
from appliance.instrument.worker.memory import LivePicture, behind_picture
from appliance.instrument.worker.serve import Server
from appliance.measure.guidance import Overlap
from appliance.measure.light.acquisition import AcquisitionSettings
from appliance.measure.light.patterns import build_sequence
from appliance.measure.light.sides import SIDES
from appliance.measure.news import FullCloud, LiveGuidance, News, PatternIdentity, ReconstructionFailure, ScanOverlap
from appliance.measure.points.pipeline import Pipeline
from appliance.measure.points.table import PointTable
from appliance.measure.procedure import SequenceProcessor
from appliance.measure.warm import watch_compiler
from tests.support import synthetic

WIDTH_PX, HEIGHT_PX = 120, 90
TIMEOUT_S = 60.0
SEQUENCE, CALIBRATION = build_sequence(16), synthetic.calibration(WIDTH_PX, HEIGHT_PX)
FRAMES = [say.FrameStored(side, k) for k in range(len(SEQUENCE)) for side in SIDES]
LOOK, LOOKED = say.LookAt(5, (3, 4), 1), LiveGuidance(None, 5, 0.1)


def begin(ticket: int) -> say.Begin:
    return say.Begin(ticket, AcquisitionSettings(), belongs_to=2)


class Pieces:
    """Work of as many pieces as are given, each of which waits to be let through: what neighbours have, or a live guide once it looks."""

    def __init__(self, pieces: int, answer: object, wanted: bool = True) -> None:
        self._pieces, self._answer, self._wanted = pieces, answer, wanted
        self.done, self.begun = 0, list[int | None]()
        self.pictures: list[NDArray[np.uint8]] = []
        self.reached, self.go = threading.Semaphore(0), threading.Semaphore(0)

    @property
    def has_work(self) -> bool:
        return self._wanted and self.done < self._pieces

    def begin(self, belongs_to: int | None = None) -> None:
        self.begun.append(belongs_to)
        self._wanted = False

    def look(self, _order: say.LookAt, picture: NDArray[np.uint8]) -> None:
        self.pictures.append(picture)
        self._wanted = True

    def go_on(self) -> object:
        self.reached.release()
        assert self.go.acquire(timeout=TIMEOUT_S)
        self.done += 1
        return self._answer if self.done == self._pieces else None


@contextmanager
def serving(
    *first: object,
    left: list[Callable[[], object]] | None = None,
    neighbours: Any = None,
    onlooker: Any = None,
    lit: bool = False,
) -> Iterator[Connection]:
    """The parent's end of a server for frames of a wall, in the dark or ``lit``; it is told ``first`` before it listens."""
    ours, theirs = multiprocessing.Pipe()
    picture = LivePicture(memoryview(bytearray(behind_picture(10))), 10)
    picture.put(np.arange(12, dtype=np.uint8).reshape(3, 4))
    with (
        FrameStore(len(SEQUENCE), HEIGHT_PX, WIDTH_PX) as store,
        Pipeline(CALIBRATION, synthetic.WATER, SEQUENCE) as pipeline,
    ):
        for side, frames in synthetic.wall(CALIBRATION, SEQUENCE).items() if lit else ():
            store.frames(side)[...] = frames
        processor = SequenceProcessor(pipeline, CALIBRATION, synthetic.WATER)
        coarse, aiming = PointTable(WIDTH_PX * HEIGHT_PX), None if onlooker is None else (onlooker, picture)
        server = Server(theirs, processor, store, coarse, left or [], neighbours, aiming)
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


def heard(pipe: Connection) -> Any:
    assert pipe.poll(TIMEOUT_S), "it says nothing"
    return pipe.recv()


def test_a_scan_that_is_there_at_once_does_not_wait_for_what_only_some_scans_need() -> None:
    ran: list[str] = []
    loaded = threading.Event()
    left: list[Callable[[], object]] = [lambda: ran.append("first"), lambda: ran.append("second"), loaded.set]
    with serving(begin(1), *FRAMES, say.Finish(), left=left) as pipe:
        said = heard(pipe)
        assert isinstance(said.fact, PatternIdentity)
        assert said.fact.judgement.fault is not None, "dark frames show no patterns"
        assert loaded.wait(TIMEOUT_S)
        assert ran == ["first", "second"]
        pipe.send(say.Ping())
        assert heard(pipe) == say.Pong(), "nothing is said of it"


def test_nothing_is_loaded_between_two_frames_of_a_scan() -> None:
    loaded = threading.Event()
    with serving(begin(1), FRAMES[0], say.Ping(), left=[loaded.set]) as pipe:
        assert heard(pipe) == say.Pong()
        time.sleep(0.05)  # the pause between two frames
        pipe.send(say.Ping())
        assert (heard(pipe), loaded.is_set()) == (say.Pong(), False)
        pipe.send(say.Drop())
        assert loaded.wait(TIMEOUT_S)


@pytest.mark.parametrize("between", [(), (say.Drop(),)])
def test_the_next_scan_does_not_wait_for_the_one_before(between: tuple[object, ...]) -> None:
    with serving(begin(1), *FRAMES, say.Finish(), *between, begin(2), *FRAMES, say.Finish(), lit=True) as pipe:
        told = []
        while not isinstance((said := heard(pipe)).fact, FullCloud):
            told.append(said)
        assert said.number == 2
        assert any(one.number == 2 and isinstance(one.fact, PatternIdentity) for one in told)
        assert len([one for one in told if one.number == 1]) <= 1, "its work has ended"


def test_frames_that_are_no_sequence_fail_it_and_the_next_one_is_done() -> None:
    with serving(begin(1), FRAMES[0], say.Finish(), begin(2), *FRAMES, say.Finish(), lit=True) as pipe:
        said = heard(pipe)
        assert isinstance(said.fact, ReconstructionFailure)
        assert (said.number, "frames" in said.fact.fault.detail) == (1, True)
        assert isinstance(heard(pipe).fact, PatternIdentity)


def test_what_had_to_be_compiled_is_told_from_what_was_there() -> None:
    @numba.njit()
    def new(values: NDArray[np.float64]) -> float:
        return float(values[0])

    with watch_compiler() as compiled:
        assert not compiled()
        new(np.zeros(1))
        assert compiled()
    with watch_compiler() as compiled:
        new(np.zeros(2))
        assert not compiled()


def test_a_live_picture_is_looked_at_in_the_pauses_behind_a_scan_that_is_compared() -> None:
    neighbours = Pieces(2, ScanOverlap(Overlap(0.5), 0.1))
    onlooker = Pieces(3, LOOKED, wanted=False)
    with serving(neighbours=neighbours, onlooker=onlooker) as pipe:
        assert neighbours.reached.acquire(timeout=TIMEOUT_S)
        pipe.send(LOOK)
        for work in (*[onlooker] * 3, *[neighbours] * 2):
            work.go.release()
        assert heard(pipe) == News(0, ScanOverlap(Overlap(0.5), 0.1))
        assert heard(pipe) == LOOKED
        np.testing.assert_array_equal(onlooker.pictures, [np.arange(12).reshape(3, 4)])


def test_a_scan_that_begins_waits_for_one_piece_of_a_look_at_most_and_ends_it() -> None:
    neighbours, onlooker = Pieces(0, None), Pieces(100, LOOKED, wanted=False)
    with serving(neighbours=neighbours, onlooker=onlooker) as pipe:
        pipe.send(LOOK)
        assert onlooker.reached.acquire(timeout=TIMEOUT_S)
        pipe.send(begin(1))
        pipe.send(say.Ping())
        onlooker.go.release()
        assert heard(pipe) == say.Pong()
        assert (onlooker.done, neighbours.begun) == (1, [2])
        pipe.send(say.Drop())
        onlooker.go.release()
        assert not onlooker.reached.acquire(timeout=0.2), "not even when that scan is over"
