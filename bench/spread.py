"""Distribution of independent measurements over the processor's cores."""

from __future__ import annotations

import multiprocessing
import os
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ProcessPoolExecutor
from typing import TypeVar

Item = TypeVar("Item")
Found = TypeVar("Found")


def spread(work: Callable[[Item], Found], items: Iterable[Item]) -> Iterator[Found]:
    """Yield the result of ``work`` for each item, in their order, by a process for each core.

    An error in one ends them all. Both arguments must be picklable. Not for CPU times, because cores share caches and
    clocks.
    """
    pool = ProcessPoolExecutor(os.cpu_count(), mp_context=multiprocessing.get_context("spawn"))
    try:
        yield from pool.map(work, items)
    finally:
        pool.shutdown(cancel_futures=True)
