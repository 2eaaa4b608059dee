"""Owns the warm process in which scans are reconstructed, so that computing never delays a vertical blank.

The parent sends small messages; pixels stay in the shared frame store and points come back through shared memory.
A worker that dies, does not answer in time or takes too much memory is killed and started again, and the scan it had is
processed again from the raw frames, which are untouched by all of that. The child's side is ``serve``.
"""

from __future__ import annotations

from dataclasses import dataclass
from multiprocessing.shared_memory import SharedMemory
from types import TracebackType

import numpy as np
from numpy.typing import NDArray

from appliance.calibration.file import encode
from appliance.capture.store import FrameStore
from appliance.reconstruct.table import Cloud, Found
from appliance.scan.acquisition import AcquisitionSettings
from appliance.scan.fault import Fault, FaultCode
from appliance.scan.overlap import Overlap
from appliance.scan.sides import SIDES
from appliance.scan.verdict import Judgement
from appliance.worker.child import ChildGone, ChildProcess
from appliance.worker.cloud_memory import CloudMemory
from appliance.worker.live_picture import LivePicture
from appliance.worker.looking import LiveLookedAt, Looking
from appliance.worker.messages import (
    Begin,
    BracketJudged,
    CloudCopied,
    CloudFound,
    Crashed,
    Drop,
    Finish,
    FrameStored,
    FromWorker,
    GoingOn,
    Keep,
    Loaded,
    LookedAt,
    OverlapFound,
    PatternsIdentified,
    Ping,
    Pong,
    Ready,
    SequenceFailed,
    SequenceJudged,
    Spoiled,
    ToWorker,
)
from appliance.worker.order import WorkLimits, WorkOrder
from appliance.worker.serve import work
from appliance.worker.shared_points import SharedPoints
from appliance.worker.usage import cpu_s, own_memory_mb
from drivers.api import Clock

STOP_TIMEOUT_S = 2.0
MEMORY_CHECK_S = 0.5
MOST_ATTEMPTS = 2
"""Largest number of attempts at one scan."""
MOST_FRUITLESS_STARTS = 4
"""Largest number of starts in a row without a cloud in between; then the worker stays down until the next scan begins."""
POLL_S = 0.002
MOST_PASSED_OVER = 32
"""Largest number of messages that one poll passes over because nothing is to be told of them; a scan has some ten."""
PING_S = 1.0
"""Time between two questions to a worker with nothing to do whether it is there."""
COMPUTING_SHARE = 0.05
"""Share of the time that a worker uses a processor if it gets on; one that hangs uses none."""
PROGRESS_CHECK_S, PROGRESS_CPU_S = 2.0, 0.1
"""Time between two looks at a start, and the processor time that it takes meanwhile if it gets on."""


@dataclass(frozen=True, slots=True)
class WorkerReady:
    """The kernels are loaded and the buffers allocated."""


@dataclass(frozen=True, slots=True)
class SequenceIdentified:
    """Every frame shows the pattern it should; points follow."""

    scan: int


@dataclass(frozen=True, slots=True)
class CloudReady:
    scan: int
    """The number given to ``begin``."""
    full: bool
    """False: the coarse cloud."""
    cloud: Cloud
    cpu_s: float
    """CPU time the worker spent on this step."""


@dataclass(frozen=True, slots=True)
class ScanJudged:
    """The judges' word on a scan, in place of what they said of it before."""

    scan: int
    judgements: tuple[Judgement, ...]
    cpu_s: float
    """CPU time the worker spent on judging."""


@dataclass(frozen=True, slots=True)
class ScanSpoiled:
    """The scan gets no cloud: its frames are not what they should be."""

    scan: int
    judgement: Judgement
    """Judgement of the patterns; its fault is never ``None``."""


@dataclass(frozen=True, slots=True)
class PairJudged:
    """The outcome of a second sequence."""

    scan: int
    """The number given to ``begin``."""
    second: tuple[Judgement, ...]
    """The judges' word on the second sequence alone."""
    pair: Judgement
    """Judgement of both sequences; with a fault there is no cloud."""
    cloud: Cloud | None
    """Cloud of both sequences."""
    cpu_s: float


@dataclass(frozen=True, slots=True)
class ScanCompared:
    """It is known how much of a scan lies on the one before."""

    scan: int
    overlap: Overlap
    cpu_s: float


