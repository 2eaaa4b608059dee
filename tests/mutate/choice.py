"""Owns which tests judge a mutant: those that execute its lines, the cheap ones first.

Candidates are the folder of ``tests/`` that mirrors the file's and the integration tests of ``BESIDE``. They run once
under a trace (kept in ``.cache/mutate``, named after the contents of all files concerned). A kernel's lines never
show, and a constant's show only at import: for these, the functions that use them stand in.

To compile the kernels of a mutant anew takes a minute. So which tests pass in seconds with the kernels as plain Python
is found out once and kept as well: these judge a mutant of a kernel first.
"""

from __future__ import annotations

import ast
import hashlib
import json
from collections import deque
from dataclasses import dataclass
from pathlib import Path

from tests.mutate.mutants import Mutant
from tests.mutate.names import PACKAGES, Definition, Name, Names
from tests.mutate.tree import Tree

BESIDE = {
    "appliance/bringup": ("tests/appliance/service/bringup/test_*.py",),
    "appliance/capture": ("tests/integration/test_every_frame_fault.py",),
    "appliance/offline": (
        "tests/appliance/calibration/test_calibrate_verb.py",
        "tests/appliance/evaluation/test_evaluate_verb.py",
        "tests/appliance/cli/test_calibrate_air.py",
        "tests/appliance/cli/test_measure.py",
        "tests/appliance/service/test_lost_cloud.py",
    ),
    "appliance/offline/anew": ("tests/integration/test_reprocess.py",),
    "appliance/service": ("tests/appliance/machine/test_menu.py",),
    "appliance/storage": (
        "tests/crash/test_power_loss.py",
        "tests/crash/test_refused_writes.py",
        "tests/crash/test_bad_disk.py",
        "tests/appliance/cli/test_roots.py",
    ),
    "appliance/processing": (
        "tests/appliance/worker/test_pair.py",
        "tests/appliance/reconstruct/decode/test_specks.py",
        "tests/appliance/reconstruct/decode/test_backscatter.py",
    ),
    "appliance/reconstruct/decode": ("tests/appliance/reconstruct/test_*.py",),
    "drivers/board": ("tests/integration/drivers/test_board*.py",),
    "drivers/camera": ("tests/integration/drivers/test_camera*.py",),
    "drivers/keys": ("tests/integration/drivers/test_keys*.py",),
    "drivers/output": ("tests/integration/output/test_*.py",),
}
TRACE_LIMIT_S = 900.0
INTERPRETED_S = 2.0
"""Processor time that a test may take with its kernels as plain Python, a hundred times slower: small images pass."""


@dataclass(frozen=True, slots=True)
class Traced:
    """One test file, run once without a mutant."""

    file: str
    digest: str
    tests: dict[str, tuple[str, float]]
    lines: dict[str, dict[str, list[int]]]

    def reaching(self, path: str, lines: range) -> set[str]:
        return {
            name
            for name, by_file in self.lines.items()
            if self.tests.get(name, ("", 0.0))[0] == "passed" and any(line in lines for line in by_file.get(path, ()))
        }


@dataclass(frozen=True, slots=True)
class Chosen:
    """The tests for one mutant: files in the order in which they shall run, and of these the tests that count."""

    files: tuple[str, ...]
    tests: tuple[str, ...]
    seconds: float
    digest: str
    """Of the contents of these files: another one, and a survivor must be tried again."""


