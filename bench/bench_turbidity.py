"""Effect of turbid water: noise, completeness, lengths and flatness over attenuation, backscatter and blur."""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from bench.progress import Progress
from bench.result import Measurement
from bench.turbidity.page import write_page
from bench.turbidity.study import ARTEFACT_PX, SERIES, SMALL_PX, Row, artefacts, as_json, plane, planes, steps

OUT = Path("bench/out/turbidity.json")
DATA, PAGE, PICTURES = Path("docs/turbidity.json"), Path("docs/turbidity.md"), Path("docs/pictures")


def measure() -> Iterator[Measurement]:
    """Measure a few waters, as a quick check of noise and of completeness in clear water."""
    clear, middle, thick = (plane(SERIES[3], attenuation, 1, SMALL_PX) for attenuation in (0.2, 1.0, 2.0))
    yield Measurement("completeness at 0.2 /m", clear.completeness_percent, "%", at_least=99.0)
    yield Measurement("completeness at 2 /m", thick.completeness_percent, "%", at_least=95.0)
    for name, row in (("0.2 /m", clear), ("1 /m", middle), ("2 /m", thick)):
        yield Measurement(f"error in expected errors, rms, at {name}", _known(row.sigma_ratio), "", 1.25, 0.8)
        yield Measurement(f"noise at {name}", _known(row.rms_um), "µm")


def _known(value: float | None) -> float:
    return float("nan") if value is None else value


def main(arguments: Sequence[str]) -> int:
    """Run the command line: ``./dev bench turbidity --help``."""
    parser = argparse.ArgumentParser(prog="./dev bench turbidity", description=__doc__)
    parser.add_argument("--rigs", type=int, default=1, help="hidden rigs for the plane, with successive seeds")
    parser.add_argument("--artefact-rigs", type=int, default=1, help="of them, how many also measure ball bars")
    parser.add_argument("--seed", type=int, default=1, help="of the first rig")
    parser.add_argument("--json", type=Path, default=OUT, help="default: %(default)s")
    parser.add_argument(
        "--write-docs", action="store_true", help=f"measure nothing; write {PAGE} and its pictures from {DATA}"
    )
    options = parser.parse_args(arguments)
    if options.write_docs:
        write_page(DATA, PAGE, PICTURES)
        return 0
    if not 1 <= options.rigs <= 100 or not 0 <= options.artefact_rigs <= options.rigs:
        parser.error(
            f"--rigs {options.rigs} --artefact-rigs {options.artefact_rigs}: allowed are 1 to 100, and 0 to --rigs"
        )
    if options.seed < 0:
        parser.error(f"--seed {options.seed}: allowed are 0 and more")
    run(range(options.seed, options.seed + options.rigs), options.artefact_rigs, options.json)
    sys.stdout.write(f"{options.json}\n")
    return 0


def run(seeds: Sequence[int], artefact_rigs: int, path: Path) -> None:
    """Measure rig by rig; the file is written after each, so that results are kept."""
    path.parent.mkdir(parents=True, exist_ok=True)
    content: dict[str, Any] = {
        "plane": {"width_px": SMALL_PX, "rows": []},
        "artefacts": {"width_px": ARTEFACT_PX, "rows": []},
    }
    progress = Progress(steps(len(seeds), artefact_rigs))
    try:
        for k, seed in enumerate(seeds):
            rows: list[Row] = list(planes(seed, progress.step))
            content["plane"]["rows"] += [as_json(row) for row in rows]
            if k < artefact_rigs:
                content["artefacts"]["rows"] += [as_json(row) for row in artefacts(seed, progress.step)]
            path.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")
    finally:
        progress.close()
