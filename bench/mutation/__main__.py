"""``./dev mutate draw | run``: does a test notice when a line is broken?

``draw`` writes a list of mutants, chosen by a seed. ``run`` breaks one line at a time in a copy of the project, runs
the tests of its file and its room until one fails, and writes the verdict below each mutant of the list.
"""

from __future__ import annotations

import argparse
import sys
from dataclasses import replace
from pathlib import Path

from bench.mutation.mutants import MutantRecord, draw, find, read
from bench.mutation.names import Names
from bench.mutation.tree import Tree

ROOT = Path(__file__).parents[2]
HOME = ROOT / ".cache" / "mutation"
EQUIVALENT = Path(__file__).with_name("equivalent.txt")
LIMIT_S = 400.0
"""Processor seconds of a mutant's tests from which on it hangs."""


def main() -> int:
    """Run the command line; return 1 if a mutant survived that died before, else 0."""
    parser = argparse.ArgumentParser("dev mutate", description="Find the lines whose breaking no test notices.")
    verbs = parser.add_subparsers(dest="verb", required=True)
    drawing = verbs.add_parser("draw", help="write a list of mutants")
    drawing.add_argument("list", type=Path, help="the file to write")
    drawing.add_argument(
        "globs", nargs="+", metavar="GLOB", help="files, such as 'drivers/*'; '!hw_sim/water/*': not these"
    )
    drawing.add_argument("--seed", type=int, required=True)
    drawing.add_argument("--count", type=int, required=True)
    running = verbs.add_parser("run", help="try the mutants of a list that have no verdict yet")
    running.add_argument("list", type=Path)
    running.add_argument(
        "--again", type=Path, metavar="FILE", help="try all, write their verdicts to this file and compare"
    )
    running.add_argument(
        "--tests", nargs="+", metavar="FILE", help="these files' tests, not those of each mutant's room"
    )
    args = parser.parse_args()
    if args.verb == "run":
        return run(args.list, args.again or args.list, args.tests)
    drawn = draw(ROOT, args.globs, args.count, args.seed, read(EQUIVALENT))
    write(args.list, f"# seed {args.seed}, {args.count} of {' '.join(args.globs)}", drawn)
    return 0


def write(file: Path, head: str, mutants: list[MutantRecord]) -> None:
    """Write a list of mutants and their verdicts below a line that says how they were drawn."""
    file.write_text(f"{head}\n\n" + "\n".join(map(str, mutants)), encoding="utf-8")


def run(list_: Path, verdicts: Path, tests: list[str] | None) -> int:
    """Judge the mutants without a verdict and print the figures; return 1 if one survived that died before.

    Each verdict is written at once, so that an interrupted run continues.
    """
    before = {entry.key: entry for entry in read(list_)}
    old_verdicts = {entry.key: entry.verdict for entry in (read(verdicts) if verdicts.exists() else ())}
    entries = {key: replace(entry, verdict=old_verdicts.get(key, "")) for key, entry in before.items()}
    tree, arguments = Tree(ROOT, HOME / verdicts.stem), {entry.key: entry.verdict for entry in read(EQUIVALENT)}
    names = Names(tree.path)
    for key in [key for key, entry in entries.items() if not entry.verdict]:
        mutant = find(tree.path, entries[key])
        if mutant is None:
            verdict = "gone"
        elif key in arguments:
            verdict = f"equivalent: {arguments[key]}"
        else:
            chosen = tests or names.tests_of(mutant.listed.path)
            verdict = tree.judge(mutant, names, chosen, LIMIT_S) if chosen else "not reached"
        entries[key] = replace(entries[key], verdict=verdict)
        write(verdicts, list_.read_text(encoding="utf-8").partition("\n")[0], list(entries.values()))
        print(entries[key], flush=True)
    kinds = [entry.verdict.split()[0].strip(":") for entry in entries.values()]
    print(", ".join(f"{kinds.count(kind)} {kind}" for kind in sorted(set(kinds))))
    died = [key for key, entry in before.items() if entry.verdict.startswith("died")]
    worse = [entries[key] for key in died if entries[key].verdict.startswith(("survived", "not reached"))]
    print("\n".join(["died before and survived:", *map(str, worse)] if worse else []))
    return 1 if worse else 0


if __name__ == "__main__":
    sys.exit(main())
