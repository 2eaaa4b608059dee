"""The distance from the laser dots against where the beams truly end: objects, textures, waters, light, hands, hidden dots."""

from __future__ import annotations

import argparse
import json
import math
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from bench.progress import Progress
from bench.ranging.picture import draw
from bench.ranging.study import rows_of
from bench.result import Measured
from bench.runner import machine

OUT = Path("bench/out/ranging.json")
PICTURE = Path("docs/pictures/ranging.png")
FEW_SCENES = 20
WIDTH_PX = 400
WRONG_MM = 10.0
"""A distance so far off is false: something else was taken for a dot."""


def measure() -> Iterator[Measured]:
    """A few scenes: whether distances are still right."""
    yield from judged(rows_of(FEW_SCENES, 1, WIDTH_PX, lambda what, share: None))


def judged(rows: Sequence[dict[str, Any]]) -> list[Measured]:
    """What the rows say."""
    told = [row for row in rows if row["distance_mm"] is not None]
    errors = np.abs([row["error_mm"] if row["error_mm"] is not None else math.inf for row in told])
    planes = [row for row in told if row["object"] in ("plane", "board") and row["tilt_error_deg"] is not None]
    tilts = np.abs([row["tilt_error_deg"] for row in planes])
    could = [row for row in rows if row["both_see"] > 0]
    sigmas = [abs(row["error_mm"]) / row["sigma_mm"] for row in told if row["error_mm"] is not None]
    nan = float("nan")

    def of(values: Any, share: float) -> float:
        return float(np.percentile(values, share)) if len(values) else nan

    return [
        Measured("scenes with a dot that both cameras see", float(len(could)), ""),
        Measured("distance told of these", 100.0 * _share(could), "%", at_least=90.0),
        Measured("error of the distance, median", of(errors, 50.0), "mm"),
        Measured("error of the distance, 95 %", of(errors, 95.0), "mm", at_most=2.0),
        Measured("error of the distance, worst", of(errors, 100.0), "mm"),
        Measured("distances within 2 mm", 100.0 * float(np.mean(errors <= 2.0)), "%", at_least=97.0),
        Measured("false distances", float(np.sum(errors > WRONG_MM)), "", at_most=0.0),
        Measured("dots where no beam meets anything", float(sum(row["invented"] for row in rows)), "", at_most=0.0),
        Measured("tilt of planes, 95 %", of(tilts, 95.0), "deg", at_most=2.0),
        Measured("tilt of planes, worst", of(tilts, 100.0), "deg"),
        Measured("error in its stated sigmas, median", of(sigmas, 50.0), ""),
        Measured("one pair, median", float(np.median([row["cpu_ms"] for row in rows])), "ms CPU", at_most=10.0),
    ]


def _share(rows: Sequence[dict[str, Any]]) -> float:
    return float(np.mean([row["distance_mm"] is not None for row in rows])) if rows else float("nan")


def main(arguments: Sequence[str]) -> int:
    """The command line: ``./dev bench ranging --help``."""
    parser = argparse.ArgumentParser(prog="./dev bench ranging", description=__doc__)
    parser.add_argument("--scenes", type=int, default=FEW_SCENES, help="drawn at random; default: %(default)s")
    parser.add_argument("--seed", type=int, default=1, help="of the draws; default: %(default)s")
    parser.add_argument("--width", type=int, default=WIDTH_PX, help="of the images, px; default: %(default)s")
    parser.add_argument("--json", type=Path, default=OUT, help="default: %(default)s")
    parser.add_argument("--picture", action="store_true", help=f"draw {PICTURE}")
    wanted = parser.parse_args(arguments)
    if not 1 <= wanted.scenes <= 100_000:
        parser.error(f"--scenes {wanted.scenes}: allowed are 1 to 100000")
    if wanted.seed < 0:
        parser.error(f"--seed {wanted.seed}: allowed are 0 and more")
    if wanted.width not in (400, 800, 1600):
        parser.error(f"--width {wanted.width}: allowed are 400, 800 and 1600")
    progress = Progress(1)
    try:
        rows = rows_of(wanted.scenes, wanted.seed, wanted.width, progress.show)
    finally:
        progress.close()
    found = judged(rows)
    wanted.json.parent.mkdir(parents=True, exist_ok=True)
    content = {
        "machine": machine(), "scenes": wanted.scenes, "seed": wanted.seed, "width_px": wanted.width,
        "measured": [number.as_dict() for number in found], "rows": rows,
    }  # fmt: skip
    wanted.json.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")
    if wanted.picture:
        draw(PICTURE, rows)
    sys.stdout.writelines(number.line() + "\n" for number in found)
    return 0 if all(number.kept for number in found) else 1
