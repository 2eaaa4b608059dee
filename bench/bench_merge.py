"""Do many scans become one object? Pairs of views of all shapes, and rows of scans along a pipe, against where they were taken from."""

from __future__ import annotations

import argparse
import json
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from bench.merge import dive, guide, large, loops, overlaps, pairs, row
from bench.result import Measured

PAIRS, ROW, LARGE, GUIDE, DIVE, LOOPS, OVERLAPS = "pairs", "row", "large", "guide", "dive", "loops", "overlaps"


def measure() -> Iterable[Measured]:
    """A few pairs and one row: enough to see that merging works. The figures of docs/objects.md are of more, see ``main``."""
    yield from pairs.measure(28, 1, None)[0]
    yield from row.measure(3, "realistic", (800, 600), None)[0]


def main(arguments: list[str]) -> int:
    """``./dev bench merge --seed S [--parts pairs,row,large,guide,dive,loops,overlaps] [--pairs N] [--rigs SET] [--size WxH] [--calibrated N] [--keep DIR] [--json F]``."""
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
    wanted = parser.parse_args(arguments)
    found: list[Measured] = []
    whole: dict[str, Any] = {"seed": wanted.seed}
    if PAIRS in wanted.parts.split(","):
        figures, whole[PAIRS] = pairs.measure(wanted.pairs, wanted.seed, wanted.keep)
        found += figures
    if ROW in wanted.parts.split(","):
        width, height = (int(part) for part in wanted.size.split("x"))
        figures, whole[ROW] = row.measure(wanted.seed, wanted.rigs, (width, height), wanted.keep, wanted.calibrated)
        found += figures
    if LARGE in wanted.parts.split(","):
        found += large.measure(wanted.seed, wanted.keep)
    if GUIDE in wanted.parts.split(","):
        width, height = (int(part) for part in wanted.size.split("x"))
        figures, whole[GUIDE] = guide.measure(wanted.seed, (width, height))
        found += figures
    width, height = (int(part) for part in wanted.size.split("x"))
    if DIVE in wanted.parts.split(","):
        found += dive.measure(wanted.seed, (width, height), wanted.keep)
    if LOOPS in wanted.parts.split(","):
        figures, whole[LOOPS] = loops.measure(wanted.seed, (width, height), wanted.keep)
        found += figures
    if OVERLAPS in wanted.parts.split(","):
        figures, whole[OVERLAPS] = overlaps.measure(wanted.seed, (width, height), wanted.overlaps)
        found += figures
    for one in found:
        print(one.line())
    if wanted.json is not None:
        whole["figures"] = {one.name: one.value for one in found}
        wanted.json.write_text(json.dumps(whole, indent=1) + "\n")
    return 0 if all(one.kept for one in found) else 1
