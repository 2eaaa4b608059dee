"""Owns how kernels are compiled before somebody waits for a picture: in pieces, on all cores, each piece once.

A piece is a function that runs some kernels on next to nothing; numba compiles what it has not in its cache. Each piece
runs in one of several processes, which share the cache's folder, so that a computer with two cores needs half the time.
A mark in the folder remembers the piece; it holds until a kernel's file is written anew. Pieces are stated by whoever
has kernels: ``appliance.measure.warm`` those of the product.
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
"""Time in seconds between two reports of the progress while nothing ends."""
PIECE_S = 900.0
"""The longest that one piece may take; the longest known takes half a minute of a processor of its own."""
LOCK_S = 1800.0
END_S = 10.0
"""A process that has nothing left to do, or was killed, ends in no time."""


@dataclass(frozen=True, slots=True)
class Piece:
    """Some kernels that are compiled together."""

    what: str
    """Plain English words for these kernels, for whoever waits."""
    function: str
    """``package.module:function``; called without arguments, its result is not looked at."""


@dataclass(frozen=True, slots=True)
class Compiling:
    """Progress of compiling: ``done`` pieces of ``of``."""

    done: int
    of: int
    what: tuple[str, ...]
    """Names of the pieces being compiled now; empty: somebody else is compiling, and is waited for."""
    seconds: float
    """Time in seconds since it began."""


class CompileError(Exception):
    """Some kernels could not be compiled; the text says which and why."""


Said = Callable[[Compiling], None]


def missing_kernels(folder: Path, pieces: Sequence[Piece]) -> list[Piece]:
    """Return those of the pieces that are still to be compiled into ``folder``."""
    now = stamps()
    return [piece for piece in pieces if _read(_mark(folder, piece)) != now]


def compile_pieces(
    folder: Path,
    pieces: Sequence[Piece],
    said: Said = lambda _: None,
    processor: Processor | None = None,
    processes: int | None = None,
) -> None:
    """Compile what ``folder`` has not of ``pieces``, the first ones first, for ``processor`` (default: this one).

    Waits where another process is compiling into the same folder, and then does what is left. ``said`` is called at the
    beginning, at each change, and at least every ``TICK_S``; ``processes`` defaults to the cores that this process may
    use. Raises CompileError after everything else was compiled, OSError when the folder cannot be written.
    """
    if not missing_kernels(folder, pieces):
        return
    begun_s = time.monotonic()
    folder.mkdir(parents=True, exist_ok=True)
    # Looked at twice: who waited for the lock finds that the other process has done the work.
    with _alone(folder / LOCK, lambda: said(Compiling(0, 0, (), time.monotonic() - begun_s))):
        left = missing_kernels(folder, pieces)
        if left:
            _Team(folder, left, said, processor, begun_s).work(processes or len(os.sched_getaffinity(0)))


def build_kernels(
    target: Path, pieces: Sequence[Piece], said: Said = lambda _: None, processor: Processor | None = None
) -> Path:
    """Compile ``pieces`` into a folder of ``target``, which is there whole or not at all; return that folder.

    Raises OSError when ``target`` cannot be written, CompileError.
    """
    folder = target / fingerprint(processor)
    if (folder / COMPLETE).exists():
        return folder
    target.mkdir(parents=True, exist_ok=True)
    making = Path(tempfile.mkdtemp(prefix=".making-", dir=target))
    try:
        compile_pieces(making, pieces, said, processor)
        (making / COMPLETE).touch()
        making.chmod(0o755)
        # Made elsewhere and renamed, so that nobody can read a half-filled folder; two at once are equal, and one wins.
        with suppress(FileExistsError):
            shutil.rmtree(folder, ignore_errors=True)
            making.rename(folder)
    finally:
        shutil.rmtree(making, ignore_errors=True)
    return folder


class _Team:
    """Processes that take one piece after the other. One thread asks them and hears them."""

    def __init__(
        self, folder: Path, pieces: Sequence[Piece], said: Said, processor: Processor | None, begun_s: float
    ) -> None:
        self._folder, self._said, self._begun_s = folder, said, begun_s
        self._processor = processor
        # Not fork: it copies locks that other threads hold, and none of the threads that would release them.
        self._context = multiprocessing.get_context("spawn")
        # Taken from the end, so that pieces are begun in the order in which they were given: the ones needed first,
        # first.
        self._left = list(reversed(pieces))
        self._of = len(pieces)
        self._done = 0
        self._working: dict[Connection, tuple[BaseProcess, Piece, float]] = {}
        self._failed: list[str] = []

    def work(self, processes: int) -> None:
        """Compile until nothing is left, in at most ``processes`` processes. Raises CompileError."""
        (self._folder / MARKS).mkdir(exist_ok=True)
        try:
            for _ in range(min(processes, MOST_PROCESSES, self._of)):
                self._start()
            self._say()
            while self._working:
                for pipe in wait(list(self._working), TICK_S):
                    assert isinstance(pipe, Connection)
                    self._hear(pipe)
                self._end_overdue()
                self._say()
        finally:
            for pipe in list(self._working):
                self._dismiss(pipe)
        if self._failed:
            raise CompileError("; ".join(self._failed))

    def _start(self) -> None:
        """Start another process, if there is something left for it to do."""
        if self._left:
            mine, theirs = self._context.Pipe()
            process = self._context.Process(target=_serve, args=(theirs, self._folder, self._processor), daemon=True)
            process.start()
            # This side's copy of their end: left open, the pipe would not end with the process, and its death not be
            # noticed.
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

    def _hear(self, pipe: Connection) -> None:
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
            # Marked only when done and one by one: an interrupted start goes on where it was.
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

    def _say(self) -> None:
        if self._working:
            what = tuple(piece.what for _, piece, _ in self._working.values())
            self._said(Compiling(self._done, self._of, what, time.monotonic() - self._begun_s))


def _serve(pipe: Connection, folder: Path, processor: Processor | None) -> None:
    """Serve as a compiling process: the name of a piece's function in, ``None`` or an error's text out, until the
    pipe closes."""
    point_at(folder, processor)
    # A compiler makes millions of objects, and most of what is still there when garbage is looked for stays: looking
    # while it works costs a tenth of its time. So it is looked for between pieces, and what stays is not looked at
    # again.
    gc.disable()
    try:
        while True:
            module, _, function = pipe.recv().partition(":")
            try:
                run: Callable[[], Any] = getattr(importlib.import_module(module), function)
                run()
            except Exception as error:  # whoever waits hears which piece it was
                pipe.send(f"{type(error).__name__}: {error}")
            else:
                pipe.send(None)
            gc.collect()
            gc.freeze()
    except (EOFError, OSError, KeyboardInterrupt):
        pass  # nothing is left to be done


@contextmanager
def _alone(lock: Path, waiting: Callable[[], None]) -> Iterator[None]:
    """Inside, no other process compiles into the folder. ``waiting`` is called while one does. Raises CompileError."""
    never = threading.Event()
    with lock.open("a") as held:
        for _ in range(round(LOCK_S / TICK_S)):
            try:
                fcntl.flock(held, fcntl.LOCK_EX | fcntl.LOCK_NB)
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
