"""Owns that every scan of an archive is worked through once: what is in work, what is tried again, and how long it will still take.

Who does the work is an ``Engine``: processes of this computer (``local``) or of many (``many``). At no time is more in work than an engine
has room for, so that nothing is queued without bound; what an engine loses comes back and is given out again.
"""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Protocol

from appliance.offline.anew.results import Row
from appliance.offline.anew.task import AGAIN, DONE, FAILED, Job

TRIES = 3
"""Times that a scan is given out because a machine failed under it, before it is left for the next call."""
TROUBLES_IN_A_ROW = 8
"""Number of refusals one after another that end the work: that many, and no result between them, are no accident of one scan: the disk is full for all."""
POLL_S = 0.5


@dataclass(frozen=True, slots=True)
class Ended:
    """One job that an engine is done with."""

    job: Job
    row: Row | None
    """``None``: whoever did it is gone."""
    trouble: str = ""
    counts: bool = True
    """False where the scan cannot be to blame: a scheduler was started again."""


class Engine(Protocol):
    """Does jobs. ``close`` ends everything that it started."""

    def room(self) -> int:
        """Return how many more jobs it takes now."""

    def start(self, job: Job) -> None:
        """Take a job; there is room for it."""

    def ended(self, timeout_s: float) -> list[Ended]:
        """Return what ended, as soon as something did, and after ``timeout_s`` at the latest."""

    def close(self) -> None:
        """End, also what is in work."""


@dataclass(frozen=True, slots=True)
class Worked:
    """Outcome of all jobs."""

    rows: tuple[Row, ...]
    """A row of each job that has a result or a reason why it has none."""
    left: tuple[Row, ...]
    """Rows of those for which machines failed: they are tried again by the next call."""
    lost: int
    """Times that a job came back because its worker was gone."""
    stopped: str | None
    """Reason why the rest was not begun; ``None``: everything was."""


@dataclass(slots=True)
class _State:
    waiting: deque[tuple[Job, int]]
    tries: dict[str, int] = field(default_factory=dict)
    rows: list[Row] = field(default_factory=list)
    left: list[Row] = field(default_factory=list)
    lost: int = 0
    in_a_row: int = 0
    in_work: int = 0


Said = Callable[[int, int, float | None], None]
"""Hears how many jobs are done, of how many, and how many seconds are left, ``None`` where that is not known yet."""


def work_through_all(
    jobs: Sequence[Job], engine: Engine, said: Said, now_s: Callable[[], float] = time.monotonic
) -> Worked:
    """Have every job done by ``engine``. Never raises for a job; what the engine itself raises ends the work."""
    state = _State(deque((job, 1) for job in jobs))
    begun_s = now_s()
    stopped: str | None = None
    while state.in_work or (state.waiting and stopped is None):
        while state.waiting and stopped is None and engine.room() > 0:
            job, number = state.waiting.popleft()
            state.tries[job.folder] = number
            engine.start(job)
            state.in_work += 1
        for one in engine.ended(POLL_S):
            state.in_work -= 1
            _take(one, state)
        if state.in_a_row >= TROUBLES_IN_A_ROW:
            stopped = str(state.left[-1]["reason"] if state.left else "one refusal after another")
        done = len(state.rows) + len(state.left)
        passed_s = now_s() - begun_s
        said(done, len(jobs), passed_s / done * (len(jobs) - done) if done else None)
    return Worked(tuple(state.rows), tuple(state.left), state.lost, stopped)


def _take(one: Ended, state: _State) -> None:
    number = state.tries[one.job.folder]
    if one.row is not None and one.row["state"] in (DONE, FAILED):
        state.rows.append(one.row)
        state.in_a_row = 0
        return
    if one.row is None:
        state.lost += 1
    reason = one.trouble if one.row is None else str(one.row["reason"])
    # Death of a worker is nothing that the next scan shares; a refusal of the disk is.
    state.in_a_row += one.row is not None
    if not one.counts:
        state.waiting.append((one.job, number))
    elif number < TRIES and state.in_a_row < TROUBLES_IN_A_ROW:
        state.waiting.append((one.job, number + 1))
    else:
        state.left.append({"scan": one.job.name, "folder": one.job.folder, "state": AGAIN, "reason": reason})