class Choice:
    """Chooses tests for the mutants of some files of one tree."""

    def __init__(self, tree: Tree, names: Names, home: Path, only: str | None = None) -> None:
        """``only``: a pattern, of test files that may be chosen."""
        self._only = only
        self._tree, self._names, self._home = tree, names, home / "reach"
        self._home.mkdir(parents=True, exist_ok=True)
        self._traced: dict[str, list[Traced]] = {}
        self._quick: dict[tuple[str, str], dict[str, float]] = {}
        self._imported: dict[str, set[Name]] = {}
        self.red: dict[str, str] = {}
        """Tests that fail without any mutant, with what they said: they judge nothing."""

    def for_mutant(self, mutant: Mutant, budget_s: float) -> Chosen:
        """The tests that execute the mutant; the dearest are left out once they take more than ``budget_s``."""
        return self._cheapest(
            [(sum(one.tests[name][1] for name in tests), one, tests) for one, tests in self._candidates(mutant)],
            budget_s,
        )

    def interpreted(self, mutant: Mutant, budget_s: float) -> Chosen:
        """Of the tests that execute the mutant: those that pass in seconds with all kernels as plain Python."""
        wanted: list[tuple[float, Traced, set[str]]] = []
        for one, tests in self._candidates(mutant):
            if not tests:
                continue
            seconds = self._interpreted(one, Path(mutant.path).parent.as_posix())
            quick = tests & seconds.keys()
            wanted.append((sum(seconds[name] for name in quick), one, quick))
        return self._cheapest(wanted, budget_s)

    def _candidates(self, mutant: Mutant) -> list[tuple[Traced, set[str]]]:
        definition = self._names.at(mutant.path, mutant.line)
        return [(one, self._reaching(one, mutant, definition)) for one in self._of_file(mutant.path)]

    @staticmethod
    def _cheapest(wanted: list[tuple[float, Traced, set[str]]], budget_s: float) -> Chosen:
        wanted = [entry for entry in wanted if entry[2]]
        wanted.sort(key=lambda entry: (entry[0], entry[1].file))
        files: list[str] = []
        chosen: list[str] = []
        total = 0.0
        digest = hashlib.sha256()
        for seconds, one, tests in wanted:
            if files and total + seconds > budget_s:
                break
            files.append(one.file)
            total += seconds
            digest.update(one.digest.encode())
            chosen += sorted(tests)
        return Chosen(tuple(files), tuple(chosen), total, digest.hexdigest()[:16])

    def _reaching(self, traced: Traced, mutant: Mutant, definition: Definition | None) -> set[str]:
        if definition is None:
            return set()
        called = mutant.line >= definition.body or mutant.within != definition.name  # else it runs at import
        if called and definition.function and not definition.kernel:
            return traced.reaching(mutant.path, range(mutant.line, mutant.last_line + 1))
        workers = self._names.workers(definition)
        named = self._names.stale_kernels(definition) | {(definition.path, definition.name)}
        if not definition.function:
            named |= {(worker.path, worker.name) for worker in workers}
        if named & self._named(traced.file):  # what a test file calls at its import, or as a kernel, shows nowhere
            return {name for name, (outcome, _) in traced.tests.items() if outcome == "passed"}
        found: set[str] = set()
        for worker in (definition, *workers):
            found |= traced.reaching(worker.path, range(min(worker.body, worker.last), worker.last + 1))
            if worker.body > worker.last:  # of a class, whatever of it runs
                found |= traced.reaching(worker.path, range(worker.first + 1, worker.last + 1))
        return found

    def _named(self, file: str) -> set[Name]:
        """What a test file imports by name."""
        if file not in self._imported:
            tree = ast.parse((self._tree.path / file).read_text(encoding="utf-8"))
            self._imported[file] = {
                (f"{node.module.replace('.', '/')}.py", alias.name)
                for node in ast.walk(tree)
                if isinstance(node, ast.ImportFrom) and node.module
                for alias in node.names
            }
        return self._imported[file]

    def _of_file(self, path: str) -> list[Traced]:
        folder = Path(path).parent.as_posix()
        if folder not in self._traced:
            candidates = candidates_of(self._tree.path, path)
            if self._only is not None:
                like = {one.relative_to(self._tree.path).as_posix() for one in self._tree.path.glob(self._only)}
                candidates = [one for one in candidates if one in like]
            self._traced[folder] = [self._trace(file, self._watched(folder)) for file in candidates]
        return self._traced[folder]

    def _watched(self, folder: str) -> list[str]:
        """The files of a folder, and those whose functions stand in for its kernels and constants."""
        here = {one.relative_to(self._tree.path).as_posix() for one in (self._tree.path / folder).glob("*.py")}
        workers = {
            worker.path
            for definition in self._names.definitions.values()
            if definition.path in here and (definition.kernel or not definition.function)
            for worker in self._names.workers(definition)
        }
        return sorted(here | workers)

    def _interpreted(self, traced: Traced, folder: str) -> dict[str, float]:
        """The tests of a file that pass with kernels as plain Python, and their seconds."""
        file = traced.file
        if (file, folder) not in self._quick:
            kept = self._kept(file, self._watched(folder), "interpreted")
            if not kept.exists():
                # What takes long compiled is not even tried; the rest is room for a busy computer.
                short = [
                    name
                    for name, (outcome, seconds) in traced.tests.items()
                    if outcome == "passed" and seconds <= 5.0 * INTERPRETED_S
                ]
                passed: dict[str, float] = {}
                if short:
                    run = self._tree.run([file], TRACE_LIMIT_S, wanted=short, interpreted=True, most_s=INTERPRETED_S)
                    passed = {name: seconds for name, (outcome, seconds) in run.tests.items() if outcome == "passed"}
                kept.write_text(json.dumps(passed))
            self._quick[file, folder] = json.loads(kept.read_text())
        return self._quick[file, folder]

    def _kept(self, file: str, watched: list[str], kind: str) -> Path:
        """Where is kept what a run of a test file said; another name when one of the files concerned has changed."""
        digest = hashlib.sha256(kind.encode())
        for tracer in (Path(__file__).with_name("worker.py"), Path(__file__).parent / "child" / "sitecustomize.py"):
            digest.update(tracer.read_bytes())
        for name in (file, *watched):
            digest.update(name.encode() + b"\0" + (self._tree.path / name).read_bytes() + b"\0")
        return self._home / f"{digest.hexdigest()[:24]}.json"

    def _trace(self, file: str, watched: list[str]) -> Traced:
        own = hashlib.sha256((self._tree.path / file).read_bytes()).hexdigest()
        kept = self._kept(file, watched, "")
        if kept.exists():
            known = json.loads(kept.read_text())
            return Traced(file, own, {k: (v[0], v[1]) for k, v in known["tests"].items()}, known["lines"])
        run = self._tree.run([file], TRACE_LIMIT_S, watched=watched)
        tests = dict(run.tests)
        if any(outcome == "failed" for outcome, _ in tests.values()) or run.outcome in {"died", "timed out"}:
            again = self._tree.run([file], TRACE_LIMIT_S)  # a trace makes everything slow, and some tests mind
            tests = {name: again.tests.get(name, entry) for name, entry in tests.items()}
            self.red |= {name: again.said[-2000:] for name, entry in tests.items() if entry[0] == "failed"}
            if again.outcome in {"died", "timed out"}:
                self.red[file] = again.outcome
        else:
            kept.write_text(json.dumps({"tests": tests, "lines": run.lines}))
        return Traced(file, own, tests, run.lines)


