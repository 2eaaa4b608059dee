"""One scan on the product's worker process at the pace of the cameras: times and CPU of its results.

The clock starts when the last pair of frames is announced. Processor time is that of all threads of the worker, by its own
clock in the kernel, from the same moment; what steps after an answer cost is taken off by the worker's own account of them.
"""

from __future__ import annotations

import tempfile
import threading
import time
from collections.abc import Iterator
from concurrent.futures import Future
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path

from appliance.instrument.capture.store import FrameStore
from appliance.instrument.service.scan_files import DiskQueue
from appliance.instrument.worker.messages import Ready, WorkLimits, WorkOrder
from appliance.instrument.worker.process import ReconstructionWorker
from appliance.measure.light.sides import SIDES
from appliance.measure.news import CoarseCloud, FullCloud, News, PatternIdentity, Verdicts
from appliance.measure.verdict import Judgement, faults_in
from appliance.store.library import Library, PendingScan
from appliance.store.manifest import SequenceInfo
from bench.warm_worker import FRAME_S, START_TIMEOUT_S, peak_memory_mb
from bench.whole_scan.scenes import TimedScene
from drivers.native import MonotonicClock
from tests.appliance.store.scenes import ORIGIN
from tests.appliance.store.scenes import record as plain_record

CLOUD_TIMEOUT_S = 60.0
"""A compensation takes seconds."""
LIMITS = WorkLimits(memory_mb=4000.0)
"""A scan that takes more memory than the product allows is measured all the same, and its memory is judged."""
SAMPLE_S = 0.001
WARM_UPS = 2
"""Scans before the first that counts: the first one runs with cold memory, and files that the folder has not yet."""
CPUCLOCK_SCHED = 2
"""Linux's name for the processor time of a process in a clock's number (include/linux/posix-timers.h)."""


@dataclass(frozen=True, slots=True)
class PacedScan:
    """Milliseconds of one scan: by the clock from the last frame, and CPU of all threads of the worker."""

    coarse_ms: float
    """Until the parent has the coarse cloud."""
    verdict_ms: float
    full_ms: float
    durable_ms: float
    """Until both cameras' raw frames are durable."""
    recording_cpu_ms: float
    """From the first frame to the last but one."""
    complete_cpu_ms: float
    """From the last frame pair to the full cloud."""
    judging_cpu_ms: float
    """Between coarse cloud and verdict."""
    compensating_cpu_ms: float
    """Between the first and the last verdict; 0 without motion."""
    compensating_ms: float
    """The same by the clock."""
    full_step_cpu_ms: float
    points: int
    faults: tuple[str, ...]
    """Codes of the faults of the scan."""
    trace: tuple[tuple[float, float], ...] = ()
    """Time in ms from the last frame on, and the worker's CPU by then in ms, sampled during a scan that is drawn."""

    @property
    def verdict_cpu_ms(self) -> float:
        """From the last pair of frames to the verdict."""
        return self.complete_cpu_ms - self.full_step_cpu_ms - self.compensating_cpu_ms

    @property
    def coarse_cpu_ms(self) -> float:
        """From the last pair of frames to the coarse cloud, the identity of the frames judged before."""
        return self.verdict_cpu_ms - self.judging_cpu_ms

    @property
    def whole_cpu_ms(self) -> float:
        """From the first frame on."""
        return self.recording_cpu_ms + self.complete_cpu_ms


@dataclass(slots=True)
class _Heard:
    """Results of a scan so far, and their times."""

    coarse_s: float | None = None
    verdict_s: float | None = None
    compensated_s: float | None = None
    full_s: float | None = None
    judging_cpu_s: float = 0.0
    compensating_cpu_s: float = 0.0
    full_cpu_s: float = 0.0
    points: int = 0
    faults: tuple[str, ...] = ()


