"""The life of a child process: it answers, it ends by itself, it hangs, it is not there."""

from __future__ import annotations

import gc
import os
import threading
import time
from collections.abc import Iterator
from multiprocessing.connection import Connection
from pathlib import Path

import numpy as np
import pytest

from appliance.process_start import BLAS_THREADS
from appliance.worker.child import ChildGone, ChildProcess


def echo(pipe: Connection, first: str) -> None:
    """Say ``first``, then every message again; end on the word, or close the pipe and end later, or hang."""
    pipe.send(first)
    while True:
        match pipe.recv():
            case "end":
                os._exit(7)
            case "close":
                pipe.close()
                time.sleep(0.3)
                os._exit(9)
            case "hang":
                pipe.close()
                time.sleep(60.0)
            case message:
                pipe.send(message)


@pytest.fixture
def child() -> Iterator[ChildProcess]:
    made = ChildProcess("kf-test", echo)
    made.start("hello")
    yield made
    made.stop()


def open_descriptors() -> set[str]:
    return {one.name for one in Path("/proc/self/fd").iterdir()}


def heard(child: ChildProcess) -> object:
    until_s = time.monotonic() + 60.0
    while (message := child.receive()) is None:
        assert time.monotonic() < until_s
        time.sleep(0.005)
    return message


def test_it_lives_says_and_ends(child: ChildProcess) -> None:
    assert heard(child) == "hello"
    child.send({"a": 1})
    assert heard(child) == {"a": 1}
    assert child.receive() is None, "nothing more, and nobody waits for it"
    pid = child.pid
    assert pid is not None
    child.send("end")
    with pytest.raises(ChildGone, match="the process ended with code 7"):
        heard(child)
    child.send("nobody listens any more")
    child.stop()
    assert (child.runs, child.pid, child.receive()) == (False, None, None)
    with pytest.raises(ProcessLookupError):
        os.kill(pid, 0)


def test_one_that_has_closed_its_pipe_is_waited_for_to_tell_how_it_ended(child: ChildProcess) -> None:
    assert heard(child) == "hello"
    child.send("close")
    with pytest.raises(ChildGone, match="the process ended with code 9"):
        heard(child)


def test_one_that_listens_is_given_its_time_to_end_by_itself(child: ChildProcess) -> None:
    assert heard(child) == "hello"
    process = child._process
    assert process is not None
    assert (process.name, process.daemon) == ("kf-test", True), "nothing waits for it when the program ends"
    child.stop(60.0)
    assert process.exitcode == 1, "its pipe had ended, which it minds; it was not killed"


def test_a_process_that_cannot_be_started_leaves_nothing_behind() -> None:
    child = ChildProcess("kf-test", echo)
    descriptors = open_descriptors()
    with pytest.raises(TypeError, match="pickle") as refused:
        child.start(threading.Lock())
    assert (child.runs, child.pid) == (False, None)
    assert open_descriptors() == descriptors, "however long somebody keeps the error"
    del refused
    child.send("nobody is there")
    assert child.receive() is None


def test_one_that_hangs_is_killed(child: ChildProcess) -> None:
    assert heard(child) == "hello"
    pid = child.pid
    assert pid is not None
    child.send("hang")
    begun_s = time.monotonic()
    child.stop(0.2)
    assert time.monotonic() - begun_s < 30.0
    with pytest.raises(ProcessLookupError):
        os.kill(pid, 0)


def tell_what_it_costs(pipe: Connection, _: object) -> None:
    """Say how many threads the process has after a product of matrices, and how many objects the collector leaves alone."""
    large = np.ones((400, 400))
    assert (large @ large)[0, 0] == 400.0
    pipe.send((len(list(Path("/proc/self/task").iterdir())), gc.get_freeze_count(), gc.isenabled()))


def test_it_turns_in_no_busy_loop_and_collects_no_imports(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv(BLAS_THREADS, raising=False)
    child = ChildProcess("kf-test", tell_what_it_costs)
    child.start(
        np.float32(1.0)
    )  # whose class is NumPy's: it must not be imported before the number of threads is known
    try:
        said = heard(child)
    finally:
        child.stop()
    assert isinstance(said, tuple)
    threads, left_alone, collects = said
    assert threads == 1
    assert left_alone > 10_000
    assert collects
