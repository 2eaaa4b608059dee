"""Owns child processes: their life, and whether they get on.

ChildProcess            one process: started with a pipe, spoken to, listened to, ended, killed where it does not end
Liveness                one rule: while a process owes an answer, it shows progress within a limit
own_memory_mb, cpu_s    what a process takes of the machine, as Linux tells it
"""

from __future__ import annotations

import multiprocessing
import os
import pickle
import threading
from collections.abc import Callable
from importlib import import_module
from multiprocessing.connection import Connection
from pathlib import Path
from typing import TYPE_CHECKING, Any

from appliance.base import importing, use_one_blas_thread

if TYPE_CHECKING:  # drivers.api brings NumPy, which must not be here before its number of threads is set
    from drivers.api import Clock

KILL_TIMEOUT_S = 2.0
"""Longest wait for a process that was killed, or that has closed its pipe."""


class ChildGone(Exception):
    """The process ended by itself; its text says with which code."""


def _begin(module: str, function: str, pipe: Connection, packed: bytes) -> None:
    """Run a function of a module that this process has not imported yet; ``packed`` are its arguments after the pipe."""
    use_one_blas_thread(os.environ)
    with importing():
        main = getattr(import_module(module), function)
        # Opened here and not by the spawning: to open them imports the modules of their classes, and with them NumPy,
        # which asks once and for all how many threads it may have.
        arguments = pickle.loads(packed)
    main(pipe, *arguments)


class ChildProcess:
    """One process at a time that runs ``main(pipe, *arguments)``, a function of a module, in a fresh interpreter until
    its pipe closes.

    One thread starts, listens and stops; ``send`` may be called by any.
    """

    def __init__(self, name: str, main: Callable[..., None]) -> None:
        self._name, self._main = name, main
        # A fresh interpreter: a fork would take along GL, device handles and locks of threads that are not there.
        self._context = multiprocessing.get_context("spawn")
        self._process: multiprocessing.process.BaseProcess | None = None
        self._pipe: Connection | None = None
        self._sending = threading.Lock()

    @property
    def runs(self) -> bool:
        """There is a process, as far as was noticed."""
        return self._process is not None

    @property
    def pid(self) -> int | None:
        """The process's number; ``None`` while there is none."""
        return self._process.pid if self._process is not None else None

    def start(self, *arguments: Any) -> None:
        """Start the process, with these arguments after its end of the pipe.

        Raises OSError where there is no room for one.
        """
        packed = pickle.dumps(arguments)
        ours, theirs = self._context.Pipe()
        main = (self._main.__module__, self._main.__name__)
        process = self._context.Process(target=_begin, name=self._name, args=(*main, theirs, packed), daemon=True)
        try:
            process.start()
        except BaseException:
            ours.close()
            raise
        finally:
            # The child has its own copy: with this one open, the pipe would not end when the child does.
            theirs.close()
        self._pipe, self._process = ours, process

    def send(self, message: object) -> None:
        """Say ``message``; lost where nobody listens any more, which ``receive`` will notice."""
        pipe = self._pipe
        if pipe is None:
            return
        try:
            # Two camera threads and the heartbeat speak: a message of one must not come into the middle of another's.
            with self._sending:
                pipe.send(message)
        except OSError:
            return

    def receive(self) -> object | None:
        """Return the next thing it said, ``None`` where it said nothing; never waits for words. Raises ChildGone."""
        pipe, process = self._pipe, self._process
        if pipe is None or process is None:
            return None
        try:
            if pipe.poll(0.0):
                return pipe.recv()  # type: ignore[no-any-return]  # whatever was pickled
        except (EOFError, OSError):
            process.join(KILL_TIMEOUT_S)  # it closed its end: it is ending
            raise ChildGone(f"the process ended with code {process.exitcode}") from None
        return None

    def stop(self, patience_s: float = 0.0) -> None:
        """Close the pipe, which ends a process that listens, and kill one that is still there after ``patience_s``."""
        pipe, process = self._pipe, self._process
        # Forgotten first: a camera thread that sends meanwhile finds no process, not one that is being killed.
        self._pipe = self._process = None
        if pipe is not None:
            pipe.close()
        if process is not None:
            process.join(patience_s)
            if process.is_alive():
                process.kill()
                process.join(KILL_TIMEOUT_S)


