"""Cost of a scan with all judges, on the product's worker: from the last frame to coarse cloud, verdict, full cloud,
disk.

Four scenes (``bench.whole_scan.scenes``), one after the other in turns. Times by the clock and CPU of all threads are
those of the worker process; the disk's writer runs beside it, as in the service. Times by the clock are also stated for
a reference machine, on which OpenCV's vector operations and NumPy decode one camera in 41 and 103 ms: they are divided
by the quotient of both times here and there, measured anew after each scan.
"""

from __future__ import annotations

import argparse
import math
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path

from appliance.instrument.worker.messages import WorkLimits
from bench import references
from bench.document import AGAINST
from bench.result import Measurement
from bench.runner import Benchmark, run
from bench.timing import cpu_ms, median_of
from bench.whole_scan import parts as by_part
from bench.whole_scan import timeline
from bench.whole_scan.against import NoComparison, compared, other_tree, table
from bench.whole_scan.paced import PacedScan, paced_worker
from bench.whole_scan.scenes import DISC, FOLDER, NAMES, WORDS, TimedScene, timed_scene

OUT = Path("bench/out")
MOVING = "moving"
OPENCV_THERE_MS, NUMPY_THERE_MS = 41.0, 103.0
"""Decoding one camera on the reference machine."""
NORMALISED: dict[str, tuple[tuple[str, str, Callable[[PacedScan], float]], ...]] = {
    DISC: (
        ("coarse_reference_ms", "last frame to coarse cloud", lambda s: s.coarse_ms),
        ("verdict_reference_ms", "last frame to verdict", lambda s: s.verdict_ms),
        ("complete_reference_ms", "last frame to full cloud, all judged", lambda s: s.full_ms),
    ),
    MOVING: (("compensation_reference_ms", "compensation", lambda s: s.compensating_ms),),
}
"""Clock times that are also stated for the reference machine: key, label, value."""
ROWS: tuple[tuple[str, str, Callable[[PacedScan], float], str], ...] = (
    ("coarse_path_cpu_ms", "last frame to coarse cloud", lambda s: s.coarse_cpu_ms, "ms CPU"),
    ("verdict_cpu_ms", "last frame to verdict", lambda s: s.verdict_cpu_ms, "ms CPU"),
    ("complete_cpu_ms", "last frame to full cloud, all judged", lambda s: s.complete_cpu_ms, "ms CPU"),
    ("complete_scan_cpu_ms", "whole scan with judges", lambda s: s.whole_cpu_ms, "ms CPU"),
    ("coarse_wall_ms", "last frame to coarse cloud, by the clock", lambda s: s.coarse_ms, "ms"),
    ("verdict_wall_ms", "last frame to verdict, by the clock", lambda s: s.verdict_ms, "ms"),
    ("complete_wall_ms", "last frame to full cloud, by the clock", lambda s: s.full_ms, "ms"),
    ("durable_wall_ms", "last frame to raw frames durable, by the clock", lambda s: s.durable_ms, "ms"),
)


@dataclass(frozen=True, slots=True)
class Effort:
    """Image width, and number of scans."""

    width_px: int = 1600
    scans: int = 9
    rounds: int = 5
    """Of the procedure judge by judge."""
    traced: int = 7
    """Number of scans of which the most typical one is drawn."""
    folder: Path = FOLDER
    """Where the scenes' frames are kept."""
    scenes: Sequence[str] = NAMES


@dataclass(frozen=True, slots=True)
class SceneTimes:
    """Measurements of one scene."""

    scene: TimedScene
    scans: Sequence[PacedScan]
    slower: Sequence[float]
    """This machine's times over those of the reference machine, one of each scan."""
    parts_ms: Mapping[str, Sequence[float]]
    peak_mb: float
    own_peak_mb: float


def measure() -> Iterator[Measurement]:
    OUT.mkdir(parents=True, exist_ok=True)
    yield from measured_with(Effort(), OUT)


def main(arguments: Sequence[str]) -> int:
    """Run the command line: ``./dev bench whole_scan --against REV``."""
    parser = argparse.ArgumentParser(
        prog="./dev bench whole_scan",
        description="CPU time of each part of a scan over that of another revision: both run in turns on the same frames.",
    )
    parser.add_argument(
        "--against", metavar="REV", required=True, help="a revision of this repository, as git names it"
    )
    parser.add_argument("--rounds", type=int, default=12, help="default: %(default)s")
    parser.add_argument(
        "--scenes", default=",".join(NAMES), help="names with commas between; default: all, %(default)s"
    )
    options = parser.parse_args(arguments)
    scenes = options.scenes.split(",")
    for name in scenes:
        if name not in NAMES:
            parser.error(f"--scenes: {name!r} is no scene; allowed: {', '.join(NAMES)}")
    if options.rounds < 1:
        parser.error(f"--rounds is {options.rounds}; at least 1 is needed")

    numbers: list[Measurement] = []
    try:
        sys.stdout.write(
            f"{options.against}: its tree is made, and its kernels are compiled, which takes minutes the first time\n"
        )
        theirs = other_tree(options.against)
    except NoComparison as error:
        sys.stderr.write(f"{error}\n")
        return 2

    def measured() -> Iterator[Measurement]:
        for number in compared(theirs, options.rounds, scenes):
            numbers.append(number)
            yield number

    paired = Benchmark("whole_scan_against", f"each part of a scan, CPU over that of {theirs.revision[:8]}", measured)
    all_kept = run([paired], OUT, sys.stdout.write)
    if all_kept:
        (OUT / AGAINST).write_text(table(theirs.revision, options.rounds, numbers), encoding="utf-8")
    return 0 if all_kept else 1


