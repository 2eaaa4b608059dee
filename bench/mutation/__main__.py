"""``./dev mutate draw | reach | run``: does a test notice when a line is broken?

``draw`` writes a list of mutants, chosen by a seed. ``reach`` runs the tests once in a copy of the project and notes which test
reaches which of them. ``run`` breaks one line at a time in a copy, lets the tests that reach it run until one fails, and writes
the verdict below each mutant of the list.
"""

from __future__ import annotations

import argparse
import queue
import sys
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from pathlib import Path

from bench.mutation.mutants import Listed, draw, find, read, written
from bench.mutation.names import Names
from bench.mutation.tree import Tree

ROOT = Path(__file__).parents[2]
HOME = ROOT / ".cache" / "mutation"
NOTES = HOME / "reached.txt"
EQUIVALENT = Path(__file__).with_name("equivalent.txt")


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
    reaching.add_argument("--tests", nargs="*", default=[], help="arguments for pytest (default: all tests)")
    running = verbs.add_parser("run", help="try the mutants of a list that have no verdict yet")
    running.add_argument("list", type=Path)
    running.add_argument("--again", type=Path, metavar="FILE", help="try all, and write the verdicts to this file")
    running.add_argument("--tests", nargs="*", help="these files' tests, not those that were noted by reach")
    running.add_argument("--limit", type=float, default=150.0, help="processor seconds of tests for one (default 150)")
    running.add_argument("--processes", type=int, default=1)
    args = parser.parse_args()
    if args.verb == "draw":
        drawn = draw(ROOT, args.globs, args.count, args.seed, read(EQUIVALENT.read_text(encoding="utf-8")))
        args.list.write_text(written(f"# seed {args.seed}, {args.count} of {' '.join(args.globs)}\n", drawn), "utf-8")
        return 0
    if args.verb == "reach":
        return reach([one for file in args.lists for one in read(file.read_text(encoding="utf-8"))], args.tests)
    return Run(args.list, args.again or args.list, args.tests, args.limit).all(args.processes)


def reach(listed: list[Listed], tests: list[str]) -> int:
    """Note which tests reach the mutants."""
    tree = Tree(ROOT, HOME / "reach")
    found = {one.key: find(ROOT, one) for one in listed}
    tree.put_probes({key: one for key, one in found.items() if one is not None}, Names(ROOT))
    code = tree.pytest(["-n2", "--dist", "loadfile", *tests], tree.kernels, 4 * 3600.0)
    NOTES.write_text(tree.notes(), encoding="utf-8")
    return 0 if code in (0, 1) else code


@dataclass(slots=True)
class Reached:
    """The tests that reach each mutant, and how long tests take."""

    tests: dict[str, set[str]]
    cpu_s: dict[str, float]

    @classmethod
    def noted(cls) -> Reached:
        """Read what ``reach`` noted. A test that failed there judges nothing."""
        notes = [line.split("\t") for line in NOTES.read_text(encoding="utf-8").splitlines()]
        failed = {words[1] for words in notes if words[0] == "failed"}
        cpu_s: dict[str, float] = {}
        by_file: dict[str, set[str]] = {}
        for kind, test, *times in notes:
            if kind == "ran" and test not in failed:
                cpu_s[test] = max(cpu_s.get(test, 0.0), float(times[0]))
                by_file.setdefault(test.partition("::")[0], set()).add(test)
        tests: dict[str, set[str]] = {}
        for key, test, *phase in notes:
            if key not in {"ran", "failed"}:
                # What a fixture made may be judged by any test of its file.
                some = by_file.get(test.partition("::")[0], set()) if phase == ["(setup)"] else {test} & cpu_s.keys()
                tests.setdefault(key, set()).update(some)
        return cls(tests, cpu_s)

    def chosen(self, key: str, limit_s: float) -> tuple[list[str], float]:
        """Return the tests for a mutant, the file first whose tests take least, and their processor seconds."""
        by_file: dict[str, list[str]] = {}
        for test in self.cpu_s:  # in the order in which they ran
            if test in self.tests.get(key, ()):
                by_file.setdefault(test.partition("::")[0], []).append(test)
        wanted: list[str] = []
        total_s = 0.0
        for some in sorted(by_file.values(), key=lambda tests: sum(self.cpu_s[one] for one in tests)):
            for test in some:
                if not wanted or total_s + self.cpu_s[test] <= limit_s:
                    wanted.append(test)
                    total_s += self.cpu_s[test]
        return wanted, total_s


class Run:
    """Tries mutants; each verdict is written at once, so that a run may be ended and goes on where it was."""

    def __init__(self, list_: Path, verdicts: Path, files: list[str] | None, limit_s: float) -> None:
        self._verdicts, self._files, self._limit_s = verdicts, files, limit_s
        self._before = read(list_.read_text(encoding="utf-8"))
        self._head = list_.read_text(encoding="utf-8").partition("\n")[0] + "\n"
        known = (
            {one.key: one.verdict for one in read(verdicts.read_text(encoding="utf-8"))} if verdicts.exists() else {}
        )
        self._now = {one.key: replace(one, verdict=known.get(one.key, "")) for one in self._before}
        self._arguments = {one.key: one.verdict for one in read(EQUIVALENT.read_text(encoding="utf-8"))}
        self._reached = Reached.noted() if files is None else Reached({}, {})
        self._names = Names(ROOT)

    def all(self, processes: int) -> int:
        """Try what has no verdict and print the figures; 1 when a mutant survived that died before."""
        todo = [one for one in self._now.values() if not one.verdict]
        free: queue.SimpleQueue[Tree] = queue.SimpleQueue()
        for number in range(min(processes, len(todo))):
            free.put(Tree(ROOT, HOME / f"{self._verdicts.stem}-{number}"))
        with ThreadPoolExecutor(processes) as pool:
            for _ in pool.map(lambda one: self._try(one, free), todo):
                self._verdicts.write_text(written(self._head, list(self._now.values())), encoding="utf-8")
        kinds = [one.verdict.partition(" ")[0].strip(":") for one in self._now.values()]
        print(", ".join(f"{kinds.count(kind)} {kind}" for kind in dict.fromkeys(kinds)))
        worse = [
            f"{one.path} · {one.within}\n- {one.before}\n+ {one.after}\n  {one.verdict}"
            for one in self._before
            if one.verdict.startswith("died") and self._now[one.key].verdict.startswith(("survived", "not"))
        ]
        print("\n\n".join(["survived, and died before:", *worse] if worse else []))
        return 1 if worse else 0

    def _try(self, listed: Listed, free: queue.SimpleQueue[Tree]) -> None:
        tree = free.get()
        try:
            verdict = self._verdict(listed, tree)
        finally:
            free.put(tree)
        self._now[listed.key] = replace(listed, verdict=verdict)
        print(f"{verdict}  {listed.path} · {listed.within}  + {listed.after}", flush=True)

    def _verdict(self, listed: Listed, tree: Tree) -> str:
        mutant = find(ROOT, listed)
        if mutant is None:
            return "gone"
        if listed.key in self._arguments:
            return f"equivalent: {self._arguments[listed.key]}"
        tests, cpu_s = self._reached.chosen(listed.key, self._limit_s)
        if self._files is not None:
            tests, cpu_s = self._files, self._limit_s
        return tree.judge(mutant, self._names, tests, 60.0 + 3.0 * cpu_s) if tests else "not reached"


if __name__ == "__main__":
    sys.exit(main())
