"""Measures how small packed scans are, and whether an archive is worked through whatever fails meanwhile."""

from __future__ import annotations

import argparse
import json
import shutil
import sys
import tempfile
from collections.abc import Iterable, Sequence
from pathlib import Path

from appliance.storage.archive import pack_scan
from appliance.storage.filesystem import LocalFileSystem
from bench.archive import chaos, cost, scaling
from bench.archive.ratio import figures, packed_scans
from bench.archive.scenes import FAMILIES, FULL_PX, SMALL_PX, drawn_scans, repeated_scans
from bench.result import Measured

FEW = 6
SMALL, DIFFERENT = 300, 12
FULL, DIFFERENT_FULL = 40, 6
RATIO, CHAOS, COST, SCALING = "ratio", "chaos", "cost", "scaling"
PACKED, FULL_PACKED, ROUNDS_PACKED = "packed", 24, 2
PARTS = (RATIO, CHAOS, COST, SCALING, PACKED)


def measure() -> Iterable[Measured]:
    """The ratio over one full-size scan of each object; the figures of docs/archive.md are of more, see ``main``."""
    with tempfile.TemporaryDirectory() as folder:
        yield from _ratio("ordinary", FEW, Path(folder))


def main(arguments: Sequence[str]) -> int:
    """The command line: ``./dev bench archive --help``."""
    parser = argparse.ArgumentParser(prog="./dev bench archive", description=__doc__)
    parser.add_argument(
        "--parts",
        default=RATIO,
        help=f"of {', '.join(PARTS)}; default: {RATIO}; chaos mounts a small disk, as root; scaling and packed want two idle cores",
    )
    parser.add_argument("--count", type=int, default=36, help="full-size scans of each world (36: six of each object)")
    parser.add_argument(
        "--worlds", default=",".join(FAMILIES), help=f"default: {','.join(FAMILIES)}; outside takes minutes a scan"
    )
    parser.add_argument(
        "--keep", type=Path, required=True, help="folder of drawn scans, used and added to: 92 MB a scan"
    )
    parser.add_argument("--json", type=Path, help="write the figures there")
    wanted = parser.parse_args(arguments)
    found: list[Measured] = []
    for part in wanted.parts.split(","):
        if part not in PARTS:
            parser.error(f"--parts: {part!r} is unknown; allowed are {', '.join(PARTS)}")
        wanted.keep.mkdir(parents=True, exist_ok=True)
        for one in _part(part, wanted.worlds.split(","), wanted.count, wanted.keep):
            found.append(one)
            print(one.line(), flush=True)
    if wanted.json is not None:
        wanted.json.write_text(json.dumps([one.as_dict() for one in found], indent=1) + "\n", encoding="utf-8")
    return 0 if all(one.kept for one in found) else 1


def _part(part: str, worlds: Sequence[str], count: int, keep: Path) -> Iterable[Measured]:
    if part == RATIO:
        for world in worlds:
            yield from _ratio(world, count, keep)
        return
    if part == COST:
        with tempfile.TemporaryDirectory(dir=keep) as scratch:
            yield from cost.measure(Path(scratch), _say)
        return
    if part == PACKED:
        folders = repeated_scans(keep / "full", FULL, DIFFERENT_FULL, FULL_PX, _say)[:FULL_PACKED]
        shelf = keep / "full-packed" / "scans"
        shelf.mkdir(parents=True, exist_ok=True)
        for folder in folders:
            pack_scan(LocalFileSystem(), folder, shelf / folder.name)
        with tempfile.TemporaryDirectory(dir=keep) as scratch:
            yield from scaling.measure(shelf.parent, Path(scratch), _say, ROUNDS_PACKED)
        return
    if part == SCALING:
        repeated_scans(keep / "full", FULL, DIFFERENT_FULL, FULL_PX, _say)
        with tempfile.TemporaryDirectory(dir=keep) as scratch:
            yield from scaling.measure(keep / "full", Path(scratch), _say)
        return
    repeated_scans(keep / "small", SMALL, DIFFERENT, SMALL_PX, _say)
    with tempfile.TemporaryDirectory() as scratch:
        yield from chaos.measure(keep / "small", Path(scratch), _say)


def _ratio(world: str, count: int, keep: Path) -> Iterable[Measured]:
    drawn = drawn_scans(keep / world, world, count, FULL_PX, _say)
    archive = keep / f"{world}-packed"
    yield from figures(packed_scans(drawn, archive, _say), bound=world == "ordinary")
    shutil.rmtree(archive)


def _say(text: str) -> None:
    print(text, file=sys.stderr, flush=True)
