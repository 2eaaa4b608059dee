"""Owns the worst day of a reprocessing: two workers killed, one stopped, a full disk and a scheduler started again, over one archive.

A scheduler and four workers in processes of their own, on this computer. Whatever started the workers starts them again when they end, as
systemd does with ``Restart=always``.
"""

from __future__ import annotations

import csv
import json
import os
import shutil
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path

from bench.result import Measured

WORKERS = 4
LIMIT_S = 45
"""Time for one scan before it is begun again elsewhere."""
DISK_MB = 24
LONGEST_S = 3000.0
CALLS = 5
_TICK_S = 0.2


@dataclass(slots=True)
class _Cluster:
    """A scheduler and workers that are started again when they end."""

    port: int
    log: Path
    scheduler: subprocess.Popen[bytes] | None = None
    workers: list[subprocess.Popen[bytes]] = field(default_factory=list)
    ending: threading.Event = field(default_factory=threading.Event)
    again: int = 0

    def start(self) -> None:
        """Start everything, and a thread that looks after the workers."""
        self.start_scheduler()
        self.workers = [self._worker(k) for k in range(WORKERS)]
        threading.Thread(target=self._look_after, daemon=True).start()

    def start_scheduler(self) -> None:
        """Start the scheduler at its port."""
        self.scheduler = self._run(
            "scheduler",
            "distributed.cli.dask_scheduler",
            "--host",
            "127.0.0.1",
            "--port",
            str(self.port),
            "--no-dashboard",
        )

    def end(self) -> None:
        """End all of it."""
        self.ending.set()
        for process in (*self.workers, self.scheduler):
            if process is not None:
                with suppress(ProcessLookupError):
                    os.killpg(process.pid, signal.SIGKILL)
                process.wait(timeout=30)

    def _worker(self, number: int) -> subprocess.Popen[bytes]:
        return self._run(
            f"worker-{number}", "distributed.cli.dask_worker", f"tcp://127.0.0.1:{self.port}", "--nthreads", "1", "--no-dashboard",
            "--no-nanny", "--memory-limit", "3GB", "--death-timeout", "60", "--local-directory", str(self.log.parent / "dask"),
        )  # fmt: skip

    def _look_after(self) -> None:
        while not self.ending.wait(1.0):
            for number, process in enumerate(self.workers):
                if process.poll() is not None and not self.ending.is_set():
                    self.again += 1
                    self.workers[number] = self._worker(number)

    def _run(self, name: str, module: str, *words: str) -> subprocess.Popen[bytes]:
        with (self.log.parent / f"{name}.log").open("ab") as log:
            return subprocess.Popen(
                [sys.executable, "-m", module, *words], stdout=log, stderr=log, start_new_session=True
            )


@dataclass(slots=True)
class _Blow:
    """One thing that happens when so many results are there."""

    at: int
    what: str
    do: Callable[[], None]


def measure(source: Path, scratch: Path, say: Callable[[str], None]) -> Iterator[Measured]:
    """Work ``source`` through below ``scratch`` while everything fails; the folder of results is a disk of ``DISK_MB`` (as root)."""
    out = scratch / "out"
    out.mkdir(parents=True)
    subprocess.run(["mount", "-t", "tmpfs", "-o", f"size={DISK_MB}m", "tmpfs", str(out)], check=True, timeout=30)
    cluster = _Cluster(_free_port(), scratch / "log")
    try:
        cluster.start()
        yield from _worst_day(source, out, cluster, say)
    finally:
        cluster.end()
        subprocess.run(["umount", "-l", str(out)], check=False, timeout=30)
        shutil.rmtree(scratch / "dask", ignore_errors=True)


