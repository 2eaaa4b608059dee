"""CPU time of each verb from its start to the error about a wrong argument.

A person corrects the word after it, or a program tries the next scan. So errors that follow from words and heads of
files are reported before modules that compute are loaded. The mistakes are those of
``tests/appliance/cli/test_first_mistake.py``, which counts the loaded modules.
"""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from pathlib import Path

from bench.result import Measurement
from bench.timing import run_python, verb
from tests.appliance.cli.test_first_mistake import ALL, place

TARGET_CPU_S = 0.5
NAMED = 5
"""Number of the slowest verbs that are listed by name."""


def measure() -> Iterator[Measurement]:
    """Make each mistake in a process of its own, one after the other."""
    with tempfile.TemporaryDirectory() as folder:
        place(Path(folder))
        spent_s = {
            name: run_python(verb(f"{name} {mistake.words}"), Path(folder)).cpu_s for name, mistake in ALL.items()
        }
    slowest = sorted(spent_s, key=lambda name: spent_s[name], reverse=True)
    yield Measurement(
        f"the slowest of {len(spent_s)} first mistakes, {slowest[0]}",
        spent_s[slowest[0]],
        "s CPU",
        at_most=TARGET_CPU_S,
        key="first_mistake_cpu_s",
    )
    for name in slowest[1:NAMED]:
        yield Measurement(name, spent_s[name], "s CPU")
    yield Measurement(
        "the middle one", sorted(spent_s.values())[len(spent_s) // 2], "s CPU", key="first_mistake_middle_cpu_s"
    )