def measured_with(effort: Effort, out: Path) -> Iterator[Measurement]:
    """Yield all figures, and write ``timeline.png`` in ``out``."""
    decoded = timed_scene(DISC, effort.width_px, effort.folder)
    for name in effort.scenes:
        scene = decoded if name == DISC else timed_scene(name, effort.width_px, effort.folder)
        yield from figures(_timed(scene, decoded, effort, out))


def key_of(scene: str, key: str) -> str:
    """Return a figure's name in ``latest.json``: that of the disc is the headline and has the plain name."""
    return key if scene == DISC else f"{scene}_{key}"


def figures(timed: SceneTimes) -> Iterator[Measurement]:
    """Yield the figures of the scans of one scene."""
    name, scans = timed.scene.name, timed.scans
    label = WORDS[name]
    points = [scan.points for scan in scans]
    fault_names = ", ".join(sorted({code for scan in scans for code in scan.faults})) or "nothing"
    yield median_of(
        f"{label}: points (held against it: {fault_names})", points, "points", key_of(name, "complete_points")
    )
    for key, row, part, unit in ROWS:
        yield median_of(f"{name}: {row}", [part(scan) for scan in scans], unit, key_of(name, key))
    if name == DISC:
        label = "this machine's times against the reference machine's"
        yield median_of(label, timed.slower, "times", "complete_machine_factor")
    for key, row, part in NORMALISED.get(name, ()):
        reference_ms = [part(scan) / slower for scan, slower in zip(scans, timed.slower, strict=True)]
        yield median_of(f"{name}: {row}, by the clock of the reference machine", reference_ms, "ms", key)
    for part_name, taken_ms in timed.parts_ms.items():
        yield median_of(f"{name}, {part_name}", taken_ms, "ms CPU", key_of(name, part_key(part_name)))
    label = f"{name}: peak memory of the worker, frames included"
    yield Measurement(label, timed.peak_mb, "MB", key=key_of(name, "complete_peak_mb"))
    yield Measurement(
        f"{name}: without what it shares", timed.own_peak_mb, "MB", WorkLimits().memory_mb,
        key=key_of(name, "complete_own_peak_mb"),
    )  # fmt: skip


def part_key(part: str) -> str:
    """Return the end of the key of one part of a scan."""
    return f"part_{part.replace('of it: ', '').replace(' ', '_')}_cpu_ms"


def _timed(scene: TimedScene, decoded: TimedScene, effort: Effort, out: Path) -> SceneTimes:
    scans, slower = [], []
    with ExitStack() as stack:
        worker = stack.enter_context(paced_worker(scene, out))
        for _ in range(effort.scans):
            scans.append(worker.scan())
            slower.append(machine_factor(decoded))
        if scene.name == DISC:
            # Behind the scans that count: to sample the worker's clock costs a little of the processor that it wants.
            traced = [worker.scan(traced=True) for _ in range(effort.traced)]
            timeline.draw(out / "timeline.png", WORDS[DISC], scene.sequence, timeline.typical(traced))
        peak_mb, own_peak_mb = worker.peak_mb, worker.own_peak_mb
    with by_part.procedure(scene) as procedure:
        for _ in range(effort.rounds):
            procedure.round()
        taken_ms = procedure.parts_ms()
    return SceneTimes(scene, scans, slower, taken_ms, peak_mb, own_peak_mb)


def machine_factor(scene: TimedScene) -> float:
    """Return this machine's times against the reference machine's, now: two ways to decode one camera, each weighing the same."""
    frames = scene.frames["left"]
    # Both allocate as they go; the first time after a scan much of what they take is the kernel's work to find memory.
    for decode in (references.opencv_decode, references.numpy_decode):
        decode(scene.sequence, frames)
    opencv_ms = cpu_ms(lambda: references.opencv_decode(scene.sequence, frames))
    numpy_ms = cpu_ms(lambda: references.numpy_decode(scene.sequence, frames))
    return math.sqrt(opencv_ms / OPENCV_THERE_MS * numpy_ms / NUMPY_THERE_MS)
