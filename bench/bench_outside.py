"""Accuracy in the harsher simulated world ``outside``: scenes, milk, calibration health, part by part."""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Iterator, Sequence
from datetime import date
from functools import partial
from pathlib import Path

from bench.outside.noise import WAYS
from bench.outside.page import write_page
from bench.outside.parts import PARTS, measure_part
from bench.outside.record import added, read
from bench.progress import Progress
from bench.result import Measurement
from bench.runner import machine

OUT = Path("bench/out/outside.json")
USUAL_NOISE = "measured"
PAGE, PICTURES = Path("docs/outside.md"), Path("docs/pictures")


def measure() -> Iterator[Measurement]:
    """Yield every part with a few scenes, as a quick check."""
    for name, entry in PARTS.items():
        measured, _ = measure_part(name, entry.few, 1, lambda what, share: None, None, USUAL_NOISE)
        yield from measured


def main(arguments: Sequence[str]) -> int:
    """Run the command line: ``./dev bench outside --help``."""
    parser = argparse.ArgumentParser(prog="./dev bench outside", description=__doc__)
    parser.add_argument(
        "--seed",
        type=int,
        default=1,
        help="of the draws; nothing was chosen on any below 10000 but the third gap's floors, on 1 and 2",
    )
    parser.add_argument("--parts", default=",".join(PARTS), help="names with commas between; default: all, %(default)s")
    parser.add_argument(
        "--count",
        type=int,
        help="scenes, scans or rigs of each part; default: " + ", ".join(f"{n} {e.count}" for n, e in PARTS.items()),
    )
    parser.add_argument("--keep", type=Path, help="folder of frames and rows, used and added to: 6 MB a scan")
    parser.add_argument(
        "--noise",
        choices=WAYS,
        default=USUAL_NOISE,
        help="what the instrument knows of its cameras' noise: what it measured, or their data sheet; default: %(default)s",
    )
    parser.add_argument(
        "--json",
        type=Path,
        default=OUT,
        help="added to if it is there, each part and seed by itself; default: %(default)s",
    )
    parser.add_argument(
        "--write-docs",
        action="store_true",
        help=f"measure nothing; write figures of what --json has into {PAGE}; rows of other parts stay",
    )
    options = parser.parse_args(arguments)
    if options.write_docs:
        write_page(options.json, PAGE, PICTURES)
        return 0
    names = options.parts.split(",")
    for name in names:
        if name not in PARTS:
            parser.error(f"--parts: {name!r} is unknown; allowed are {', '.join(PARTS)}")
    if options.count is not None and not 1 <= options.count <= 100_000:
        parser.error(f"--count {options.count}: allowed are 1 to 100000")
    if not 0 <= options.seed < 1 << 31:
        parser.error(f"--seed {options.seed}: allowed are 0 to {(1 << 31) - 1}")
    return 0 if run(names, options.count, options.seed, options.json, options.keep, options.noise) else 1


def run(
    names: Sequence[str], count: int | None, seed: int, path: Path, keep: Path | None, noise: str = USUAL_NOISE
) -> bool:
    """Measure part by part; the file is written after each. Return True if every limit was kept."""
    path.parent.mkdir(parents=True, exist_ok=True)
    content = {**(read(path) if path.exists() else {"parts": {}}), "machine": machine()}
    all_kept = True
    for finished, name in enumerate(names):
        progress = Progress(1)
        say = partial(_show, progress, finished, len(names))
        try:
            measured, data = measure_part(name, count, seed, say, keep, noise)
        finally:
            progress.close()
        sys.stdout.write(f"{name}: {PARTS[name].subject}\n")
        sys.stdout.writelines(number.line() + "\n" for number in measured)
        sys.stdout.flush()
        all_kept = all_kept and all(number.is_kept for number in measured)
        many = PARTS[name].count if count is None else count
        settings = {"count": many, "noise": noise, "measured_on": date.today().isoformat(), "data": data}
        content = added(content, name, seed, measured, settings)
        draft = path.with_name(f".{path.name}")
        draft.write_text(json.dumps(content) + "\n", encoding="utf-8")
        draft.replace(path)
    return all_kept


def _show(progress: Progress, done: int, parts: int, what: str, share: float) -> None:
    progress.show(what, (done + share) / parts)
