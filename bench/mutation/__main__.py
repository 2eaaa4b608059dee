"""``./dev mutate draw | reach | run``: does a test notice when a line is broken?

``draw`` writes a list of mutants, chosen by a seed. ``reach`` runs the tests once in a copy of the project and notes which test
reaches which of them. ``run`` breaks one line at a time in a copy, lets the tests that reach it run until one fails, and writes
the verdict below each mutant of the list.
"""

from __future__ import annotations

import argparse
import sys
from dataclasses import dataclass, replace
from pathlib import Path

from bench.mutation.mutants import Listed, draw, find, read
from bench.mutation.names import Names
from bench.mutation.tree import Tree

ROOT = Path(__file__).parents[2]
HOME = ROOT / ".cache" / "mutation"
REACHED = HOME / "reached.txt"
EQUIVALENT = Path(__file__).with_name("equivalent.txt")
LIMIT_S = 150.0
"""Processor seconds of tests for one mutant, by what they take without it."""


def main() -> int:
    """0, or 1 when a mutant survived that died before."""
    parser = argparse.ArgumentParser("dev mutate", description="Find the lines whose breaking no test notices.")
    verbs = parser.add_subparsers(dest="verb", required=True)
    drawing = verbs.add_parser("draw", help="write a list of mutants")
    drawing.add_argument("list", type=Path, help="the file to write")
    drawing.add_argument(
        "globs", nargs="+", metavar="GLOB", help="files, such as 'drivers/*'; '!hw_sim/water/*': not these"
    )
    drawing.add_argument("--seed", type=int, required=True)
    drawing.add_argument("--count", type=int, required=True)
    reaching = verbs.add_parser("reach", help="run the tests once and note which of them reach the mutants of lists")
    reaching.add_argument("lists", nargs="+", type=Path)
    reaching.add_argument("--tests", nargs="*", default=[], help="only these files' tests")
    running = verbs.add_parser("run", help="try the mutants of a list that have no verdict yet")
    running.add_argument("list", type=Path)
    running.add_argument(
        "--again", type=Path, metavar="FILE", help="try all, write their verdicts to this file and compare"
    )
    running.add_argument("--tests", nargs="*", help="these files' tests, not those that were noted by reach")
    args = parser.parse_args()
    if args.verb == "draw":
        drawn = draw(ROOT, args.globs, args.count, args.seed, read(EQUIVALENT))
        write(args.list, f"# seed {args.seed}, {args.count} of {' '.join(args.globs)}", drawn)
        return 0
    if args.verb == "reach":
        return reach([one for file in args.lists for one in read(file)], args.tests)
    return run(args.list, args.again or args.list, args.tests)


def write(file: Path, head: str, mutants: list[Listed]) -> None:
    """Write a list of mutants and their verdicts below a line that says how they were drawn."""
    file.write_text(f"{head}\n\n" + "\n".join(map(str, mutants)), encoding="utf-8")


def reach(listed: list[Listed], tests: list[str]) -> int:
    """Note which tests reach the mutants."""
    tree = Tree(ROOT, HOME / "reach")
    found = {one.key: find(tree.path, one) for one in listed}
    tree.put_probes({key: one for key, one in found.items() if one is not None}, Names(tree.path))
    code = tree.pytest(["-n2", "--dist", "loadfile", *tests], tree.kernels, 4 * 3600.0, {})
    REACHED.write_text("\n".join("\t".join(words) for words in tree.notes()), encoding="utf-8")
    return 0 if code == 1 else code  # a test that fails there judges nothing


@dataclass(frozen=True, slots=True)
class Reached:
    """The tests or files of tests that reach each mutant, and how long tests take."""

    tests: dict[str, set[str]]
    cpu_s: dict[str, float]

    @classmethod
    def read(cls, file: Path) -> Reached:
        """Read what ``reach`` noted."""
        notes = [line.split("\t") for line in file.read_text(encoding="utf-8").splitlines()]
        failed = {words[1] for words in notes if words[0] == "failed"}
        cpu_s: dict[str, float] = {}
        for _, test, cpu, _ in (words for words in notes if words[0] == "ran" and words[1] not in failed):
            cpu_s[test] = max(cpu_s.get(test, 0.0), float(cpu))
        tests: dict[str, set[str]] = {}
        for key, test, phase in (words for words in notes if words[0] not in {"ran", "failed"}):
            # What a fixture made may be judged by any test of its file.
            tests.setdefault(key, set()).add(test if phase == "(call)" else test.partition("::")[0])
        return cls(tests, cpu_s)

    def chosen(self, key: str) -> list[str]:
        """Return the tests for a mutant, the cheapest first, within the limit."""
        reaching = self.tests.get(key, set())
        tests = [test for test in self.cpu_s if reaching & {test, test.partition("::")[0]}]
        tests.sort(key=lambda test: self.cpu_s[test])
        return [test for k, test in enumerate(tests) if not k or self.sum_s(tests[: k + 1]) <= LIMIT_S]

    def sum_s(self, tests: list[str]) -> float:
        """Return the processor seconds of tests or, where they were not noted, the limit."""
        return sum(self.cpu_s.get(test, LIMIT_S) for test in tests)


def run(list_: Path, verdicts: Path, tests: list[str] | None) -> int:
    """Try what has no verdict and print the figures; 1 when a mutant survived that died before. What is found is written
    at once, so that a run may be ended and goes on where it was."""
    before = {one.key: one for one in read(list_)}
    known = {one.key: one.verdict for one in (read(verdicts) if verdicts.exists() else ())}
    now = {key: replace(one, verdict=known.get(key, "")) for key, one in before.items()}
    tree, arguments = Tree(ROOT, HOME / verdicts.stem), {one.key: one.verdict for one in read(EQUIVALENT)}
    names, reached = Names(tree.path), Reached.read(REACHED) if tests is None else Reached({}, {})
    for key in [key for key, one in now.items() if not one.verdict]:
        mutant, chosen = find(tree.path, now[key]), tests or reached.chosen(key)
        if mutant is None:
            verdict = "gone"
        elif key in arguments:
            verdict = f"equivalent: {arguments[key]}"
        else:
            verdict = tree.judge(mutant, names, chosen, 60.0 + 3.0 * reached.sum_s(chosen)) if chosen else "not reached"
        now[key] = replace(now[key], verdict=verdict)
        write(verdicts, list_.read_text(encoding="utf-8").partition("\n")[0], list(now.values()))
        print(now[key], flush=True)
    kinds = [one.verdict.split()[0].strip(":") for one in now.values()]
    print(", ".join(f"{kinds.count(kind)} {kind}" for kind in sorted(set(kinds))))
    died = [key for key, one in before.items() if one.verdict.startswith("died")]
    worse = [now[key] for key in died if now[key].verdict.startswith(("survived", "not reached"))]
    print("\n".join(["died before and survived:", *map(str, worse)] if worse else []))
    return 1 if worse else 0


if __name__ == "__main__":
    sys.exit(main())
