"""Runs inputs through a target: what it accepted, what it refused in how many ways, and what it should not have done.

An input is a function of target, seed and number alone: ``--seed S --only N`` makes it again.
"""

from __future__ import annotations

import re
import signal
import threading
import time
import traceback
from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from random import Random
from types import FrameType
from typing import Any

from tests.fuzz.target import Target, check_refusal

LONGEST_S = 2.0
"""Of CPU time for one input; the usual one takes some 0.0001 s."""
MOST_FINDINGS = 20
_KIND = re.compile(r"(['\"]).*?\1|0x[0-9a-f]+|[-+]?\d[\d.e+_]*|/\S+")


class TooLong(BaseException):
    """An input takes too long; no parser's handler may take it for an error of its own."""


@dataclass(frozen=True, slots=True)
class Finding:
    """One input that was not answered as promised."""

    target: str
    seed: int
    index: int
    what: str
    case: str
    trace: str

    def __str__(self) -> str:
        return (
            f"{self.target}: {self.what}\n    ./dev fuzz --target {self.target} --seed {self.seed} --only {self.index}\n"
            f"    input {self.case}"
        )


@dataclass(slots=True)
class Tally:
    """What came of the inputs of one target."""

    inputs: int = 0
    accepted: int = 0
    refused: Counter[str] = field(default_factory=Counter)
    """By kind of message, numbers and quoted words left out."""
    findings: list[Finding] = field(default_factory=list)
    cpu_s: float = 0.0

    @property
    def per_s(self) -> float:
        """Inputs per second of CPU time."""
        return self.inputs / self.cpu_s if self.cpu_s else 0.0


def make_case(target: Target, seed: int, index: int) -> Any:
    """Input number ``index``."""
    return target.make(Random(f"{target.name} {seed} {index}"))


def run(
    target: Target, seed: int, indices: Iterable[int], scratch: Path, mark: Callable[[int], None] = lambda index: None
) -> Tally:
    """Run inputs; ``mark`` is told each number before it is read, so that a dead process says which one it was."""
    tally = Tally()
    begun = time.process_time()
    kinds: set[str] = set()
    with _limited() as limit:
        for index in indices:
            mark(index)
            tally.inputs += 1
            case = make_case(target, seed, index)
            try:
                limit(LONGEST_S)
                target.read(case, scratch)
                tally.accepted += 1
            except target.refusals as error:
                try:
                    check_refusal(target, case, error)
                except AssertionError as unclear:
                    _find(tally, kinds, target, seed, index, case, unclear)
                tally.refused[kind_of(error)] += 1
            except (Exception, TooLong) as error:
                _find(tally, kinds, target, seed, index, case, error)
            finally:
                limit(0.0)
    tally.cpu_s = time.process_time() - begun
    return tally


def kind_of(error: BaseException) -> str:
    """The message without what differs from input to input."""
    return f"{type(error).__name__}: {_KIND.sub('#', str(error))}"[:60]


def _find(
    tally: Tally, kinds: set[str], target: Target, seed: int, index: int, case: Any, error: BaseException
) -> None:
    what = f"{type(error).__name__}: {str(error)[:300]}"
    place = traceback.extract_tb(error.__traceback__)[-1]
    kind = f"{type(error).__name__} {place.filename}:{place.lineno}"
    if kind in kinds or len(tally.findings) >= MOST_FINDINGS:
        return
    kinds.add(kind)
    trace = "".join(line[:400].rstrip("\n") + "\n" for line in traceback.format_exception(error)[-8:])
    tally.findings.append(Finding(target.name, seed, index, what, repr(case)[:600], trace))


@contextmanager
def _limited() -> Iterator[Callable[[float], None]]:
    """A function that sets how much CPU time may pass from now on; 0 takes the limit away."""
    if threading.current_thread() is not threading.main_thread():
        raise RuntimeError("inputs are limited in time by a signal: run them in the main thread")

    def ring(_number: int, _frame: FrameType | None) -> None:
        raise TooLong(f"more than {LONGEST_S:g} s")

    before = signal.signal(signal.SIGVTALRM, ring)
    try:
        yield lambda seconds: signal.setitimer(signal.ITIMER_VIRTUAL, seconds) and None
    finally:
        signal.setitimer(signal.ITIMER_VIRTUAL, 0.0)
        signal.signal(signal.SIGVTALRM, before)