def _worst_day(source: Path, out: Path, cluster: _Cluster, say: Callable[[str], None]) -> Iterator[Measured]:
    count = sum(1 for _ in (source / "scans").iterdir())
    filler = out / "filler"
    stopped: list[int] = []

    def stop() -> None:
        stopped.append(cluster.workers[2].pid)
        os.kill(stopped[0], signal.SIGSTOP)

    def restart() -> None:
        assert cluster.scheduler is not None
        os.killpg(cluster.scheduler.pid, signal.SIGKILL)
        cluster.scheduler.wait(timeout=30)
        time.sleep(3.0)
        cluster.start_scheduler()

    blows = [
        _Blow(count // 10, "a worker is killed", lambda: os.kill(cluster.workers[0].pid, signal.SIGKILL)),
        _Blow(count // 5, "another worker is killed", lambda: os.kill(cluster.workers[1].pid, signal.SIGKILL)),
        _Blow(3 * count // 10, "a worker is stopped for good", stop),
        _Blow(count // 2, "the disk is full", lambda: _fill(filler)),
        _Blow(7 * count // 10, "the scheduler is killed and started again", restart),
        _Blow(17 * count // 20, "the stopped worker goes on", lambda: os.kill(stopped[0], signal.SIGCONT)),
    ]
    begun_s, seen, calls, refused = time.monotonic(), 0, 0, 0
    program: subprocess.Popen[bytes] | None = None
    while time.monotonic() - begun_s < LONGEST_S and calls <= CALLS:
        if program is None or program.poll() is not None:
            if program is not None and program.returncode == 0:
                break
            refused += program is not None
            filler.unlink(missing_ok=True)  # somebody was told that the disk is full, and made room
            calls += 1
            program = _call(source, out, cluster)
        seen = sum(1 for _ in out.glob("*/results/*"))
        if blows and seen >= blows[0].at:
            blow = blows.pop(0)
            say(f"{seen} of {count}: {blow.what}")
            blow.do()
        time.sleep(_TICK_S)
    with suppress(OSError):
        (program.kill if program is not None and program.poll() is None else int)()
    rows = [
        row for path in out.glob("*/table.csv") for row in csv.DictReader(path.read_text(encoding="utf-8").splitlines())
    ]
    names = [row["scan"] for row in rows if row["state"] == "done"]
    yield Measured("scans", count, "")
    yield Measured("blows that fell", 6 - len(blows), "of 6", at_least=6.0)
    yield Measured("calls of `kingfisher reprocess`", calls, "", at_most=float(CALLS))
    yield Measured("workers that were started again", cluster.again, "")
    yield Measured("results published", seen, "", at_least=float(count), at_most=float(count))
    yield Measured("scans in the table, each once", len(set(names)), "", at_least=float(count))
    yield Measured("scans twice in the table", len(rows) - len({row["scan"] for row in rows}), "", at_most=0.0)
    yield Measured("half results", sum(not _whole(path) for path in out.glob("*/results/*")), "", at_most=0.0)
    yield Measured("drafts left behind", sum(1 for _ in out.glob("*/drafts/*")), "", at_most=0.0)
    yield Measured("wall time", time.monotonic() - begun_s, "s")


def _call(source: Path, out: Path, cluster: _Cluster) -> subprocess.Popen[bytes]:
    words = (
        "reprocess",
        source,
        "--out",
        out,
        "--table-only",
        "--limit-s",
        LIMIT_S,
        "--scheduler",
        f"tcp://127.0.0.1:{cluster.port}",
    )
    with (cluster.log.parent / "reprocess.log").open("ab") as log:
        return subprocess.Popen([sys.executable, "-m", "appliance.cli", *map(str, words)], stdout=log, stderr=log)


def _fill(path: Path) -> None:
    # Unbuffered: what a buffer still held would be refused once more when the file is closed.
    with path.open("wb", buffering=0) as file, suppress(OSError):
        while file.write(bytes(4096)):
            pass


def _whole(folder: Path) -> bool:
    try:
        return bool(json.loads((folder / "row.json").read_bytes())["state"] == "done")
    except (OSError, ValueError, KeyError):
        return False


def _free_port() -> int:
    with socket.socket() as one:
        one.bind(("127.0.0.1", 0))
        return int(one.getsockname()[1])
