"""Owns that every scan of an archive is worked through once: what is in work, what is tried again, and how long it will still take.

Who does the work is an ``Engine``: processes of this computer (``local``) or of many (``many``). At no time is more in work than an engine
has room for, so that nothing is queued without bound; what an engine loses comes back and is given out again. A place (a worker, or
this computer) that refuses one scan after another gets no more of them, and the others go on.
"""

from __future__ import annotations

import math
import time
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Protocol

from appliance.offline.anew.results import Row
from appliance.offline.anew.task import AGAIN, BLAME, DONE, FAILED, OF_HOST, OF_MACHINE, OF_SCAN, Job

TRIES = 3
"""Times that a scan is given out because a machine failed under it, before it is left for the next call."""
TROUBLES_IN_A_ROW = 8
"""Number of refusals of one place, and no result of it between them, that are no accident of one scan: it gets no more. Where every place
has refused, that many of them together end the work: the disk is full for all."""
TROUBLES_OF_EACH = 2
"""Refusals in a row of each place then, at least: one that has not said anything yet may be able to."""
PLACELESS_S = 600.0
"""Time that there may be nobody to do anything, before the work is given up."""
LEFT_OUT_S = 60.0
"""The same where all that were there were left out: others may be about to come."""
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
    place: str = ""
    """Who did it, as the engine names its places; empty where that is not known."""
    together: bool = False
    """True where it was lost together with others, each of which may be to blame: it is given out alone then, to find out."""


class Engine(Protocol):
    """Does jobs. ``close`` ends everything that it started."""

    @property
    def others_may_come(self) -> bool:
        """True where there may be more places later than now."""

    def room(self) -> int:
        """Return how many more times it takes jobs now."""

    def at_once(self, waiting: int) -> int:
        """Return how many of ``waiting`` jobs it takes at once, at least one: of quick ones several, for each time has its cost."""

    def start(self, jobs: Sequence[Job]) -> None:
        """Take jobs; there is room for them."""

    def ended(self, timeout_s: float) -> list[Ended]:
        """Return what ended, as soon as something did, and after ``timeout_s`` at the latest."""

    def places(self) -> Mapping[str, str | None]:
        """Return who may get jobs now, by name, and who gets none, with the reason."""

    def leave_out(self, place: str, reason: str) -> None:
        """Give ``place`` no more jobs."""

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
    left_out: Mapping[str, str]
    """Places that got no more scans after a while, or never any, with the reason."""
    stopped: str | None
    """Reason why the rest was not begun; ``None``: everything was."""
    not_begun: int
    """Number of jobs that this concerns."""


@dataclass(slots=True)
class _State:
    waiting: deque[tuple[Job, int]]
    tries: dict[str, int] = field(default_factory=dict)
    rows: list[Row] = field(default_factory=list)
    left: list[Row] = field(default_factory=list)
    lost: int = 0
    in_a_row: int = 0
    """Refusals since the last result of anybody."""
    alone: set[str] = field(default_factory=set)
    """Folders of jobs that are given out alone."""
    of_place: dict[str, int] = field(default_factory=dict)
    """Refusals of each place since its own last result."""
    last: str = ""
    """Reason of the last refusal."""
    left_out: dict[str, str] = field(default_factory=dict)
    in_work: int = 0
    alone_s: float | None = None
    """Time of the clock at which the last place went; ``None``: there is one."""


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
            some = _next(state, engine.at_once(len(state.waiting)))
            engine.start(some)
            state.in_work += len(some)
        for one in engine.ended(POLL_S):
            state.in_work -= 1
            _take(one, state, engine)
        passed_s = now_s() - begun_s
        stopped = stopped or _hopeless(state, engine, passed_s)
        done = len(state.rows) + len(state.left)
        said(done, len(jobs), passed_s / done * (len(jobs) - done) if done else None)
        if stopped is not None and engine.others_may_come and not _able(engine):
            break  # what is still given out waits for somebody, too
    not_begun = len(jobs) - len(state.rows) - len(state.left)
    return Worked(tuple(state.rows), tuple(state.left), state.lost, state.left_out, stopped, not_begun)


def _next(state: _State, most: int) -> list[Job]:
    """Take jobs that are given out together off those that wait."""
    found: list[Job] = []
    while state.waiting and len(found) < most:
        job, number = state.waiting[0]
        if found and job.folder in state.alone:
            break
        state.waiting.popleft()
        state.tries[job.folder] = number
        found.append(job)
        if job.folder in state.alone:
            break
    return found


def _take(one: Ended, state: _State, engine: Engine) -> None:
    number = state.tries[one.job.folder]
    if one.row is not None and one.row["state"] in (DONE, FAILED):
        state.rows.append(one.row)
        state.in_a_row = 0
        state.of_place.pop(one.place, None)
        return
    if one.row is None:
        state.lost += 1
        reason, blame = one.trouble, OF_SCAN
    else:
        reason, blame = str(one.row["reason"]), str(one.row.get(BLAME, OF_MACHINE))
        host = str(one.row.get("host", ""))
        reason = reason if host in reason else f"{host}: {reason}"
    # Death of a worker is nothing that the next scan shares; a refusal of the disk is.
    if blame != OF_SCAN:
        _refused(one.place, reason, blame, state, engine)
    if one.together:
        state.alone.add(one.job.folder)
    if one.together or not one.counts or blame == OF_HOST:
        state.waiting.append((one.job, number))
    elif number < TRIES:
        state.waiting.append((one.job, number + 1))
    else:
        state.left.append({"scan": one.job.name, "folder": one.job.folder, "state": AGAIN, "reason": reason})


def _refused(place: str, reason: str, blame: str, state: _State, engine: Engine) -> None:
    state.in_a_row, state.last = state.in_a_row + 1, reason
    state.of_place[place] = state.of_place.get(place, 0) + 1
    if blame == OF_HOST or state.of_place[place] >= TROUBLES_IN_A_ROW:
        # Whoever refuses within milliseconds would otherwise get, and refuse, all scans while the others work on one.
        engine.leave_out(place, reason)


def _able(engine: Engine) -> list[str]:
    return [place for place, reason in engine.places().items() if reason is None]


def _hopeless(state: _State, engine: Engine, now_s: float) -> str | None:
    """Return why nothing more should be begun; ``None`` where somebody may still do it."""
    state.left_out |= {place: reason for place, reason in engine.places().items() if reason is not None}
    able = _able(engine)
    if able:
        state.alone_s = None
        each = all(state.of_place.get(place, 0) >= TROUBLES_OF_EACH for place in able)
        return state.last if each and state.in_a_row >= TROUBLES_IN_A_ROW else None
    state.alone_s = now_s if state.alone_s is None else state.alone_s
    waited_s = now_s - state.alone_s if engine.others_may_come else math.inf
    if state.left_out and waited_s >= LEFT_OUT_S:
        return f"nobody is left who can do it: {'; '.join(sorted(set(state.left_out.values())))}"
    # Longer where nobody was left out: workers come back one by one after a scheduler was started again.
    if waited_s >= PLACELESS_S:
        return f"there was no worker for {PLACELESS_S:.0f} s; start one with `dask worker`, and call again"
    return None
