"""A pool of threads for the work on a scan: the caller's thread and its helpers.

A thread that waits for a task which has not been begun runs it. So nothing waits for a free thread, tasks may wait for
other tasks, and without helpers the caller runs everything in the order in which it asks. The result of a task must not
depend on the thread or the time.

Crew        the threads
WorkList    tasks that are dropped or awaited together
WorkItem    one task
answers     the results of several tasks
"""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from functools import partial
from typing import Generic, TypeVar, cast

MOST_S = 900.0
"""Longest wait for a task that another thread runs; its kernels may have to be compiled first."""

T = TypeVar("T")
Item = TypeVar("Item")


class Crew:
    """The caller's thread and ``helpers`` more; tasks begin in the order in which they were added.

    ``close`` ends the threads.
    """

    def __init__(self, helpers: int = 1) -> None:
        self.helpers = helpers
        self._pool = ThreadPoolExecutor(helpers, "kf-decode") if helpers else None
        # The lock itself is used as context manager: one step of the interpreter. A condition takes several, and an
        # interruption between them would leave it locked for ever.
        self._lock = threading.Lock()
        """Guards what follows, and the state of all tasks."""
        self._changed = threading.Condition(self._lock)
        self._open: deque[WorkItem[object]] = deque()
        """Tasks that have not been begun."""

    def close(self) -> None:
        """End the helpers' threads after their current tasks."""
        if self._pool is not None:
            self._pool.shutdown()

    @contextmanager
    def tasks(self) -> Iterator[WorkList]:
        """Open a list of tasks; when the context ends, none of them is running."""
        with WorkList(self) as tasks:
            yield tasks

    def each(self, work: Callable[[Item], T], items: Iterable[Item]) -> list[T]:
        """Return the results of ``work`` for each item, in order; raise the first error."""
        with self.tasks() as tasks:
            return answers([tasks.add(partial(work, item)) for item in items])

    def add(self, task: WorkItem[object]) -> None:
        """Add ``task`` for the next free thread."""
        with self._lock:
            self._open.append(task)
            self._changed.notify_all()
        if self._pool is not None:
            self._pool.submit(self._help)

    def take(self, task: WorkItem[object]) -> bool:
        """Take ``task`` off the list, for the caller to run or to drop; False if a thread has begun it."""
        with self._lock:
            if task not in self._open:
                return False
            self._take(task)
            return True

    def ended(self, task: WorkItem[object]) -> None:
        """Mark ``task`` as done and wake the threads that wait for it."""
        with self._lock:
            task.is_done = True
            self._changed.notify_all()

    def await_or_help(self, task: WorkItem[object], *, helping: bool) -> bool:
        """Wait until ``task`` is done and return True, or run another one meanwhile and return False.

        Raises TimeoutError after ``MOST_S``.
        """
        open_task: WorkItem[object] | None = None
        try:
            with self._lock:
                if not self._changed.wait_for(lambda: task.is_done or (helping and self._open), MOST_S):
                    raise TimeoutError(f"a part of the reconstruction has not ended after {MOST_S:g} s")
                if task.is_done:
                    return True
                open_task = self._open[0]
                self._take(open_task)
            open_task.do()
        except BaseException:
            if open_task is not None:
                self.end_left(open_task)
            raise
        return False

    def await_end(self, task: WorkItem[object]) -> None:
        """Wait until no thread runs ``task``. Raises TimeoutError after ``MOST_S``."""
        with self._lock:
            # A task that an interruption kept from being added was never taken.
            if task.taken_by is not None and not self._changed.wait_for(lambda: task.is_done, MOST_S):
                raise TimeoutError(f"a part of the reconstruction has not ended after {MOST_S:g} s")

    def end_left(self, task: WorkItem[object]) -> None:
        """Mark ``task`` as done if this thread took it and was interrupted before or after running it.

        Otherwise threads that wait for it would wait for ever.
        """
        with self._lock:
            if task.taken_by == threading.get_ident() and not task.is_done and task not in self._open:
                task.raised = RuntimeError("it was interrupted; start the scan again")
                task.is_done = True
                self._changed.notify_all()

    def _take(self, task: WorkItem[object]) -> None:
        """Take an open task; the caller holds ``_lock``."""
        # First, before the task is off the list: after an interruption in between it is still open.
        task.taken_by = threading.get_ident()
        self._open.remove(task)

    def _help(self) -> None:
        with self._lock:
            task = self._open[0] if self._open else None
            if task is not None:
                self._take(task)
        # None: another thread has begun it meanwhile.
        if task is not None:
            task.do()


