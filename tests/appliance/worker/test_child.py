"""The life of a child process: it answers, it ends by itself, it hangs, it is not there."""

from __future__ import annotations

import os
import time
from collections.abc import Iterator
from multiprocessing.connection import Connection

import pytest

from appliance.worker.child import ChildGone, ChildProcess


def echo(pipe: Connection, first: str) -> None:
    """Say ``first``, then every message again; end on the word, hang on the word."""
    pipe.send(first)
    while True:
        match pipe.recv():
            case "end":
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