class PacedWorker:
    """A warm worker for one scene, and a disk beside it. Made by ``paced_worker``."""

    def __init__(
        self, scene: TimedScene, process: ReconstructionWorker, library: Library, disk: DiskQueue, ready_s: float
    ) -> None:
        self._scene, self._process, self._library, self._disk = scene, process, library, disk
        self.ready_s = ready_s
        """Seconds from its start until it was warm."""
        self._clock = MonotonicClock()
        self._record = plain_record(sequence=SequenceInfo.of(scene.sequence))
        self._number = 0

    @property
    def peak_mb(self) -> float:
        """Peak resident memory of the worker, shared frames and points included."""
        return peak_memory_mb(self._process.pid)

    @property
    def own_peak_mb(self) -> float:
        """Peak memory without the part that is shared with the parent."""
        status = Path(f"/proc/{self._process.pid}/status").read_text(encoding="ascii", errors="replace")
        shared = next(line for line in status.splitlines() if line.startswith("RssShmem"))
        return self.peak_mb - int(shared.split()[1]) / 1000.0

    def scan(self, *, traced: bool = False) -> PacedScan:
        """Take one scan at 60 Hz, with its raw frames written meanwhile as by the service. Raises RuntimeError."""
        self._number += 1
        last = len(self._scene.sequence) - 1
        with _tracing(self._process.pid, traced) as trace:
            begun_s = time.monotonic()
            begun_cpu_ms = cpu_ms(self._process.pid)
            self._process.begin(self._number, self._scene.settings)
            for k in range(last + 1):
                self._clock.sleep_s(begun_s + k * FRAME_S - time.monotonic())
                if k == last:
                    last_cpu_ms, last_s = cpu_ms(self._process.pid), time.monotonic()
                for side in SIDES:
                    self._process.frame(side, k)
            self._process.finish()
            durable = self._disk.submit(self._make_durable)
            results = self._listen()
            # The worker is idle again: it waits for the next order.
            ended_cpu_ms = cpu_ms(self._process.pid)
        pending, durable_s = _result(durable)
        pending.reject("timed")
        return PacedScan(
            coarse_ms=1e3 * (_known(results.coarse_s) - last_s),
            verdict_ms=1e3 * (_known(results.verdict_s) - last_s),
            full_ms=1e3 * (_known(results.full_s) - last_s),
            durable_ms=1e3 * (durable_s - last_s),
            recording_cpu_ms=last_cpu_ms - begun_cpu_ms,
            complete_cpu_ms=ended_cpu_ms - last_cpu_ms,
            judging_cpu_ms=1e3 * results.judging_cpu_s,
            compensating_cpu_ms=1e3 * results.compensating_cpu_s,
            compensating_ms=1e3 * ((results.compensated_s or _known(results.verdict_s)) - _known(results.verdict_s)),
            full_step_cpu_ms=1e3 * results.full_cpu_s,
            points=results.points,
            faults=results.faults,
            trace=tuple((1e3 * (at_s - last_s), used_ms - begun_cpu_ms) for at_s, used_ms in trace),
        )

    def _make_durable(self) -> tuple[PendingScan, float]:
        pending = self._library.begin(dict(self._scene.frames), self._record, ORIGIN)
        return pending, time.monotonic()

    def _listen(self) -> _Heard:
        results = _Heard()
        while results.full_s is None:
            event = self._process.wait(CLOUD_TIMEOUT_S)
            now_s = time.monotonic()
            match event:
                case News(_, PatternIdentity(judgement)) if judgement.fault is None:
                    pass
                case News(_, CoarseCloud()):
                    results.coarse_s = now_s
                case News(_, FullCloud(found, judgements, cpu_s)):
                    results.full_s, results.full_cpu_s, results.points = now_s, cpu_s, found.summary.points
                    results.faults = _codes(judgements)
                case News(_, Verdicts(judgements, cpu_s)):
                    results.faults = _codes(judgements)
                    if results.verdict_s is None:
                        results.verdict_s, results.judging_cpu_s = now_s, cpu_s
                    else:
                        results.compensated_s = now_s
                        results.compensating_cpu_s += cpu_s
                case other:
                    raise RuntimeError(f"the worker answered {other!r:.200}")
        return results


def _codes(judgements: tuple[Judgement, ...]) -> tuple[str, ...]:
    return tuple(fault.code.value for fault in faults_in(judgements))


@contextmanager
def paced_worker(scene: TimedScene, disk: Path) -> Iterator[PacedWorker]:
    """Start the worker for ``scene``, warm it up, and write to the disk of the folder ``disk``. Raises RuntimeError."""
    with ExitStack() as stack:
        left = scene.frames["left"]
        store = stack.enter_context(FrameStore(*left.shape))
        for side in SIDES:
            store.frames(side)[...] = scene.frames[side]
        sequence = scene.sequence
        order = WorkOrder(scene.calibration, scene.water, sequence, scene.settings.noise)
        library = Library(Path(stack.enter_context(tempfile.TemporaryDirectory(dir=disk))) / "storage")
        library.prepare()
        writer = stack.enter_context(DiskQueue())
        begun_s = time.monotonic()
        process = stack.enter_context(ReconstructionWorker(order, store, MonotonicClock(), LIMITS))
        if process.wait(START_TIMEOUT_S) != Ready():
            raise RuntimeError("the worker did not start")
        worker = PacedWorker(scene, process, library, writer, time.monotonic() - begun_s)
        for _ in range(WARM_UPS):
            worker.scan()
        yield worker


def cpu_ms(pid: int | None) -> float:
    """Return the CPU time of a process, with its ended threads. Raises RuntimeError if it has ended."""
    if pid is None:
        raise RuntimeError("the worker is gone; see what it said before")
    # clock_getcpuclockid(3): the complement of the number, and which of the kernel's counts.
    return 1e3 * time.clock_gettime((~pid << 3) | CPUCLOCK_SCHED)


@contextmanager
def _tracing(pid: int | None, is_traced: bool) -> Iterator[list[tuple[float, float]]]:
    """Sample the process's CPU time until the end of the block, if ``is_traced``."""
    trace: list[tuple[float, float]] = []
    over = threading.Event()

    def sample() -> None:
        while not over.wait(SAMPLE_S):
            trace.append((time.monotonic(), cpu_ms(pid)))

    thread = threading.Thread(target=sample, name="bench-trace", daemon=True)
    if is_traced:
        thread.start()
    try:
        yield trace
    finally:
        over.set()
        if is_traced:
            thread.join()


def _result(durable: Future[tuple[PendingScan, float]]) -> tuple[PendingScan, float]:
    return durable.result(CLOUD_TIMEOUT_S)


def _known(at_s: float | None) -> float:
    if at_s is None:
        raise RuntimeError("the worker found a full cloud without a verdict or a coarse cloud before it")
    return at_s
