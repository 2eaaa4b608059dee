"""Child processes: start, messages, end, and the check that they make progress.

ChildProcess            one process: started with a pipe, sends and receives, killed if it does not end
Liveness                one rule: while a process owes an answer, it shows progress within a limit
own_memory_mb, cpu_s    memory and processor time of a process, by Linux
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
    """The process ended by itself; the text gives its exit code."""


def _begin(module: str, function: str, pipe: Connection, packed: bytes) -> None:
    """Run a function of a module that this process has not imported yet.

    ``packed``: its arguments after the pipe, pickled.
    """
    use_one_blas_thread(os.environ)
    with importing():
        main = getattr(import_module(module), function)
        # Unpickled here and not by the spawning: that imports the modules of their classes, and NumPy reads the number
        # of threads only once, when it is imported.
        arguments = pickle.loads(packed)
    main(pipe, *arguments)


class ChildProcess:
    """One process at a time that runs ``main(pipe, *arguments)`` until its pipe closes.

    ``main``: a function of a module, run in a fresh interpreter. One thread starts, receives and stops; ``send`` may be
    called by any.
    """

    def __init__(self, name: str, main: Callable[..., None]) -> None:
        self._name, self._main = name, main
        # A fresh interpreter: a fork would inherit GL, device handles and locks of threads that it does not have.
        self._context = multiprocessing.get_context("spawn")
        self._process: multiprocessing.process.BaseProcess | None = None
        self._pipe: Connection | None = None
        self._sending = threading.Lock()

    @property
    def runs(self) -> bool:
        """True if there is a process, as far as is known."""
        return self._process is not None

    @property
    def pid(self) -> int | None:
        """The process id; ``None`` while there is none."""
        return self._process.pid if self._process is not None else None

    def start(self, *arguments: Any) -> None:
        """Start the process, with these arguments after its end of the pipe.

        Raises OSError if the system has no resources for it.
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
            # The child has its own copy; with this one open, the pipe would outlive the child.
            theirs.close()
        self._pipe, self._process = ours, process

    def send(self, message: object) -> None:
        """Send ``message``; it is lost if the process has ended, which ``receive`` will notice."""
        pipe = self._pipe
        if pipe is None:
            return
        try:
            # Two camera threads and the service's main thread send; their messages must not mix.
            with self._sending:
                pipe.send(message)
        except OSError:
            return

    def receive(self) -> object | None:
        """Return the next message, ``None`` if there is none; never waits. Raises ChildGone."""
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
        """Close the pipe, which ends a process that listens; kill it if it still runs after ``patience_s``."""
        pipe, process = self._pipe, self._process
        # Cleared first, so that a camera thread does not send to a process that is being killed.
        self._pipe = self._process = None
        if pipe is not None:
            pipe.close()
        if process is not None:
            process.join(patience_s)
            if process.is_alive():
                process.kill()
                process.join(KILL_TIMEOUT_S)


def own_memory_mb(pid: int) -> float | None:
    """Return the resident private memory of a process, MB; ``None`` if it has ended."""
    status = _read(pid, "status")
    kb = {line.split(":")[0]: line.split()[1] for line in status.splitlines() if line.startswith("Rss")}
    # proc(5): VmRSS = RssAnon + RssFile + RssShmem; the last one is shared: the frame store and the points.
    return (int(kb.get("RssAnon", "0")) + int(kb.get("RssFile", "0"))) / 1000.0 if kb else None


def cpu_s(pid: int) -> float | None:
    """Return the processor time of a process and its threads so far; ``None`` if it has ended."""
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
"""Least time between two readings of the processor time."""
SHARE = 0.05
"""Share of a processor from which a process counts as computing; one that hangs uses none."""


class Liveness:
    """Check that one process makes progress. Called by one thread.

    Progress is a message, or processor time. The latter alone counts for a limited time, since a computation may never
    end.
    """

    def __init__(self, clock: Clock, used_s: Callable[[], float]) -> None:
        """Begin without a duty; ``used_s`` returns the processor time of the process so far."""
        self._clock, self._used_s = clock, used_s
        self._limits_s: tuple[float, float] | None = None
        """Longest time without progress, and without a message; ``None``: no answer is due."""
        self._since_ns = self._progress_ns = self._looked_ns = clock.now_ns()
        self._cpu_s = 0.0
        self._computed = False

    def owe(self, limit_s: float, silence_s: float) -> None:
        """Expect progress every ``limit_s`` from now on, and a message within ``silence_s``."""
        self._limits_s = limit_s, silence_s
        self._since_ns = self._progress_ns = self._looked_ns = self._clock.now_ns()
        self._cpu_s, self._computed = self._used_s(), False

    def rest(self) -> None:
        """Expect no answer from now on."""
        self._limits_s, self._since_ns = None, self._clock.now_ns()

    @property
    def rested_s(self) -> float:
        """Time for which no answer has been due; 0 while one is."""
        return (self._clock.now_ns() - self._since_ns) / 1e9 if self._limits_s is None else 0.0

    def late(self, grace_s: float = 0.0) -> str | None:
        """Return the reason why the process counts as stuck, in words; ``None``: it does not.

        ``grace_s``: time added to the limits.
        """
        if self._limits_s is None:
            return None
        self._look()
        now_ns, (limit_s, silence_s) = self._clock.now_ns(), self._limits_s
        if (now_ns - self._progress_ns) / 1e9 > limit_s + grace_s:
            return f"it sent nothing for {limit_s:g} s"
        if (now_ns - self._since_ns) / 1e9 > silence_s + grace_s:
            return f"it computed for {silence_s:g} s without a message"
        return None

    def computed(self) -> bool:
        """Return True if the process has used a processor since the last call."""
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
