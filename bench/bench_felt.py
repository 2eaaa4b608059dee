"""Waiting times of a diver and at a desk, by the clock, beside the least possible time.

A diver's times begin with the key: the recording of the sequence, then the product's worker, as ``bench.whole_scan``
paces it. The appliance starts on simulated devices, whose world shares the processors with it. A desk's verbs are
processes of their own, with warm files and compiled kernels; CPU is that of all their processes. Each time is the
median of a few repetitions.
"""

from __future__ import annotations

import subprocess
import tarfile
import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path

from appliance.measure.calibration.file import encode_calibration
from appliance.store.config import parse_rig
from appliance.store.library import Library
from appliance.store.manifest import SequenceInfo
from appliance.store.scan import ScanOrigin
from bench.archive.scenes import rig_text
from bench.result import Measurement
from bench.timing import median_of, run_python, verb
from bench.warm_worker import FRAME_S
from bench.whole_scan.paced import PacedScan, paced_worker
from bench.whole_scan.scenes import DISC, FOLDER, TimedScene, timed_scene
from tests.appliance.store.scenes import record as plain_record
from tests.behaviour.frozen import RECORDINGS
from tests.integration.dived import Service

OUT = Path("bench/out")
MOVING = "moving"
ANSWERS: tuple[tuple[str, str, Callable[[PacedScan], float]], ...] = (
    ("verdict", "felt_verdict_ms", lambda s: s.verdict_ms),
    ("coarse cloud", "felt_coarse_ms", lambda s: s.coarse_ms),
    ("full cloud", "felt_full_ms", lambda s: s.full_ms),
)
"""Words and key of each answer to the key, and its time from the last frame on."""
LARGE_SCAN, SMALL_SCANS, EMPTY = "stored", "small", "empty"
"""Folders of the desk: a scan of full size, the recordings of ``tests/behaviour``, and no scans."""
NEW_OBJECT = verb(f"object add --root {SMALL_SCANS}/root Solved 1 2 3")
DESK: tuple[tuple[str, str, list[str]], ...] = (
    ("bare Python", "python", ["-c", "pass"]),
    ("kingfisher --version", "version", verb("--version")),
    ("kingfisher scans list, no scans", "list", verb(f"scans list --root {EMPTY}")),
    ("kingfisher cloud, a stored scan processed again", "cloud", verb(f"cloud --root {LARGE_SCAN} 1 --out again.npz")),
    ("kingfisher object solve, three small scans", "object", verb(f"object solve --root {SMALL_SCANS}/root Solved")),
)
"""Words, the middle of the keys, and the arguments of Python."""
AIM_TIMEOUT_S, STOP_TIMEOUT_S, LOOK_S = 120.0, 30.0, 0.005


@dataclass(frozen=True, slots=True)
class Effort:
    """Image width, and number of repetitions."""

    width_px: int = 1600
    starts: int = 3
    """Number of starts of the worker and of the appliance, and of repetitions of each verb."""
    scans: int = 3
    """Number of scans on each start of the worker."""
    folder: Path = FOLDER
    """Where the scenes' frames are kept."""
    compensated: bool = True
    """Include the scene with the moving hand, which takes minutes to render."""


def measure() -> Iterator[Measurement]:
    OUT.mkdir(parents=True, exist_ok=True)
    yield from measured_with(Effort(), OUT)


def measured_with(effort: Effort, out: Path) -> Iterator[Measurement]:
    """Yield all figures; scans are written to the disk of ``out``."""
    disc = timed_scene(DISC, effort.width_px, effort.folder)
    yield from key_to_answers(disc, effort, out)
    with tempfile.TemporaryDirectory(dir=out) as folder:
        yield from power_to_aim(Path(folder) / "root", effort)
        yield from desk(Path(folder), disc, effort.starts)


