"""Owns the life of a child process: started with a pipe, spoken to, listened to, ended, and killed where it does not
end."""

from __future__ import annotations

import multiprocessing
import os
import pickle
import threading
from collections.abc import Callable
from importlib import import_module
from multiprocessing.connection import Connection
from typing import Any

from appliance.base import importing, use_one_blas_thread

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
