"""Objects from many scans: scan pairs of all shapes, and rows of scans along a pipe, against their true poses."""

from __future__ import annotations

import argparse
import json
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from bench.merge import dive, guide, large, loops, overlaps, pairs, row
from bench.result import Measurement

PAIRS, ROW, LARGE, GUIDE, DIVE, LOOPS, OVERLAPS = "pairs", "row", "large", "guide", "dive", "loops", "overlaps"


def measure() -> Iterable[Measurement]:
    """Measure a few pairs and one row, as a quick check; ``main`` measures more for docs/objects.md."""
    yield from pairs.measure(28, 1, None)[0]
    yield from row.measure(3, "realistic", (800, 600), None)[0]


def main(arguments: list[str]) -> int:
    """Run the command line: ``./dev bench merge --help``."""
    parser = argparse.ArgumentParser(prog="./dev bench merge", description=__doc__)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--parts", default=f"{PAIRS},{ROW}", help=f"default: {PAIRS},{ROW}")
    parser.add_argument("--pairs", type=int, default=300, metavar="N", help="drawn pairs (300)")
    parser.add_argument("--overlaps", type=int, metavar="N", help="pairs of each paint of the part overlaps (35)")
    parser.add_argument(
        "--rigs", default="outside", metavar="SET", help="set that the row's rig is drawn from (outside)"
    )
    parser.add_argument(
        "--size",
        default="800x600",
        metavar="WxH",
        help="of the images of row, guide, dive, loops and overlaps (800x600)",
    )
    parser.add_argument(
        "--calibrated",
        type=int,
        default=0,
        metavar="N",
        help="rigs of `outside`, calibrated, that the row is taken with, too (0)",
    )
    parser.add_argument("--keep", type=Path, help="keep the views there; they are taken from there the next time")
    parser.add_argument("--json", type=Path, help="write everything there")
    options = parser.parse_args(arguments)
    measured: list[Measurement] = []
    content: dict[str, Any] = {"seed": options.seed}
    if PAIRS in options.parts.split(","):
        figures, content[PAIRS] = pairs.measure(options.pairs, options.seed, options.keep)
        measured += figures
    if ROW in options.parts.split(","):
        width, height = (int(part) for part in options.size.split("x"))
        figures, content[ROW] = row.measure(
            options.seed, options.rigs, (width, height), options.keep, options.calibrated
        )
        measured += figures
    if LARGE in options.parts.split(","):
        measured += large.measure(options.seed, options.keep)
    if GUIDE in options.parts.split(","):
        width, height = (int(part) for part in options.size.split("x"))
        figures, content[GUIDE] = guide.measure(options.seed, (width, height))
        measured += figures
    width, height = (int(part) for part in options.size.split("x"))
    if DIVE in options.parts.split(","):
        measured += dive.measure(options.seed, (width, height), options.keep)
    if LOOPS in options.parts.split(","):
        figures, content[LOOPS] = loops.measure(options.seed, (width, height), options.keep)
        measured += figures
    if OVERLAPS in options.parts.split(","):
        figures, content[OVERLAPS] = overlaps.measure(options.seed, (width, height), options.overlaps)
        measured += figures
    for number in measured:
        print(number.line())
    if options.json is not None:
        content["figures"] = {number.name: number.value for number in measured}
        options.json.write_text(json.dumps(content, indent=1) + "\n")
    return 0 if all(number.is_kept for number in measured) else 1
