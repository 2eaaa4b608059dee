"""Import of twenty random sequences of other programs without a description: complete, asked, or wrong with or without
a note."""

from __future__ import annotations

import argparse
import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path
from time import process_time

from bench.result import Measurement
from tests.support.imported import Import, import_folder
from tests.support.other_programs import PROGRAMS

SEED = 11
LEAST_WHOLE = 18


def main(arguments: Sequence[str]) -> int:
    parser = argparse.ArgumentParser(prog="./dev bench import_sequences", description=__doc__)
    parser.add_argument("--seed", type=int, default=SEED)
    parser.add_argument("--only", metavar="TEXT", default="", help="programs whose name has it")
    parser.add_argument("--keep", metavar="FOLDER", type=Path, help="where sets and clouds stay")
    chosen = parser.parse_args(arguments)
    all_kept = True
    for number in measure(chosen.seed, chosen.only, chosen.keep):
        all_kept &= number.is_kept
        print(number.line(), flush=True)
    return 0 if all_kept else 1


def measure(seed: int = SEED, only: str = "", keep: Path | None = None) -> Iterator[Measurement]:
    """Draw, import and judge each sequence; messages about incomplete ones stand below their figures."""
    outcomes: list[Import] = []
    with tempfile.TemporaryDirectory() as temporary:
        root = keep or Path(temporary)
        for k, program in enumerate(PROGRAMS):
            if only.lower() not in program.name.lower():
                continue
            drawn = program.make(root / f"{k:02d}", 100 * seed + k)
            begin_s = process_time()
            result = import_folder(root / f"{k:02d}", root / f"{k:02d}.npz", drawn)
            cpu_s = process_time() - begin_s
            outcomes.append(result)
            yield Measurement(
                f"{program.name}: {result.outcome}",
                result.complete_percent,
                f"%, {result.off_px:.2f} px off, {cpu_s:.1f} s CPU",
            )
            for line in result.said if result.outcome != "whole" else ():
                yield Measurement(f"    {line}", float("nan"), "", why="")
    for outcome, bound in (
        ("whole", LEAST_WHOLE * len(outcomes) / len(PROGRAMS)),
        ("asked", None),
        ("crashed", None),
        ("wrong, with a note", None),
    ):
        yield Measurement(
            outcome, float(sum(each.outcome == outcome for each in outcomes)), f"of {len(outcomes)}", at_least=bound
        )
    silent = sum(each.outcome == "wrong without a note" for each in outcomes)
    yield Measurement("wrong without a note", float(silent), f"of {len(outcomes)}", at_most=0.0)
