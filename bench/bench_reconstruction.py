"""Cost of a scan from its first frame to its last point, against other programs and the limit of memory.

All are measured in one run, in turns, so that a busy machine slows them equally. Times are CPU milliseconds of the
process, threads included.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from appliance.measure.light.sides import SIDES
from appliance.measure.points.pipeline import Pipeline
from appliance.measure.points.table import Cloud
from bench import foreign, roofline
from bench.disk import durable
from bench.judgement import judge_cloud, judged_at_steps, precision
from bench.picture import Bar, Panel, draw
from bench.result import Measurement
from bench.rivals import Rounds, in_turns
from bench.scan_frames import ScanFrames, make_scan
from bench.stages import one_scan
from bench.timing import median_of
from bench.warm_worker import worker
from tests.support import synthetic

OUT = Path("bench/out")
KDTREE_TARGET = 40.0
PAIR_MS = 1000.0 / 60.0
"""A pair of frames must be worked on before the next one comes."""
BAR_HEIGHT_MM = 15.0


@dataclass(frozen=True, slots=True)
class Effort:
    """Image size, and number of repetitions."""

    width_px: int = 1600
    height_px: int = 1200
    rounds: int = 21
    slow_rounds: int = 3
    worker_starts: int = 5
    paced_scans: int = 7
    disk_rounds: int = 10
    ask_peers: bool = True


def measure() -> Iterator[Measurement]:
    OUT.mkdir(parents=True, exist_ok=True)
    yield from measured_with(Effort(), OUT)


def measured_with(effort: Effort, out: Path) -> Iterator[Measurement]:
    """Yield all figures, and write ``reconstruction.png`` in ``out``."""
    scan = make_scan(effort.width_px, effort.height_px)
    with Pipeline(scan.calibration, synthetic.WATER, scan.sequence) as pipeline:
        rounds = in_turns(pipeline, scan, effort.rounds, effort.slow_rounds, effort.ask_peers)
        one_scan(pipeline, scan)
        cloud = pipeline.full()
        lit_px = [pipeline.decoded(side).illuminated_pixels for side in SIDES]
        numbers = [*stages(rounds), *compared(rounds), *least(rounds, scan, lit_px, len(cloud.points_mm))]
        draw(out / "reconstruction.png", panels({n.key: n for n in numbers if n.key is not None}, rounds))
        yield from numbers
        yield from judge_cloud(scan, cloud)
        yield from precision(scan, pipeline)
        yield from judged_at_steps(*with_a_bar(pipeline, effort))
    yield from worker(scan, effort.worker_starts, effort.paced_scans)
    yield from durable(scan, cloud, out, effort.disk_rounds)


def with_a_bar(pipeline: Pipeline, effort: Effort) -> tuple[ScanFrames, Cloud]:
    """Return a second scene with depth discontinuities, and its cloud."""
    scan = make_scan(effort.width_px, effort.height_px, bar_height_mm=BAR_HEIGHT_MM)
    one_scan(pipeline, scan)
    return scan, pipeline.full()


def stages(rounds: Rounds) -> Iterator[Measurement]:
    """Yield the cost of each part of a scan."""
    pairs = np.array([scan.pairs_ms for scan in rounds.scans])
    dearest = int(np.argmax(np.median(pairs, 0)))
    name = f"dearest pair of frames (number {dearest})"
    yield median_of(name, pairs[:, dearest].tolist(), "ms CPU", "pair_max_cpu_ms", at_most=PAIR_MS)
    for name, part, key in (
        ("recording: all pairs but the last", lambda s: s.recording_ms, "recording_cpu_ms"),
        ("last pair of frames", lambda s: s.pairs_ms[-1], "last_frame_cpu_ms"),
        ("prepare and coarse cloud", lambda s: s.coarse_ms, "coarse_step_cpu_ms"),
        ("full cloud", lambda s: s.full_ms, "full_step_cpu_ms"),
        ("last frame to coarse cloud", lambda s: s.to_coarse_ms, "coarse_cpu_ms"),
        ("last frame to full cloud", lambda s: s.to_full_ms, "full_cpu_ms"),
        ("whole scan", lambda s: s.whole_ms, "scan_cpu_ms"),
    ):
        yield median_of(name, rounds.scan_ms(part), "ms CPU", key)


def compared(rounds: Rounds) -> Iterator[Measurement]:
    """Yield the cost of other programs, and its ratio to ours."""
    whole_ms = rounds.scan_ms(lambda s: s.whole_ms)
    decode = rounds.taken_ms["decode"]
    yield median_of("one camera decoded", decode, "ms CPU", "decode_cpu_ms")
    opencv, plain = rounds.taken_ms["opencv_decode"], rounds.taken_ms["numpy_decode"]
    yield median_of("the same in OpenCV's vector operations", opencv, "ms CPU", "opencv_decode_cpu_ms")
    yield median_of("that against ours", rounds.ratios("opencv_decode", decode), "times", "ratio_opencv_decode")
    yield median_of("the same in NumPy, float32", plain, "ms CPU", "numpy_decode_cpu_ms")
    yield median_of("that against ours", rounds.ratios("numpy_decode", decode), "times", "ratio_numpy_decode")
    slow = rounds.taken_ms["numpy_kdtree"]
    yield median_of("whole scan, float64 NumPy and KD-tree", slow, "ms CPU", "numpy_kdtree_cpu_ms")
    ratio = rounds.ratios("numpy_kdtree", whole_ms)
    yield median_of("that against ours", ratio, "times", "ratio_numpy_kdtree", at_least=KDTREE_TARGET)
    ours = {"cv2_structured_light": whole_ms, "fringes": decode}
    for name in foreign.PROGRAMS:
        label = f"{name} {rounds.versions.get(name, '')}".strip()
        if name in rounds.absent:
            for row, unit, key in (
                (label, "ms CPU", f"{name}_cpu_ms"),
                ("that against ours", "times", f"ratio_{name}"),
            ):
                yield Measurement(row, math.nan, unit, key=key, why=rounds.absent[name])
            continue
        yield median_of(label, rounds.taken_ms[name], "ms CPU", f"{name}_cpu_ms")
        yield median_of("that against ours", rounds.ratios(name, ours[name]), "times", f"ratio_{name}")


def least(rounds: Rounds, scan: ScanFrames, lit_px: Sequence[int], points: int) -> Iterator[Measurement]:
    """Yield the time that memory alone needs, at the highest speed of this run."""
    read_gb_s, write_gb_s = (float(best) for best in np.max(rounds.bandwidth_gb_s, 0))
    frames = scan.frames["left"]
    least_ms = roofline.scan_ms(frames[0].size, len(frames), points, read_gb_s, write_gb_s)
    yield Measurement("memory reads", read_gb_s, "GB/s", key="memory_read_gb_s")
    yield Measurement("memory writes", write_gb_s, "GB/s", key="memory_write_gb_s")
    yield Measurement("whole scan, if memory alone counted", least_ms, "ms", key="roofline_scan_ms")
    ratio = [scan_ms / least_ms for scan_ms in rounds.scan_ms(lambda s: s.whole_ms)]
    yield median_of("ours against that", ratio, "times", "ratio_roofline")
    left_px, right_px = lit_px
    least_ms = roofline.full_cloud_ms(left_px, right_px, points, read_gb_s, write_gb_s)
    yield Measurement("full cloud, if memory alone counted", least_ms, "ms", key="roofline_full_ms")
    ratio = [full / least_ms for full in rounds.scan_ms(lambda s: s.full_ms)]
    yield median_of("ours against that", ratio, "times", "ratio_full_roofline")


def panels(numbers: dict[str, Measurement], rounds: Rounds) -> list[Panel]:
    """Return the panels of the picture: the steps of a scan, then other programs."""

    def bar(name: str, key: str, ratio: str | None = None) -> Bar:
        number = numbers[key]
        note = f"{numbers[ratio].value:.3g} times" if ratio is not None else ""
        return Bar(name, number.value, number.spread, note=note)

    one_camera = [
        bar("Kingfisher", "decode_cpu_ms"),
        bar("OpenCV vector operations", "opencv_decode_cpu_ms", ratio="ratio_opencv_decode"),
        bar("NumPy float32", "numpy_decode_cpu_ms", ratio="ratio_numpy_decode"),
    ]
    both_cameras = [
        bar("memory traffic alone", "roofline_scan_ms"),
        bar("Kingfisher", "scan_cpu_ms"),
    ]
    if "fringes" in rounds.versions and "fringes" not in rounds.absent:
        label = f"fringes {rounds.versions['fringes']} (no Gray code)"
        one_camera.append(bar(label, "fringes_cpu_ms", ratio="ratio_fringes"))
    if "cv2_structured_light" in rounds.versions and "cv2_structured_light" not in rounds.absent:
        label = "cv2.structured_light (whole px)"
        both_cameras.append(bar(label, "cv2_structured_light_cpu_ms", ratio="ratio_cv2_structured_light"))
    both_cameras.append(bar("float64 NumPy and KD-tree", "numpy_kdtree_cpu_ms", ratio="ratio_numpy_kdtree"))
    return [
        Panel(
            "One scan here, CPU ms",
            [
                bar("recording, 23 pairs", "recording_cpu_ms"),
                bar("last pair", "last_frame_cpu_ms"),
                bar("prepare and coarse cloud", "coarse_step_cpu_ms"),
                bar("full cloud", "full_step_cpu_ms"),
                bar("last frame to coarse", "coarse_cpu_ms"),
                bar("last frame to full", "full_cpu_ms"),
                bar("whole scan", "scan_cpu_ms"),
            ],
        ),
        Panel("One camera decoded, CPU ms", one_camera),
        Panel("Both cameras to correspondences or points, CPU ms", both_cameras),
    ]
