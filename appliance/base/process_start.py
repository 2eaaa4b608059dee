"""Owns how a process of the instrument begins, without processor time and heat that nobody gains anything from; and how
it is interrupted.

Both helpers for the beginning come before the modules that they concern are imported, and neither changes a result.
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
    """Let linear algebra take one thread in processes of this ``environment``, unless it says otherwise already.

    The matrices of a scan are small: OpenBLAS's other threads gain nothing on them, but each turns in a busy loop for
    tens of milliseconds after every product, in wait for the next. In a scan's worker that was a seventh of all
    processor time.
    """
    environment.setdefault(BLAS_THREADS, "1")


@contextmanager
def importing() -> Iterator[None]:
    """Import modules inside without the garbage collector, and keep it from what they made ever after.

    What an import makes stays: some hundred thousand objects, through which the collector would go again and again
    while they become more (a fifth of the time that the imports take), and later in the midst of the heartbeat.
    """
    if not gc.isenabled():
        yield  # whoever switched it off will look after it
        return
    gc.disable()
    try:
        yield
    finally:
        gc.freeze()
        gc.enable()


@contextmanager
def uninterrupted() -> Iterator[None]:
    """Let an interruption (Ctrl-C) wait for the end of what is inside: libigl, amidst its loading, makes an
    ``ImportError`` of it."""
    if threading.current_thread() is not threading.main_thread():
        yield  # only the main thread is interrupted
        return
    struck: list[int] = []
    before = signal.signal(signal.SIGINT, lambda number, _: struck.append(number))
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)
        for number in struck[:1]:
            signal.raise_signal(number)


def interrupts(error: BaseException) -> bool:
    """Return True if ``error`` is an interruption (Ctrl-C), or was made of one.

    It may strike between any two bytecodes of the main thread. Within a callback of a compiled library it arrives as
    what that library makes of it: inside numba's unpickling, as ``SystemError: … returned a result with an exception
    set``.
    """
    seen: set[int] = set()
    at: BaseException | None = error
    while at is not None and id(at) not in seen:
        if isinstance(at, KeyboardInterrupt):
            return True
        seen.add(id(at))
        # The interpreter's own error has the interruption as its cause; any other error may well have happened while
        # one was handled.
        at = at.__cause__ if isinstance(at, SystemError) else None
    return False


def raise_if_interrupted(error: BaseException) -> None:
    """Raises KeyboardInterrupt where ``error`` was made of one, for whoever writes errors down as results."""
    if interrupts(error):
        raise KeyboardInterrupt from error
