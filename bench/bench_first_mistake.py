"""How soon is a mistake told? Processor time of each verb from its start to the one line that says what is wrong with what was typed.

A person types the next word after it, or a program tries the next scan: what can be known from words and heads of files is said before
anything that computes is loaded. The mistakes are those of ``tests/appliance/cli/test_first_mistake.py``, which counts what is loaded.
"""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from pathlib import Path

from bench.result import Measured
from bench.timing import run_python, verb
from tests.appliance.cli.test_first_mistake import ALL, place

TARGET_CPU_S = 0.5
NAMED = 5
"""Number of the slowest verbs that are listed by name."""


def measure() -> Iterator[Measured]:
    """Make each mistake in a process of its own, one after the other."""
    with tempfile.TemporaryDirectory() as folder:
        place(Path(folder))
        spent_s = {words: run_python(verb(f"{words} {one.words}"), Path(folder)).cpu_s for words, one in ALL.items()}
    slowest = sorted(spent_s, key=lambda words: spent_s[words], reverse=True)
    yield Measured(
        f"the slowest of {len(spent_s)} first mistakes, {slowest[0]}",
        spent_s[slowest[0]],
        "s CPU",
        at_most=TARGET_CPU_S,
        key="first_mistake_cpu_s",
    )
    for words in slowest[1:NAMED]:
        yield Measured(words, spent_s[words], "s CPU")
    yield Measured(
        "the middle one", sorted(spent_s.values())[len(spent_s) // 2], "s CPU", key="first_mistake_middle_cpu_s"
    )
