"""Owns the warm process in which scans are reconstructed, so that computing never delays a vertical blank.

The parent sends small messages; pixels stay in the shared frame store and points come back through shared memory.
A worker that dies or does not answer in time is killed and started again; the raw frames are untouched by that.
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
from types import TracebackType

import numpy as np
from numpy.typing import NDArray

from appliance.calibration.file import Calibration, decode, encode
from appliance.capture.fault import Fault, FaultCode
from appliance.capture.store import SIDES, FrameStore
from appliance.optics.water import Water
from appliance.patterns.sequence import build_sequence
from appliance.reconstruct.pipeline import Cloud, Pipeline
from appliance.reconstruct.quality import CloudSummary
from drivers.api import Clock

START_TIMEOUT_S = 60.0
"""A cold start without compiled kernels takes several seconds."""
CLOUD_TIMEOUT_S = 20.0
STOP_TIMEOUT_S = 2.0
POLL_S = 0.002

POINT = np.dtype(
    [
        ("xyz", np.float32, 3),
        ("gap", np.float32),
        ("sigma", np.float32),
        ("modulation", np.float32),
        ("pixel", np.uint32),
        ("intensity", np.uint8),
    ]
)


@dataclass(frozen=True, slots=True)
class WorkOrder:
    """Everything a worker must know to reconstruct scans; another order needs another worker."""

    calibration: Calibration
    water: Water
    period_px: int
    projector_width_px: int
    projector_height_px: int


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
    scan: int | None
    fault: Fault


WorkerEvent = WorkerReady | CloudReady | WorkerFailed


class ReconstructionWorker:
    """The parent's end. A context manager; one thread calls ``poll``, camera threads may call ``frame``."""

    def __init__(self, order: WorkOrder, store: FrameStore, clock: Clock) -> None:
        self._order = order
        self._store = store
        self._clock = clock
        left = order.calibration.rig.left
        self._results = SharedMemory(create=True, size=left.width_px * left.height_px * POINT.itemsize)
        self._context = multiprocessing.get_context("spawn")
        self._process: multiprocessing.process.BaseProcess | None = None
        self._pipe: Connection | None = None
        self._sending = threading.Lock()
        self._deadline_ns: int | None = None
        self._scan: int | None = None
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

    def begin(self, scan: int) -> None:
        """A new scan's frames will follow."""
        self._scan = scan
        self._send(("begin", scan))

    def frame(self, side: str, index: int) -> None:
        """Frame ``index`` of ``side`` is in the store."""
        self._send(("frame", side, index))

    def finish(self) -> None:
        """All frames are there and the ledger agrees: answer with the coarse, then the full cloud."""
        self._deadline_ns = self._clock.now_ns() + int(CLOUD_TIMEOUT_S * 1e9)
        self._send(("finish",))

    def drop(self) -> None:
        """Forget the scan that was begun."""
        self._scan = None
        self._deadline_ns = None
        self._send(("drop",))

    def reprocess(self, scan: int) -> None:
        """Reconstruct the frames in the store from the first on."""
        self.begin(scan)
        for index in range(self._store.shape[0]):
            for side in SIDES:
                self.frame(side, index)
        self.finish()

    def poll(self) -> WorkerEvent | None:
        """The next event, or ``None``. Restarts a worker that died or exceeded its time, and reports that once."""
        pipe, process = self._pipe, self._process
        if pipe is None or process is None:
            return None
        try:
            message = pipe.recv() if pipe.poll(0.0) else None
        except (EOFError, OSError):
            return self._restart(f"the process ended with code {process.exitcode}")
        if message is None:
            if self._deadline_ns is not None and self._clock.now_ns() > self._deadline_ns:
                return self._restart("it did not answer in time")
            return None
        match message:
            case ("ready",):
                self._deadline_ns = None
                return WorkerReady()
            case ("cloud", int(scan), bool(full), int(count), CloudSummary() as summary, float(cpu_s)):
                if scan != self._scan:
                    return None
                if full:
                    self._deadline_ns = None
                return CloudReady(scan, full, self._cloud(count, summary), cpu_s)
            case ("failed", str(text)):
                current, self._scan, self._deadline_ns = self._scan, None, None
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

    def _cloud(self, count: int, summary: CloudSummary) -> Cloud:
        table = np.ndarray(count, POINT, buffer=self._results.buf)
        cloud = Cloud(
            points_mm=table["xyz"].copy(),
            intensity=table["intensity"].copy(),
            modulation_dn=table["modulation"].copy(),
            ray_gap_mm=table["gap"].copy(),
            sigma_mm=table["sigma"].copy(),
            pixel=table["pixel"].copy(),
            summary=summary,
        )
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
        self._deadline_ns = self._clock.now_ns() + int(START_TIMEOUT_S * 1e9)

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
        scan, self._scan = self._scan, None
        self._stop()
        self.restarts += 1
        self._start()
        return WorkerFailed(scan, Fault(FaultCode.RECONSTRUCTION_FAILED, f"the worker was restarted: {why}"))


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
        pipeline = Pipeline(decode(calibration), water, build_sequence(*sequence))
        _warm_up(pipeline, frame_store, frames)
        pipe.send(("ready",))
        _serve(pipe, pipeline, frame_store, memory)
    except EOFError:
        pass  # the parent closed the pipe: the normal end
    finally:
        frame_store.close()
        memory.close()


def _warm_up(pipeline: Pipeline, store: FrameStore, frames: int) -> None:
    """Load every kernel on an empty scan, so that the first real one is as fast as the others."""
    empty = np.zeros((frames, *store.shape[1:]), np.uint8)
    for side in SIDES:
        for index in range(frames):
            pipeline.push(side, empty, index)
    pipeline.coarse()
    pipeline.full()


def _serve(pipe: Connection, pipeline: Pipeline, store: FrameStore, memory: SharedMemory) -> None:
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
                    for full, make in ((False, pipeline.coarse), (True, pipeline.full)):
                        _answer(pipe, memory, scan, full, make, time.process_time)
                case _:
                    pass
        except ValueError as error:
            failed = True
            pipe.send(("failed", str(error)))


def _answer(
    pipe: Connection,
    memory: SharedMemory,
    scan: int,
    full: bool,
    make: Callable[[], Cloud],
    cpu_time: Callable[[], float],
) -> None:
    begun = cpu_time()
    cloud = make()
    count = len(cloud.points_mm)
    table: NDArray[np.void] = np.ndarray(count, POINT, buffer=memory.buf)
    table["xyz"] = cloud.points_mm
    table["intensity"] = cloud.intensity
    table["modulation"] = cloud.modulation_dn
    table["gap"] = cloud.ray_gap_mm
    table["sigma"] = cloud.sigma_mm
    table["pixel"] = cloud.pixel
    pipe.send(("cloud", scan, full, count, cloud.summary, cpu_time() - begun))
    # The parent copies before the memory is used again.
    while pipe.recv() != ("taken",):
        pass
