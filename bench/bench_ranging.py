"""Measured distances by laser dots against the true ones: objects, textures, waters, light, motion, hidden dots."""

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
from bench.ranging.scenes import OBJECTS
from bench.ranging.study import POSED, rows_of
from bench.result import Measurement
from bench.runner import machine

OUT = Path("bench/out/ranging.json")
PICTURE = Path("docs/pictures/ranging.png")
FEW_SCENES = 20
WIDTH_PX = 400
WRONG_MM = 10.0
"""Error above which a distance is false, because something else was taken for a dot."""


def measure() -> Iterator[Measurement]:
    """Measure distances in a few scenes, as a quick check."""
    yield from ranging_figures(rows_of(FEW_SCENES, 1, WIDTH_PX, lambda what, share: None))


def ranging_figures(rows: Sequence[dict[str, Any]], posed: str = POSED[0]) -> list[Measurement]:
    """Return the figures of the rows. No beam hits a bar that is held as in the sketches unless it is aimed at."""
    with_distance = [row for row in rows if row["distance_mm"] is not None]
    errors = np.abs([row["error_mm"] if row["error_mm"] is not None else math.inf for row in with_distance])
    planes = [row for row in with_distance if row["object"] in ("plane", "board") and row["tilt_error_deg"] is not None]
    tilts = np.abs([row["tilt_error_deg"] for row in planes])
    could = [row for row in rows if row["both_see"] > 0]
    sigmas = [math.inf if row["error_mm"] is None else abs(row["error_mm"]) / row["sigma_mm"] for row in with_distance]
    bars = [row for row in rows if row["object"] == "ballbar"]
    with_truth = [row for row in rows if row["true_mm"] is not None]
    nan = float("nan")

    def of(values: Any, share: float) -> float:
        return float(np.percentile(values, share)) if len(values) else nan

    return [
        Measurement("scenes with a dot that both cameras see", float(len(could)), ""),
        Measurement(
            "distance reported of these", 100.0 * _share(could), "%", at_least=None if len(bars) == len(rows) else 90.0
        ),
        Measurement("distance reported of all", 100.0 * _share(rows), "%"),
        Measurement("distance reported where a beam meets the object", 100.0 * _share(with_truth), "%"),
        Measurement("scenes of the ball bar", float(len(bars)), ""),
        Measurement(
            "distance reported of these",
            100.0 * _share(bars),
            "%",
            at_least=80.0 if len(bars) >= FEW_SCENES and posed != "guided" else None,
        ),
        Measurement("error of the distance, median", of(errors, 50.0), "mm"),
        Measurement("error of the distance, 95 %", of(errors, 95.0), "mm", at_most=2.0),
        Measurement("error of the distance, worst", of(errors, 100.0), "mm"),
        Measurement("distances within 2 mm", 100.0 * float(np.mean(errors <= 2.0)), "%", at_least=97.0),
        Measurement("false distances", float(np.sum(errors > WRONG_MM)), "", at_most=0.0),
        Measurement("dots where no beam meets anything", float(sum(row["invented"] for row in rows)), "", at_most=0.0),
        Measurement("tilt of planes, 95 %", of(tilts, 95.0), "deg", at_most=2.0 if planes else None),
        Measurement("tilt of planes, worst", of(tilts, 100.0), "deg"),
        Measurement("error in its stated sigmas, median", of(sigmas, 50.0), ""),
        Measurement("error in its stated sigmas, worst", of(sigmas, 100.0), ""),
        Measurement(
            "distances wrong by more than three of their sigmas", float(np.sum(np.array(sigmas) > 3.0)), "", at_most=0.0
        ),
        Measurement("one pair, median", float(np.median([row["cpu_ms"] for row in rows])), "ms CPU", at_most=10.0),
    ]


def _share(rows: Sequence[dict[str, Any]]) -> float:
    return float(np.mean([row["distance_mm"] is not None for row in rows])) if rows else float("nan")


def main(arguments: Sequence[str]) -> int:
    """Run the command line: ``./dev bench ranging --help``."""
    parser = argparse.ArgumentParser(prog="./dev bench ranging", description=__doc__)
    parser.add_argument("--scenes", type=int, default=FEW_SCENES, help="drawn at random; default: %(default)s")
    parser.add_argument("--seed", type=int, default=1, help="of the draws; default: %(default)s")
    parser.add_argument("--width", type=int, default=WIDTH_PX, help="of the images, px; default: %(default)s")
    parser.add_argument("--json", type=Path, default=OUT, help="default: %(default)s")
    parser.add_argument("--object", choices=OBJECTS, help="that is looked at in every scene; default: at random")
    parser.add_argument("--posed", choices=POSED, default=POSED[0], help="how; default: as it comes")
    parser.add_argument("--picture", action="store_true", help=f"draw {PICTURE}")
    options = parser.parse_args(arguments)
    if not 1 <= options.scenes <= 100_000:
        parser.error(f"--scenes {options.scenes}: allowed are 1 to 100000")
    if options.seed < 0:
        parser.error(f"--seed {options.seed}: allowed are 0 and more")
    if options.width not in (400, 800, 1600):
        parser.error(f"--width {options.width}: allowed are 400, 800 and 1600")
    progress = Progress(1)
    try:
        rows = rows_of(options.scenes, options.seed, options.width, progress.show, options.posed, options.object)
    finally:
        progress.close()
    measured = ranging_figures(rows, options.posed)
    options.json.parent.mkdir(parents=True, exist_ok=True)
    content = {
        "machine": machine(), "scenes": options.scenes, "seed": options.seed, "width_px": options.width,
        "posed": options.posed, "object": options.object,
        "measured": [number.as_dict() for number in measured], "rows": rows,
    }  # fmt: skip
    options.json.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")
    if options.picture:
        draw(PICTURE, rows)
    sys.stdout.writelines(number.line() + "\n" for number in measured)
    return 0 if all(number.is_kept for number in measured) else 1
