"""The parent's end of the worker, a warm process in which scans are reconstructed.

    ReconstructionWorker    the parent's end
    ScanInWork              the latest scan
    LiveImageRequests       live images for the worker: one at a time, the latest, a third of a processor at most

In a process of its own, computing never delays a vertical blank. The parent sends small messages; frames and points are
in shared memory. A worker that dies, hangs or takes too much memory is killed and started again, and its scan is
processed again from the raw frames. The child's side is ``serve``; ``Liveness`` checks that it makes progress.
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
"""Least time between two images, and the largest share of a processor for evaluating them."""
LIMIT_S = 5.0
"""Longest wait for an answer before another image is sent."""


class LiveImageRequests:
    """Decides when a live image may be sent to the worker. Called by one thread."""

    def __init__(self) -> None:
        self._taken_ns: int | None = None
        """Time of the image whose answer is awaited; ``None``: none is."""
        self._from_ns = 0
        """Time from which the next one may be sent."""

    def may(self, now_ns: int) -> bool:
        """Return True if an image may be sent now."""
        return now_ns >= self._from_ns

    def ask(self, shape: tuple[int, int], belongs_to: int, now_ns: int) -> LookAt:
        """Return the order for an image (h, w) in the shared memory, for an object of that number."""
        self._taken_ns, self._from_ns = now_ns, now_ns + round(LIMIT_S * 1e9)
        return LookAt(now_ns, shape, belongs_to)

    def awaits(self, answer: LiveGuidance) -> bool:
        """Record an answer; return False if it is outdated."""
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
"""Largest number of consecutive starts without a cloud; then the worker stays down until the next scan."""
POLL_S = 0.002
MOST_PASSED_OVER = 32
"""Largest number of messages without an event that one poll reads; a scan has some ten."""
PING_S = 1.0
"""Time between two pings to an idle worker."""

WorkerEvent = Ready | News | LiveGuidance | WorkerFailure


@dataclass(slots=True)
class ScanInWork:
    """The latest scan."""

    number: int = 0
    orders: tuple[Begin, ...] = ()
    """Order of its sequence, and of its second one, if there is one."""
    is_wanted: bool = False
    """True while its results are needed."""
    is_finishing: bool = False
    """True if all frames of the sequence are there, and the cloud is awaited."""
    is_unsent: bool = False
    """True if the worker was started again since: it needs all frames announced once more."""
    has_cloud: bool = False
    """True if this process made the full cloud: a second sequence can follow without the frames of the first."""
    attempts: int = 1
    failure: str | None = None
    """Reason why it gets no cloud."""


class ReconstructionWorker:
    """The parent's end. A context manager; one thread calls ``poll``, camera threads may call ``frame``."""

    def __init__(self, order: WorkOrder, store: FrameStore, clock: Clock, limits: WorkLimits | None = None) -> None:
        self.order = order
        """Setup of the worker; ``change`` starts it with another."""
        self.limits = limits or WorkLimits()
        """May be replaced at any time; the memory that the process may allocate is fixed when it starts."""
        self.restarts = 0
        """Number of times that the process had to be started again."""
        self.coarse: Cloud | None = None
        """Points of the last ``CoarseCloud``, until another scan begins."""
        self.full: Cloud | None = None
        """Points of the last ``FullCloud`` or ``Bracket``, until another scan begins; ``None`` if both have none."""
        self._store, self._clock = store, clock
        left = order.calibration.rig.left
        self._memory = ParentMemory(left.width_px, left.height_px)
        self._child = ChildProcess("kf-reconstruct", work)
        self._liveness = Liveness(clock, self._used_s)
        self._image_requests = LiveImageRequests()
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
        """Id of the process; ``None`` while there is none."""
        return self._child.pid

    @property
    def answers(self) -> bool:
        """False if the process is stuck and ``poll`` should have noticed it."""
        # With a later limit than in `poll`: the watchdog must not act before the restart.
        return not self._child.runs or self._liveness.late(self.limits.alive_s) is None

    def gets_on(self) -> bool:
        """Return True if the first start, still under way, has used processor time since the last call."""
        # For the first start only: the self-test waits for it, and a start that failed before may fail for ever.
        return self._starting and not self._fruitless and self._child.runs and self._liveness.computed()

    # ------------------------------------------------------------------------------------- orders

    def change(self, order: WorkOrder, store: FrameStore | None = None) -> None:
        """Start again with another calibration, water or sequence, for cameras of the same size.

        The current scan is dropped. ``store``: the memory for frames of another sequence; the old one is no longer
        used.
        """
        self.drop()
        self.order = order
        self._store = store or self._store
        self._fruitless = 0
        self._child.stop()
        self._start_again()

    def begin(self, scan: int, settings: AcquisitionSettings | None = None, belongs_to: int | None = None) -> None:
        """Expect a new scan's frames with these settings (``None``: the defaults).

        ``belongs_to``: number of its object.
        """
        self._image_requests.stop()
        self.coarse = self.full = None
        settings = settings or AcquisitionSettings(noise=self.order.noise)
        self._take_in_work(
            ScanInWork(scan, (Begin(self._ticket + 1, settings, belongs_to=belongs_to),), is_wanted=True)
        )
        self._send(self._scan.orders[0])

    def begin_second(self, scan: int, settings: AcquisitionSettings) -> None:
        """Expect a second sequence's frames, of the latest ``scan``, whose first ones are still in the store.

        After ``finish``, news of one ``Bracket`` answer.
        """
        second = Begin(self._ticket + 1, settings, second=True)
        first = replace(self._scan.orders[0], ticket=second.ticket)
        self._take_in_work(ScanInWork(scan, (first, second), is_wanted=True, has_cloud=self._scan.has_cloud))
        # A process that was started since has no results of the first sequence, and makes them from its frames.
        if not self._scan.has_cloud:
            self._announce(first)
        self._send(second)

    def _take_in_work(self, scan: ScanInWork) -> None:
        self._scan = scan
        self._ticket += 1
        if not self._child.runs:
            self._fruitless = 0
            self._start_again()

    def frame(self, side: str, index: int) -> None:
        """Announce frame ``index`` of ``side``, which is in the store, for the latest sequence."""
        # For a process that was started meanwhile, `finish` announces all frames, beginning with frame 0.
        if not self._scan.is_unsent:
            self._send(FrameStored(side, index))

    def finish(self) -> None:
        """Request the results, as all frames are there and the ledger agrees.

        The last fact is the full cloud, or that the scan is lost.
        """
        scan = self._scan
        if not scan.is_wanted:
            return
        scan.is_finishing = True
        if scan.failure is not None:
            return
        self._expect()
        if scan.is_unsent:
            self._announce_again()
        self._send(Finish())

    def drop(self) -> None:
        """Drop the latest scan."""
        self._scan.is_wanted = self._scan.is_finishing = False
        self._expect()
        self._send(Drop())

    def keep(self) -> None:
        """Let the next scan be compared with the latest one, which the diver keeps.

        A process that was started since does not have it; then the next one is not compared.
        """
        self._send(Keep())

    def reprocess(self, scan: int, settings: AcquisitionSettings | None = None) -> None:
        """Reconstruct the frames in the store from the first on."""
        self.begin(scan, settings)
        self._announce_again()
        self.finish()

    def look(self, picture: NDArray[np.uint8], belongs_to: int) -> bool:
        """Send the latest live image, (h, w) uint8, for guidance to the next scan of an object.

        ``LiveGuidance`` answers, unless a scan begins before. Returns False if the image was not sent: the process is
        not ready, is busy, still evaluates the last one, or has used its share of a processor.
        """
        now_ns = self._clock.now_ns()
        if not self._image_requests.may(now_ns) or not self._child.runs or self._starting or self._scan.is_finishing:
            return False
        self._send(self._image_requests.ask(self._memory.put(picture), belongs_to, now_ns))
        return True

    def _announce_again(self) -> None:
        """Announce all frames of the scan again."""
        self._scan.is_unsent = False
        for order in self._scan.orders:
            self._announce(order)

    def _announce(self, order: Begin) -> None:
        self._send(order)
        for index in range(self._store.shape[0]):
            for side in SIDES:
                self._send(FrameStored(side, index))

    def _send(self, message: ToWorker) -> None:
        self._child.send(message)  # both camera threads and the service's do

    # ------------------------------------------------------------------------------------- answers

    def poll(self) -> WorkerEvent | None:
        """Return the next event, or ``None``; never waits.

        Restarts a worker that died or exceeded its limits, and reports that once. The service calls this in each cycle.
        """
        if self._scan.is_finishing and self._scan.failure is not None:
            return self._give_up(self._scan.failure)
        if not self._child.runs:
            return self._restart(self._not_started) if self._not_started is not None else None
        # Messages without an event are skipped at once: at a cycle for each, an answer behind ten of them would be
        # 0.2 s late.
        for _ in range(MOST_PASSED_OVER):
            try:
                message = self._child.receive()
            except ChildGone as gone:
                return self._restart(str(gone))
            if message is None:
                return self._check()
            event = self._handle(message)
            if event is not None:
                return event
        return None

    def wait(self, timeout_s: float) -> WorkerEvent | None:
        """Poll for up to ``timeout_s``, for programs without a cycle; return the first event, or ``None``."""
        end_ns = self._clock.now_ns() + int(timeout_s * 1e9)
        while True:
            event = self.poll()
            if event is not None or self._clock.now_ns() >= end_ns:
                return event
            self._clock.sleep_s(POLL_S)

    def _handle(self, message: object) -> WorkerEvent | None:
        """Process a message, and return its event, if any."""
        event: WorkerEvent | None = None
        match message:
            case Ready():
                self._starting, event = False, message
            case Pong():
                pass
            case LiveGuidance():
                event = message if self._image_requests.awaits(message) else None
            case News(ticket, fact):
                event = self._news(fact) if ticket == self._ticket else None
            case WorkerFailure(text):
                return self._restart(f"it failed: {text}")
            case _:
                return self._restart(f"it sent a {type(message).__name__}, no valid answer")
        self._expect()
        return event

    def _news(self, fact: SequenceFact) -> WorkerEvent | None:
        """Process a fact about the current scan, and return its event, if any."""
        scan = self._scan
        match fact:
            case ReconstructionFailure(fault):
                return self._give_up(fault.detail)
            case WorkProgress():
                return None
            case _ if not scan.is_wanted:
                return None
            case PatternIdentity(judgement) if judgement.fault is not None:
                scan.is_wanted = scan.is_finishing = False
            case CoarseCloud(found):
                self.coarse = self._memory.coarse(found)
            case FullCloud(found) | Bracket(found):
                self.full = None  # first, since the new one may need its memory
                if found is not None:
                    self.full = self._memory.full(found)
                self._send(CloudCopied(self._ticket))
                scan.is_finishing, scan.has_cloud, self._fruitless = False, True, 0
            case _:
                pass
        return News(scan.number, fact)

    # ------------------------------------------------------------------------------------- its life

    def _expect(self) -> None:
        """Set the limits for the process's next answer."""
        if self._starting:
            return  # a start has its own limit, whatever is requested meanwhile
        if self._scan.is_finishing:
            self._liveness.owe(self.limits.cloud_s, self.limits.computing_s)
        else:
            self._liveness.rest()

    def _check(self) -> WorkerFailure | News | None:
        """Restart a process that is stuck or too large; ping one that is idle."""
        why = self._liveness.late() or self._too_large()
        if why is not None:
            return self._restart(why)
        # Only while idle: a worker that computes reads no messages.
        if self._liveness.rested_s > PING_S:
            self._send(Ping())
            self._liveness.owe(self.limits.alive_s, self.limits.computing_s)
        return None

    def _too_large(self) -> str | None:
        now_ns = self._clock.now_ns()
        if self.pid is None or now_ns < self._memory_check_ns:
            return None
        self._memory_check_ns = now_ns + int(MEMORY_CHECK_S * 1e9)
        # Only the start has another limit: it may have to compile kernels.
        most_mb = self.limits.start_memory_mb if self._starting else self.limits.memory_mb
        # None: it has just ended, which the pipe will show.
        used_mb = own_memory_mb(self.pid)
        if used_mb is None or used_mb <= most_mb:
            return None
        return f"it took {used_mb:.0f} MB of memory; allowed are {most_mb:.0f} MB"

    def _used_s(self) -> float:
        return (cpu_s(self.pid) if self.pid is not None else None) or 0.0

    def _start(self) -> None:
        order = self.order
        self._image_requests.stop()
        self._child.start(
            encode_calibration(order.calibration),
            order.water,
            order.sequence,
            order.noise,
            (self._store.name, *self._store.shape),
            self._memory.name,
            self.limits.memory_mb,
        )
        self._starting, self._scan.has_cloud = True, False
        self._liveness.owe(self.limits.start_s, self.limits.start_s)

    def _start_again(self) -> None:
        """Start the process; a lack of resources fails this start, not the service."""
        try:
            self._start()
            self._not_started = None
        except OSError as error:
            self._not_started = f"no process could be started: {error.strerror or error}"

    def _restart(self, why: str) -> WorkerFailure | News:
        """Start again, with the current scan if it has an attempt left."""
        scan = self._scan
        self._child.stop()  # the service's cycle waits meanwhile
        self._not_started = None
        self.restarts += 1
        # Reset only by a full cloud: a worker that starts and then dies at each scan does not count as healthy.
        self._fruitless += 1
        if self._fruitless >= MOST_FRUITLESS_STARTS:
            return self._give_up(f"the worker failed {self._fruitless} times in a row, the last time because {why}")
        self._start_again()
        why = f"the worker was started again: {why}"
        # A third attempt would only keep the diver waiting: the frames can be saved without a cloud.
        if scan.attempts >= MOST_ATTEMPTS:
            return self._give_up(why)
        if scan.is_wanted:
            scan.attempts += 1
            scan.is_unsent = True
            if scan.is_finishing:
                self._announce_again()
                self._send(Finish())
        return WorkerFailure(why)

    def _give_up(self, why: str) -> WorkerFailure | News:
        """Give up the current scan.

        The loss is reported once all its frames are there: before, its points are not awaited.
        """
        scan = self._scan
        scan.failure = why
        if not scan.is_finishing:
            return WorkerFailure(why)
        scan.is_wanted = scan.is_finishing = False
        return News(scan.number, ReconstructionFailure(Fault(FaultCode.RECONSTRUCTION_FAILED, why)))
