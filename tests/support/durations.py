"""Durations of a test run: its slowest tests, processor time by folder, and all of it in units of a fixed NumPy loop.

A machine is up to twice as fast as another one: seconds of two runs compare only where the loop's do.
"""

from __future__ import annotations

import re
import resource
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

SLOWEST = 20


def cpu_s() -> float:
    """Return the processor time of this process and of those children that ended, seconds."""
    used = (resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))
    return sum(one.ru_utime + one.ru_stime for one in used)


def loop_s() -> float:
    """Return the processor time that a fixed piece of NumPy's work takes here, seconds."""
    numbers = np.random.default_rng(1).random(1_000_000)
    begun = cpu_s()
    for _ in range(10):
        np.sort(numbers)
    return cpu_s() - begun


class Durations:
    """Plugin of pytest. In each process it notes what a phase of a test took; the one that tells, adds up."""

    def __init__(self) -> None:
        self._seen_s = cpu_s()
        self._tests: dict[str, list[float]] = defaultdict(lambda: [0.0, 0.0])
        """Seconds by the clock and of the processor, by test."""

    def pytest_runtest_logstart(self) -> None:
        self._seen_s = cpu_s()

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_makereport(self) -> Iterator[None]:
        report = yield
        now_s = cpu_s()
        report.cpu_s = now_s - self._seen_s  # type: ignore[attr-defined]
        self._seen_s = now_s
        return report

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        of_test = self._tests[report.nodeid]
        of_test[0] += report.duration
        of_test[1] += getattr(report, "cpu_s", 0.0)

    def pytest_terminal_summary(self, terminalreporter: pytest.TerminalReporter, config: pytest.Config) -> None:
        if len(self._tests) <= SLOWEST:
            return
        lines = list(self._lines(loop_s()))
        stage = re.match(r"(?!not )\w+", config.option.markexpr)
        path = config.rootpath / ".cache" / "durations" / f"{stage[0] if stage else 'default'}.txt"
        path.parent.mkdir(parents=True, exist_ok=True)
        everything = [f"{clock:8.2f} {cpu:8.2f}  {name}" for name, (clock, cpu) in self._slowest()]
        path.write_text("\n".join([*lines, "", "   clock      cpu  every test", *everything]) + "\n", encoding="utf-8")
        terminalreporter.section("durations, s")
        terminalreporter.write("\n".join([*lines, f"all of them: {path.relative_to(config.rootpath)}"]) + "\n")

    def _slowest(self) -> list[tuple[str, list[float]]]:
        return sorted(self._tests.items(), key=lambda one: -one[1][1])

    def _lines(self, unit_s: float) -> Iterator[str]:
        yield "   clock      cpu  slowest tests"
        for name, (clock, cpu) in self._slowest()[:SLOWEST]:
            yield f"{clock:8.2f} {cpu:8.2f}  {name}"
        folders: dict[str, float] = defaultdict(float)
        for name, (_, cpu) in self._tests.items():
            folders[str(Path(name.partition("::")[0]).parent)] += cpu
        yield "              cpu  folder"
        for folder, cpu in sorted(folders.items(), key=lambda one: -one[1]):
            yield f"         {cpu:8.1f}  {folder}"
        whole_s = sum(folders.values())
        yield f"         {whole_s:8.1f}  together: {whole_s / unit_s:,.0f} times NumPy's loop of {unit_s:.2f} s"
