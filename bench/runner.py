"""Finding, running and reporting benchmarks: modules of a package with ``measure()``."""

from __future__ import annotations

import difflib
import importlib
import json
import os
import pkgutil
import platform
import subprocess
import sys
import traceback
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from bench.document import write_figures, write_health
from bench.result import Measurement

LATEST = "latest.json"
WRITE_DOCS = "--write-docs"
GIT_TIMEOUT_S = 30.0
Measure = Callable[[], Iterable[Measurement]]
Main = Callable[[Sequence[str]], int]


@dataclass(frozen=True, slots=True)
class Benchmark:
    """A module ``bench_<name>``, with the first line of its docstring as summary."""

    name: str
    summary: str
    measure: Measure
    main: Main | None = None
    """Function for its own options; ``None`` without any."""


class UnknownBenchmark(Exception):
    """No benchmark has that name; the message names the nearest ones."""


def find(package: str) -> dict[str, Benchmark]:
    """Return all benchmarks of ``package``, by name, in order: its modules ``bench_<name>`` with ``measure``.

    Raises TypeError for a module with such a name but no ``measure``, because it would never run.
    """
    benchmarks = {}
    for module_info in sorted(pkgutil.iter_modules(importlib.import_module(package).__path__), key=lambda m: m.name):
        if not module_info.name.startswith("bench_"):
            continue
        module = importlib.import_module(f"{package}.{module_info.name}")
        measure = getattr(module, "measure", None)
        if not callable(measure):
            raise TypeError(f"{module.__name__} has no function measure(): define it or rename the module")
        name = module_info.name.removeprefix("bench_")
        summary = (module.__doc__ or "").strip().partition("\n")[0]
        benchmarks[name] = Benchmark(name, summary, measure, getattr(module, "main", None))
    return benchmarks


def choose(benchmarks: dict[str, Benchmark], names: Sequence[str]) -> list[Benchmark]:
    """Return the benchmarks called ``names``, in that order; all without names. Raises UnknownBenchmark."""
    for name in names:
        if name not in benchmarks:
            near = difflib.get_close_matches(name, benchmarks) or sorted(benchmarks)
            raise UnknownBenchmark(f"no benchmark is called {name!r}; there is: {', '.join(near) or 'none'}")
    return [benchmarks[name] for name in names] if names else list(benchmarks.values())


def run(benchmarks: Sequence[Benchmark], out: Path, write: Callable[[str], object]) -> bool:
    """Run benchmarks one after the other, and write a line per number and ``out/<name>.json``.

    Return True if every limit was kept. A benchmark that raises counts as not kept; the others still run.
    """
    out.mkdir(parents=True, exist_ok=True)
    all_kept = True
    for benchmark in benchmarks:
        write(f"{benchmark.name}: {benchmark.summary}\n")
        measured: list[Measurement] = []
        error = None
        try:
            for number in benchmark.measure():
                measured.append(number)
                write(number.line() + "\n")
        except Exception:
            error = traceback.format_exc()
            write(error)
        all_kept = all_kept and error is None and all(number.is_kept for number in measured)
        record = {
            "benchmark": benchmark.name,
            "machine": machine(),
            "error": error,
            "measured": [number.as_dict() for number in measured],
        }
        (out / f"{benchmark.name}.json").write_text(json.dumps(record, indent=2) + "\n", encoding="utf-8")
        if any(number.key is not None for number in measured):
            note_latest(measured, out / LATEST)
    return all_kept


def note_latest(measured: Sequence[Measurement], path: Path) -> None:
    """Write numbers with a key into the file of the latest ones; its other content stays.

    A number that could not be measured is null, with the reason under ``why``; ``spread`` has its quantiles, ``bounds``
    the limits, ``versions`` day and commit.
    """
    now = version()
    try:
        latest = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        latest = {}
    notes: dict[str, dict[str, Any]] = {
        name: latest.setdefault(name, {}) for name in ("why", "spread", "bounds", "versions")
    }
    for number in measured:
        if number.key is not None:
            values = number.as_dict()
            latest[number.key] = values["value"]
            bounds = {name: values[name] for name in ("at_most", "at_least") if values[name] is not None}
            facts = {"why": values["why"], "spread": values["spread"], "bounds": bounds or None, "versions": now}
            for name, note in facts.items():
                notes[name].pop(number.key, None)
                if note is not None:
                    notes[name][number.key] = note
    latest["machine"] = machine()
    path.write_text(json.dumps(latest, indent=2, sort_keys=True) + "\n", encoding="utf-8")


def machine() -> dict[str, str | int | None]:
    """Return the machine of the numbers, for comparisons: processor, how many, interpreter."""
    model = None
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
        model = next((line.partition(":")[2].strip() for line in lines if line.startswith("model name")), None)
    except OSError:
        pass  # not Linux: the processor stays unknown
    return {
        "processor": model,
        "processors": len(os.sched_getaffinity(0)),
        "python": platform.python_version(),
        "system": platform.platform(),
    }


def version() -> str | None:
    """Return day and commit of this source tree, as tables of figures in the documents name them; ``None`` without git."""
    git = ["git", "log", "-1", "--format=%cs (%h)", "--abbrev=8"]
    try:
        ran = subprocess.run(
            git, cwd=Path(__file__).parent, capture_output=True, text=True, check=True, timeout=GIT_TIMEOUT_S
        )
    except (OSError, subprocess.SubprocessError):
        return None
    return ran.stdout.strip()


def main(
    arguments: Sequence[str], package: str = "bench", out: Path = Path("bench/out"), docs: Path = Path("docs")
) -> int:
    """Run the command line: ``--list``, names or none for all, or one name with its own options.

    ``--write-docs`` writes the tables of the documents from the latest numbers, after measuring named ones. Returns 0
    if all limits are kept, 1 for a missed one, 2 for a wrong name.
    """
    benchmarks = find(package)
    named = benchmarks.get(arguments[0]) if len(arguments) > 1 and arguments[1].startswith("-") else None
    if named is not None and named.main is not None:
        return named.main(arguments[1:])
    if "--list" in arguments:
        for benchmark in benchmarks.values():
            sys.stdout.write(f"{benchmark.name:<16} {benchmark.summary}\n")
        return 0
    names = [name for name in arguments if name != WRITE_DOCS]
    all_kept, writing = True, len(names) < len(arguments)
    if names or not writing:
        try:
            chosen = choose(benchmarks, names)
        except UnknownBenchmark as unknown:
            sys.stderr.write(f"{unknown}\n")
            return 2
        all_kept = run(chosen, out, sys.stdout.write)
    if writing:
        # Missed limits are marked in the tables, too.
        write_figures(out / LATEST, docs / "performance.md")
        write_health(out, docs)
    return 0 if all_kept else 1
