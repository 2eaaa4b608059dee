"""Long computations in a process of their own: answers, failures, deaths and changes of mind, none of which is waited for."""

from __future__ import annotations

import os
import time
from collections.abc import Iterator

import pytest

from appliance.base import Progress
from appliance.calibrate.recordings import NotConverged
from appliance.instrument.machine.events import CalibrationProgressed
from appliance.instrument.machine.states import Failure, FailureKind
from appliance.instrument.service.calibrating import Background
from drivers.native import MonotonicClock


def double(x: int, report: Progress) -> int:
    report("doubling", 0.5)
    return 2 * x


def refuse(report: Progress) -> None:
    raise NotConverged("no calibration fits M3", subject="M3")


def die(report: Progress) -> None:
    os.abort()


def hang(report: Progress) -> None:
    while True:
        time.sleep(0.05)


@pytest.fixture
def background() -> Iterator[Background]:
    made = Background()
    yield made
    made.stop()


def answers(background: Background, timeout_s: float = 30.0) -> list[object]:
    clock = MonotonicClock()
    found: list[object] = []
    end_ns = clock.now_ns() + int(timeout_s * 1e9)
    while clock.now_ns() < end_ns:
        said = background.poll()
        if said is not None:
            found.append(said)
            if not isinstance(said, CalibrationProgressed):
                return found
        clock.sleep_s(0.01)
    raise AssertionError(f"no end of the job; so far {found}")


def test_a_job_says_how_far_it_is_and_answers_or_fails_in_its_words(background: Background) -> None:
    background.ask(double, 21)
    assert [background.busy] == [True]
    assert answers(background) == [CalibrationProgressed(0.5), 42]
    assert [background.busy] == [False]
    background.ask(refuse)
    assert answers(background) == [Failure(FailureKind.NO_SOLUTION, "no calibration fits M3", "M3")]


def test_a_process_that_dies_is_told_once_and_one_that_is_no_longer_wanted_is_gone_at_once(
    background: Background,
) -> None:
    background.ask(die)
    (failed,) = answers(background)
    assert isinstance(failed, Failure)
    assert "ended with code" in failed.detail
    assert background.poll() is None
    background.ask(hang)
    assert background.poll() is None, "nobody waits for a job"
    background.stop()
    assert not background.busy
    background.ask(double, 5)
    assert answers(background) == [CalibrationProgressed(0.5), 10], "another process, and nothing of the last job"
