"""Start and interruption of a process of the instrument.

  use_one_blas_thread    no idle threads of linear algebra
  importing              imports without garbage collection
  uninterrupted          Ctrl-C waits until a library is loaded
  interrupts             whether an exception is a Ctrl-C
  raise_if_interrupted   turn such an exception back into one

The first two save processor time and heat, and change no result. They are called before the modules are imported that
they concern.
"""

from __future__ import annotations

import gc
import signal
import threading
from collections.abc import Iterator, MutableMapping
from contextlib import contextmanager

BLAS_THREADS = "OPENBLAS_NUM_THREADS"
"""Environment variable that OpenBLAS reads when NumPy is imported."""


def use_one_blas_thread(environment: MutableMapping[str, str]) -> None:
    """Let linear algebra take one thread in processes of this ``environment``, unless it is set already.

    The matrices of a scan are small: OpenBLAS's other threads gain nothing on them, but each turns in a busy loop for
    tens of milliseconds after every product, in wait for the next. In a scan's worker that was a seventh of all
    processor time.
    """
    environment.setdefault(BLAS_THREADS, "1")


@contextmanager
def importing() -> Iterator[None]:
    """Import modules inside without garbage collection, and freeze the objects that they make.

    The objects of an import stay: some hundred thousand, which the collector would walk through again and again while
    the imports run (a fifth of their time), and later in the midst of a cycle of the service.
    """
    if not gc.isenabled():
        yield  # the caller has switched it off, and will switch it on again
        return
    gc.disable()
    try:
        yield
    finally:
        gc.freeze()
        gc.enable()


@contextmanager
def uninterrupted() -> Iterator[None]:
    """Delay an interruption (Ctrl-C) until the block has ended.

    While libigl is being loaded, it would make an ``ImportError`` of it.
    """
    if threading.current_thread() is not threading.main_thread():
        yield  # only the main thread is interrupted
        return
    signals: list[int] = []
    previous_handler = signal.signal(signal.SIGINT, lambda number, _: signals.append(number))
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, previous_handler)
        for number in signals[:1]:
            signal.raise_signal(number)


def interrupts(error: BaseException) -> bool:
    """Return True if ``error`` is an interruption (Ctrl-C), or was made of one.

    It may come between any two bytecodes of the main thread. Compiled libraries replace one that comes in their
    callback by an error of their own: numba's unpickling by ``SystemError: … returned a result with an exception set``.
    """
    visited_ids: set[int] = set()
    cause: BaseException | None = error
    while cause is not None and id(cause) not in visited_ids:
        if isinstance(cause, KeyboardInterrupt):
            return True
        visited_ids.add(id(cause))
        # Only the interpreter's SystemError has the interruption as its cause. Any other error with that cause may
        # have happened while an interruption was being handled.
        cause = cause.__cause__ if isinstance(cause, SystemError) else None
    return False


def raise_if_interrupted(error: BaseException) -> None:
    """Raise KeyboardInterrupt if ``error`` was made of one; for code that records errors as results."""
    if interrupts(error):
        raise KeyboardInterrupt from error
