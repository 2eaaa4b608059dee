"""Owns who works on a scan: the thread that asks, and helpers that take what it has not begun yet.

Whoever waits for a task that nobody has begun does it. So nothing waits for a thread to be free, tasks may ask for
others, and without helpers all is done by the caller, in the order in which it asks. What a task returns must not
depend on who does it, or when.
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
"""Longest wait for a task that another thread has begun; its kernels may have to be compiled first."""

T = TypeVar("T")
Item = TypeVar("Item")


class Crew:
    """The caller's thread and ``helpers`` more; tasks begin in the order in which they were added.

    ``close`` ends the threads.
    """

    def __init__(self, helpers: int = 1) -> None:
        self.helpers = helpers
        self._pool = ThreadPoolExecutor(helpers, "kf-decode") if helpers else None
        # The lock itself is entered and left, which takes one step of the interpreter each; a condition's own way takes
        # several, and an interruption between them would leave it locked for ever.
        self._lock = threading.Lock()
        """Guards what follows, and the state of all tasks."""
        self._changed = threading.Condition(self._lock)
        self._open: deque[WorkItem[object]] = deque()
        """Tasks that nobody has begun."""

    def close(self) -> None:
        """End the helpers' threads, after what they have begun."""
        if self._pool is not None:
            self._pool.shutdown()

    @contextmanager
    def tasks(self) -> Iterator[WorkList]:
        """Open a list of tasks; however it is left, none of them is at work afterwards."""
        with WorkList(self) as tasks:
            yield tasks

    def each(self, work: Callable[[Item], T], items: Iterable[Item]) -> list[T]:
        """Return what ``work`` returns for each item, in their order.

        Raises what the first of them raised that failed.
        """
        with self.tasks() as tasks:
            return answers([tasks.add(partial(work, item)) for item in items])

    def add(self, task: WorkItem[object]) -> None:
        """Let whoever is free begin ``task``."""
        with self._lock:
            self._open.append(task)
            self._changed.notify_all()
        if self._pool is not None:
            self._pool.submit(self._help)

    def take(self, task: WorkItem[object]) -> bool:
        """Take ``task`` off the list, for the caller to do or to drop; False where somebody has begun it."""
        with self._lock:
            if task not in self._open:
                return False
            self._take(task)
            return True

    def ended(self, task: WorkItem[object]) -> None:
        """Note that ``task`` is done, and wake who waits for it."""
        with self._lock:
            task.is_done = True
            self._changed.notify_all()

    def await_or_help(self, task: WorkItem[object], *, helping: bool) -> bool:
        """Wait until ``task`` is done, and return True; or do another one meanwhile, and return False.

        Raises TimeoutError after ``MOST_S``.
        """
        other: WorkItem[object] | None = None
        try:
            with self._lock:
                if not self._changed.wait_for(lambda: task.is_done or (helping and self._open), MOST_S):
                    raise TimeoutError(f"a part of the reconstruction has not ended for {MOST_S:g} s")
                if task.is_done:
                    return True
                other = self._open[0]
                self._take(other)
            other.do()
        except BaseException:
            if other is not None:
                self.end_left(other)
            raise
        return False

    def await_end(self, task: WorkItem[object]) -> None:
        """Wait until nobody is at ``task``. Raises TimeoutError after ``MOST_S``."""
        with self._lock:
            # Nobody has taken what an interruption kept from being added.
            if task.taken_by is not None and not self._changed.wait_for(lambda: task.is_done, MOST_S):
                raise TimeoutError(f"a part of the reconstruction has not ended for {MOST_S:g} s")

    def end_left(self, task: WorkItem[object]) -> None:
        """Note that ``task`` is done where this thread has taken it and left it: an interruption (Ctrl-C) may strike
        between the taking and the work, or between the work and its end, and others would wait for it."""
        with self._lock:
            if task.taken_by == threading.get_ident() and not task.is_done and task not in self._open:
                task.raised = RuntimeError("it was interrupted; begin the scan again")
                task.is_done = True
                self._changed.notify_all()

    def _take(self, task: WorkItem[object]) -> None:
        """Take an open task; ``_lock`` is held."""
        # Before it is off the list: whoever is interrupted in between has left it open.
        task.taken_by = threading.get_ident()
        self._open.remove(task)

    def _help(self) -> None:
        with self._lock:
            task = self._open[0] if self._open else None
            if task is not None:
                self._take(task)
        # None: the caller has begun it meanwhile.
        if task is not None:
            task.do()


class WorkItem(Generic[T]):
    """A task: work that some thread does once. Made by ``WorkList.add``."""

    def __init__(self, crew: Crew, work: Callable[[], T]) -> None:
        self._crew = crew
        self._work: Callable[[], T] | None = work
        """None once it is done or dropped: what it holds of a scan, and whatever points at this task, is free then."""
        self._returned: T | None = None
        self.raised: BaseException | None = None
        """Error that the work, or what became of it, ended with; raised where the answer is awaited."""
        self.is_done = False
        self.taken_by: int | None = None
        """Thread that has taken it off the list; ``None``: nobody has."""
        self.cpu_s = 0.0
        """Processor time of the thread that did it, once it is done."""

    def do(self) -> None:
        """Do the work; whoever calls has taken it off the crew's list."""
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
        """Return what the work returned, or raise what it raised; it is done here and now unless somebody has begun it.

        ``helping``: while another thread is at it, the caller does whatever else is open.
        """
        crew, itself = self._crew, cast(WorkItem[object], self)
        self.do_unless_begun()
        while not crew.await_or_help(itself, helping=helping):
            pass
        if self.raised is not None:
            raise self.raised
        return cast(T, self._returned)

    def do_unless_begun(self) -> None:
        """Do the work here and now unless somebody has begun it."""
        itself = cast(WorkItem[object], self)
        try:
            if self._crew.take(itself):
                self.do()
        except BaseException:
            self._crew.end_left(itself)
            raise

    def drop(self) -> None:
        """Let nobody begin it any more."""
        crew, itself = self._crew, cast(WorkItem[object], self)
        if crew.take(itself):
            self._work = None
            self.raised = RuntimeError("its scan was given up before this was begun; begin the scan again")
            crew.ended(itself)

    def await_end(self) -> None:
        """Wait until nobody is at it; what it raised is nobody's concern any more."""
        self._crew.await_end(cast(WorkItem[object], self))


class WorkList:
    """Tasks that belong together: when the list is closed, those that nobody has begun are dropped and the others
    awaited."""

    def __init__(self, crew: Crew) -> None:
        self._crew = crew
        self._added: list[WorkItem[object]] = []

    def __enter__(self) -> WorkList:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def add(self, work: Callable[[], T]) -> WorkItem[T]:
        """Add ``work``, for whoever is free."""
        task = WorkItem(self._crew, work)
        itself = cast(WorkItem[object], task)
        self._added.append(itself)
        self._crew.add(itself)
        return task

    def close(self) -> None:
        """Drop what nobody has begun and wait for the rest; again is allowed."""
        # All are dropped before any is awaited: else a helper would go on with the next.
        for task in self._added:
            task.drop()
        for task in self._added:
            task.await_end()
        self._added.clear()


def answers(tasks: Sequence[WorkItem[T]]) -> list[T]:
    """Return what all of ``tasks`` returned.

    The caller does what nobody has begun before it waits for any; of several errors, that of the first is raised.
    """
    for task in tasks:
        task.do_unless_begun()
    return [task.answer() for task in tasks]
