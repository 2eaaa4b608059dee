"""What a scan costs from its first frame to its last point, against other ways and against what memory allows.

Everything is measured in one run, in turns, so that a busy machine slows all of it alike. Times are CPU milliseconds of
the whole process, threads included. Targets are for a machine on which OpenCV's vector operations decode one camera in
41 ms: a slower or busier one is allowed as much more as it needs for that (``machine_factor``).
"""

from __future__ import annotations

import math
import os
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from appliance.capture.store import FrameStore
from appliance.patterns.sequence import Direction
from appliance.reconstruct.phase import phase
from appliance.reconstruct.pipeline import Pipeline
from appliance.reconstruct.table import Cloud
from appliance.reconstruct.worker import CloudReady, ReconstructionWorker, WorkerReady, WorkOrder
from appliance.storage.library import Library
from appliance.storage.record import SequenceInfo
from bench import foreign, references, roofline
from bench.picture import draw_bars
from bench.result import Measured
from bench.scan_frames import NORMAL, SIDES, ScanFrames, make_scan
from drivers.native import MonotonicClock
from tests.appliance.storage.scenes import record as plain_record
from tests.support import oracle, synthetic

ROUNDS = 9
REFERENCE_ROUNDS = 2
FALSE_MM = 1.0
OPENCV_TARGET_MS = 41.0
STAGES = ("last frame to coarse cloud", "last frame to full cloud", "whole scan")
TARGETS_MS = (15.0, 50.0, 60.0)
KEYS = ("coarse_target_machine_ms", "full_target_machine_ms", "scan_target_machine_ms")
OUT = Path("bench/out")
Array = NDArray[np.float64]


def measure() -> Iterator[Measured]:
    scan = make_scan()
    with Pipeline(scan.calibration, synthetic.WATER, scan.sequence) as pipeline:
        for _ in range(2):  # compiles, and warms the caches
            one_scan(pipeline, scan)
        rounds = np.array([one_scan(pipeline, scan) for _ in range(ROUNDS)])
        recording, last, coarse, full = np.median(rounds, 0)
        yield Measured("recording: frames 1 to 23 of both cameras", recording, "ms CPU", key="recording_cpu_ms")
        yield Measured("last frame of both cameras", last, "ms CPU", key="last_frame_cpu_ms")
        after = last + coarse
        yield Measured("last frame to coarse cloud", after, "ms CPU", key="coarse_cpu_ms")
        yield Measured("last frame to full cloud", after + full, "ms CPU", key="full_cpu_ms")
        whole = recording + last + coarse + full
        yield Measured("whole scan", whole, "ms CPU", key="scan_cpu_ms")
        spread = np.percentile(rounds.sum(1), [0, 100])
        yield Measured("whole scan, fastest", spread[0], "ms CPU", key="scan_cpu_min_ms")
        yield Measured("whole scan, slowest", spread[1], "ms CPU", key="scan_cpu_max_ms")
        yield from compared(pipeline, scan, (after, after + full, whole))
        found = pipeline.find_full()
        yield from judged(scan, pipeline.table.cloud(found), pipeline)
    yield from worker(scan)
    yield from durable(scan)


def one_scan(pipeline: Pipeline, scan: ScanFrames) -> tuple[float, float, float, float]:
    """CPU ms of: recording but for the last frame, the last frame, the coarse and the full cloud."""
    n = len(scan.sequence)
    times_s = [time.process_time()]
    for k in range(n):
        if k == n - 1:
            times_s.append(time.process_time())
        for side in SIDES:
            pipeline.push(side, scan.frames[side], k)
    times_s.append(time.process_time())
    pipeline.find_coarse()
    times_s.append(time.process_time())
    pipeline.find_full()
    times_s.append(time.process_time())
    a, b, c, d = np.diff(times_s) * 1e3
    return float(a), float(b), float(c), float(d)


