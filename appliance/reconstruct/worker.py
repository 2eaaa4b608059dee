"""Owns the warm process in which scans are reconstructed, so that computing never delays a vertical blank.

The parent sends small messages; pixels stay in the shared frame store and points come back through shared memory.
A worker that dies, does not answer in time or takes too much memory is killed and started again, and the scan it had is
processed again from the raw frames, which are untouched by all of that.
"""

from __future__ import annotations

import multiprocessing
import os
import signal
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from multiprocessing.connection import Connection
from multiprocessing.shared_memory import SharedMemory
from pathlib import Path
from types import TracebackType

import numpy as np

from appliance.calibration.file import Calibration, decode, encode
from appliance.capture.fault import Fault, FaultCode
from appliance.capture.store import SIDES, FrameStore
from appliance.optics.water import Water
from appliance.patterns.sequence import PatternSequence, build_sequence
from appliance.reconstruct.pipeline import Pipeline
from appliance.reconstruct.table import POINT_BYTES, Cloud, Found, PointTable
from appliance.reconstruct.warm import run_empty_scan
from drivers.api import Clock

STOP_TIMEOUT_S = 2.0
MEMORY_CHECK_S = 0.5
MOST_ATTEMPTS = 2
"""Of one scan."""
MOST_FRUITLESS_STARTS = 4
"""In a row, without a cloud in between; then the worker stays down until the next scan begins."""
POLL_S = 0.002


@dataclass(frozen=True, slots=True)
class WorkOrder:
    """Everything a worker must know to reconstruct scans; another order needs another worker."""

    calibration: Calibration
    water: Water
    period_px: int
    projector_width_px: int
    projector_height_px: int


@dataclass(frozen=True, slots=True)
class WorkLimits:
    """What a worker may take; beyond, it is started again."""

    start_s: float = 60.0
    """A cold start without compiled kernels takes several seconds."""
    cloud_s: float = 10.0
    """From the last frame to the full cloud; a hundred times what it takes."""
    memory_mb: float = 600.0
    """Of its own; the shared frames do not count."""


@dataclass(frozen=True, slots=True)
class WorkerReady:
    """The kernels are loaded and the buffers allocated."""


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
class WorkerFailed:
    """The worker is being started again, or has given up."""

    scan: int | None
    """The scan that gets no cloud; ``None``: none is lost, a scan in work is processed again."""
    fault: Fault


WorkerEvent = WorkerReady | CloudReady | WorkerFailed


