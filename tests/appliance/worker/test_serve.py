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
from appliance.scan.acquisition import AcquisitionSettings
from appliance.scan.sides import SIDES
from appliance.worker.messages import Begin, Drop, Finish, FrameStored, Loaded, Ping, Pong, Spoiled
from appliance.worker.serve import Server
from appliance.worker.warm import compiler_watched
from tests.support import synthetic

WIDTH_PX, HEIGHT_PX = 96, 72
TIMEOUT_S = 60.0


@contextmanager
def serving(left: list[Callable[[], object]], *first: object) -> Iterator[Connection]:
    """The parent's end of a server for dark frames, told ``first`` before it listens."""
    calibration, sequence = synthetic.calibration(WIDTH_PX, HEIGHT_PX), build_sequence(16)
    ours, theirs = multiprocessing.Pipe()
    with (
        FrameStore(len(sequence), HEIGHT_PX, WIDTH_PX) as store,
        Pipeline(calibration, synthetic.WATER, sequence) as pipeline,
    ):
        server = Server(theirs, SequenceProcessor(pipeline, calibration, synthetic.WATER), store, left)
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
