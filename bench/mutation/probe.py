"""Notes which test reaches a mutant's statement, how long tests take, and which are wanted: a pytest plugin, and what probes call.

It is imported in every process that a test starts, so it imports nothing of the project.
"""

from __future__ import annotations

import os
import time
from pathlib import Path
from typing import Any

NOTES, WANTED = "KINGFISHER_MUTATION_NOTES", "KINGFISHER_MUTATION_WANTED"
"""Variables that name the file of notes, and one of the wanted tests or files of tests."""
_seen: set[tuple[str, str]] = set()
_began = [0.0, 0.0]


def at(key: str) -> None:
    """Note once per test that the statement of the mutant ``key`` is about to run."""
    test = os.environ.get("PYTEST_CURRENT_TEST", "")
    if test and (key, test) not in _seen:
        _seen.add((key, test))
        _note(key, *test.rsplit(" ", 1))


def _note(*words: str) -> None:
    if NOTES in os.environ:
        file = os.open(os.environ[NOTES], os.O_WRONLY | os.O_APPEND | os.O_CREAT, 0o600)
        os.write(file, ("\t".join(words) + "\n").encode())
        os.close(file)


def _now() -> list[float]:
    return [sum(os.times()[:4]), time.monotonic()]


def pytest_runtest_logstart(nodeid: str) -> None:
    _began[:] = _now()


def pytest_runtest_logfinish(nodeid: str) -> None:
    cpu_s, wall_s = (now - began for now, began in zip(_now(), _began, strict=True))
    _note("ran", nodeid, f"{cpu_s:.2f}", f"{wall_s:.2f}")


def pytest_runtest_logreport(report: Any) -> None:
    if report.failed:
        _note("failed", report.nodeid)


def pytest_collection_modifyitems(items: list[Any]) -> None:
    if WANTED in os.environ:
        wanted = set(Path(os.environ[WANTED]).read_text().splitlines())
        items[:] = [one for one in items if wanted & {one.nodeid, one.nodeid.partition("::")[0]}]