@dataclass(frozen=True, slots=True)
class WorkerFailed:
    """The worker is being started again, or has given up."""

    scan: int | None
    """The scan that gets no cloud; ``None``: none is lost, a scan in work is processed again."""
    fault: Fault


WorkerEvent = (
    WorkerReady
    | SequenceIdentified
    | CloudReady
    | ScanJudged
    | ScanSpoiled
    | PairJudged
    | ScanCompared
    | LiveLookedAt
    | WorkerFailed
)


class ReconstructionWorker:
    """The parent's end. A context manager; one thread calls ``poll``, camera threads may call ``frame``."""

    def __init__(self, order: WorkOrder, store: FrameStore, clock: Clock, limits: WorkLimits | None = None) -> None:
        self.order = order
        """The order that it was started for; ``change`` starts it for another."""
        self._store = store
        self._clock = clock
        self.limits = limits or WorkLimits()
        """May be replaced at any time; what it can still ask for is fixed when it starts."""
        left = order.calibration.rig.left
        self._points = SharedPoints(left.width_px, left.height_px)
        self._results = SharedMemory(create=True, size=self._points.size_bytes)
        self._clouds = CloudMemory(self._points.capacity)
        self._child = ChildProcess("kf-reconstruct", work)
        self._starting = False
        self._deadline_ns: int | None = None
        self._alive_ns = 0
        """Time at which it said something last, or was asked to."""
        self._ping_sent = False
        self._memory_check_ns = 0
        self._loaded_by_ns: int | None = None
        """Time by which a process that is ready has loaded what only some scans need; ``None``: it has."""
        self._progress_check_ns = 0
        self._start_cpu_s = 0.0
        self._patience_ns = 0
        """Longest wait for a step that computes."""
        self._step_cpu_s = 0.0
        """Processor time when the deadline was set."""
        self._scan: int | None = None
        self._settings = AcquisitionSettings(noise=order.noise)
        self._belongs_to: int | None = None
        """Number of the scan's object; ``None``: it is part of none."""
        self._second: AcquisitionSettings | None = None
        """Settings of the scan's second sequence; ``None``: there is none, or not yet."""
        self._knows_first = False
        """This process found the scan's full cloud: a second sequence can follow without the frames of the first."""
        self._ticket = 0
        """Counts the scans begun; what the worker says of an earlier one is of no interest."""
        self._finishing = False
        """All frames of the scan are there, and the cloud is awaited."""
        self._missed = False
        """The worker was started again since the scan began: it must be told of all frames once more."""
        self._attempts = self._fruitless = 0
        self._given_up: str | None = None
        """Reason why the scan in work gets no cloud."""
        self._looking = Looking()
        self._not_started: str | None = None
        """Reason why there is no process although there should be one."""
        self.restarts = 0
        """Number of times that the process had to be started again."""

    def __enter__(self) -> ReconstructionWorker:
        try:
            self._start()
        except BaseException:
            self._release()
            raise
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._child.stop(STOP_TIMEOUT_S)
        self._release()

    def _release(self) -> None:
        self._results.close()
        self._results.unlink()

    @property
    def pid(self) -> int | None:
        """Number of the process; ``None`` while there is none."""
        return self._child.pid

    @property
    def answers(self) -> bool:
        """It keeps its times, or it is known not to be there; false where ``poll`` should have seen that it does not."""
        if not self._child.runs:
            return True
        # Later than `poll` itself would be: this is for the watchdog, which must not act before the restart does.
        now_ns, grace_ns = self._clock.now_ns(), int(self.limits.alive_s * 1e9)
        if self._deadline_ns is not None:
            return now_ns <= self._deadline_ns + grace_ns
        return not self._ping_sent or now_ns - self._alive_ns <= 2 * grace_ns

    def gets_on(self) -> bool:
        """Tell whether the first start, still under way, took processor time since it was looked at last; one that
        hangs takes none. False also where that was only just asked."""
        now_ns = self._clock.now_ns()
        # Of the first start only: the self-test waits for that one, and a start that failed before may fail for ever.
        if not self._starting or self._fruitless or self.pid is None or now_ns < self._progress_check_ns:
            return False
        self._progress_check_ns = now_ns + int(PROGRESS_CHECK_S * 1e9)
        before_s, self._start_cpu_s = self._start_cpu_s, self._used_s()
        return self._start_cpu_s - before_s >= PROGRESS_CPU_S

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
        """A new scan's frames will follow, taken so (``None``: as always). ``belongs_to``: number of its object."""
        self._belongs_to = belongs_to
        self._settings = settings or AcquisitionSettings(noise=self.order.noise)
        self._second, self._knows_first = None, False
        self._looking.stop()
        self._take_in_work(scan)
        self._send(Begin(self._ticket, self._settings, belongs_to=belongs_to))

    def look(self, picture: NDArray[np.uint8], belongs_to: int) -> bool:
        """Hand over the latest live picture, (h, w) uint8, of a diver who aims at the next scan of an object; ``LiveLookedAt`` answers, unless a scan
        begins before.

        Returns False where it was not taken: the process is not ready, has something else to do, still looks at the last one, or has taken as much
        of a processor as it may.
        """
        now_ns = self._clock.now_ns()
        if not self._looking.may(now_ns) or not self._child.runs or self._starting or self._finishing:
            return False
        shape = LivePicture(self._results.buf, self._points.capacity).put(picture)
        self._send(self._looking.ask(shape, belongs_to, now_ns))
        return True

    def keep(self) -> None:
        """The diver keeps the scan begun last: the next one is compared with it.

        A process that was started since knows nothing of it; then nothing is said of the next one.
        """
        self._send(Keep())

    def begin_second(self, scan: int, settings: AcquisitionSettings) -> None:
        """A second sequence's frames will follow, of the ``scan`` begun last, whose first ones are still in the store.

        After ``finish``, one event PairJudged answers.
        """
        self._second = settings
        self._take_in_work(scan)
        # The process was started since: it has neither maps nor cloud of the first sequence, and makes them from the
        # frames.
        if not self._knows_first:
            self._tell_first()
        self._send(Begin(self._ticket, settings, second=True))

    def _take_in_work(self, scan: int) -> None:
        self._scan, self._finishing, self._missed, self._attempts = scan, False, False, 1
        self._given_up = None
        self._ticket += 1
        if not self._child.runs:
            self._fruitless = 0
            self._start_again()

    def frame(self, side: str, index: int) -> None:
        """Frame ``index`` of ``side`` is in the store, in the place of the sequence begun last."""
        # A process that was started meanwhile is told of all frames at once by `finish`: one of the middle would be no
        # frame 0 to it.
        if not self._missed:
            self._send(FrameStored(side, index))

    def finish(self) -> None:
        """All frames are there and the ledger agrees: answer with the coarse, then the full cloud, or that the scan is lost."""
        if self._scan is None:
            return
        self._finishing = True
        if self._given_up is not None:
            return
        if self._missed:
            self._tell_again()
        if not self._starting:  # else from the moment it is ready
            self._await_cloud()
        self._send(Finish())

    def drop(self) -> None:
        """Forget the scan that was begun."""
        self._scan, self._finishing = None, False
        if not self._starting:
            self._deadline_ns = None
        self._send(Drop())

    def reprocess(self, scan: int, settings: AcquisitionSettings | None = None) -> None:
        """Reconstruct the frames in the store from the first on."""
        self.begin(scan, settings)
        self._tell_again()
        self.finish()

    def poll(self) -> WorkerEvent | None:
        """Return the next event, or ``None``. Restarts a worker that died or exceeded its limits, and reports that
        once.

        Never waits: the caller is the heartbeat.
        """
        if self._finishing and self._given_up is not None:
            return self._give_up(self._given_up)
        if not self._child.runs:
            return self._restart(self._not_started) if self._not_started is not None else None
        # What needs no answer is passed over here and now: at a heartbeat for each, an answer behind ten of them would come 0.2 s late.
        for _ in range(MOST_PASSED_OVER):
            try:
                message = self._child.receive()
            except ChildGone as gone:
                return self._restart(str(gone))
            now_ns = self._clock.now_ns()
            if message is None:
                return self._check_answer(now_ns) or self._check_memory(now_ns)
            # Whatever it says is a sign of life.
            self._alive_ns, self._ping_sent = now_ns, False
            event = self._heard(message)
            if event is not None:
                return event
        return None

    def _heard(self, message: object) -> WorkerEvent | None:
        """Note what the process said, and return what is to be told of it."""
        match message:
            case Ready():
                self._deadline_ns, self._starting = None, False
                if self._finishing:
                    self._await_cloud()
                return WorkerReady()
            case Loaded():
                self._loaded_by_ns = None
                return None
            case Pong():
                return None
            case LookedAt() as answer:
                return self._looking.answered(answer)
            case Crashed(text):
                return self._restart(f"it failed: {text}")
            case (
                GoingOn(ticket) | PatternsIdentified(ticket) | Spoiled(ticket) | CloudFound(ticket) | SequenceJudged(ticket)
                | BracketJudged(ticket) | OverlapFound(ticket) | SequenceFailed(ticket)
            ) as message:  # fmt: skip
                return self._event_of(self._scan, message) if ticket == self._ticket else None
            case _:
                return self._restart(f"it sent a {type(message).__name__}, which is no answer")

    def _event_of(self, scan: int | None, message: FromWorker) -> WorkerEvent | None:
        """Turn what was said of the ``scan`` in work into an event; ``None``: the scan was dropped meanwhile, or nothing is to be told."""
        match message:
            case GoingOn():
                if self._deadline_ns is not None:
                    self._await_cloud()
                return None
            case SequenceFailed(_, text):
                self._deadline_ns = None
                return self._give_up(text)
            case _ if scan is None:
                return None
            case PatternsIdentified():
                return SequenceIdentified(scan)
            case SequenceJudged(_, judgements, cpu_s):
                if self._finishing:
                    self._await_cloud()  # it got so far; what follows may be more than on other scans
                return ScanJudged(scan, judgements, cpu_s)
            case OverlapFound(_, overlap, cpu_s):
                return ScanCompared(scan, overlap, cpu_s)
            case CloudFound(_, full, found, cpu_s):
                return self._cloud_found(scan, full, found, cpu_s)
            case BracketJudged(_, found, second, pair, cpu_s):
                return self._bracket_judged(scan, found, second, pair, cpu_s)
            case Spoiled(_, judgement):
                self._scan, self._finishing, self._deadline_ns = None, False, None
                return ScanSpoiled(scan, judgement)
            case _:
                return None

    def wait(self, timeout_s: float) -> WorkerEvent | None:
        """Poll for up to ``timeout_s``, for programs without a heartbeat; return the first event, ``None``: there was none."""
        end_ns = self._clock.now_ns() + int(timeout_s * 1e9)
        while True:
            event = self.poll()
            if event is not None or self._clock.now_ns() >= end_ns:
                return event
            self._clock.sleep_s(POLL_S)

    def _await_cloud(self) -> None:
        now_ns = self._clock.now_ns()
        self._deadline_ns = now_ns + int(self.limits.cloud_s * 1e9)
        self._patience_ns = now_ns + int(self.limits.computing_s * 1e9)
        self._step_cpu_s = self._used_s()

    def _used_s(self) -> float:
        return (cpu_s(self.pid) if self.pid is not None else None) or 0.0

    def _computes(self, now_ns: int) -> bool:
        """Tell whether the step that is late uses the processor, and may go on: then its deadline is a new one."""
        # A start has its own, longer limit; and a computation that goes on for ever is cut off all the same.
        if self._starting or now_ns >= self._patience_ns:
            return False
        before_s, self._step_cpu_s = self._step_cpu_s, self._used_s()
        if self._step_cpu_s - before_s < COMPUTING_SHARE * self.limits.cloud_s:
            return False
        self._deadline_ns = now_ns + int(self.limits.cloud_s * 1e9)
        return True

    def _loads(self, now_ns: int) -> bool:
        """Tell whether a process that is ready, but has not loaded everything yet, was at it since it was asked or looked at last."""
        if self._loaded_by_ns is None or now_ns > self._loaded_by_ns:
            return False
        before_s, self._step_cpu_s = self._step_cpu_s, self._used_s()
        return self._step_cpu_s - before_s >= COMPUTING_SHARE * self.limits.alive_s

    def _tell_again(self) -> None:
        """Tell the process of all frames of the scan, from the first on."""
        self._missed = False
        self._tell_first()
        if self._second is not None:
            self._send(Begin(self._ticket, self._second, second=True))
            self._tell_frames()

    def _tell_first(self) -> None:
        self._send(Begin(self._ticket, self._settings, belongs_to=self._belongs_to))
        self._tell_frames()

    def _tell_frames(self) -> None:
        for index in range(self._store.shape[0]):
            for side in SIDES:
                self._send(FrameStored(side, index))

    def _check_answer(self, now_ns: int) -> WorkerFailed | None:
        """Tell whether it is late with what was asked, or with a sign of life."""
        if self._deadline_ns is not None:
            if now_ns <= self._deadline_ns or self._computes(now_ns):
                return None
            return self._restart("it did not answer in time")
        waited_s = (now_ns - self._alive_ns) / 1e9
        # Asked only while nothing is awaited: a worker that computes reads no messages.
        if self._ping_sent and waited_s > self.limits.alive_s:
            # It reads no messages while it loads a piece; in the worst case that is compiled first.
            if self._loads(now_ns):
                self._alive_ns = now_ns
                return None
            return self._restart(f"it gave no sign of life for {self.limits.alive_s:g} s")
        if not self._ping_sent and waited_s > PING_S:
            self._alive_ns, self._ping_sent = now_ns, True
            self._step_cpu_s = self._used_s()
            self._send(Ping())
        return None

    def _check_memory(self, now_ns: int) -> WorkerFailed | None:
        if self.pid is None or now_ns < self._memory_check_ns:
            return None
        self._memory_check_ns = now_ns + int(MEMORY_CHECK_S * 1e9)
        # A process that has to compile does so before it is ready; loading what is compiled takes no more than scans do.
        most_mb = self.limits.start_memory_mb if self._starting else self.limits.memory_mb
        # None: it has just ended, which the pipe will say.
        used_mb = own_memory_mb(self.pid)
        if used_mb is None or used_mb <= most_mb:
            return None
        return self._restart(f"it took {used_mb:.0f} MB of memory; allowed are {most_mb:.0f} MB")

    def _cloud_found(self, scan: int, full: bool, found: Found, cpu_s: float) -> CloudReady:
        # No reference to the memory may outlive this call: it could not be closed.
        if not full:
            return CloudReady(scan, full, self._points.coarse(self._results.buf).cloud(found), cpu_s)
        cloud = self._clouds.copied(self._points.full(self._results.buf), found)
        self._send(CloudCopied(self._ticket))
        self._finishing, self._deadline_ns, self._fruitless = False, None, 0
        self._knows_first = True
        return CloudReady(scan, full, cloud, cpu_s)

    def _bracket_judged(
        self, scan: int, found: Found | None, second: tuple[Judgement, ...], pair: Judgement, cpu_s: float
    ) -> PairJudged:
        cloud = None if found is None else self._clouds.copied(self._points.full(self._results.buf), found)
        self._send(CloudCopied(self._ticket))
        self._finishing, self._deadline_ns, self._fruitless, self._knows_first = False, None, 0, True
        return PairJudged(scan, second, pair, cloud, cpu_s)

    def _send(self, message: ToWorker) -> None:
        self._child.send(message)  # both camera threads and the service's do

    def _start(self) -> None:
        order = self.order
        self._looking.stop()
        self._child.start(
            encode(order.calibration),
            order.water,
            (order.period_px, order.projector_width_px, order.projector_height_px),
            order.noise,
            (self._store.name, *self._store.shape),
            self._results.name,
            self.limits.memory_mb,
        )
        self._starting, self._knows_first = True, False
        self._alive_ns, self._ping_sent = self._clock.now_ns(), False
        self._deadline_ns = self._loaded_by_ns = self._alive_ns + int(self.limits.start_s * 1e9)
        self._start_cpu_s = 0.0

    def _start_again(self) -> None:
        """A machine that has no room for another process now is a failure of this start, not of the service."""
        try:
            self._start()
            self._not_started = None
        except OSError as error:
            self._not_started = f"no process could be started: {error.strerror or error}"

    def _restart(self, why: str) -> WorkerFailed:
        """Start again, with the scan in work if it has an attempt left."""
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
        if self._attempts >= MOST_ATTEMPTS:
            return self._give_up(why)
        if self._scan is not None:
            self._attempts += 1
            self._missed = True
            if self._finishing:
                self._tell_again()
                self._send(Finish())
        return _failed(None, why)

    def _give_up(self, why: str) -> WorkerFailed:
        """Give up the scan in work. That it is lost is told once its frames are all there: before, nobody waits for its points."""
        self._given_up = why
        if not self._finishing:
            return _failed(None, why)
        lost, self._scan, self._finishing = self._scan, None, False
        return _failed(lost, why)


def _failed(scan: int | None, why: str) -> WorkerFailed:
    return WorkerFailed(scan, Fault(FaultCode.RECONSTRUCTION_FAILED, why))
