"""Size of packed scans relative to raw ones, by world and object, and the time of packing and opening them."""

from __future__ import annotations

import shutil
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from statistics import median

from appliance.measure.light.sides import SIDES
from appliance.store.archive import CopyOutcome, pack_scan
from appliance.store.atomic import LocalFileSystem
from appliance.store.scan import StoredScan
from bench.archive.scenes import RandomScan
from bench.result import Measurement

LEAST_RATIO = 3.1
DIVE_SCANS = 1440
"""Scans of a two-hour dive, one every five seconds."""
GB = 1e9


@dataclass(frozen=True, slots=True)
class PackedScan:
    """Sizes of one scan, and the CPU time of packing it with all comparisons, and of opening it."""

    drawn: RandomScan
    raw_bytes: int
    packed_bytes: int
    pack_cpu_s: float
    open_cpu_s: float
    frame_cpu_s: float
    """Median for one frame read by itself."""

    @property
    def ratio(self) -> float:
        """Factor by which its frames became smaller."""
        return self.raw_bytes / self.packed_bytes


def packed_scans(drawn: Sequence[RandomScan], archive: Path, say: Callable[[str], None]) -> list[PackedScan]:
    """Pack each scan into ``archive``, which is created empty."""
    results = []
    shutil.rmtree(archive, ignore_errors=True)  # of a call that was interrupted
    archive.mkdir(parents=True, exist_ok=True)
    for scan in drawn:
        target = archive / scan.folder.name
        begun_s = time.process_time()
        if pack_scan(LocalFileSystem(), scan.folder, target) is not CopyOutcome.WRITTEN:
            raise RuntimeError(f"{target} was not written")
        pack_s = time.process_time() - begun_s
        begun_s = time.process_time()
        StoredScan.load(target)
        open_s = time.process_time() - begun_s
        frame_s = median(_frame_cpu_s(target, side, k) for side in SIDES for k in range(0, 24, 4))
        sizes = [sum(path.stat().st_size for path in folder.glob("frames_*")) for folder in (scan.folder, target)]
        results.append(PackedScan(scan, sizes[0], sizes[1], pack_s, open_s, frame_s))
        say(f"{scan.world} {scan.folder.name} {scan.object}: {results[-1].ratio:.2f}")
    return results


def _frame_cpu_s(folder: Path, side: str, k: int) -> float:
    """Return the CPU time of reading one frame of a packed scan: manifest, index, stream and checksum."""
    begun_s = time.process_time()
    StoredScan.read_frame(folder, side, k)
    return time.process_time() - begun_s


def figures(scans: Sequence[PackedScan], *, bound: bool) -> Iterator[Measurement]:
    """Yield the figures of one world's scans; ``bound``: the ratio has its lower limit."""
    world = scans[0].drawn.world
    raw, held = sum(scan.raw_bytes for scan in scans), sum(scan.packed_bytes for scan in scans)
    limit = LEAST_RATIO if bound else None
    yield Measurement(f"{world}: packed how many times smaller", raw / held, f"all {len(scans)} scans", at_least=limit)
    ratios = sorted(scan.ratio for scan in scans)
    yield Measurement(f"{world}: of one scan at least", ratios[0], "times")
    yield Measurement(f"{world}: of one scan at most", ratios[-1], "times")
    for name in sorted({scan.drawn.object for scan in scans}):
        some = [scan for scan in scans if scan.drawn.object == name]
        ratio = sum(scan.raw_bytes for scan in some) / sum(scan.packed_bytes for scan in some)
        yield Measurement(f"{world}: {name}", ratio, f"times, {len(some)} scans")
    each = DIVE_SCANS / len(scans) / GB
    yield Measurement(f"{world}: {DIVE_SCANS} scans, raw", raw * each, "GB")
    yield Measurement(f"{world}: {DIVE_SCANS} scans, packed", held * each, "GB")
    yield Measurement(
        f"{world}: packing and comparing", sum(scan.pack_cpu_s for scan in scans) / len(scans), "CPU s a scan"
    )
    yield Measurement(
        f"{world}: opening a packed scan", sum(scan.open_cpu_s for scan in scans) / len(scans), "CPU s a scan"
    )
    frame_ms = 1000.0 * median(scan.frame_cpu_s for scan in scans)
    yield Measurement(f"{world}: one frame of a packed scan", frame_ms, "CPU ms")
