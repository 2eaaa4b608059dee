"""Errors of each rung of the model ladder, from images: hidden rigs, new ball bars, planes and frustums."""

from __future__ import annotations

import argparse
import re
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from bench.metrology.accuracy import SETS, write_accuracy
from bench.metrology.hidden import Effort, examine
from bench.metrology.rungs import WAYS
from bench.metrology.table import JsonRow, as_json, summary, text, write
from bench.progress import Progress
from bench.result import Measurement

OUT = Path("bench/out")


def measure() -> Iterator[Measurement]:
    """Yield the errors of one realistic rig with half the pixels, as a quick check."""
    summary_of_run = summary(run("realistic", [1], 800, 600, Effort(bars=3, planes=2, frustums=1), None))
    for rung, key, at_most in (
        ("ba_spline_4", "E_Lb", 0.06),
        ("ba_spline_10", "E_Lb", 0.03),
        ("ba_spline_10", "E_Lp", 0.06),
        ("ba_spline_10", "E_F_sys", 0.03),
        ("salt_updated", "E_Lb", 0.04),
    ):
        values = summary_of_run[rung][key]
        value = float("nan") if values is None else values["worst"]
        yield Measurement(f"{rung}: {key}, 800x600, one rig", value, "%", at_most=at_most)


def main(arguments: Sequence[str]) -> int:
    """Run the command line: ``./dev bench metrology --help``."""
    parser = argparse.ArgumentParser(prog="./dev bench metrology", description=__doc__)
    parser.add_argument(
        "--set", choices=SETS, default="realistic", help="how much the hidden rigs differ from the drawing"
    )
    parser.add_argument("--rigs", type=int, default=1, help="how many, with successive seeds")
    parser.add_argument("--seed", type=int, default=1, help="of the first rig")
    parser.add_argument("--resolution", default="1600x1200", help="of the cameras, WIDTHxHEIGHT, 4 to 3")
    parser.add_argument("--bars", type=int, default=4, help="unseen ball bars per rig")
    parser.add_argument("--planes", type=int, default=3)
    parser.add_argument("--frustums", type=int, default=3)
    parser.add_argument("--rungs", default=",".join(WAYS), help="names with commas between; default: %(default)s")
    parser.add_argument("--json", type=Path, help="default: bench/out/metrology-SET.json")
    parser.add_argument(
        "--write-docs", action="store_true", help="measure nothing; write docs/accuracy.md from bench/out"
    )
    options = parser.parse_args(arguments)
    if options.write_docs:
        write_accuracy(OUT, Path("docs/accuracy.md"), Path("docs/accuracy.png"))
        return 0
    size = re.fullmatch(r"(\d+)x(\d+)", options.resolution)
    width_px, height_px = (int(size[1]), int(size[2])) if size else (0, 0)
    if not 320 <= width_px <= 1600 or 3 * width_px != 4 * height_px:
        parser.error(
            f"--resolution {options.resolution}: allowed are 320x240 to 1600x1200, 4 to 3; for example 800x600"
        )
    if options.seed < 0:
        parser.error(f"--seed {options.seed}: allowed are 0 and more")
    for name in ("rigs", "bars", "planes", "frustums"):
        if not 1 <= getattr(options, name) <= 100:
            parser.error(f"--{name} {getattr(options, name)}: allowed are 1 to 100")
    rungs = tuple(options.rungs.split(","))
    for rung in rungs:
        if rung not in WAYS:
            parser.error(f"--rungs: {rung!r} is unknown; allowed are {', '.join(WAYS)}")
    effort = Effort(rungs, bars=options.bars, planes=options.planes, frustums=options.frustums)
    path = options.json or OUT / f"metrology-{options.set}.json"
    rows = run(options.set, range(options.seed, options.seed + options.rigs), width_px, height_px, effort, path)
    sys.stdout.write(text({"set": options.set}, rows))
    return 0


def run(
    truth_set: str, seeds: Sequence[int], width_px: int, height_px: int, effort: Effort, path: Path | None
) -> list[JsonRow]:
    """Examine rig by rig; the file is written after each, so that results are kept."""
    settings: dict[str, Any] = {
        "set": truth_set,
        "resolution": f"{width_px}x{height_px}",
        "unseen": {"bars": effort.bars, "planes": effort.planes, "frustums": effort.frustums},
    }
    progress = Progress(effort.scans * len(seeds))
    rows: list[JsonRow] = []
    try:
        for seed in seeds:
            rows += [as_json(row) for row in examine(truth_set, seed, width_px, height_px, effort, progress.step)]
            if path is not None:
                write(path, settings, rows)
    finally:
        progress.close()
    return rows