def candidates_of(root: Path, path: str) -> list[str]:
    """The test files that are tried for a file: the mirrored folder, a file named after it, and ``BESIDE``."""
    folder = Path(path).parent.as_posix()
    mirrored = root / "tests" / folder
    found = sorted(one.relative_to(root).as_posix() for one in mirrored.rglob("test_*.py"))
    beside = [one for head, extra in BESIDE.items() if f"{folder}/".startswith(f"{head}/") for one in extra]
    found += [path.relative_to(root).as_posix() for pattern in beside for path in sorted(root.glob(pattern))]
    return list(dict.fromkeys(found))


def wider(root: Path, path: str, without: tuple[str, ...]) -> list[str]:
    """Every other test file that imports ``path``, over however many modules: the nearest first."""
    imports = {
        file.relative_to(root).as_posix(): _imported(file, root)
        for package in (*PACKAGES, "tests", "bench")
        for file in sorted((root / package).rglob("*.py"))
    }
    users: dict[str, set[str]] = {}
    for file, used in imports.items():
        for one in used:
            users.setdefault(one, set()).add(file)
    distance, waiting = {path: 0}, deque([path])
    while waiting:
        file = waiting.popleft()
        for user in users.get(file, ()):
            if user not in distance:
                distance[user] = distance[file] + 1
                waiting.append(user)
    tests = [file for file in distance if Path(file).name.startswith("test_") and file not in without]
    return sorted(tests, key=lambda file: (distance[file], file))


def _imported(file: Path, root: Path) -> set[str]:
    modules: set[str] = set()
    for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            modules |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module:
            modules |= {node.module, *(f"{node.module}.{alias.name}" for alias in node.names)}
    found: set[str] = set()
    for module in modules:
        stem = module.replace(".", "/")
        found |= {one for one in (f"{stem}.py", f"{stem}/__init__.py") if (root / one).is_file()}
    return found
