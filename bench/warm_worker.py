"""Cost of the worker process: start, memory, and CPU time for a scan recorded at 60 Hz."""

from __future__ import annotations

import math
import time
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path

from appliance.instrument.capture.store import FrameStore
from appliance.instrument.worker.messages import Ready, WorkOrder
from appliance.instrument.worker.process import ReconstructionWorker
from appliance.measure.light.sides import SIDES
from appliance.measure.news import CoarseCloud, FullCloud, News, PatternIdentity, Verdicts
from bench.result import Measurement
from bench.scan_frames import ScanFrames
from bench.timing import median_of
from drivers.native import MonotonicClock
from tests.support import synthetic

FRAME_S = 1.0 / 60.0
FIRST_SCAN_TARGET_S = 1.2
START_TIMEOUT_S, CLOUD_TIMEOUT_S = 60.0, 20.0


def worker(scan: ScanFrames, starts: int, paced_scans: int) -> Iterator[Measurement]:
    """Start the worker ``starts`` times, after one that may have to compile; the last one also records at 60 Hz."""
    clock = MonotonicClock()
    ready_s, first_s, first_cpu_s = [], [], []
    cpu_ms, coarse_ms, full_ms = [], [], []
    with ExitStack() as stack:
        store = stack.enter_context(FrameStore(*scan.frames["left"].shape))
        for side in SIDES:
            store.frames(side)[...] = scan.frames[side]
        order = WorkOrder(scan.calibration, synthetic.WATER, scan.sequence)
        for start in range(starts + 1):
            begun_s = time.monotonic()
            with ReconstructionWorker(order, store, clock) as process:
                if process.wait(START_TIMEOUT_S) != Ready():
                    raise RuntimeError("the worker did not start")
                ready_s.append(time.monotonic() - begun_s)
                process.reprocess(0)
                clouds_after_s(process, begun_s)
                first_s.append(time.monotonic() - begun_s)
                first_cpu_s.append(process_cpu_ms(process.pid) / 1e3)
                if start == starts:
                    for number in range(1, paced_scans + 1):
                        before_ms = process_cpu_ms(process.pid)
                        ended_s = record(process, clock, number, len(scan.sequence))
                        coarse, full = clouds_after_s(process, ended_s)
                        cpu_ms.append(process_cpu_ms(process.pid) - before_ms)
                        coarse_ms.append(coarse * 1e3)
                        full_ms.append(full * 1e3)
                    peak_mb = peak_memory_mb(process.pid)
    yield median_of("start of the worker until it is warm", ready_s[1:], "s", "worker_ready_s")
    target_s = FIRST_SCAN_TARGET_S
    yield median_of("start of the worker until its first cloud", first_s[1:], "s", "first_scan_s", at_most=target_s)
    # Tells a slow start from a busy machine; it does not stand in for the clock.
    yield median_of("the worker's CPU time from start to first cloud", first_cpu_s[1:], "s CPU", "first_scan_cpu_s")
    yield median_of("the worker's CPU time for a scan at 60 Hz", cpu_ms, "ms CPU", "worker_scan_cpu_ms")
    yield median_of("last frame to coarse cloud, by the clock", coarse_ms, "ms", "worker_coarse_wall_ms")
    yield median_of("last frame to full cloud, by the clock", full_ms, "ms", "worker_full_wall_ms")
    yield Measurement("peak memory of the worker, frames included", peak_mb, "MB", key="worker_peak_mb")


def record(process: ReconstructionWorker, clock: MonotonicClock, number: int, frames: int) -> float:
    """Announce the frames at the pace of the cameras; return the time of the last one."""
    begun_s = time.monotonic()
    process.begin(number)
    for k in range(frames):
        clock.sleep_s(begun_s + k * FRAME_S - time.monotonic())
        for side in SIDES:
            process.frame(side, k)
    ended_s = time.monotonic()
    process.finish()
    return ended_s


def clouds_after_s(process: ReconstructionWorker, since_s: float) -> tuple[float, float]:
    """Wait for both clouds. Raises RuntimeError when one does not come."""
    took_s: list[float] = []
    while len(took_s) < 2:
        match process.wait(CLOUD_TIMEOUT_S):
            case News(_, CoarseCloud() | FullCloud() as cloud) if isinstance(cloud, FullCloud) == bool(took_s):
                took_s.append(time.monotonic() - since_s)
            case News(_, PatternIdentity(judgement)) if judgement.fault is None:
                pass
            case News(_, Verdicts()):
                pass
            case other:
                raise RuntimeError(f"the worker answered {other!r:.200}")
    return took_s[0], took_s[1]


def process_cpu_ms(pid: int | None) -> float:
    """Return the CPU time of all present threads of a process, in steps of 1 ns (the usual counters have 10 ms)."""
    tasks = Path(f"/proc/{pid}/task").iterdir()
    return sum(int((task / "schedstat").read_text(encoding="ascii").split()[0]) for task in tasks) / 1e6


def peak_memory_mb(pid: int | None) -> float:
    """Return the peak resident memory, shared pages included."""
    for line in Path(f"/proc/{pid}/status").read_text(encoding="ascii", errors="replace").splitlines():
        if line.startswith("VmHWM"):
            return int(line.split()[1]) / 1000.0
    return math.nan