class ReconstructionWorker:
    """The parent's end. A context manager; one thread calls ``poll``, camera threads may call ``frame``."""

    def __init__(self, order: WorkOrder, store: FrameStore, clock: Clock, limits: WorkLimits | None = None) -> None:
        self._order = order
        self._store = store
        self._clock = clock
        self._limits = limits or WorkLimits()
        left = order.calibration.rig.left
        self._capacity = left.width_px * left.height_px
        self._results = SharedMemory(create=True, size=self._capacity * POINT_BYTES)
        self._context = multiprocessing.get_context("spawn")
        self._process: multiprocessing.process.BaseProcess | None = None
        self._pipe: Connection | None = None
        self._sending = threading.Lock()
        self._deadline_ns: int | None = None
        self._memory_check_ns = 0
        self._scan: int | None = None
        self._finishing = False
        """All frames of the scan are there, and the cloud is awaited."""
        self._missed = False
        """The worker was started again since the scan began: it must be told of all frames once more."""
        self._attempts = 0
        self._fruitless = 0
        self.restarts = 0
        """How often the process had to be started again."""

    def __enter__(self) -> ReconstructionWorker:
        self._start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._stop()
        self._results.close()
        self._results.unlink()

    @property
    def pid(self) -> int | None:
        """Of the process; ``None`` while there is none."""
        return self._process.pid if self._process is not None else None

    def begin(self, scan: int) -> None:
        """A new scan's frames will follow."""
        self._scan, self._finishing, self._missed, self._attempts = scan, False, False, 1
        if self._process is None:
            self._fruitless = 0
            self._start()
        self._send(("begin", scan))

    def frame(self, side: str, index: int) -> None:
        """Frame ``index`` of ``side`` is in the store."""
        if not self._missed:
            self._send(("frame", side, index))

    def finish(self) -> None:
        """All frames are there and the ledger agrees: answer with the coarse, then the full cloud."""
        self._finishing = True
        if self._missed:
            self._tell_again()
        self._await_cloud()
        self._send(("finish",))

    def drop(self) -> None:
        """Forget the scan that was begun."""
        self._scan, self._finishing, self._deadline_ns = None, False, None
        self._send(("drop",))

    def reprocess(self, scan: int) -> None:
        """Reconstruct the frames in the store from the first on."""
        self.begin(scan)
        self._tell_again()
        self.finish()

    def poll(self) -> WorkerEvent | None:
        """The next event, or ``None``. Restarts a worker that died or exceeded its limits, and reports that once."""
        pipe, process = self._pipe, self._process
        if pipe is None or process is None:
            return None
        try:
            message = pipe.recv() if pipe.poll(0.0) else None
        except (EOFError, OSError):
            process.join(STOP_TIMEOUT_S)
            return self._restart(f"the process ended with code {process.exitcode}")
        if message is None:
            now_ns = self._clock.now_ns()
            if self._deadline_ns is not None and now_ns > self._deadline_ns:
                return self._restart("it did not answer in time")
            return self._check_memory(now_ns)
        match message:
            case ("ready",):
                self._deadline_ns = None
                if self._finishing:
                    self._await_cloud()
                return WorkerReady()
            case ("cloud", int(scan), bool(full), Found() as found, float(cpu_s)):
                cloud = self._cloud(found)
                if scan != self._scan:
                    return None
                if full:
                    self._finishing, self._deadline_ns, self._fruitless = False, None, 0
                return CloudReady(scan, full, cloud, cpu_s)
            case ("failed", str(text)):
                current, self._scan, self._finishing, self._deadline_ns = self._scan, None, False, None
                return WorkerFailed(current, Fault(FaultCode.RECONSTRUCTION_FAILED, text))
            case _:
                return self._restart(f"it sent {message!r:.60}")

    def wait(self, timeout_s: float) -> WorkerEvent | None:
        """As ``poll``, waiting up to ``timeout_s`` (for the desk; the service polls)."""
        end_ns = self._clock.now_ns() + int(timeout_s * 1e9)
        while True:
            event = self.poll()
            if event is not None or self._clock.now_ns() >= end_ns:
                return event
            self._clock.sleep_s(POLL_S)

    def _await_cloud(self) -> None:
        self._deadline_ns = self._clock.now_ns() + int(self._limits.cloud_s * 1e9)

    def _tell_again(self) -> None:
        """Of all frames of the scan, from the first on."""
        self._missed = False
        self._send(("begin", self._scan))
        for index in range(self._store.shape[0]):
            for side in SIDES:
                self.frame(side, index)

    def _check_memory(self, now_ns: int) -> WorkerFailed | None:
        if self.pid is None or now_ns < self._memory_check_ns:
            return None
        self._memory_check_ns = now_ns + int(MEMORY_CHECK_S * 1e9)
        used_mb, most_mb = own_memory_mb(self.pid), self._limits.memory_mb
        if used_mb is None or used_mb <= most_mb:
            return None
        return self._restart(f"it took {used_mb:.0f} MB of memory; allowed are {most_mb:.0f} MB")

    def _cloud(self, found: Found) -> Cloud:
        # No reference to the memory may outlive this call: it could not be closed.
        cloud = PointTable(self._capacity, self._results.buf).cloud(found)
        self._send(("taken",))
        return cloud

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
        order = self._order
        process = self._context.Process(
            target=work,
            name="kf-reconstruct",
            args=(
                theirs,
                encode(order.calibration),
                order.water,
                (order.period_px, order.projector_width_px, order.projector_height_px),
                (self._store.name, *self._store.shape),
                self._results.name,
            ),
            daemon=True,
        )
        process.start()
        theirs.close()
        self._pipe, self._process = ours, process
        self._deadline_ns = self._clock.now_ns() + int(self._limits.start_s * 1e9)

    def _stop(self) -> None:
        pipe, process = self._pipe, self._process
        self._pipe = self._process = None
        if pipe is not None:
            pipe.close()
        if process is not None:
            process.join(STOP_TIMEOUT_S)
            if process.is_alive():
                process.kill()
                process.join(STOP_TIMEOUT_S)

    def _restart(self, why: str) -> WorkerFailed:
        """Start again, with the scan in work if it has an attempt left."""
        self._stop()
        self.restarts += 1
        self._fruitless += 1
        if self._fruitless >= MOST_FRUITLESS_STARTS:
            lost, self._scan, self._finishing, self._deadline_ns = self._scan, None, False, None
            return _failed(lost, f"the worker failed {self._fruitless} times in a row, the last time because {why}")
        self._start()
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


