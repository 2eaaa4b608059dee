"""Owns a private copy of the project in which mutants run: its files, its environment, its compiled kernels."""

from __future__ import annotations

import ast
import hashlib
import os
import pickle
import resource
import shutil
import signal
import subprocess
import sys
import venv
from collections.abc import Iterator, Mapping
from contextlib import suppress
from pathlib import Path

from bench.mutation.mutants import Mutant, Positions
from bench.mutation.names import Names
from bench.mutation.probe import NOTES, WANTED

_MARK = "KINGFISHER_MUTATION_TREE"
_CALL = '__import__("bench.mutation.probe", None, None, "_").at("{}")'
_LATER_NS = 10_000_000_000
"""By so much a mutant is younger than the file it stands for: nothing compiled from one passes for the other."""


class Tree:
    """A copy of ``root`` at ``path``; making it brings it up to date."""

    def __init__(self, root: Path, path: Path) -> None:
        self.root, self.path = root, path
        self.kernels, self._notes = path.with_suffix(".kernels"), path.with_suffix(".notes")
        self._count = 0
        for old in (path, self.kernels):
            shutil.rmtree(old, ignore_errors=True)
        listed = subprocess.run(["git", "ls-files", "-z", "-co", "--exclude-standard"], cwd=root, capture_output=True, text=True, check=True, timeout=60)  # fmt: skip
        for name in listed.stdout.split("\0"):
            if (root / name).is_file():
                (path / name).parent.mkdir(parents=True, exist_ok=True)
                shutil.copy2(root / name, path / name)
        self._make_environment()
        given = Path(os.environ["NUMBA_CACHE_DIR"])
        for folder in {file.parent for file in path.rglob("*.py")}:
            source = given / _cache_name(root / folder.relative_to(path))
            if source.is_dir():  # numba finds it under a name made from the folder's path
                shutil.copytree(source, self.kernels / _cache_name(folder))
        self.kernels.chmod(0o700)

    def _make_environment(self) -> None:
        """Make .venv with the packages of this one and the project's own from the copy."""
        venv.create(self.path / ".venv", symlinks=True)
        site = next((self.path / ".venv").glob("lib/python*/site-packages"))
        packages = next(Path(sys.prefix).glob("lib/python*/site-packages"))
        own = (self.path, self.path / "systemd", self.path / "appliance/python")
        (site / "packages.pth").write_text("\n".join(map(str, (*own, packages))))
        for script in (Path(sys.prefix) / "bin").iterdir():
            target = self.path / ".venv/bin" / script.name
            if script.is_file() and not target.exists():
                shutil.copy2(script, target)
                with suppress(UnicodeDecodeError):
                    target.write_text(target.read_text().replace(sys.prefix, str(self.path / ".venv")))

    def put_probes(self, mutants: Mapping[str, Mutant], names: Names) -> None:
        """Let the statement of each mutant note its key; for one that no probe can stand in, the functions that use it."""
        inserted: dict[str, list[tuple[int, str]]] = {}
        positions = {path: Positions((self.path / path).read_text(encoding="utf-8")) for path in names.trees}
        for key, mutant in mutants.items():
            places = [(mutant.listed.path, mutant.statement)]
            if not mutant.in_function or names.in_kernel(mutant):
                places = list(names.at_work(mutant))
            for path, statement in places:
                inserted.setdefault(path, []).extend(_probe(positions[path], statement, _CALL.format(key)))
        for path, some in inserted.items():
            text = positions[path].text
            for at, new in sorted(some, key=lambda one: one[0], reverse=True):
                text = text[:at] + new + text[at:]
            self._write(path, text, self.kernels)

    def _write(self, path: str, text: str, kernels: Path) -> None:
        """Write a file and let the kernels of it that are there pass for those of the new text."""
        file = self.path / path
        self._count += 1
        later = file.stat().st_mtime_ns + self._count * _LATER_NS
        file.write_text(text, encoding="utf-8")
        os.utime(file, ns=(later, later))
        for index in (kernels / _cache_name(file.parent)).glob(f"{file.stem}.*.nbi"):
            with index.open("rb") as opened:
                version, (_, overloads) = pickle.load(opened), pickle.load(opened)
            with index.open("wb") as opened:
                pickle.dump(version, opened, protocol=-1)
                pickle.dump(((file.stat().st_mtime, file.stat().st_size), overloads), opened, protocol=-1)

    def judge(self, mutant: Mutant, names: Names, tests: list[str], limit_s: float) -> str:
        """Return the verdict of some tests, in their order, on a mutant; the first that fails ends it."""
        path, stale = mutant.listed.path, names.stale_kernels(mutant)
        file, kernels = self.path / path, self.path.with_suffix(".mutant-kernels")
        text, known = file.read_text(encoding="utf-8"), file.stat()
        shutil.rmtree(kernels, ignore_errors=True)
        shutil.copytree(self.kernels, kernels)
        for one in stale:
            source = self.path / one.path
            for entry in (kernels / _cache_name(source.parent)).glob(f"{source.stem}.{one.name}-*"):
                entry.unlink()
        wanted = self.path.with_suffix(".wanted")
        wanted.write_text("\n".join(tests))
        files = dict.fromkeys(test.partition("::")[0] for test in tests)
        try:
            self._write(path, mutant.applied(text), kernels)
            options = ["-x", "-q", "-n0", "--tb=short", "--hypothesis-seed=0", "-p", "no:cacheprovider"]
            code = self.pytest([*options, *files], kernels, limit_s + 90.0 * bool(stale), wanted)
        finally:
            file.write_text(text, encoding="utf-8")
            os.utime(file, ns=(known.st_atime_ns, known.st_mtime_ns))
        notes = [line.split("\t") for line in self._notes.read_text().splitlines()] if self._notes.exists() else []
        failed = [words[1] for words in notes if words[0] == "failed"]
        many = sum(words[0] == "ran" for words in notes)
        match code:
            case 0:
                return f"survived {many} tests"
            case 5:
                return "not reached"
            case 1 if failed:
                return f"died: {failed[0]}"
            case 1 | 2 | 3 | 4:
                return "died: no test can be collected"
            case _:
                return f"died: the process ended with {code} in or after {tests[min(many, len(tests) - 1)]}"

    def pytest(self, arguments: list[str], kernels: Path, limit_s: float, wanted: Path | None = None) -> int:
        """Run pytest in the copy, ``limit_s`` of processor time at most for a process; return its status, or -9 when it hangs."""
        self._notes.unlink(missing_ok=True)
        own = {NOTES: self._notes, _MARK: self.path, "NUMBA_CACHE_DIR": kernels, "PATH": f"{self.path}/.venv/bin:{os.environ['PATH']}"}  # fmt: skip
        own |= {WANTED: wanted, "PYTHONDONTWRITEBYTECODE": "1"} if wanted else {}
        limit = (int(limit_s) + 1, int(limit_s) + 5)
        with self.path.with_suffix(".said").open("w") as said, subprocess.Popen(
            [str(self.path / ".venv/bin/python"), "-m", "pytest", "-p", "bench.mutation.probe", *arguments],
            cwd=self.path,
            env={key: str(value) for key, value in {**os.environ, **own}.items() if not key.startswith("PYTEST_")},
            stdin=subprocess.DEVNULL,
            stdout=said,
            stderr=said,
            preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_CPU, limit),
        ) as running:  # fmt: skip
            try:
                return running.wait(4.0 * limit_s)
            except subprocess.TimeoutExpired:
                return -signal.SIGKILL
            finally:
                self._end_the_rest()

    def notes(self) -> str:
        """What the last run noted."""
        return self._notes.read_text()

    def _end_the_rest(self) -> None:
        """Kill what a run left behind, known by a variable of its environment."""
        for process in Path("/proc").glob("[0-9]*/environ"):
            with suppress(OSError):
                if f"{_MARK}={self.path}\0".encode() in process.read_bytes():
                    os.kill(int(process.parent.name), signal.SIGKILL)


def _probe(positions: Positions, statement: ast.stmt, call: str) -> Iterator[tuple[int, str]]:
    """The insertions that let a statement call a probe first, all on its own lines: a kernel is known by its line."""
    match statement:
        case ast.If(test=first) | ast.While(test=first) | ast.For(iter=first) | ast.Match(subject=first):
            pass
        case ast.With(items=[ast.withitem(context_expr=first), *_]):
            pass
        case _:
            yield positions.span(statement)[0], f"{call}; "
            return
    start, end = positions.span(first)
    yield start, f"{call} or ("
    yield end, ")"


def _cache_name(folder: Path) -> str:
    """What numba calls the folder, below its cache, for the files of a source folder."""
    return f"{folder.name}_{hashlib.sha1(str(folder).encode()).hexdigest()}"
