"""Owns the warm process in which scans are reconstructed, so that computing never delays a vertical blank.

The parent sends small messages; pixels stay in the shared frame store and points come back through shared memory.
A worker that dies, does not answer in time or takes too much memory is killed and started again, and the scan it had is
processed again from the raw frames, which are untouched by all of that. The child's side is ``serve``.
"""

from __future__ import annotations

import multiprocessing
import threading
from dataclasses import dataclass
from multiprocessing.connection import Connection
from multiprocessing.shared_memory import SharedMemory
from types import TracebackType

from appliance.calibration.file import Calibration, encode
from appliance.capture.store import FrameStore
from appliance.optics.water import Water
from appliance.reconstruct.table import POINT_BYTES, Cloud, Found, PointTable
from appliance.scan.acquisition import AcquisitionSettings
from appliance.scan.fault import Fault, FaultCode
from appliance.scan.noise import TYPICAL_PAIR, StereoNoise
from appliance.scan.sides import SIDES
from appliance.scan.verdict import Judgement
from appliance.verdict.window import Windows
from appliance.worker.serve import work
from appliance.worker.usage import cpu_s, own_memory_mb
from drivers.api import Clock

STOP_TIMEOUT_S = 2.0
MEMORY_CHECK_S = 0.5
MOST_ATTEMPTS = 2
"""Of one scan."""
MOST_FRUITLESS_STARTS = 4
"""In a row, without a cloud in between; then the worker stays down until the next scan begins."""
POLL_S = 0.002
PING_S = 1.0
"""How often a worker with nothing to do is asked whether it is there."""
COMPUTING_SHARE = 0.05
"""Of the time, that a worker uses a processor if it gets on; one that hangs uses none."""
PROGRESS_CHECK_S, PROGRESS_CPU_S = 2.0, 0.1
"""How often a start is looked at, and the processor time that it takes meanwhile if it gets on."""


@dataclass(frozen=True, slots=True)
class WorkOrder:
    """Everything a worker must know to reconstruct scans; another order needs another worker."""

    calibration: Calibration
    water: Water
    period_px: int
    projector_width_px: int
    projector_height_px: int
    noise: StereoNoise = TYPICAL_PAIR
    """Of the cameras as they are set."""


@dataclass(frozen=True, slots=True)
class WorkLimits:
    """What a worker may take; beyond, it is started again."""

    start_s: float = 240.0
    """A cold start without compiled kernels takes most of a minute, and more on a busy machine."""
    cloud_s: float = 10.0
    """From one step to the next of those that lead from the last frame to the full cloud; a hundred times what they take."""
    computing_s: float = 60.0
    """The same where it is seen to compute: on a processor that is throttled, or shared."""
    alive_s: float = 5.0
    """From a question to its answer while it has nothing to do."""
    memory_mb: float = 600.0
    """Of its own; the shared frames do not count."""
    start_memory_mb: float = 1500.0
    """The same until it is ready: without compiled kernels, the compiler is in it, too."""


@dataclass(frozen=True, slots=True)
class WorkerReady:
    """The kernels are loaded and the buffers allocated."""


@dataclass(frozen=True, slots=True)
class PatternsRight:
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
    """What the judges say of a scan, in place of what they said of it before."""

    scan: int
    judgements: tuple[Judgement, ...]
    windows: Windows | None
    """What it says of the cameras' windows, for who compares scans; ``None``: nothing."""
    cpu_s: float
    """CPU time the worker spent on judging."""


@dataclass(frozen=True, slots=True)
class ScanSpoiled:
    """The scan gets no cloud: its frames are not what they should be."""

    scan: int
    judgement: Judgement
    """Its fault is never ``None``."""


@dataclass(frozen=True, slots=True)
class PairJudged:
    """What became of a second sequence."""

    scan: int
    """The number given to ``begin``."""
    second: tuple[Judgement, ...]
    """On the second sequence alone."""
    pair: Judgement
    """On both; with a fault there is no cloud."""
    cloud: Cloud | None
    """Of both sequences."""
    cpu_s: float


@dataclass(frozen=True, slots=True)
class WorkerFailed:
    """The worker is being started again, or has given up."""

    scan: int | None
    """The scan that gets no cloud; ``None``: none is lost, a scan in work is processed again."""
    fault: Fault


WorkerEvent = WorkerReady | PatternsRight | CloudReady | ScanJudged | ScanSpoiled | PairJudged | WorkerFailed


