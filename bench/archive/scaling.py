"""Owns what working an archive through costs beside the work itself: overhead of the engines, two cores against one, memory.

The same full-size scans three ways: in a plain loop of one process, which is the work itself; by `kingfisher reprocess` with processes of its
own; and with a scheduler and workers of Dask. Everything that takes part is confined to one core, or to two, the scheduler too. Starting up
is left out and told apart: rates count from the tenth published result, when every worker has loaded its program, to the last.
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

from bench.result import Measured

MOST_OVERHEAD_PERCENT, LEAST_SCALING, MOST_WORKER_MB = 2.0, 1.8, 1500.0
LONGEST_S = 900.0
SETTLED = 10
"""Results after which every worker is at work."""
_POLL_S = 0.02
_HZ = os.sysconf("SC_CLK_TCK")


@dataclass(frozen=True, slots=True)
class _Run:
    """One way through all scans."""

    count: int
    wall_s: float
    """Between the ``SETTLED``-th published result and the last."""
    cpu_s: float
    """Of all processes that took part, between the same."""
    start_s: float
    """Until the first result, less what that scan took."""
    peak_mb: float

    @property
    def cpu_per_scan_s(self) -> float:
        return self.cpu_s / (self.count - SETTLED)

    @property
    def per_s(self) -> float:
        return (self.count - SETTLED) / self.wall_s


def measure(source: Path, scratch: Path, say: Callable[[str], None]) -> Iterator[Measured]:
    """Work ``source`` through five times below ``scratch``. Needs two cores that nothing else uses."""
    cores = sorted(os.sched_getaffinity(0))[:2]
    if len(cores) < 2:
        yield Measured("throughput of two cores over one", float("nan"), "", why="this machine has one core")
        return
    for frames in source.glob("scans/*/frames_*.npy"):
        frames.read_bytes()  # from memory for all, or the first one pays for the disk
    runs: dict[str, _Run] = {}
    for name, wanted, way in (
        ("plain loop", 1, _loop), ("processes", 1, _processes), ("processes", 2, _processes), ("Dask", 1, _dask), ("Dask", 2, _dask),
    ):  # fmt: skip
        say(f"{name}, {wanted} core{'s' * (wanted > 1)}")
        out = scratch / f"{name.replace(' ', '-')}-{wanted}"
        with ExitStack() as stack:
            here = os.sched_getaffinity(0)
            stack.callback(os.sched_setaffinity, 0, here)
            os.sched_setaffinity(0, set(cores[:wanted]))  # inherited by everything that is started
            runs[f"{name} {wanted}"] = way(source, out, wanted, stack)
        shutil.rmtree(out)
    plain = runs["plain loop 1"]
    yield Measured("scans", plain.count, "")
    yield Measured("plain loop: processor time a scan", plain.cpu_per_scan_s, "s")
    yield Measured("plain loop: time a scan", 1.0 / plain.per_s, "s")
    for name in ("processes", "Dask"):
        one, two = runs[f"{name} 1"], runs[f"{name} 2"]
        yield Measured(f"{name}: starting up, one worker", one.start_s, "s")
        yield Measured(
            f"{name}: processor time beside the work",
            100.0 * (one.cpu_per_scan_s / plain.cpu_per_scan_s - 1.0),
            "%",
            at_most=MOST_OVERHEAD_PERCENT,
        )
        yield Measured(f"{name}: time beside the work, one core", 100.0 * (plain.per_s / one.per_s - 1.0), "%")
        yield Measured(f"{name}: throughput of two cores over one", two.per_s / one.per_s, "", at_least=LEAST_SCALING)
        yield Measured(
            f"{name}: memory of a worker at most", max(one.peak_mb, two.peak_mb), "MB", at_most=MOST_WORKER_MB
        )


def _loop(source: Path, out: Path, _: int, __: ExitStack) -> _Run:
    """Time the work itself: ``attempt`` for one scan after the other, nothing else."""
    code = (
        "import sys\nfrom pathlib import Path\nfrom appliance import kernel_cache\nkernel_cache.use()\n"
        "from appliance.offline.anew.task import Job, attempt, program_digits\n"
        "for folder in sorted(Path(sys.argv[1], 'scans').iterdir()):\n"
        "    row = attempt(Job(str(folder), sys.argv[2], None, False, None, True, program_digits()))\n"
        "    assert row['state'] == 'done', row\n"
    )
    for name in ("results", "failed", "drafts"):
        (out / "loop" / name).mkdir(parents=True)
    return _timed([sys.executable, "-c", code, str(source), str(out / "loop")], source, out, [])


def _processes(source: Path, out: Path, workers: int, _: ExitStack) -> _Run:
    return _timed([*_command(source, out), "--workers", str(workers)], source, out, [])


def _dask(source: Path, out: Path, workers: int, stack: ExitStack) -> _Run:
    with socket.socket() as one:
        one.bind(("127.0.0.1", 0))
        port = one.getsockname()[1]
    address = f"tcp://127.0.0.1:{port}"
    out.mkdir(parents=True)
    started = [
        stack.enter_context(_running(out, "distributed.cli.dask_scheduler", "--host", "127.0.0.1", "--port", str(port), "--no-dashboard"))
    ]  # fmt: skip
    for _ in range(workers):
        started.append(
            stack.enter_context(
                _running(out, "distributed.cli.dask_worker", address, "--nthreads", "1", "--no-nanny", "--no-dashboard",
                         "--memory-limit", "3GB", "--death-timeout", "60", "--local-directory", str(out / "dask"))
            )
        )  # fmt: skip
    return _timed([*_command(source, out), "--scheduler", address], source, out, [one.pid for one in started])


def _command(source: Path, out: Path) -> list[str]:
    return [sys.executable, "-m", "appliance.cli", "reprocess", str(source), "--out", str(out)]


@contextmanager
def _running(out: Path, module: str, *words: str) -> Iterator[subprocess.Popen[bytes]]:
    with (out / "dask.log").open("ab") as log:
        process = subprocess.Popen([sys.executable, "-m", module, *words], stdout=log, stderr=log)
    try:
        yield process
    finally:
        process.terminate()
        try:
            process.wait(timeout=20)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait(timeout=20)


def _timed(command: Sequence[str], source: Path, out: Path, others: Sequence[int]) -> _Run:
    """Run ``command`` to its end and time what it publishes. ``others``: processes that take part, too."""
    count = sum(1 for _ in (source / "scans").iterdir())
    out.mkdir(parents=True, exist_ok=True)
    begun_s = time.monotonic()
    first_s: float | None = None
    settled: tuple[float, float] | None = None
    last = (0.0, 0.0)
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
            seen, last = now, (time.monotonic(), _cpu_s([program.pid, *others]))
            first_s = first_s or last[0]
            if settled is None and seen >= SETTLED:
                settled = last
        time.sleep(_POLL_S)
    rows = [json.loads(path.read_bytes()) for path in out.glob("*/results/*/row.json")]
    if program.returncode or len(rows) != count or first_s is None or settled is None:
        raise RuntimeError(
            f"{' '.join(command)}: code {program.returncode}, {len(rows)} of {count}; see {out / 'said.log'}"
        )
    mean_s = sum(row["wall_s"] for row in rows) / count
    return _Run(
        count,
        last[0] - settled[0],
        last[1] - settled[1],
        first_s - begun_s - mean_s,
        max(row["peak_mb"] for row in rows),
    )


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
