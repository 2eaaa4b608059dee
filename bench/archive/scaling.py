"""Owns what working an archive through costs beside the work itself: overhead of the engines, two cores against one, memory.

The same full-size scans by `kingfisher reprocess` with processes of its own, and with a scheduler and workers of Dask, in turns. Everything
that takes part is confined to one core, or to two, the scheduler too. Starting up is left out and told apart: rates count from the tenth
published result, when every worker has loaded its program, to the last. No clouds are written: the disk is not what is measured.
"""

from __future__ import annotations

import json
import os
import shutil
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from statistics import median

from bench.result import Measured

MOST_OVERHEAD_PERCENT, LEAST_SCALING, MOST_WORKER_MB = 2.0, 1.8, 1500.0
LONGEST_S = 900.0
ROUNDS = 3
SETTLED = 10
"""Results after which every worker is at work."""
_POLL_S = 0.02
QUIET = {
    "DASK_DISTRIBUTED__ADMIN__TICK__INTERVAL": "1s",
    "DASK_DISTRIBUTED__ADMIN__SYSTEM_MONITOR__INTERVAL": "10s",
    "DASK_DISTRIBUTED__WORKER__PROFILE__ENABLED": "False",
    "DASK_DISTRIBUTED__WORKER__MEMORY__MONITOR_INTERVAL": "2s",
    "DASK_DISTRIBUTED__SCHEDULER__ACTIVE_MEMORY_MANAGER__START": "False",
    "DASK_DISTRIBUTED__SCHEDULER__WORK_STEALING_INTERVAL": "1s",
}
"""What docs/archive.md has scheduler and workers started with."""
_HZ = os.sysconf("SC_CLK_TCK")


@dataclass(frozen=True, slots=True)
class _Run:
    """One way through all scans, from the ``SETTLED``-th published result to the last."""

    results: int
    wall_s: float
    cpu_s: float
    """Of all processes that took part."""
    beside_cpu_s: float
    """Of those among them that work no scan through: who gives the work out."""
    busy_s: float
    """Sum of what the scans took their workers, by the clock."""
    start_s: float
    """Until the first result, less what that scan took."""
    peak_mb: float

    @property
    def per_s(self) -> float:
        return self.results / self.wall_s

    def overhead_percent(self, workers: int) -> float:
        """Return the share of the workers' time that no scan had, and of the processor time that others took."""
        idle = 1.0 - self.busy_s / (workers * self.wall_s)
        return 100.0 * (idle + self.beside_cpu_s / self.cpu_s)


def measure(source: Path, scratch: Path, say: Callable[[str], None], rounds: int = ROUNDS) -> Iterator[Measured]:
    """Work ``source``, packed or not, through ``rounds`` times each way below ``scratch``. Needs two cores that nothing else uses."""
    cores = sorted(os.sched_getaffinity(0))[:2]
    if len(cores) < 2:
        yield Measured("throughput of two cores over one", float("nan"), "", why="this machine has one core")
        return
    for frames in source.glob("scans/*/frames_*"):
        frames.read_bytes()  # from memory for all, or the first one pays for the disk
    runs: dict[tuple[str, int], list[_Run]] = {}
    ways = {"processes": _processes, "Dask": _dask}
    for turn in range(rounds):
        for name, way in ways.items():
            for wanted in (1, 2):
                say(f"{turn + 1} of {rounds}: {name}, {wanted} core{'s' * (wanted > 1)}")
                out = scratch / f"{name}-{wanted}-{turn}"
                with ExitStack() as stack:
                    stack.callback(os.sched_setaffinity, 0, os.sched_getaffinity(0))
                    os.sched_setaffinity(0, set(cores[:wanted]))  # inherited by everything that is started
                    runs.setdefault((name, wanted), []).append(way(source, out, wanted, stack))
                shutil.rmtree(out)
    yield Measured("scans", sum(1 for _ in (source / "scans").iterdir()), "")
    one_s = median(run.cpu_s / run.results for run in runs["processes", 1])
    yield Measured("processor time a scan", one_s, "s")
    for name in ways:
        alone, both = runs[name, 1], runs[name, 2]
        yield Measured(f"{name}: starting up", median(run.start_s for run in (*alone, *both)), "s")
        for workers, some in ((1, alone), (2, both)):
            percent = median(run.overhead_percent(workers) for run in some)
            title = f"{name}: overhead on {workers} core{'s' * (workers > 1)}"
            yield Measured(title, percent, "%", at_most=MOST_OVERHEAD_PERCENT)
        scaling = [two.per_s / one.per_s for one, two in zip(alone, both, strict=True)]
        yield Measured(
            f"{name}: throughput of two cores over one", median(scaling), "", at_least=LEAST_SCALING,
            spread=(min(scaling), max(scaling)),
        )  # fmt: skip
        peak_mb = max(run.peak_mb for run in (*alone, *both))
        yield Measured(f"{name}: memory of a worker at most", peak_mb, "MB", at_most=MOST_WORKER_MB)


def _processes(source: Path, out: Path, workers: int, _: ExitStack) -> _Run:
    return _timed([*_command(source, out), "--workers", str(workers)], source, out, [], [])