def compared(pipeline: Pipeline, scan: ScanFrames, took_ms: tuple[float, float, float]) -> Iterator[Measured]:
    """In turns with the product: each ratio is of medians of one run."""
    frames = scan.frames["left"]
    opencv, plain, ours, reference, bandwidth = [], [], [], [], []
    for k in range(max(ROUNDS // 2, REFERENCE_ROUNDS)):
        ours.append(sum(one_scan(pipeline, scan)))
        opencv.append(cpu_ms(lambda: references.opencv_decode(scan.sequence, frames)))
        plain.append(cpu_ms(lambda: references.numpy_decode(scan.sequence, frames)))
        bandwidth.append(roofline.bandwidth_gb_s(1))
        if k < REFERENCE_ROUNDS:
            reference.append(cpu_ms(lambda: references.reference_scan(scan)))
    decode = [cpu_ms(lambda: decode_left(pipeline, scan)) for _ in range(ROUNDS)]
    mine, his = float(np.median(decode)), float(np.median(opencv))
    yield Measured("decoding one camera", mine, "ms CPU", key="decode_cpu_ms")
    yield Measured("the same in OpenCV's vector operations", his, "ms CPU", key="opencv_decode_cpu_ms")
    yield Measured("the same in NumPy, float32", float(np.median(plain)), "ms CPU", key="numpy_decode_cpu_ms")
    factor = his / OPENCV_TARGET_MS
    yield Measured("this machine at this moment, against the target's", factor, "times", key="machine_factor")
    for name, value, most, key in zip(STAGES, took_ms, TARGETS_MS, KEYS, strict=True):
        yield Measured(f"{name}, on the target's machine", value / factor, "ms CPU", at_most=most, key=key)
    slow = float(np.median(reference))
    yield Measured("whole scan in NumPy with a KD-tree, float64", slow, "ms CPU", key="numpy_kdtree_cpu_ms")
    ratio = slow / float(np.median(ours))
    yield Measured("that against the product", ratio, "times", at_least=40.0, key="ratio_numpy_kdtree")
    read_gb_s, write_gb_s = np.max(bandwidth, 0)
    points = pipeline.find_full().summary.points
    least_ms = roofline.scan_ms(frames[0].size, len(frames), points, read_gb_s, write_gb_s)
    yield Measured("memory reads", read_gb_s, "GB/s", key="memory_read_gb_s")
    yield Measured("memory writes", write_gb_s, "GB/s", key="memory_write_gb_s")
    yield Measured("whole scan, if memory alone counted", least_ms, "ms", key="roofline_scan_ms")
    bars = {"Kingfisher": mine, "OpenCV vector operations": his, "NumPy float32": float(np.median(plain))}
    for name, said in peers(scan):
        value = math.nan if said.cpu_ms is None else said.cpu_ms
        yield Measured(f"{name} {said.version or ''}".strip(), value, "ms CPU", key=f"{name}_cpu_ms", why=said.why)
        if said.cpu_ms is not None:
            bars[f"{name} {said.version}"] = said.cpu_ms
    OUT.mkdir(parents=True, exist_ok=True)
    draw_bars(
        OUT / "reconstruction.png",
        [
            ("One camera decoded (OpenCV GrayCodePattern: both, matched to whole px); CPU ms", bars),
            (
                "Whole scan; CPU ms",
                {
                    "memory alone": least_ms,
                    "Kingfisher": took_ms[2],
                    "target here": 60.0 * factor,
                    "NumPy with a KD-tree": slow,
                },
            ),
        ],
    )


def peers(scan: ScanFrames) -> Iterator[tuple[str, foreign.Foreign]]:
    """Other people's decoders on the same frames."""
    x, y = scan.sequence.axis(Direction.X), scan.sequence.axis(Direction.Y)
    with tempfile.TemporaryDirectory() as folder:
        frames = Path(folder) / "frames.npz"
        np.savez(
            frames, left=scan.frames["left"], right=scan.frames["right"], gray_x=x.gray, gray_y=y.gray, sines=x.sine + y.sine,
            width_px=x.size_px, height_px=y.size_px, period_px=scan.sequence.period_px,
        )  # fmt: skip
        for name, program in (("cv2_structured_light", "graycode"), ("fringes", "fringes_package")):
            yield name, foreign.ask(program, frames)


def decode_left(pipeline: Pipeline, scan: ScanFrames) -> None:
    pipeline.reset()
    for k in range(len(scan.sequence)):
        pipeline.push("left", scan.frames["left"], k)
    pipeline.reset()


def judged(scan: ScanFrames, cloud: Cloud, pipeline: Pipeline) -> Iterator[Measured]:
    """The cloud against the truth."""
    width = scan.right_uv_px.shape[1]
    v, u = np.divmod(cloud.pixel.astype(np.int64), width)
    expected = np.asarray(np.isfinite(scan.right_uv_px).all(-1))
    got = np.zeros(expected.shape, bool)
    got[v, u] = True
    complete = 100.0 * (got & expected).sum() / expected.sum()
    yield Measured("completeness", complete, "%", at_least=99.5, key="completeness_percent")
    rig, index = scan.calibration.rig, synthetic.WATER.index
    truth = synthetic.plane_points(rig.left, *plane_of(scan))[v, u]
    false = np.asarray(np.linalg.norm(cloud.points_mm - truth, axis=1) > FALSE_MM)
    yield Measured("false matches (> 1 mm)", 1e6 * float(false.mean()), "ppm", at_most=100.0, key="false_matches_ppm")
    known = expected[v, u]
    at = rig.right.project(cloud.points_mm[known].astype(float), index) - scan.right_uv_px[v, u][known]
    bias = float(np.abs(np.mean(at, 0)).max())
    yield Measured("bias of the correspondence", bias, "px", at_most=0.001, key="bias_px")
    noise_mm = float(np.std((cloud.points_mm - truth) @ np.array([0.0, 0.0, 1.0])))
    yield Measured("noise of the depth", noise_mm, "mm", key="noise_mm")
    yield Measured(
        "float32 against float64: wrapped phase", phase_error_px(scan), "px", at_most=1e-5, key="float32_max_px"
    )
    decoded = oracle.decode(scan.sequence, scan.frames["left"])
    maps = pipeline.decoded("left")
    valid = np.isfinite(maps.p_px)
    stored = np.abs(np.stack([maps.p_px, maps.q_px], -1)[valid] - decoded.pq[valid]).max()
    yield Measured(
        "the same with the coordinate stored in 32 bits", float(stored), "px", key="float32_coordinate_max_px"
    )


def plane_of(scan: ScanFrames) -> tuple[Array, float]:
    return NORMAL, float(NORMAL @ scan.calibration.rig.volume_centre_mm(synthetic.WATER.index))


def phase_error_px(scan: ScanFrames) -> float:
    """Largest difference of our wrapped phase to float64's, in pattern px, where there is light."""
    worst = 0.0
    for direction in (Direction.X, Direction.Y):
        i0, i1, i2, i3 = (scan.frames["left"][k].reshape(-1) for k in scan.sequence.axis(direction).sine)
        turn = np.empty(i0.size, np.float32)
        phase(i0, i1, i2, i3, turn)
        wide = [a.astype(float) for a in (i0, i1, i2, i3)]
        exact = np.arctan2(wide[3] - wide[1], wide[0] - wide[2]) / (2.0 * np.pi)
        difference = turn - exact
        difference -= np.rint(difference)
        worst = max(worst, float(np.abs(difference).max()) * scan.sequence.period_px)
    return worst


def worker(scan: ScanFrames) -> Iterator[Measured]:
    """The warm process, from its start to the first cloud, and what it needs."""
    n, height_px, width_px = scan.frames["left"].shape
    with ExitStack() as stack:
        store = stack.enter_context(FrameStore(n, height_px, width_px))
        for side in SIDES:
            store.frames(side)[...] = scan.frames[side]
        order = WorkOrder(scan.calibration, synthetic.WATER, scan.sequence.period_px, 1024, 768)
        first_s = []
        for k in range(4):
            begun_s = time.monotonic()
            with ReconstructionWorker(order, store, MonotonicClock()) as process:
                if process.wait(60.0) != WorkerReady():
                    raise RuntimeError("the worker did not start")
                ready_s = time.monotonic() - begun_s
                for number in range(1 if k < 3 else 5):
                    process.reprocess(number)
                    while not (isinstance(event := process.wait(20.0), CloudReady) and event.full):
                        if event is None:
                            raise RuntimeError("the worker did not answer")
                    if number == 0:
                        first_s.append((time.monotonic() - begun_s, ready_s))
                peak_mb = peak_memory_mb(process.pid or 0)
        whole, ready = np.median(np.array(first_s[1:]), 0)  # the first start may have compiled
        yield Measured("start of the worker until it is warm", ready, "s", key="worker_ready_s")
        yield Measured("start of the worker until its first cloud", whole, "s", at_most=1.2, key="first_scan_s")
        yield Measured("peak memory of the worker, all of it", peak_mb, "MB", at_most=400.0, key="worker_peak_mb")


def peak_memory_mb(pid: int) -> float:
    """Peak resident memory, shared frames included."""
    for line in Path(f"/proc/{pid}/status").read_text(encoding="ascii", errors="replace").splitlines():
        if line.startswith("VmHWM"):
            return int(line.split()[1]) / 1000.0
    return math.nan


def durable(scan: ScanFrames) -> Iterator[Measured]:
    """A scan's raw frames on the disk, against the same bytes written plainly, in turns."""
    ours, plain = [], []
    with tempfile.TemporaryDirectory(dir=OUT) as folder:
        library = Library(Path(folder) / "storage")
        library.prepare()
        record = plain_record(sequence=SequenceInfo.of(scan.sequence))
        for k in range(5):
            ours.append(wall_ms(lambda: library.begin(scan.frames, record)))
            plain.append(wall_ms(lambda k=k: write_plainly(Path(folder), k, scan.frames)))  # type: ignore[misc]
    yield Measured("the disk's own time for the raw frames", float(np.median(plain)), "ms", key="disk_ms")
    beyond = float(np.median(np.array(ours) - np.array(plain)))
    yield Measured("raw frames durable, beyond that", beyond, "ms", at_most=100.0, key="raw_durable_ms")


def write_plainly(folder: Path, number: int, frames: dict[str, NDArray[np.uint8]]) -> None:
    for side, stack in frames.items():
        with (folder / f"{number}-{side}").open("wb", buffering=0) as file:
            stack.tofile(file)
            os.fsync(file.fileno())


def cpu_ms(action: Callable[[], object]) -> float:
    begun_s = time.process_time()
    action()
    return (time.process_time() - begun_s) * 1e3


def wall_ms(action: Callable[[], object]) -> float:
    begun_s = time.monotonic()
    action()
    return (time.monotonic() - begun_s) * 1e3
