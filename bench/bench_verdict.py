"""Accuracy of the verdicts on a scan against the truth: identity, motion, compensation, light, water, uncertainty."""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import Any

from bench.progress import Progress
from bench.result import Measurement
from bench.runner import machine, version
from bench.verdict.compensation_page import write_page as write_compensation
from bench.verdict.motion_page import write_page as write_motion
from bench.verdict.parts import IN_WORLDS, KEEPING, PARTS, measure_part, part
from bench.verdict.worlds import ORDINARY, WORLDS

OUT = Path("bench/out/verdict.json")
FEW_SCANS = 20


def measure() -> Iterator[Measurement]:
    """Yield every part with a few scans, as a quick check."""
    for name in PARTS:
        measured, _ = part(name).measure(FEW_SCANS, 1, lambda what, share: None)
        yield from measured


def main(arguments: Sequence[str]) -> int:
    """Run the command line: ``./dev bench verdict --help``."""
    parser = argparse.ArgumentParser(prog="./dev bench verdict", description=__doc__)
    parser.add_argument(
        "--scans", type=int, default=FEW_SCANS, help="drawn at random for each part; default: %(default)s"
    )
    parser.add_argument(
        "--seed", type=int, default=1, help="of the draws; any gives scans nothing was tuned on below 10000"
    )
    parser.add_argument("--json", type=Path, default=OUT, help="default: %(default)s")
    parser.add_argument(
        "--keep", type=Path, help=f"folder of rendered scans, used and added to ({', '.join(KEEPING)}): 6 MB each"
    )
    parser.add_argument("--parts", default=",".join(PARTS), help="names with commas between; default: all, %(default)s")
    parser.add_argument(
        "--world", choices=WORLDS, default=ORDINARY,
        help=f"outside: the same draws with the families of that world ({', '.join(IN_WORLDS)}); default: %(default)s",
    )  # fmt: skip
    parser.add_argument(
        "--write-docs",
        action="store_true",
        help="measure nothing; write the figures of docs/motion.md and compensation.md from --json",
    )
    options = parser.parse_args(arguments)
    if options.write_docs:
        content = json.loads(options.json.read_text(encoding="utf-8"))
        if "motion" in content["parts"]:
            write_motion(content, Path("docs"))
        write_compensation(content, Path("docs"))
        return 0
    if not 1 <= options.scans <= 100_000:
        parser.error(f"--scans {options.scans}: allowed are 1 to 100000")
    if options.seed < 0:
        parser.error(f"--seed {options.seed}: allowed are 0 and more")
    names = options.parts.split(",")
    for name in names:
        if name not in PARTS:
            parser.error(f"--parts: {name!r} is unknown; allowed are {', '.join(PARTS)}")
    if options.world != ORDINARY:
        for name in names:
            if name not in IN_WORLDS:
                parser.error(
                    f"--world {options.world}: {name!r} has no scans there; allowed are {', '.join(IN_WORLDS)}"
                )
    return 0 if run(names, options.scans, options.seed, options.json, options.keep, options.world) else 1


def run(
    names: Sequence[str], scans: int, seed: int, path: Path, keep: Path | None = None, world: str = ORDINARY
) -> bool:
    """Measure part by part; the file is written after each. Return True if every limit was kept."""
    path.parent.mkdir(parents=True, exist_ok=True)
    content: dict[str, Any] = {
        "machine": machine(),
        "version": version(),
        "scans": scans,
        "seed": seed,
        "world": world,
        "parts": {},
    }
    all_kept = True
    for finished, name in enumerate(names):
        progress = Progress(1)
        say = partial(_show, progress, finished, len(names))
        try:
            measured, data = measure_part(name, scans, seed, say, keep, None if world == ORDINARY else world)
        finally:
            progress.close()
        sys.stdout.write(f"{name}: {PARTS[name]}\n")
        sys.stdout.writelines(number.line() + "\n" for number in measured)
        sys.stdout.flush()
        all_kept = all_kept and all(number.is_kept for number in measured)
        content["parts"][name] = {"measured": [number.as_dict() for number in measured], "data": data}
        path.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")
    return all_kept


def _show(progress: Progress, done: int, parts: int, what: str, share: float) -> None:
    progress.show(what, (done + share) / parts)
