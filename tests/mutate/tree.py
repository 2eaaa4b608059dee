"""Owns the private copy of the project in which mutants run: its files, its compiled kernels, its runner.

The working tree is never written to. A copy is kept between calls below ``.cache/mutate``, each with a lock, so that
several campaigns may run side by side.
"""

from __future__ import annotations

import fcntl
import hashlib
import json
import os
import pickle
import shutil
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO, Any

from tests.mutate.mutants import Mutant
from tests.mutate.names import Name

MOST_TREES = 32
HEAVY = (
    *(
        "pytest",
        "hypothesis",
        "_hypothesis_pytestplugin",
        "pytest_timeout",
        "numpy",
        "numpy.testing",
        "cv2",
        "pydantic",
    ),
    *("scipy.optimize", "scipy.ndimage", "scipy.spatial", "scipy.interpolate", "scipy.sparse.linalg", "scipy.special"),
    *("scipy.stats", "scipy.signal", "numba"),
)
"""Libraries that nearly every test needs: imported once, not for each mutant."""
_LATER_NS = 10_000_000_000
"""By so much a mutant is younger than the file it stands for: nothing compiled from one passes for the other."""


@dataclass(frozen=True, slots=True)
class Run:
    """How one call of pytest ended: passed, failed, died, timed out, or no tests."""

    outcome: str
    seconds: float
    tests: dict[str, tuple[str, float]]
    """Of each test that ran: its outcome and its seconds."""
    lines: dict[str, dict[str, list[int]]]
    said: str

    @property
    def noticed(self) -> bool:
        return self.outcome in {"failed", "died", "timed out"}

    def first_failed(self) -> str | None:
        return next((name for name, (outcome, _) in self.tests.items() if outcome == "failed"), None)


class ForeignTree(Exception):
    """A run imported modules of another tree than its own: whatever it found says nothing about the mutant."""


