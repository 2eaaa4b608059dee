"""Timing: CPU of this process or of another program, threads included, as medians with their spread."""

from __future__ import annotations

import os
import resource
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from bench.result import Measurement

PROGRAM_TIMEOUT_S = 300.0


@dataclass(frozen=True, slots=True)
class Cost:
    """Times of a program from start to end, its exit code, and its errors."""

    wall_s: float
    cpu_s: float
    code: int
    errors: str


def verb(command_line: str) -> list[str]:
    """Return the arguments of Python for ``kingfisher`` with these words."""
    return ["-m", "appliance.cli", *command_line.split()]


def run_python(arguments: Sequence[str], folder: Path) -> Cost:
    """Run Python with these arguments, standing in ``folder``; CPU is that of all its processes."""
    # Without a folder of kernels from outside, as at a desk.
    environment = {name: value for name, value in os.environ.items() if name != "NUMBA_CACHE_DIR"}
    environment["PYTHONPATH"] = str(Path(__file__).parents[1])
    before, begun_s = resource.getrusage(resource.RUSAGE_CHILDREN), time.monotonic()
    ran = subprocess.run(
        [sys.executable, *arguments], cwd=folder, env=environment, capture_output=True, text=True,
        timeout=PROGRAM_TIMEOUT_S, check=False,
    )  # fmt: skip
    wall_s, after = time.monotonic() - begun_s, resource.getrusage(resource.RUSAGE_CHILDREN)
    cpu_s = after.ru_utime - before.ru_utime + after.ru_stime - before.ru_stime
    return Cost(wall_s, cpu_s, ran.returncode, ran.stderr)


def cpu_ms(action: Callable[[], object]) -> float:
    """Return the CPU time of ``action`` in all threads of this process."""
    begun_s = time.process_time()
    action()
    return (time.process_time() - begun_s) * 1e3


def median_of(
    name: str,
    values: Sequence[float],
    unit: str,
    key: str | None = None,
    at_most: float | None = None,
    at_least: float | None = None,
) -> Measurement:
    """Return the median with the first and ninth tenth. Raises ValueError without values."""
    if not len(values):
        raise ValueError(f"{name} was never measured; measure it at least once")
    low, middle, high = (float(value) for value in np.quantile(values, [0.1, 0.5, 0.9]))
    return Measurement(name, middle, unit, at_most, at_least, key, spread=(low, high))