def own_memory_mb(pid: int) -> float | None:
    """Return the resident memory of a process without what it shares with others, MB; ``None`` when it is not there any
    more."""
    status = _read(pid, "status")
    kb = {line.split(":")[0]: line.split()[1] for line in status.splitlines() if line.startswith("Rss")}
    # proc(5): VmRSS = RssAnon + RssFile + RssShmem; the last one is the frame store and the points.
    return (int(kb.get("RssAnon", "0")) + int(kb.get("RssFile", "0"))) / 1000.0 if kb else None


def cpu_s(pid: int) -> float | None:
    """Return the processor time of a process so far, all its threads; ``None`` when it is not there any more."""
    fields = _read(pid, "stat").rpartition(")")[2].split()  # the name before may hold spaces
    if len(fields) < 13:
        return None
    return (int(fields[11]) + int(fields[12])) / float(os.sysconf("SC_CLK_TCK"))  # proc(5): utime, stime


def _read(pid: int, name: str) -> str:
    try:
        return Path(f"/proc/{pid}/{name}").read_text(encoding="ascii", errors="replace")
    except OSError:
        return ""


LOOK_S = 2.0
"""Least time between two looks at the processor time."""
SHARE = 0.05
"""Share of the time between two looks that a process uses a processor if it gets on; one that hangs uses none."""


class Liveness:
    """Judge of one process.

    Progress is a message, or processor time; the latter alone counts for so long only, since a computation may go on
    for ever. Called by one thread.
    """

    def __init__(self, clock: Clock, used_s: Callable[[], float]) -> None:
        """``used_s`` returns the processor time of the process so far."""
        self._clock, self._used_s = clock, used_s
        self._limits_s: tuple[float, float] | None = None
        """Longest time without progress, and without a message; ``None``: nothing is owed."""
        self._since_ns = self._progress_ns = self._looked_ns = clock.now_ns()
        self._cpu_s = 0.0
        self._computed = False

    def owe(self, limit_s: float, silence_s: float) -> None:
        """Expect progress every ``limit_s`` from now on, and a message within ``silence_s``."""
        self._limits_s = limit_s, silence_s
        self._since_ns = self._progress_ns = self._looked_ns = self._clock.now_ns()
        self._cpu_s, self._computed = self._used_s(), False

    def rest(self) -> None:
        """Expect nothing from now on."""
        self._limits_s, self._since_ns = None, self._clock.now_ns()

    @property
    def rested_s(self) -> float:
        """Time since which nothing is owed; 0 while something is."""
        return (self._clock.now_ns() - self._since_ns) / 1e9 if self._limits_s is None else 0.0

    def late(self, grace_s: float = 0.0) -> str | None:
        """Return in words why the process does not get on, for longer than it may by ``grace_s``; ``None``: it does, or
        owes nothing."""
        if self._limits_s is None:
            return None
        self._look()
        now_ns, (limit_s, silence_s) = self._clock.now_ns(), self._limits_s
        if (now_ns - self._progress_ns) / 1e9 > limit_s + grace_s:
            return f"it gave no sign of life for {limit_s:g} s"
        if (now_ns - self._since_ns) / 1e9 > silence_s + grace_s:
            return f"it computed for {silence_s:g} s and said nothing"
        return None

    def computed(self) -> bool:
        """Return whether the process was seen to use a processor since this was asked last."""
        self._look()
        computed, self._computed = self._computed, False
        return computed

    def _look(self) -> None:
        now_ns = self._clock.now_ns()
        passed_s = (now_ns - self._looked_ns) / 1e9
        if passed_s < LOOK_S:
            return
        before_s, self._cpu_s = self._cpu_s, self._used_s()
        self._looked_ns = now_ns
        if self._cpu_s - before_s >= SHARE * passed_s:
            self._progress_ns, self._computed = now_ns, True
