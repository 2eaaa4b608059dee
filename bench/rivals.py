"""Comparison of the product with other programs, in turns, so that a busy machine slows all of them equally.

A ratio is taken within each round and the median of those is reported: what disturbs one round disturbs both its parts.
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from appliance.measure.light.patterns import Direction
from appliance.measure.points.pipeline import Pipeline
from bench import foreign, references
from bench.foreign import Peer, PeerFailed
from bench.roofline import Memory
from bench.scan_frames import ScanFrames
from bench.stages import ScanCost, decode_left, one_scan
from bench.timing import cpu_ms


@dataclass(slots=True)
class Rounds:
    """Measurements round by round; slow programs take part in the first rounds only."""

    scans: list[ScanCost] = field(default_factory=list)
    taken_ms: dict[str, list[float]] = field(default_factory=dict)
    """CPU ms of ``decode`` (ours, one camera) and of each other program."""
    bandwidth_gb_s: list[tuple[float, float]] = field(default_factory=list)
    """Reading and writing."""
    versions: dict[str, str] = field(default_factory=dict)
    absent: dict[str, str] = field(default_factory=dict)
    """Reason for each program that could not take part."""

    def scan_ms(self, part: Callable[[ScanCost], float]) -> list[float]:
        """Return the time of a part of our scan, for each round."""
        return [part(scan) for scan in self.scans]

    def ratios(self, name: str, ours_ms: Sequence[float]) -> list[float]:
        """Return the ratios of the time of program ``name`` to ours, for each round in which it took part."""
        return [theirs / ours for theirs, ours in zip(self.taken_ms[name], ours_ms, strict=False)]


def in_turns(pipeline: Pipeline, scan: ScanFrames, rounds: int, slow_rounds: int, ask_peers: bool) -> Rounds:
    """Measure ``rounds`` times; the KD-tree and the peers, which take seconds, ``slow_rounds`` times."""
    measured = Rounds()
    frames = scan.frames["left"]
    quick: dict[str, Callable[[], object]] = {
        "decode": lambda: decode_left(pipeline, scan),
        "opencv_decode": lambda: references.opencv_decode(scan.sequence, frames),
        "numpy_decode": lambda: references.numpy_decode(scan.sequence, frames),
    }
    with ExitStack() as stack:
        peers = dict(present(stack, scan, measured)) if ask_peers else {}
        if not ask_peers:
            measured.absent = dict.fromkeys(foreign.PROGRAMS, "not asked")
        memory = Memory()
        for _ in range(2):  # compiles, and warms the caches
            one_scan(pipeline, scan)
        for k in range(rounds):
            one_scan(pipeline, scan)  # the next one finds the caches as a scan leaves them, not as the others did
            measured.scans.append(one_scan(pipeline, scan))
            for name, action in quick.items():
                measured.taken_ms.setdefault(name, []).append(cpu_ms(action))
            measured.bandwidth_gb_s.append(memory.bandwidth_gb_s())
            if k >= slow_rounds:
                continue
            slow_ms = cpu_ms(lambda: references.reference_scan(scan))
            measured.taken_ms.setdefault("numpy_kdtree", []).append(slow_ms)
            for name, peer in peers.items():
                if name in measured.absent:
                    continue
                try:
                    measured.taken_ms.setdefault(name, []).append(peer.decode())
                except PeerFailed as failed:
                    measured.absent[name] = str(failed)
    return measured


def present(stack: ExitStack, scan: ScanFrames, measured: Rounds) -> Iterator[tuple[str, Peer]]:
    """Start the peers that can be started, with our frames; note why the others cannot."""
    folder = Path(stack.enter_context(tempfile.TemporaryDirectory()))
    x, y = scan.sequence.axis(Direction.X), scan.sequence.axis(Direction.Y)
    np.savez(
        folder / "frames.npz", left=scan.frames["left"], right=scan.frames["right"],
        gray_x=x.gray, gray_y=y.gray, sines=x.sine + y.sine,
        width_px=x.size_px, height_px=y.size_px, period_px=scan.sequence.period_px,
    )  # fmt: skip
    for name, program in foreign.PROGRAMS.items():
        script = Path(__file__).parent / "peers" / f"{program}.py"
        try:
            peer = stack.enter_context(Peer(foreign.prepare(), script, folder / "frames.npz"))
        except PeerFailed as failed:
            measured.absent[name] = str(failed)
            continue
        measured.versions[name] = peer.version
        yield name, peer
