"""``./dev mutate PATH… [--lines changed|A-B] [--seed S] [--count N]``: which broken lines does no test notice?

One small change at a time is made in a private copy of the project, and the tests that execute the changed line run
against it. A mutant that no test notices is shown as a change of the source: either a test is missing, or the change
cannot be noticed and ``tests/mutate/equivalent.txt`` says why.
"""

from __future__ import annotations

import argparse
import json
import re
import subprocess
import sys
from pathlib import Path

from tests.mutate import argued
from tests.mutate.campaign import Campaign, Result, share, table
from tests.mutate.choice import Choice
from tests.mutate.mutants import Mutant, draw, mutants_of
from tests.mutate.names import PACKAGES, Names
from tests.mutate.tree import Tree

ROOT = Path(__file__).parents[2]


def main() -> int:
    """0 when at least the wanted share of the mutants was noticed, 1 when fewer, 2 for wrong arguments."""
    parser = argparse.ArgumentParser("dev mutate", description="Find the lines whose breaking no test notices.")
    parser.add_argument("paths", nargs="*", metavar="PATH", help="files or folders (default: what changed)")
    parser.add_argument("--lines", metavar="changed|A-B", help="only mutants of changed lines, or of lines A to B")
    parser.add_argument("--since", default="HEAD", metavar="REV", help="changed means: since this (default HEAD)")
    parser.add_argument("--seed", type=int, default=0, metavar="S", help="another seed, other mutants (default 0)")
    parser.add_argument("--count", type=int, metavar="N", help="so many mutants per PATH (default: all)")
    parser.add_argument("--limit", type=float, default=30.0, metavar="S", help="processor seconds for one (default 30)")
    parser.add_argument("--budget", type=float, default=60.0, metavar="S", help="seconds of tests for one (default 60)")
    parser.add_argument("--tests", metavar="GLOB", help="only test files like this, such as 'tests/**/test_motion*.py'")
    parser.add_argument(
        "--confirm", action="store_true", help="try survivors against every test file that imports them"
    )
    parser.add_argument(
        "--compiled", action="store_true", help="compile every mutant of a kernel, also where plain Python would tell"
    )
    parser.add_argument("--fresh", action="store_true", help="forget what earlier runs found")
    parser.add_argument("--list", action="store_true", help="only list the mutants")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the results there as well")
    parser.add_argument("--at-least", type=float, default=90.0, metavar="PERCENT", help="exit 1 below (default 90)")
    args = parser.parse_args()
    try:
        chosen = choose(args.paths, args.lines, args.since, args.seed, args.count)
        arguments = argued.read(argued.FILE.read_text(encoding="utf-8"))
    except (ValueError, argued.Unreadable) as error:
        parser.error(str(error))
    if args.list:
        for _, mutants in chosen:
            for one in mutants:
                print(f"{one.path}:{one.line}  {one.operator}\n    - {one.before}\n    + {one.after}")
        return 0
    home = ROOT / ".cache" / "mutate"
    with Tree.taken(ROOT, home) as tree:
        names = Names(tree.path)
        choice = Choice(tree, names, home, args.tests)
        campaign = Campaign(tree, names, choice, arguments, home, args.limit, args.budget, interpret=not args.compiled)
        groups: list[tuple[str, list[Result]]] = []
        for name, mutants in chosen:
            groups.append((name, campaign.run(mutants, fresh=args.fresh, confirm=args.confirm, say=_say)))
    for name in choice.red:
        print(f"not used, since it fails without any mutant: {name}")
    for _, results in groups:
        for result in results:
            if result.survived:
                one = result.mutant
                print(f"\n{result.status}: {one.path}:{one.line}  {one.operator}\n  - {one.before}\n  + {one.after}")
    print("\n" + table(groups))
    if args.json:
        args.json.write_text(
            json.dumps({name: [one.as_json() for one in results] for name, results in groups}, indent=1)
        )
    every = [one for _, results in groups for one in results]
    return 0 if share(every) >= args.at_least else 1


def _say(line: str) -> None:
    print(line, flush=True)


def choose(
    paths: list[str], lines: str | None, since: str, seed: int, count: int | None
) -> list[tuple[str, list[Mutant]]]:
    """The mutants of each path, in the order of the source. Raises ValueError, which names what is wrong."""
    changed = _changed(since) if lines == "changed" or not paths else None
    found = []
    for given in paths or sorted(changed or ()):
        files = _files(given)
        mutants = []
        for file in files:
            some = mutants_of(file, (ROOT / file).read_text(encoding="utf-8"))
            if changed is not None:
                some = [one for one in some if changed.get(file, set()) & set(range(one.line, one.last_line + 1))]
            elif lines is not None:
                between = re.fullmatch(r"(\d+)-(\d+)", lines)
                if between is None:
                    raise ValueError(f"--lines {lines}: wanted is 'changed' or A-B, such as 20-45")
                first, last = int(between[1]), int(between[2])
                some = [one for one in some if first <= one.line <= last]
            mutants += some
        if count is not None:
            mutants = draw(mutants, count, seed)
        found.append((given, sorted(mutants, key=lambda one: (one.path, one.line, one.start))))
    if not any(mutants for _, mutants in found):
        raise ValueError("there is nothing to mutate: no changed line, or no code in what was named")
    return found


def _files(given: str) -> list[str]:
    path = (ROOT / given).resolve()
    if not path.exists() or not path.is_relative_to(ROOT):
        raise ValueError(f"{given}: there is no such file or folder in {ROOT}")
    files = [path] if path.is_file() else sorted(path.rglob("*.py"))
    names = [one.relative_to(ROOT).as_posix() for one in files]
    if not names or not all(one.startswith(tuple(f"{p}/" for p in PACKAGES)) for one in names):
        raise ValueError(f"{given}: only Python files of {', '.join(PACKAGES)} are mutated")
    return names


def _changed(since: str) -> dict[str, set[int]]:
    """The changed lines of each file of the packages, in the numbers of the working tree."""
    called = ["git", "diff", "-U0", "--no-color", "--no-ext-diff", since, "--", *(f"{p}/*.py" for p in PACKAGES)]
    done = subprocess.run(called, cwd=ROOT, capture_output=True, text=True, timeout=60, check=False)
    if done.returncode:
        raise ValueError(f"--since {since}: {done.stderr.strip().splitlines()[0]}")
    found: dict[str, set[int]] = {}
    file = ""
    for line in done.stdout.splitlines():
        if line.startswith("+++ "):
            file = line.removeprefix("+++ b/") if line != "+++ /dev/null" else ""
        elif file and (hunk := re.match(r"@@ \S+ \+(\d+)(?:,(\d+))? @@", line)):
            first, many = int(hunk[1]), int(hunk[2] or 1)
            found.setdefault(file, set()).update(range(first, first + many))
    return {file: lines for file, lines in found.items() if lines}


if __name__ == "__main__":
    sys.exit(main())
