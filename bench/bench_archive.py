"""Size of packed scans."""

from __future__ import annotations

import argparse
import json
import shutil
import sys
import tempfile
from collections.abc import Iterable, Sequence
from pathlib import Path

from bench.archive.ratio import figures, packed_scans
from bench.archive.scenes import FAMILIES, FULL_PX, drawn_scans
from bench.result import Measurement

FEW = 6


def measure() -> Iterable[Measurement]:
    """Measure the ratio over one full-size scan of each object; ``main`` measures more for docs/archive.md."""
    with tempfile.TemporaryDirectory() as folder:
        yield from _ratio("ordinary", FEW, Path(folder))


def main(arguments: Sequence[str]) -> int:
    """Run the command line: ``./dev bench archive --help``."""
    parser = argparse.ArgumentParser(prog="./dev bench archive", description=__doc__)
    parser.add_argument("--count", type=int, default=36, help="full-size scans of each world (36: six of each object)")
    parser.add_argument(
        "--worlds", default=",".join(FAMILIES), help=f"default: {','.join(FAMILIES)}; outside takes minutes a scan"
    )
    parser.add_argument(
        "--keep", type=Path, required=True, help="folder of drawn scans, used and added to: 92 MB a scan"
    )
    parser.add_argument("--json", type=Path, help="write the figures there")
    options = parser.parse_args(arguments)
    measured: list[Measurement] = []
    options.keep.mkdir(parents=True, exist_ok=True)
    for world in options.worlds.split(","):
        for number in _ratio(world, options.count, options.keep):
            measured.append(number)
            print(number.line(), flush=True)
    if options.json is not None:
        options.json.write_text(
            json.dumps([number.as_dict() for number in measured], indent=1) + "\n", encoding="utf-8"
        )
    return 0 if all(number.is_kept for number in measured) else 1


def _ratio(world: str, count: int, keep: Path) -> Iterable[Measurement]:
    drawn = drawn_scans(keep / world, world, count, FULL_PX, _say)
    archive = keep / f"{world}-packed"
    yield from figures(packed_scans(drawn, archive, _say), bound=world == "ordinary")
    shutil.rmtree(archive)


def _say(text: str) -> None:
    print(text, file=sys.stderr, flush=True)