def _dask(source: Path, out: Path, workers: int, stack: ExitStack) -> _Run:
    with socket.socket() as one:
        one.bind(("127.0.0.1", 0))
        port = one.getsockname()[1]
    address = f"tcp://127.0.0.1:{port}"
    out.mkdir(parents=True)
    started = [
        stack.enter_context(running(out, "distributed.cli.dask_scheduler", "--host", "127.0.0.1", "--port", str(port), "--no-dashboard"))
    ]  # fmt: skip
    for _ in range(workers):
        started.append(
            stack.enter_context(
                running(out, "distributed.cli.dask_worker", address, "--nthreads", "1", "--no-nanny", "--no-dashboard",
                         "--memory-limit", "3GB", "--death-timeout", "60", "--local-directory", str(out / "dask"))
            )
        )  # fmt: skip
    scheduler, *working = (one.pid for one in started)
    return _timed([*_command(source, out), "--scheduler", address], source, out, working, [scheduler])


def _command(source: Path, out: Path) -> list[str]:
    return [sys.executable, "-m", "appliance.cli", "reprocess", str(source), "--out", str(out), "--table-only"]


@contextmanager
def running(out: Path, module: str, *words: str) -> Iterator[subprocess.Popen[bytes]]:
    """Run a module of Dask's with the settings that watch little; its words go to a log in ``out``."""
    with (out / "dask.log").open("ab") as log:
        process = subprocess.Popen(
            [sys.executable, "-m", module, *words], stdout=log, stderr=log, env=os.environ | QUIET
        )
    try:
        yield process
    finally:
        process.terminate()
        try:
            process.wait(timeout=20)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait(timeout=20)


def _timed(command: Sequence[str], source: Path, out: Path, workers: Sequence[int], others: Sequence[int]) -> _Run:
    """Run ``command`` to its end and time what it publishes. ``workers``: processes that work scans through, where they are not its
    own children; ``others``: who takes part besides."""
    count = sum(1 for _ in (source / "scans").iterdir())
    out.mkdir(parents=True, exist_ok=True)
    begun_s = time.monotonic()
    first_s: float | None = None
    at: dict[int, _Moment] = {}
    seen = 0
    with (out / "said.log").open("ab") as log:
        program = subprocess.Popen(command, stdout=log, stderr=log)
    while program.poll() is None:
        if time.monotonic() - begun_s > LONGEST_S:
            program.kill()
            raise TimeoutError(
                f"{count - seen} of {count} scans are left after {LONGEST_S:.0f} s; see {out / 'said.log'}"
            )
        now = sum(1 for _ in out.glob("*/results/*"))
        if now > seen:
            seen = now
            total_s = _cpu_s([program.pid, *workers, *others])
            # The program's own processes are its workers, unless others are.
            beside_s = _cpu_s([program.pid, *others]) if workers else own_cpu_s(program.pid)
            at[seen] = _Moment(time.monotonic(), total_s, beside_s)
            first_s = first_s or at[seen].time_s
        time.sleep(_POLL_S)
    paths = sorted(out.glob("*/results/*/row.json"), key=lambda path: path.stat().st_mtime_ns)
    rows = [json.loads(path.read_bytes()) for path in paths]
    begins = min((number for number in at if number >= SETTLED), default=None)
    if program.returncode or len(rows) != count or first_s is None or begins is None:
        raise RuntimeError(
            f"{' '.join(command)}: code {program.returncode}, {len(rows)} of {count}; see {out / 'said.log'}"
        )
    begin, end = at[begins], at[max(at)]
    return _Run(
        results=max(at) - begins,
        wall_s=end.time_s - begin.time_s,
        cpu_s=end.cpu_s - begin.cpu_s,
        beside_cpu_s=end.beside_cpu_s - begin.beside_cpu_s,
        busy_s=sum(row["wall_s"] for row in rows[begins : max(at)]),
        start_s=first_s - begun_s - sum(row["wall_s"] for row in rows) / count,
        peak_mb=max(row["peak_mb"] for row in rows),
    )


@dataclass(frozen=True, slots=True)
class _Moment:
    """When a result was seen, and what processes had taken by then."""

    time_s: float
    cpu_s: float
    beside_cpu_s: float


def own_cpu_s(process: int) -> float:
    """Return the processor time of one process, without its children."""
    words = Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()
    return (int(words[11]) + int(words[12])) / _HZ


def _cpu_s(roots: Sequence[int]) -> float:
    """Return the processor time of ``roots`` and all their living descendants."""
    children: dict[int, list[int]] = {}
    ticks: dict[int, int] = {}
    for entry in Path("/proc").iterdir():
        if not entry.name.isdigit():
            continue
        try:
            words = (entry / "stat").read_text().rpartition(")")[2].split()
        except OSError:
            continue  # it ended meanwhile
        children.setdefault(int(words[1]), []).append(int(entry.name))
        ticks[int(entry.name)] = int(words[11]) + int(words[12])
    waiting, total = list(roots), 0
    while waiting:
        one = waiting.pop()
        total += ticks.get(one, 0)
        waiting += children.get(one, [])
    return total / _HZ
