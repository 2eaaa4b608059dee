"""Owns a run over many mutants: what became of each, what earlier runs already know, and the table at the end."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tests.mutate import argued
from tests.mutate.choice import Choice, Chosen, wider
from tests.mutate.mutants import Mutant
from tests.mutate.names import Name, Names
from tests.mutate.tree import Run, Tree

KILLED, TIMED_OUT, SURVIVED, NOT_REACHED, EQUIVALENT = "killed", "timed out", "survived", "not reached", "equivalent"
WIDER_LIMIT_S = 600.0


@dataclass(frozen=True, slots=True)
class Result:
    """What became of one mutant, and by which test or argument."""

    mutant: Mutant
    status: str
    by: str
    seconds: float
    tests: int

    @property
    def survived(self) -> bool:
        return self.status in {SURVIVED, NOT_REACHED}

    def as_json(self) -> dict[str, object]:
        one = self.mutant
        return {
            "key": one.key,
            "file": one.path,
            "line": one.line,
            "within": one.within,
            "operator": one.operator,
            "before": one.before,
            "after": one.after,
            "status": self.status,
            "by": self.by,
            "seconds": round(self.seconds, 2),
            "tests": self.tests,
        }


def share(results: list[Result]) -> float:
    """The noticed mutants in percent of those that can be noticed; 100 when there is none."""
    counted = [one for one in results if one.status != EQUIVALENT]
    noticed = [one for one in counted if not one.survived]
    return 100.0 * len(noticed) / len(counted) if counted else 100.0


def table(groups: list[tuple[str, list[Result]]]) -> str:
    """The results in figures, one line per path."""
    width = max(len("path"), "all".__len__(), *(len(name) for name, _ in groups))
    head = f"{'path':{width}}  made  killed  timed out  survived  equivalent  noticed"
    rows = [head]
    every = [("all", [one for _, results in groups for one in results])] if len(groups) > 1 else []
    for name, results in [*groups, *every]:
        many = {status: sum(one.status == status for one in results) for status in (KILLED, TIMED_OUT, EQUIVALENT)}
        survived = sum(one.survived for one in results)
        rows.append(
            f"{name:{width}}  {len(results):4}  {many[KILLED]:6}  {many[TIMED_OUT]:9}  {survived:8}"
            f"  {many[EQUIVALENT]:10}  {share(results):5.1f} %"
        )
    return "\n".join(rows)


@dataclass(slots=True)
class Campaign:
    """Runs mutants one after the other in one tree; everything found is kept at once, so that a run may be ended."""

    tree: Tree
    names: Names
    choice: Choice
    arguments: list[argued.Argument]
    home: Path
    limit_s: float
    budget_s: float
    interpret: bool = True
    """Whether a mutant of a kernel is tried as plain Python before it is compiled."""

    def run(self, mutants: list[Mutant], *, fresh: bool, confirm: bool, say: Callable[[str], None]) -> list[Result]:
        """Return what became of each mutant, and say it as it is found."""
        kept = self.home / "results.jsonl"
        known: dict[str, dict[str, Any]] = {}
        if kept.exists() and not fresh:
            known = {entry["mark"]: entry for entry in map(json.loads, kept.read_text().splitlines())}
        results = []
        for number, mutant in enumerate(mutants, 1):
            result, old = self._one(mutant, known, kept, confirm)
            results.append(result)
            say(
                f"[{number:3}/{len(mutants)}] {result.status:11} {'known' if old else f'{result.seconds:4.1f} s'}  "
                f"{mutant.path}:{mutant.line}  {mutant.operator}  {result.by}"
            )
        return results

    def _one(self, mutant: Mutant, known: dict[str, dict[str, Any]], kept: Path, confirm: bool) -> tuple[Result, bool]:
        why = argued.why(self.arguments, mutant)
        if why is not None:
            return Result(mutant, EQUIVALENT, why, 0.0, 0), True
        chosen = self.choice.for_mutant(mutant, self.budget_s)
        code = hashlib.sha256(self.tree.text(mutant.path).encode()).hexdigest()
        parts = (mutant.key, str(mutant.start), code, chosen.digest, str(confirm), str(self.interpret))
        mark = hashlib.sha256("\0".join(parts).encode()).hexdigest()[:24]
        entry = known.get(mark)
        if entry is not None:
            return Result(mutant, entry["status"], entry["by"], entry["seconds"], entry["tests"]), True
        result = self._tried(mutant, chosen)
        if result.survived and confirm:
            result = self._confirmed(result, chosen)
        with kept.open("a", encoding="utf-8") as file:
            file.write(json.dumps({"mark": mark, **result.as_json()}) + "\n")
        return result, False

    def _tried(self, mutant: Mutant, chosen: Chosen) -> Result:
        if not chosen.files:
            return Result(mutant, NOT_REACHED, "", 0.0, 0)
        if self.interpret and self._stale(mutant):
            result = self._interpreted(mutant)
            if result is not None:
                return result
        limit_s = max(self.limit_s, 3.0 * chosen.seconds)
        return self._judged(mutant, list(chosen.files), list(chosen.tests), limit_s)

    def _stale(self, mutant: Mutant) -> set[Name]:
        """The kernels that must be compiled anew to try the mutant."""
        definition = self.names.at(mutant.path, mutant.line)
        return self.names.stale_kernels(definition) if definition is not None else set()

    def _interpreted(self, mutant: Mutant) -> Result | None:
        """Try a mutant with the kernels as plain Python; None says that only compiled ones can tell.

        Whatever else than an assertion ends such a run says nothing: see ``worker.Interpreted``.
        """
        chosen = self.choice.interpreted(mutant, self.budget_s)
        if not chosen.files:
            return None
        limit_s = max(self.limit_s, 3.0 * chosen.seconds)
        with self.tree.mutated(mutant, set()):
            run = self.tree.run(list(chosen.files), limit_s, wanted=list(chosen.tests), mutated=True, interpreted=True)
        noticed = run.first_failed()
        if noticed is None:
            return None
        return Result(mutant, KILLED, f"{noticed} (interpreted)", run.seconds, len(chosen.tests))

    def _judged(self, mutant: Mutant, files: list[str], wanted: list[str] | None, limit_s: float) -> Result:
        with self.tree.mutated(mutant, self._stale(mutant)) as kernels:
            run = self.tree.run(files, limit_s, wanted=wanted, mutated=True, kernels=kernels)
        status = {"timed out": TIMED_OUT}.get(run.outcome, KILLED if run.noticed else SURVIVED)
        return Result(mutant, status, _by(run), run.seconds, len(wanted or ()))

    def _confirmed(self, survivor: Result, chosen: Chosen) -> Result:
        """Try a survivor against all other tests of the default run that import its file."""
        seconds = survivor.seconds
        for file in wider(self.tree.path, survivor.mutant.path, chosen.files):
            result = self._judged(survivor.mutant, [file], None, WIDER_LIMIT_S)
            seconds += result.seconds
            if not result.survived and self.tree.run([file], WIDER_LIMIT_S).outcome == "passed":
                return Result(survivor.mutant, result.status, result.by, seconds, survivor.tests)
        return Result(survivor.mutant, survivor.status, "confirmed", seconds, survivor.tests)


def _by(run: Run) -> str:
    if not run.noticed:
        return ""
    return run.first_failed() or run.outcome