def own_memory_mb(pid: int) -> float | None:
    """Resident memory of a process without what it shares with others, MB; ``None`` when it is not there any more."""
    try:
        status = Path(f"/proc/{pid}/status").read_text(encoding="ascii", errors="replace")
    except OSError:
        return None
    kb = {line.split(":")[0]: line.split()[1] for line in status.splitlines() if line.startswith("Rss")}
    return (int(kb.get("RssAnon", "0")) + int(kb.get("RssFile", "0"))) / 1000.0 if kb else None


def work(
    pipe: Connection,
    calibration: bytes,
    water: Water,
    sequence: tuple[int, int, int],
    store: tuple[str, int, int, int],
    results: str,
) -> None:
    """The child's main function: serve messages until the pipe closes."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the service decides when to end
    os.nice(5)
    name, frames, height_px, width_px = store
    memory = SharedMemory(name=results)
    frame_store = FrameStore(frames, height_px, width_px, attach_to=name)
    try:
        # In a function of its own: with a view of it alive, shared memory cannot be closed.
        _work(pipe, decode(calibration), water, build_sequence(*sequence), frame_store, memory)
    except (EOFError, OSError):
        pass  # the parent closed the pipe: the normal end
    finally:
        frame_store.close()
        memory.close()


def _work(
    pipe: Connection,
    calibration: Calibration,
    water: Water,
    sequence: PatternSequence,
    store: FrameStore,
    memory: SharedMemory,
) -> None:
    left = calibration.rig.left
    with Pipeline(
        calibration, water, sequence, table=PointTable(left.width_px * left.height_px, memory.buf)
    ) as pipeline:
        # So that the first real scan is as fast as the others.
        run_empty_scan(pipeline, np.zeros(store.shape, np.uint8))
        pipe.send(("ready",))
        _serve(pipe, pipeline, store)


def _serve(pipe: Connection, pipeline: Pipeline, store: FrameStore) -> None:
    scan = 0
    failed = False
    while True:
        message = pipe.recv()
        try:
            match message:
                case ("begin", int(number)):
                    scan, failed = number, False
                    pipeline.reset()
                case ("frame", str(side), int(index)) if not failed:
                    pipeline.push(side, store.frames(side), index)
                case ("finish",) if not failed:
                    for full, make in ((False, pipeline.find_coarse), (True, pipeline.find_full)):
                        _answer(pipe, scan, full, make)
                case _:
                    pass
        except ValueError as error:
            failed = True
            pipe.send(("failed", str(error)))


def _answer(pipe: Connection, scan: int, full: bool, find: Callable[[], Found]) -> None:
    begun_s = time.process_time()
    found = find()
    pipe.send(("cloud", scan, full, found, time.process_time() - begun_s))
    # The parent copies before the memory is used again.
    while pipe.recv() != ("taken",):
        pass
