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
    """Say ``first``, then every message again; close the pipe and end on the word, or hang."""
    pipe.send(first)
    while True:
        match pipe.recv():
            case "end":
                pipe.close()
                time.sleep(0.1)
                os._exit(7)
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
    process, pid = child._process, child.pid
    assert process is not None
    assert pid is not None
    assert (process.name, process.daemon) == ("kf-test", True), "nothing waits for it when the program ends"
    child.send("end")
    with pytest.raises(ChildGone, match="code 7"):
        heard(child)
    child.send("nobody listens any more")
    child.stop()
    assert (child.runs, child.pid, child.receive()) == (False, None, None)
    with pytest.raises(ProcessLookupError):
        os.kill(pid, 0)


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
    child.stop(0.2)
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
    # The argument's class is NumPy's, which must not be imported before the number of threads is known.
    child.start(np.float32(1.0))
    try:
        said = heard(child)
    finally:
        child.stop()
    assert isinstance(said, tuple)
    assert (said[0], said[1] > 10_000, said[2]) == (1, True, True)
