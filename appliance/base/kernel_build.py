"""Compiling kernels ahead of their first use: in pieces, on all cores, each piece once.

A piece is a function that runs some kernels on tiny inputs; numba compiles those that its cache lacks. Each piece runs
in one of several processes, which share the cache's folder, so that a computer with two cores needs half the time. A
mark in the folder remembers each compiled piece. It holds until a kernel's file is written again. Packages with kernels
state their pieces; ``appliance.measure.warm`` has those of the product.
"""

from __future__ import annotations

import fcntl
import gc
import importlib
import multiprocessing
import os
import shutil
import tempfile
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from multiprocessing.connection import Connection, wait
from multiprocessing.process import BaseProcess
from pathlib import Path
from typing import Any

from appliance.base.kernel_cache import COMPLETE, MARKS, Processor, fingerprint, point_at, stamps

LOCK = ".compiling"
MOST_PROCESSES = 8
"""Each takes up to 0.6 GB of memory."""
TICK_S = 1.0
"""Longest time in seconds between two reports of the progress."""
PIECE_S = 900.0
"""Longest time for one piece; the slowest one takes half a minute on a processor of its own."""
LOCK_S = 1800.0
END_S = 10.0
"""Longest time for a process to end that has no work left, or was killed."""


@dataclass(frozen=True, slots=True)
class Piece:
    """Some kernels that are compiled together."""

    what: str
    """Name of these kernels in plain English, for people who wait."""
    function: str
    """``package.module:function``; called without arguments, its result is ignored."""


@dataclass(frozen=True, slots=True)
class Compiling:
    """Progress of compiling: ``done`` pieces of ``total``."""

    done: int
    total: int
    what: tuple[str, ...]
    """Names of the pieces being compiled now; empty while another process compiles."""
    seconds: float
    """Time in seconds since the beginning."""


class CompileError(Exception):
    """Some kernels could not be compiled; the text names them, each with its reason."""


Report = Callable[[Compiling], None]


def missing_kernels(folder: Path, pieces: Sequence[Piece]) -> list[Piece]:
    """Return those of the pieces that are still to be compiled into ``folder``."""
    now = stamps()
    return [piece for piece in pieces if _read(_mark(folder, piece)) != now]


def compile_pieces(
    folder: Path,
    pieces: Sequence[Piece],
    report: Report = lambda _: None,
    processor: Processor | None = None,
    processes: int | None = None,
) -> None:
    """Compile those of ``pieces`` that ``folder`` lacks, in their order.

    ``processor``: default is that of this computer. Waits while another process compiles into the same folder, and then
    does the remaining pieces. ``report`` is called at the beginning, at each change, and at least every ``TICK_S``.
    ``processes`` defaults to the cores that this process may use. Raises CompileError after all other pieces were
    compiled, OSError when the folder cannot be written.
    """
    if not missing_kernels(folder, pieces):
        return
    begun_s = time.monotonic()
    folder.mkdir(parents=True, exist_ok=True)
    # Checked again: after waiting for the lock, the other process has done the work.
    with _alone(folder / LOCK, lambda: report(Compiling(0, 0, (), time.monotonic() - begun_s))):
        missing = missing_kernels(folder, pieces)
        if missing:
            _Team(folder, missing, report, processor, begun_s).work(processes or len(os.sched_getaffinity(0)))


def build_kernels(
    target: Path, pieces: Sequence[Piece], report: Report = lambda _: None, processor: Processor | None = None
) -> Path:
    """Compile ``pieces`` into a new folder of ``target``, atomically; return that folder.

    Raises OSError when ``target`` cannot be written, CompileError.
    """
    folder = target / fingerprint(processor)
    if (folder / COMPLETE).exists():
        return folder
    target.mkdir(parents=True, exist_ok=True)
    temporary = Path(tempfile.mkdtemp(prefix=".making-", dir=target))
    try:
        compile_pieces(temporary, pieces, report, processor)
        (temporary / COMPLETE).touch()
        temporary.chmod(0o755)
        # Filled elsewhere and renamed, so that no process reads a half-filled folder. Of two equal ones one remains.
        with suppress(FileExistsError):
            shutil.rmtree(folder, ignore_errors=True)
            temporary.rename(folder)
    finally:
        shutil.rmtree(temporary, ignore_errors=True)
    return folder


