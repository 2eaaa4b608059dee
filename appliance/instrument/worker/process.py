"""Owns the warm process in which scans are reconstructed, so that computing never delays a vertical blank.

    ReconstructionWorker    the parent's end
    ScanInWork              the scan begun last
    Looking                 live images handed to the worker: one at a time, the latest, a third of a processor at most

The parent sends small messages; pixels stay in the shared frame store and points come back through shared memory. A
worker that dies, does not get on or takes too much memory is killed and started again, and the scan it had is processed
again from the raw frames, which are untouched by all of that. The child's side is ``serve``; ``Liveness`` judges
whether it gets on.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from types import TracebackType

import numpy as np
from numpy.typing import NDArray

from appliance.instrument.capture.store import FrameStore
from appliance.instrument.worker.child import ChildGone, ChildProcess, Liveness, cpu_s, own_memory_mb
from appliance.instrument.worker.memory import ParentMemory
from appliance.instrument.worker.messages import (
    Begin,
    CloudCopied,
    Drop,
    Finish,
    FrameStored,
    Keep,
    LookAt,
    Ping,
    Pong,
    Ready,
    ToWorker,
    WorkLimits,
    WorkOrder,
)
from appliance.instrument.worker.serve import work
from appliance.measure import (
    SIDES,
    AcquisitionSettings,
    Bracket,
    Cloud,
    CoarseCloud,
    Fault,
    FaultCode,
    FullCloud,
    LiveGuidance,
    News,
    PatternIdentity,
    ReconstructionFailure,
    SequenceFact,
    WorkerFailure,
    WorkProgress,
    encode_calibration,
)
from drivers.api import Clock

EVERY_S, SHARE = 0.4, 1.0 / 3.0
"""Least time from one picture to the next, and the most of a processor that looking at them may take."""
LIMIT_S = 5.0
"""Longest wait for an answer before another picture is handed over."""


class Looking:
    """The parent's account of live pictures. Called by one thread."""

    def __init__(self) -> None:
        self._taken_ns: int | None = None
        """Time of the picture whose answer is awaited; ``None``: none is."""
        self._from_ns = 0
        """Time from which the next one may be handed over."""

    def may(self, now_ns: int) -> bool:
        """Return whether a picture may be handed over now."""
        return now_ns >= self._from_ns

    def ask(self, shape: tuple[int, int], belongs_to: int, now_ns: int) -> LookAt:
        """Return the order to look at a picture (h, w) that lies in its place, for an object of that number."""
        self._taken_ns, self._from_ns = now_ns, now_ns + round(LIMIT_S * 1e9)
        return LookAt(now_ns, shape, belongs_to)

    def awaits(self, answer: LiveGuidance) -> bool:
        """Take note of an answer; returns False where nobody waits for it any more."""
        if answer.taken_ns != self._taken_ns:
            return False
        self._taken_ns = None
        self._from_ns = answer.taken_ns + round(1e9 * max(EVERY_S, answer.cpu_s / SHARE))
        return True

    def stop(self) -> None:
        """Await no answer any more: a scan begins, or the process is another one."""
        self._taken_ns, self._from_ns = None, 0


STOP_TIMEOUT_S = 2.0
MEMORY_CHECK_S = 0.5
MOST_ATTEMPTS = 2
"""Largest number of attempts at one scan."""
MOST_FRUITLESS_STARTS = 4
"""Largest number of starts in a row without a cloud in between; then the worker stays down until the next scan begins.
"""
POLL_S = 0.002
MOST_PASSED_OVER = 32
"""Largest number of messages that one poll passes over because nothing is to be told of them; a scan has some ten."""
PING_S = 1.0
"""Time between two questions to a worker with nothing to do whether it is there."""

WorkerEvent = Ready | News | LiveGuidance | WorkerFailure


@dataclass(slots=True)
class ScanInWork:
    """The scan begun last."""

    number: int = 0
    begun: tuple[Begin, ...] = ()
    """Order of its sequence, and of its second one, if there is one."""
    wanted: bool = False
    """True as long as news of it are."""
    finishing: bool = False
    """True if all frames of the sequence are there, and the cloud is awaited."""
    missed: bool = False
    """True if the worker was started again since: it must be told of all frames once more."""
    known: bool = False
    """True if this process found the full cloud: a second sequence can follow without the frames of the first."""
    attempts: int = 1
    given_up: str | None = None
    """Reason why it gets no cloud."""