class ReconstructionWorker:
    """The parent's end. A context manager; one thread calls ``poll``, camera threads may call ``frame``."""

    def __init__(self, order: WorkOrder, store: FrameStore, clock: Clock, limits: WorkLimits | None = None) -> None:
        self.order = order
        """What it was started for; ``change`` starts it for another."""
        self._store = store
        self._clock = clock
        self.limits = limits or WorkLimits()
        """May be replaced at any time; what it can still ask for is fixed when it starts."""
        left = order.calibration.rig.left
        self._capacity = left.width_px * left.height_px
        self._results = SharedMemory(create=True, size=self._capacity * POINT_BYTES)
        self._context = multiprocessing.get_context("spawn")
        self._process: multiprocessing.process.BaseProcess | None = None
        self._pipe: Connection | None = None
        self._sending = threading.Lock()
        self._starting = False
        self._deadline_ns: int | None = None
        self._alive_ns = 0
        """When it said something last, or was asked to."""
        self._asked = False
        self._memory_check_ns = 0
        self._progress_check_ns = 0
        self._start_cpu_s = 0.0
        self._patience_ns = 0
        """How long a step that computes is waited for."""
        self._step_cpu_s = 0.0
        """Processor time when the deadline was set."""
        self._scan: int | None = None
        self._settings = AcquisitionSettings(noise=order.noise)
        self._second: AcquisitionSettings | None = None
        """How the scan's second sequence is taken; ``None``: there is none, or not yet."""
        self._knows_first = False
        """This process found the scan's full cloud: a second sequence can follow without the frames of the first."""
        self._ticket = 0
        """Counts the scans begun; what the worker says of an earlier one is of no interest."""
        self._finishing = False
        """All frames of the scan are there, and the cloud is awaited."""
        self._missed = False
        """The worker was started again since the scan began: it must be told of all frames once more."""
        self._attempts = 0
        self._fruitless = 0
        self._not_started: str | None = None
        """Why there is no process although there should be one."""
        self.restarts = 0
        """How often the process had to be started again."""

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
        self._stop(STOP_TIMEOUT_S)
        self._release()

    def _release(self) -> None:
        self._results.close()
        self._results.unlink()

    @property
    def pid(self) -> int | None:
        """Of the process; ``None`` while there is none."""
        return self._process.pid if self._process is not None else None

    @property
    def answers(self) -> bool:
        """It keeps its times, or it is known not to be there; false where ``poll`` should have seen that it does not."""
        if self._process is None:
            return True
        now_ns, grace_ns = self._clock.now_ns(), int(self.limits.alive_s * 1e9)
        if self._deadline_ns is not None:
            return now_ns <= self._deadline_ns + grace_ns
        return not self._asked or now_ns - self._alive_ns <= 2 * grace_ns

    def gets_on(self) -> bool:
        """The first start is not at its end, but took processor time since it was looked at last; a start that hangs takes
        none. False also where that was only just asked."""
        now_ns = self._clock.now_ns()
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
        self._stop(0.0)
        self._start_again()

    def begin(self, scan: int, settings: AcquisitionSettings | None = None) -> None:
        """A new scan's frames will follow, taken so (``None``: as always)."""
        self._settings = settings or AcquisitionSettings(noise=self.order.noise)
        self._scan, self._finishing, self._missed, self._attempts = scan, False, False, 1
        self._second, self._knows_first = None, False
        self._ticket += 1
        if self._process is None:
            self._fruitless = 0
            self._start_again()
        self._send(("begin", self._ticket, self._settings))

    def begin_second(self, scan: int, settings: AcquisitionSettings) -> None:
        """A second sequence's frames will follow, of the ``scan`` begun last, whose first ones are still in the store.

        After ``finish``, one event PairJudged answers.
        """
        self._scan, self._finishing, self._missed, self._attempts = scan, False, False, 1
        self._second = settings
        self._ticket += 1
        if self._process is None:
            self._fruitless = 0
            self._start_again()
        if not self._knows_first:
            self._tell_first()
        self._send(("begin second", self._ticket, settings))

    def frame(self, side: str, index: int) -> None:
        """Frame ``index`` of ``side`` is in the store, in the place of the sequence begun last."""
        if not self._missed:
            self._send(("frame", side, index))

    def finish(self) -> None:
        """All frames are there and the ledger agrees: answer with the coarse, then the full cloud.

        Nothing happens where the scan was given up before: that was said.
        """
        if self._scan is None:
            return
        self._finishing = True
        if self._missed:
            self._tell_again()
        if not self._starting:  # else from the moment it is ready
            self._await_cloud()
        self._send(("finish",))

    def drop(self) -> None:
        """Forget the scan that was begun."""
        self._scan, self._finishing = None, False
        if not self._starting:
            self._deadline_ns = None
        self._send(("drop",))

    def reprocess(self, scan: int, settings: AcquisitionSettings | None = None) -> None:
        """Reconstruct the frames in the store from the first on."""
        self.begin(scan, settings)
        self._tell_again()
        self.finish()

    def poll(self) -> WorkerEvent | None:
        """The next event, or ``None``. Restarts a worker that died or exceeded its limits, and reports that once.

        Never waits: the caller is the heartbeat.
        """
        pipe, process = self._pipe, self._process
        if pipe is None or process is None:
            return self._restart(self._not_started) if self._not_started is not None else None
        try:
            message = pipe.recv() if pipe.poll(0.0) else None
        except (EOFError, OSError):
            process.join(STOP_TIMEOUT_S)  # it closed its end: it is ending
            return self._restart(f"the process ended with code {process.exitcode}")
        now_ns = self._clock.now_ns()
        if message is None:
            return self._check_answer(now_ns) or self._check_memory(now_ns)
        self._alive_ns, self._asked = now_ns, False
        match message:
            case ("ready",):
                self._deadline_ns, self._starting = None, False
                if self._finishing:
                    self._await_cloud()
                return WorkerReady()
            case ("pong",):
                return None
            case ("step", int(ticket)):
                if ticket == self._ticket and self._deadline_ns is not None:
                    self._await_cloud()
                return None
            case ("cloud", int(ticket), bool(full), Found() as found, float(cpu_s)):
                return self._taken(full, found, cpu_s) if ticket == self._ticket else None
            case ("judged", int(ticket), tuple() as judgements, Windows() | None as windows, float(cpu_s)):
                if ticket != self._ticket or self._scan is None:
                    return None
                if self._finishing:
                    self._await_cloud()  # it got so far; what follows may be more than on other scans
                return ScanJudged(self._scan, judgements, windows, cpu_s)
            case ("identified", int(ticket)):
                return PatternsRight(self._scan) if ticket == self._ticket and self._scan is not None else None
            case (
                "merged", int(ticket), Found() | None as found, tuple() as second, Judgement() as pair, float(cpu_s)
            ):  # fmt: skip
                return self._merged(found, second, pair, cpu_s) if ticket == self._ticket else None
            case ("spoiled", int(ticket), Judgement() as judgement):
                spoiled = self._end_of(ticket)
                return None if spoiled is None else ScanSpoiled(spoiled, judgement)
            case ("failed", int(ticket), str(text)):
                if ticket != self._ticket:
                    return None
                return WorkerFailed(self._end_of(ticket), Fault(FaultCode.RECONSTRUCTION_FAILED, text))
            case ("crashed", str(text)):
                return self._restart(f"it failed: {text}")
            case _:
                return self._restart(f"it sent a {type(message).__name__}, which is no answer")

    def wait(self, timeout_s: float) -> WorkerEvent | None:
        """As ``poll``, waiting up to ``timeout_s`` (for the desk; the service polls)."""
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
        """Whether the step that is late uses the processor, and may go on: then its deadline is a new one."""
        if self._starting or now_ns >= self._patience_ns:
            return False
        before_s, self._step_cpu_s = self._step_cpu_s, self._used_s()
        if self._step_cpu_s - before_s < COMPUTING_SHARE * self.limits.cloud_s:
            return False
        self._deadline_ns = now_ns + int(self.limits.cloud_s * 1e9)
        return True

    def _tell_again(self) -> None:
        """Of all frames of the scan, from the first on."""
        self._missed = False
        self._tell_first()
        if self._second is not None:
            self._send(("begin second", self._ticket, self._second))
            self._tell_frames()

    def _tell_first(self) -> None:
        self._send(("begin", self._ticket, self._settings))
        self._tell_frames()

    def _tell_frames(self) -> None:
        for index in range(self._store.shape[0]):
            for side in SIDES:
                self._send(("frame", side, index))

    def _check_answer(self, now_ns: int) -> WorkerFailed | None:
        """Whether it is late with what was asked, or with a sign of life."""
        if self._deadline_ns is not None:
            if now_ns <= self._deadline_ns or self._computes(now_ns):
                return None
            return self._restart("it did not answer in time")
        waited_s = (now_ns - self._alive_ns) / 1e9
        if self._asked and waited_s > self.limits.alive_s:
            return self._restart(f"it gave no sign of life for {self.limits.alive_s:g} s")
        if not self._asked and waited_s > PING_S:
            self._alive_ns, self._asked = now_ns, True
            self._send(("ping",))
        return None

    def _check_memory(self, now_ns: int) -> WorkerFailed | None:
        if self.pid is None or now_ns < self._memory_check_ns:
            return None
        self._memory_check_ns = now_ns + int(MEMORY_CHECK_S * 1e9)
        most_mb = self.limits.start_memory_mb if self._starting else self.limits.memory_mb
        used_mb = own_memory_mb(self.pid)
        if used_mb is None or used_mb <= most_mb:
            return None
        return self._restart(f"it took {used_mb:.0f} MB of memory; allowed are {most_mb:.0f} MB")

    def _end_of(self, ticket: int) -> int | None:
        """The scan of this ticket, for which nothing more is awaited; ``None`` where it is no longer wanted."""
        if ticket != self._ticket:
            return None
        ended, self._scan, self._finishing, self._deadline_ns = self._scan, None, False, None
        return ended

    def _taken(self, full: bool, found: Found, cpu_s: float) -> CloudReady | None:
        if self._scan is None:
            return None  # dropped meanwhile
        # No reference to the memory may outlive this call: it could not be closed.
        cloud = PointTable(self._capacity, self._results.buf).cloud(found)
        self._send(("taken", self._ticket))
        if full:
            self._finishing, self._deadline_ns, self._fruitless = False, None, 0
            self._knows_first = True
        return CloudReady(self._scan, full, cloud, cpu_s)

    def _merged(
        self, found: Found | None, second: tuple[Judgement, ...], pair: Judgement, cpu_s: float
    ) -> PairJudged | None:
        if self._scan is None:
            return None  # dropped meanwhile
        cloud = None if found is None else PointTable(self._capacity, self._results.buf).cloud(found)
        self._send(("taken", self._ticket))
        self._finishing, self._deadline_ns, self._fruitless, self._knows_first = False, None, 0, True
        return PairJudged(self._scan, second, pair, cloud, cpu_s)

    def _send(self, message: tuple[object, ...]) -> None:
        pipe = self._pipe
        if pipe is None:
            return
        try:
            with self._sending:  # both camera threads and the service's send
                pipe.send(message)
        except (BrokenPipeError, OSError):
            return  # poll notices and restarts

    def _start(self) -> None:
        ours, theirs = self._context.Pipe()
        order = self.order
        process = self._context.Process(
            target=work,
            name="kf-reconstruct",
            args=(
                theirs,
                encode(order.calibration),
                order.water,
                (order.period_px, order.projector_width_px, order.projector_height_px),
                order.noise,
                (self._store.name, *self._store.shape),
                self._results.name,
                self.limits.memory_mb,
            ),
            daemon=True,
        )
        try:
            process.start()
        except BaseException:
            ours.close()
            raise
        finally:
            theirs.close()
        self._pipe, self._process, self._starting, self._knows_first = ours, process, True, False
        self._alive_ns, self._asked = self._clock.now_ns(), False
        self._deadline_ns = self._alive_ns + int(self.limits.start_s * 1e9)
        self._start_cpu_s = 0.0

    def _start_again(self) -> None:
        """A machine that has no room for another process now is a failure of this start, not of the service."""
        try:
            self._start()
            self._not_started = None
        except OSError as error:
            self._not_started = f"no process could be started: {error.strerror or error}"

    def _stop(self, patience_s: float) -> None:
        """Close the pipe, which ends a worker that listens; kill it when it is still there after ``patience_s``."""
        pipe, process = self._pipe, self._process
        self._pipe = self._process = None
        if pipe is not None:
            pipe.close()
        if process is not None:
            process.join(patience_s)
            if process.is_alive():
                process.kill()
                process.join(STOP_TIMEOUT_S)

    def _restart(self, why: str) -> WorkerFailed:
        """Start again, with the scan in work if it has an attempt left."""
        self._stop(0.0)  # the heartbeat waits meanwhile
        self._not_started = None
        self.restarts += 1
        self._fruitless += 1
        if self._fruitless >= MOST_FRUITLESS_STARTS:
            lost, self._scan, self._finishing, self._deadline_ns = self._scan, None, False, None
            return _failed(lost, f"the worker failed {self._fruitless} times in a row, the last time because {why}")
        self._start_again()
        lost = None
        if self._scan is not None:
            if self._attempts >= MOST_ATTEMPTS:
                lost, self._scan, self._finishing = self._scan, None, False
            else:
                self._attempts += 1
                self._missed = True
                if self._finishing:
                    self._tell_again()
                    self._send(("finish",))
        return _failed(lost, f"the worker was started again: {why}")


def _failed(scan: int | None, why: str) -> WorkerFailed:
    return WorkerFailed(scan, Fault(FaultCode.RECONSTRUCTION_FAILED, why))