class _Team:
    """Processes that compile one piece after the other; one thread directs them."""

    def __init__(
        self, folder: Path, pieces: Sequence[Piece], report: Report, processor: Processor | None, begun_s: float
    ) -> None:
        self._folder, self._report, self._begun_s = folder, report, begun_s
        self._processor = processor
        # Not fork: it copies locks that other threads hold, and none of the threads that would release them.
        self._context = multiprocessing.get_context("spawn")
        # Reversed, since pieces are popped from the end: the ones needed first are compiled first.
        self._left = list(reversed(pieces))
        self._total = len(pieces)
        self._done = 0
        self._working: dict[Connection, tuple[BaseProcess, Piece, float]] = {}
        self._failed: list[str] = []

    def work(self, processes: int) -> None:
        """Compile all pieces in at most ``processes`` processes. Raises CompileError."""
        (self._folder / MARKS).mkdir(exist_ok=True)
        try:
            for _ in range(min(processes, MOST_PROCESSES, self._total)):
                self._start()
            self._report_progress()
            while self._working:
                for pipe in wait(list(self._working), TICK_S):
                    assert isinstance(pipe, Connection)
                    self._receive(pipe)
                self._end_overdue()
                self._report_progress()
        finally:
            for pipe in list(self._working):
                self._dismiss(pipe)
        if self._failed:
            raise CompileError("; ".join(self._failed))

    def _start(self) -> None:
        """Start another process if a piece is left."""
        if self._left:
            mine, theirs = self._context.Pipe()
            process = self._context.Process(target=_serve, args=(theirs, self._folder, self._processor), daemon=True)
            process.start()
            # This side's copy of the child's end: left open, it would hide the death of the process.
            theirs.close()
            self._give(mine, process)

    def _give(self, pipe: Connection, process: BaseProcess) -> None:
        if not self._left:
            pipe.close()
            process.join(END_S)
            return
        piece = self._left.pop()
        self._working[pipe] = (process, piece, time.monotonic() + PIECE_S)
        pipe.send(piece.function)

    def _receive(self, pipe: Connection) -> None:
        process, piece, _ = self._working[pipe]
        try:
            error = pipe.recv()
        except (EOFError, OSError):
            self._dismiss(pipe)
            self._failed.append(f"{piece.what}: the compiling process ended with code {process.exitcode}")
            self._start()
            return
        del self._working[pipe]
        if error is None:
            self._done += 1
            # Each piece is marked when it is done, so that an interrupted build goes on where it was.
            _mark(self._folder, piece).write_text(stamps(), encoding="ascii")
        else:
            self._failed.append(f"{piece.what}: {error}")
        self._give(pipe, process)

    def _end_overdue(self) -> None:
        for pipe, (_, piece, until_s) in list(self._working.items()):
            if time.monotonic() > until_s:
                self._failed.append(f"{piece.what}: not done after {PIECE_S:.0f} s")
                self._dismiss(pipe)
                self._start()

    def _dismiss(self, pipe: Connection) -> None:
        process, _, _ = self._working.pop(pipe)
        process.kill()
        process.join(END_S)
        pipe.close()

    def _report_progress(self) -> None:
        if self._working:
            what = tuple(piece.what for _, piece, _ in self._working.values())
            self._report(Compiling(self._done, self._total, what, time.monotonic() - self._begun_s))


def _serve(pipe: Connection, folder: Path, processor: Processor | None) -> None:
    """Serve as a compiling process until the pipe closes.

    In: the name of a piece's function. Out: ``None``, or the text of an error.
    """
    point_at(folder, processor)
    # A compiler makes millions of objects, most of which stay. Collecting garbage while it works costs a tenth of its
    # time, so it is collected between pieces, and surviving objects are frozen.
    gc.disable()
    try:
        while True:
            module, _, function = pipe.recv().partition(":")
            try:
                run: Callable[[], Any] = getattr(importlib.import_module(module), function)
                run()
            except Exception as error:  # the parent reports it with the name of the piece
                pipe.send(f"{type(error).__name__}: {error}")
            else:
                pipe.send(None)
            gc.collect()
            gc.freeze()
    except (EOFError, OSError, KeyboardInterrupt):
        pass  # the parent has closed the pipe: the work is done


@contextmanager
def _alone(lock: Path, waiting: Callable[[], None]) -> Iterator[None]:
    """Hold the folder's lock inside; ``waiting`` is called while another process has it.

    Raises CompileError.
    """
    never = threading.Event()
    with lock.open("a") as file:
        for _ in range(round(LOCK_S / TICK_S)):
            try:
                fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
                break
            except BlockingIOError:
                waiting()
                never.wait(TICK_S)
        else:
            raise CompileError(f"another process has been compiling into {lock.parent} for {LOCK_S / 60:.0f} minutes")
        yield


def _mark(folder: Path, piece: Piece) -> Path:
    return folder / MARKS / piece.function.replace(":", ".")


def _read(mark: Path) -> str | None:
    try:
        return mark.read_text(encoding="ascii")
    except (OSError, UnicodeDecodeError):
        return None
