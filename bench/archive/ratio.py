"""Owns how much smaller packed scans are, by world and by object, and how fast they are packed and had again."""

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
from bench.archive.scenes import Drawn
from bench.result import Measured

LEAST_RATIO = 3.1
DIVE_SCANS = 1440
"""Scans of a two-hour dive, one every five seconds."""
GB = 1e9


@dataclass(frozen=True, slots=True)
class PackedScan:
    """One scan's room, and the processor time of packing it with everything that is compared, and of opening it."""

    drawn: Drawn
    raw_bytes: int
    packed_bytes: int
    pack_cpu_s: float
    open_cpu_s: float
    frame_cpu_s: float
    """Of one frame had alone, median."""

    @property
    def ratio(self) -> float:
        """Factor by which its frames became smaller."""
        return self.raw_bytes / self.packed_bytes


def packed_scans(drawn: Sequence[Drawn], archive: Path, say: Callable[[str], None]) -> list[PackedScan]:
    """Pack each scan into ``archive``, which is made anew."""
    found = []
    shutil.rmtree(archive, ignore_errors=True)  # of a call that was interrupted
    archive.mkdir(parents=True, exist_ok=True)
    for one in drawn:
        target = archive / one.folder.name
        begun_s = time.process_time()
        if pack_scan(LocalFileSystem(), one.folder, target) is not CopyOutcome.WRITTEN:
            raise RuntimeError(f"{target} was not written")
        pack_s = time.process_time() - begun_s
        begun_s = time.process_time()
        StoredScan.load(target)
        open_s = time.process_time() - begun_s
        frame_s = median(_frame_cpu_s(target, side, k) for side in SIDES for k in range(0, 24, 4))
        sizes = [sum(path.stat().st_size for path in folder.glob("frames_*")) for folder in (one.folder, target)]
        found.append(PackedScan(one, sizes[0], sizes[1], pack_s, open_s, frame_s))
        say(f"{one.world} {one.folder.name} {one.object}: {found[-1].ratio:.2f}")
    return found


def _frame_cpu_s(folder: Path, side: str, k: int) -> float:
    """Return the processor time of one frame of a packed scan: its manifest, index, stream and checksum, and nothing else."""
    begun_s = time.process_time()
    StoredScan.read_frame(folder, side, k)
    return time.process_time() - begun_s


def figures(scans: Sequence[PackedScan], *, bound: bool) -> Iterator[Measured]:
    """Yield the figures of one world's scans; ``bound``: the promise is held against them."""
    world = scans[0].drawn.world
    raw, held = sum(one.raw_bytes for one in scans), sum(one.packed_bytes for one in scans)
    least = LEAST_RATIO if bound else None
    yield Measured(f"{world}: packed how many times smaller", raw / held, f"all {len(scans)} scans", at_least=least)
    ratios = sorted(one.ratio for one in scans)
    yield Measured(f"{world}: of one scan at least", ratios[0], "times")
    yield Measured(f"{world}: of one scan at most", ratios[-1], "times")
    for name in sorted({one.drawn.object for one in scans}):
        some = [one for one in scans if one.drawn.object == name]
        ratio = sum(one.raw_bytes for one in some) / sum(one.packed_bytes for one in some)
        yield Measured(f"{world}: {name}", ratio, f"times, {len(some)} scans")
    each = DIVE_SCANS / len(scans) / GB
    yield Measured(f"{world}: {DIVE_SCANS} scans, raw", raw * each, "GB")
    yield Measured(f"{world}: {DIVE_SCANS} scans, packed", held * each, "GB")
    yield Measured(f"{world}: packing and comparing", sum(one.pack_cpu_s for one in scans) / len(scans), "CPU s a scan")
    yield Measured(f"{world}: opening a packed scan", sum(one.open_cpu_s for one in scans) / len(scans), "CPU s a scan")
    frame_ms = 1000.0 * median(one.frame_cpu_s for one in scans)
    yield Measured(f"{world}: one frame of a packed scan", frame_ms, "CPU ms")