class ReconstructionWorker:
    """The parent's end. A context manager; one thread calls ``poll``, camera threads may call ``frame``."""

    def __init__(self, order: WorkOrder, store: FrameStore, clock: Clock, limits: WorkLimits | None = None) -> None:
        self.order = order
        """The order that it was started for; ``change`` starts it for another."""
        self.limits = limits or WorkLimits()
        """May be replaced at any time; what it can still ask for is fixed when it starts."""
        self.restarts = 0
        """Number of times that the process had to be started again."""
        self.coarse: Cloud | None = None
        """The points of the last ``CoarseCloud``, until another scan begins."""
        self.full: Cloud | None = None
        """The points of the last ``FullCloud`` or ``Bracket``, until another scan begins; ``None`` also where both are
        no cloud."""
        self._store, self._clock = store, clock
        left = order.calibration.rig.left
        self._memory = ParentMemory(left.width_px, left.height_px)
        self._child = ChildProcess("kf-reconstruct", work)
        self._liveness = Liveness(clock, self._used_s)
        self._looking = Looking()
        self._starting = False
        self._not_started: str | None = None
        """Reason why there is no process although there should be one."""
        self._fruitless = 0
        self._memory_check_ns = 0
        self._scan = ScanInWork()
        self._ticket = 0
        """Counts the sequences begun; news of an earlier one are of no interest."""

    def __enter__(self) -> ReconstructionWorker:
        try:
            self._start()
        except BaseException:
            self._memory.close()
            raise
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._child.stop(STOP_TIMEOUT_S)
        self._memory.close()

    @property
    def pid(self) -> int | None:
        """Number of the process; ``None`` while there is none."""
        return self._child.pid

    @property
    def answers(self) -> bool:
        """It gets on, or it is known not to be there; false where ``poll`` should have seen that it does not."""
        # Later than `poll` itself would be: this is for the watchdog, which must not act before the restart does.
        return not self._child.runs or self._liveness.late(self.limits.alive_s) is None

    def gets_on(self) -> bool:
        """Return whether the first start, still under way, was seen to take processor time since this was asked last."""
        # Of the first start only: the self-test waits for that one, and a start that failed before may fail for ever.
        return self._starting and not self._fruitless and self._child.runs and self._liveness.computed()

    # ------------------------------------------------------------------------------------- orders

    def change(self, order: WorkOrder, store: FrameStore | None = None) -> None:
        """Start again with another calibration, water or sequence, for cameras of the same size; a scan in work is
        forgotten. ``store``: where the frames of another sequence will be; the old one is not used any more."""
        self.drop()
        self.order = order
        self._store = store or self._store
        self._fruitless = 0
        self._child.stop()
        self._start_again()

    def begin(self, scan: int, settings: AcquisitionSettings | None = None, belongs_to: int | None = None) -> None:
        """Expect a new scan's frames, taken so (``None``: as always). ``belongs_to``: number of its object."""
        self._looking.stop()
        self.coarse = self.full = None
        settings = settings or AcquisitionSettings(noise=self.order.noise)
        self._take_in_work(ScanInWork(scan, (Begin(self._ticket + 1, settings, belongs_to=belongs_to),), wanted=True))
        self._send(self._scan.begun[0])

    def begin_second(self, scan: int, settings: AcquisitionSettings) -> None:
        """Expect a second sequence's frames, of the ``scan`` begun last, whose first ones are still in the store.

        After ``finish``, news of one ``Bracket`` answer.
        """
        second = Begin(self._ticket + 1, settings, second=True)
        first = replace(self._scan.begun[0], ticket=second.ticket)
        self._take_in_work(ScanInWork(scan, (first, second), wanted=True, known=self._scan.known))
        # The process was started since: it has neither maps nor cloud of the first sequence, and makes them from the
        # frames.
        if not self._scan.known:
            self._tell(first)
        self._send(second)

    def _take_in_work(self, scan: ScanInWork) -> None:
        self._scan = scan
        self._ticket += 1
        if not self._child.runs:
            self._fruitless = 0
            self._start_again()

    def frame(self, side: str, index: int) -> None:
        """Announce frame ``index`` of ``side``, which is in the store, in the place of the sequence begun last."""
        # A process that was started meanwhile is told of all frames at once by `finish`: one of the middle would be no
        # frame 0 to it.
        if not self._scan.missed:
            self._send(FrameStored(side, index))

    def finish(self) -> None:
        """Ask for the facts, as all frames are there and the ledger agrees: the last is the full cloud, or that the
        scan is lost."""
        scan = self._scan
        if not scan.wanted:
            return
        scan.finishing = True
        if scan.given_up is not None:
            return
        self._expect()
        if scan.missed:
            self._tell_again()
        self._send(Finish())

    def drop(self) -> None:
        """Forget the scan that was begun."""
        self._scan.wanted = self._scan.finishing = False
        self._expect()
        self._send(Drop())

    def keep(self) -> None:
        """Let the next scan be compared with the one begun last, which the diver keeps.

        A process that was started since knows nothing of it; then nothing is said of the next one.
        """
        self._send(Keep())

    def reprocess(self, scan: int, settings: AcquisitionSettings | None = None) -> None:
        """Reconstruct the frames in the store from the first on."""
        self.begin(scan, settings)
        self._tell_again()
        self.finish()

    def look(self, picture: NDArray[np.uint8], belongs_to: int) -> bool:
        """Hand over the latest live picture, (h, w) uint8, of a diver who aims at the next scan of an object;
        ``LiveGuidance`` answers, unless a scan begins before.

        Returns False where it was not taken: the process is not ready, has something else to do, still looks at the
        last one, or has taken as much of a processor as it may.
        """
        now_ns = self._clock.now_ns()
        if not self._looking.may(now_ns) or not self._child.runs or self._starting or self._scan.finishing:
            return False
        self._send(self._looking.ask(self._memory.put(picture), belongs_to, now_ns))
        return True

    def _tell_again(self) -> None:
        """Announce all frames of the scan, from the first on."""
        self._scan.missed = False
        for begun in self._scan.begun:
            self._tell(begun)

    def _tell(self, begun: Begin) -> None:
        self._send(begun)
        for index in range(self._store.shape[0]):
            for side in SIDES:
                self._send(FrameStored(side, index))

    def _send(self, message: ToWorker) -> None:
        self._child.send(message)  # both camera threads and the service's do

    # ------------------------------------------------------------------------------------- answers

    def poll(self) -> WorkerEvent | None:
        """Return the next event, or ``None``. Restarts a worker that died or exceeded its limits, and reports that
        once.

        Never waits: the caller is the heartbeat.
        """
        if self._scan.finishing and self._scan.given_up is not None:
            return self._give_up(self._scan.given_up)
        if not self._child.runs:
            return self._restart(self._not_started) if self._not_started is not None else None
        # What needs no answer is passed over here and now: at a heartbeat for each, an answer behind ten of them would
        # come 0.2 s late.
        for _ in range(MOST_PASSED_OVER):
            try:
                message = self._child.receive()
            except ChildGone as gone:
                return self._restart(str(gone))
            if message is None:
                return self._check()
            event = self._heard(message)
            if event is not None:
                return event
        return None

    def wait(self, timeout_s: float) -> WorkerEvent | None:
        """Poll for up to ``timeout_s``, for programs without a heartbeat; return the first event, ``None``: there was
        none."""
        end_ns = self._clock.now_ns() + int(timeout_s * 1e9)
        while True:
            event = self.poll()
            if event is not None or self._clock.now_ns() >= end_ns:
                return event
            self._clock.sleep_s(POLL_S)

    def _heard(self, message: object) -> WorkerEvent | None:
        """Take note of a message, and return what is to be told of it."""
        event: WorkerEvent | None = None
        match message:
            case Ready():
                self._starting, event = False, message
            case Pong():
                pass
            case LiveGuidance():
                event = message if self._looking.awaits(message) else None
            case News(ticket, fact):
                event = self._news(fact) if ticket == self._ticket else None
            case WorkerFailure(text):
                return self._restart(f"it failed: {text}")
            case _:
                return self._restart(f"it sent a {type(message).__name__}, which is no answer")
        self._expect()
        return event

    def _news(self, fact: SequenceFact) -> WorkerEvent | None:
        """Take note of a fact about the scan in work, and return the news of it; ``None``: nothing is to be told."""
        scan = self._scan
        match fact:
            case ReconstructionFailure(fault):
                return self._give_up(fault.detail)
            case WorkProgress():
                return None
            case _ if not scan.wanted:
                return None
            case PatternIdentity(judgement) if judgement.fault is not None:
                scan.wanted = scan.finishing = False
            case CoarseCloud(found):
                self.coarse = self._memory.coarse(found)
            case FullCloud(found) | Bracket(found):
                self.full = None  # first: its memory may be wanted for the new one
                if found is not None:
                    self.full = self._memory.full(found)
                self._send(CloudCopied(self._ticket))
                scan.finishing, scan.known, self._fruitless = False, True, 0
            case _:
                pass
        return News(scan.number, fact)

    # ------------------------------------------------------------------------------------- its life

    def _expect(self) -> None:
        """Expect of the process what it owes from now on."""
        if self._starting:
            return  # one start has one limit, whatever is asked meanwhile
        if self._scan.finishing:
            self._liveness.owe(self.limits.cloud_s, self.limits.computing_s)
        else:
            self._liveness.rest()

    def _check(self) -> WorkerFailure | News | None:
        """Restart a process that does not get on, or takes too much memory; ask one that has nothing to do whether it
        is there."""
        why = self._liveness.late() or self._too_large()
        if why is not None:
            return self._restart(why)
        # Asked only while nothing is awaited: a worker that computes reads no messages.
        if self._liveness.rested_s > PING_S:
            self._send(Ping())
            self._liveness.owe(self.limits.alive_s, self.limits.computing_s)
        return None

    def _too_large(self) -> str | None:
        now_ns = self._clock.now_ns()
        if self.pid is None or now_ns < self._memory_check_ns:
            return None
        self._memory_check_ns = now_ns + int(MEMORY_CHECK_S * 1e9)
        # A process that has to compile does so before it is ready; loading what is compiled takes no more than scans
        # do.
        most_mb = self.limits.start_memory_mb if self._starting else self.limits.memory_mb
        # None: it has just ended, which the pipe will say.
        used_mb = own_memory_mb(self.pid)
        if used_mb is None or used_mb <= most_mb:
            return None
        return f"it took {used_mb:.0f} MB of memory; allowed are {most_mb:.0f} MB"

    def _used_s(self) -> float:
        return (cpu_s(self.pid) if self.pid is not None else None) or 0.0

    def _start(self) -> None:
        order = self.order
        self._looking.stop()
        self._child.start(
            encode_calibration(order.calibration),
            order.water,
            order.sequence,
            order.noise,
            (self._store.name, *self._store.shape),
            self._memory.name,
            self.limits.memory_mb,
        )
        self._starting, self._scan.known = True, False
        self._liveness.owe(self.limits.start_s, self.limits.start_s)

    def _start_again(self) -> None:
        """Start, where a machine that has no room for another process now is a failure of this start, not of the
        service."""
        try:
            self._start()
            self._not_started = None
        except OSError as error:
            self._not_started = f"no process could be started: {error.strerror or error}"

    def _restart(self, why: str) -> WorkerFailure | News:
        """Start again, with the scan in work if it has an attempt left."""
        scan = self._scan
        self._child.stop()  # the heartbeat waits meanwhile
        self._not_started = None
        self.restarts += 1
        # Back to 0 by a full cloud alone: a worker that starts well and dies at each scan is not well.
        self._fruitless += 1
        if self._fruitless >= MOST_FRUITLESS_STARTS:
            return self._give_up(f"the worker failed {self._fruitless} times in a row, the last time because {why}")
        self._start_again()
        why = f"the worker was started again: {why}"
        # A third process would only keep the diver waiting: the frames can be saved without a cloud.
        if scan.attempts >= MOST_ATTEMPTS:
            return self._give_up(why)
        if scan.wanted:
            scan.attempts += 1
            scan.missed = True
            if scan.finishing:
                self._tell_again()
                self._send(Finish())
        return WorkerFailure(why)

    def _give_up(self, why: str) -> WorkerFailure | News:
        """Give up the scan in work.

        That it is lost is told once its frames are all there: before, nobody waits for its points.
        """
        scan = self._scan
        scan.given_up = why
        if not scan.finishing:
            return WorkerFailure(why)
        scan.wanted = scan.finishing = False
        return News(scan.number, ReconstructionFailure(Fault(FaultCode.RECONSTRUCTION_FAILED, why)))