def key_to_answers(disc: TimedScene, effort: Effort, out: Path) -> Iterator[Measurement]:
    """Yield the times from the key to each answer, and start and memory of the worker."""
    scans, ready_s, peak_mb, shared_mb = [], [], [], []
    for _ in range(effort.starts):
        with paced_worker(disc, out) as worker:
            scans += [worker.scan() for _ in range(effort.scans)]
            ready_s.append(worker.ready_s)
            peak_mb.append(worker.peak_mb)
            shared_mb.append(worker.peak_mb - worker.own_peak_mb)
    recording_ms = 1e3 * FRAME_S * len(disc.sequence)
    yield Measurement("recording of the sequence", recording_ms, "ms", key="felt_recording_ms")
    for label, key, after_ms in ANSWERS:
        yield median_of(f"key to {label}", [recording_ms + after_ms(scan) for scan in scans], "ms", key)
    if effort.compensated:
        with paced_worker(timed_scene(MOVING, effort.width_px, effort.folder), out) as worker:
            compensated = [worker.scan() for _ in range(effort.scans)]
        if not all(scan.compensating_cpu_ms for scan in compensated):
            raise RuntimeError("the scan of the moving hand was not compensated; its time says nothing")
        full_ms = [recording_ms + scan.full_ms for scan in compensated]
        yield median_of("key to full cloud, compensated", full_ms, "ms", "felt_compensated_ms")
    yield median_of("start of the worker until it is warm", ready_s, "s", "felt_ready_s")
    yield median_of("peak memory of the worker, shared included", peak_mb, "MB", "felt_peak_mb")
    yield median_of("of it shared with the service", shared_mb, "MB", "felt_shared_mb")


def power_to_aim(root: Path, effort: Effort) -> Iterator[Measurement]:
    """Yield the time from the start of the appliance to AIM. Raises RuntimeError where it does not come."""
    size = f"size={effort.width_px}x{effort.width_px * 3 // 4}"
    aim_s = []
    for _ in range(effort.starts):
        begun_s = time.monotonic()
        service = Service(root, "truth=nominal", size, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        try:
            while service.status().get("state") != "AIM":
                if service.process.poll() is not None or time.monotonic() - begun_s > AIM_TIMEOUT_S:
                    raise RuntimeError(f"the appliance did not come to AIM; its last status: {service.status()}")
                time.sleep(LOOK_S)
            aim_s.append(time.monotonic() - begun_s)
        finally:
            service.process.terminate()
            service.process.wait(STOP_TIMEOUT_S)
    yield median_of("power to AIM, simulated devices", aim_s, "s", "felt_aim_s")


def desk(folder: Path, disc: TimedScene, repetitions: int) -> Iterator[Measurement]:
    """Yield clock and CPU of each verb. Raises RuntimeError where one fails."""
    (folder / EMPTY).mkdir()
    store(disc, folder / LARGE_SCAN)
    with tarfile.open(RECORDINGS) as packed:
        packed.extractall(folder / SMALL_SCANS, filter="data")
    _run(NEW_OBJECT, folder)
    for label, name, arguments in DESK:
        _run(arguments, folder)  # warms the files, and compiles a kernel that is missing
        times_s = [_run(arguments, folder) for _ in range(repetitions)]
        yield median_of(label, [wall_s for wall_s, _ in times_s], "s", f"felt_{name}_s")
        yield median_of(f"{label}, CPU", [cpu_s for _, cpu_s in times_s], "s CPU", f"felt_{name}_cpu_s")


def store(scene: TimedScene, root: Path) -> None:
    """Publish the frames of ``scene`` as scan 000001, with its calibration and the packaged rig file."""
    height_px, width_px = scene.frames["left"].shape[1:]
    text = rig_text((width_px, height_px))
    rig = parse_rig(text, "the packaged rig file")
    serials = (rig.camera.left.serial, rig.camera.right.serial)
    calibration = replace(scene.calibration, rig_serial=rig.rig.serial, camera_serials=serials)
    record = plain_record(sequence=SequenceInfo.of(scene.sequence))
    library = Library(root)
    library.prepare()
    pending = library.begin(dict(scene.frames), record, ScanOrigin(encode_calibration(calibration), text.encode()))
    pending.publish(record)


def _run(arguments: list[str], folder: Path) -> tuple[float, float]:
    cost = run_python(arguments, folder)
    if cost.code:
        raise RuntimeError(f"{' '.join(arguments)} ended with {cost.code}: {cost.errors[-600:]}")
    return cost.wall_s, cost.cpu_s