class WorkItem(Generic[T]):
    """A task, run once by one thread. Made by ``WorkList.add``."""

    def __init__(self, crew: Crew, work: Callable[[], T]) -> None:
        self._crew = crew
        self._work: Callable[[], T] | None = work
        """None once the task is done or dropped, which frees the memory that it refers to."""
        self._returned: T | None = None
        self.raised: BaseException | None = None
        """Error with which the work ended; raised again where the answer is awaited."""
        self.is_done = False
        self.taken_by: int | None = None
        """Thread that has taken the task off the list; ``None``: it is still open."""
        self.cpu_s = 0.0
        """Processor time of the thread that did it, once it is done."""

    def do(self) -> None:
        """Run the work; the caller must have taken the task off the crew's list."""
        work, self._work = self._work, None
        assert work is not None, "a task is taken off the list once"
        begun_s = time.thread_time()
        try:
            self._returned = work()
        except BaseException as error:  # it is raised where the answer is awaited
            self.raised = error
        del work
        self.cpu_s = time.thread_time() - begun_s
        self._crew.ended(cast(WorkItem[object], self))

    def answer(self, *, helping: bool = False) -> T:
        """Return the result of the work or raise its error; run it now unless a thread has begun it.

        ``helping``: run other open tasks while another thread runs this one.
        """
        crew, itself = self._crew, cast(WorkItem[object], self)
        self.do_unless_begun()
        while not crew.await_or_help(itself, helping=helping):
            pass
        if self.raised is not None:
            raise self.raised
        return cast(T, self._returned)

    def do_unless_begun(self) -> None:
        """Run the work now unless a thread has begun it."""
        itself = cast(WorkItem[object], self)
        try:
            if self._crew.take(itself):
                self.do()
        except BaseException:
            self._crew.end_left(itself)
            raise

    def drop(self) -> None:
        """Take the task off the list if it has not been begun."""
        crew, itself = self._crew, cast(WorkItem[object], self)
        if crew.take(itself):
            self._work = None
            self.raised = RuntimeError("its scan was cancelled before this began; start the scan again")
            crew.ended(itself)

    def await_end(self) -> None:
        """Wait until no thread runs the task; its error is ignored."""
        self._crew.await_end(cast(WorkItem[object], self))


class WorkList:
    """Tasks that belong together: closing the list drops those not begun and awaits the others."""

    def __init__(self, crew: Crew) -> None:
        self._crew = crew
        self._added: list[WorkItem[object]] = []

    def __enter__(self) -> WorkList:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def add(self, work: Callable[[], T]) -> WorkItem[T]:
        """Add ``work`` for the next free thread."""
        task = WorkItem(self._crew, work)
        itself = cast(WorkItem[object], task)
        self._added.append(itself)
        self._crew.add(itself)
        return task

    def close(self) -> None:
        """Drop the tasks that have not been begun and wait for the others; may be called again."""
        # Drop all before awaiting any: otherwise a helper would begin the next one.
        for task in self._added:
            task.drop()
        for task in self._added:
            task.await_end()
        self._added.clear()


def answers(tasks: Sequence[WorkItem[T]]) -> list[T]:
    """Return the results of all ``tasks``.

    The caller runs those not begun before it waits for any; of several errors, the first is raised.
    """
    for task in tasks:
        task.do_unless_begun()
    return [task.answer() for task in tasks]