@dataclass(slots=True)
class Tree:
    """A copy of ``root`` at ``path``."""

    root: Path
    path: Path
    _lock: IO[str]
    _heavy: tuple[str, ...] = HEAVY
    _runner: subprocess.Popen[str] | None = None
    _count: int = 0
    _texts: dict[str, str] = field(default_factory=dict)

    @classmethod
    @contextmanager
    def taken(cls, root: Path, home: Path, heavy: tuple[str, ...] = HEAVY) -> Iterator[Tree]:
        """Take the first copy below ``home`` that nobody uses and bring it up to date with ``root``."""
        home.mkdir(parents=True, exist_ok=True)
        for number in range(MOST_TREES):
            lock = (home / f"tree-{number}.lock").open("w")
            try:
                fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                lock.close()
                continue
            tree = cls(root, home / f"tree-{number}", lock, heavy)
            try:
                tree._copy_files()
                tree._copy_kernels()
                yield tree
            finally:
                tree._end_runner()
                lock.close()
            return
        raise SystemExit(f"all {MOST_TREES} copies below {home} are in use: end the other campaigns first")

    # -------------------------------------------------------------------------------------------------- contents

    def _copy_files(self) -> None:
        listed = subprocess.run(
            ["git", "ls-files", "-z", "--cached", "--others", "--exclude-standard"],
            cwd=self.root,
            capture_output=True,
            text=True,
            check=True,
            timeout=60,
        )
        wanted = {name for name in listed.stdout.split("\0") if name and (self.root / name).is_file()}
        self.path.mkdir(exist_ok=True)
        for found in list(self.path.rglob("*")):
            name = found.relative_to(self.path).as_posix()
            if found.is_file() and name not in wanted and found.suffix != ".pyc":
                found.unlink()
        for name in wanted:
            source, target = self.root / name, self.path / name
            if not target.exists() or _stamp(source) != _stamp(target):
                target.parent.mkdir(parents=True, exist_ok=True)
                shutil.copy2(source, target)

    @property
    def kernels(self) -> Path:
        """Compiled kernels of the unchanged copy."""
        return self.path.with_suffix(".kernels")

    def _copy_kernels(self) -> None:
        """Take over what is compiled for the working tree: numba finds it under a name made from the folder's path.

        The cache of ``./dev`` is named after everything that kernels depend on; another name, another start.
        """
        given = os.environ.get("NUMBA_CACHE_DIR")
        mark = self.kernels / "made-from"
        if mark.exists() and mark.read_text() == str(given):
            return
        shutil.rmtree(self.kernels, ignore_errors=True)
        self.kernels.mkdir()
        for folder in sorted({path.parent for path in self.path.rglob("*.py")}) if given else ():
            there = self.root / folder.relative_to(self.path)
            source = Path(str(given)) / _cache_name(there)
            if source.is_dir():
                shutil.copytree(source, self.kernels / _cache_name(folder))
        mark.write_text(str(given))

    def text(self, path: str) -> str:
        """The unchanged text of a file."""
        if path not in self._texts:
            self._texts[path] = (self.path / path).read_text(encoding="utf-8")
        return self._texts[path]

    @contextmanager
    def mutated(self, mutant: Mutant, stale: set[Name]) -> Iterator[Path]:
        """Put a mutant in its place and yield the folder of compiled kernels that may be used with it."""
        text, file = self.text(mutant.path), self.path / mutant.path
        known = file.stat()
        self._count += 1
        later = known.st_mtime_ns + self._count * _LATER_NS
        try:
            file.write_text(mutant.applied(text), encoding="utf-8")
            os.utime(file, ns=(later, later))
            yield self._kernels_without(stale, file) if stale else self.kernels
        finally:
            file.write_text(text, encoding="utf-8")
            os.utime(file, ns=(known.st_atime_ns, known.st_mtime_ns))

    def _kernels_without(self, stale: set[Name], changed: Path) -> Path:
        """A copy of the compiled kernels that lacks the stale ones; the others of the changed file stay valid."""
        target = self.path.with_suffix(".mutant-kernels")
        shutil.rmtree(target, ignore_errors=True)
        shutil.copytree(self.kernels, target)
        for path, name in stale:
            file = self.path / path
            for entry in (target / _cache_name(file.parent)).glob(f"{file.stem}.{name}-*"):
                entry.unlink()
        for index in (target / _cache_name(changed.parent)).glob(f"{changed.stem}.*.nbi"):
            with index.open("rb") as opened:
                version = pickle.load(opened)
                _, overloads = pickle.load(opened)
            status = changed.stat()
            with index.open("wb") as opened:
                pickle.dump(version, opened, protocol=-1)
                pickle.dump(((status.st_mtime, status.st_size), overloads), opened, protocol=-1)
        return target

    # -------------------------------------------------------------------------------------------------- running

    def run(
        self,
        files: list[str],
        limit_s: float,
        *,
        wanted: list[str] | None = None,
        watched: list[str] | None = None,
        mutated: bool = False,
        kernels: Path | None = None,
        interpreted: bool = False,
        most_s: float | None = None,
    ) -> Run:
        """Run tests of the copy; the first failure ends a mutant's run. Raises ForeignTree.

        ``interpreted``: kernels run as plain Python, and of a test that failed otherwise than by an assertion the
        outcome is "raised"; ``most_s``: a test that then takes longer has raised too.
        """
        said = self.path.with_suffix(".said")
        job = {
            "files": files,
            "wanted": wanted,
            "watched": watched or [],
            "mutated": mutated,
            "interpreted": interpreted,
            "most_s": most_s,
            "limit_s": limit_s,
            "kernels": str(kernels or self.kernels),
            "notes": str(self.path.with_suffix(".notes")),
            "said": str(said),
        }
        runner = self._started()
        assert runner.stdin is not None
        assert runner.stdout is not None
        runner.stdin.write(json.dumps(job) + "\n")
        runner.stdin.flush()
        answer: dict[str, Any] = json.loads(runner.stdout.readline() or "{}")
        if not answer:
            raise SystemExit(f"the runner of {self.path} ended by itself, with status {runner.wait(10)}")
        if answer.get("foreign"):
            raise ForeignTree(f"a run in {self.path} imported {', '.join(answer['foreign'][:3])} from elsewhere")
        return Run(
            answer["outcome"],
            answer["seconds"],
            {name: (outcome, seconds) for name, (outcome, seconds) in answer["tests"].items()},
            answer["lines"],
            said.read_text(errors="replace") if said.exists() else "",
        )

    def _started(self) -> subprocess.Popen[str]:
        if self._runner is None:
            self._runner = subprocess.Popen(
                [sys.executable, str(Path(__file__).with_name("worker.py")), *self._heavy],
                cwd=self.path,
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                text=True,
                env={key: value for key, value in os.environ.items() if not key.startswith("PYTEST_")},
            )
        return self._runner

    def _end_runner(self) -> None:
        if self._runner is not None:
            self._runner.kill()
            self._runner.communicate(timeout=10)
            self._runner = None


def _stamp(file: Path) -> tuple[int, int]:
    status = file.stat()
    return status.st_mtime_ns, status.st_size


def _cache_name(folder: Path) -> str:
    """What numba calls the folder, below its cache, for the files of a source folder."""
    return f"{folder.name}_{hashlib.sha1(str(folder).encode()).hexdigest()}"
