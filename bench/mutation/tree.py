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

from bench.mutation.mutants import Mutant, Source
from bench.mutation.names import Names
from bench.mutation.probe import NOTES, WANTED

_MARK = "KINGFISHER_MUTATION_TREE"
_CALL = '__import__("bench.mutation.probe", None, None, "_").at("{}")'
_LATER_NS = 10_000_000_000
"""By so much a mutant is younger than the file it stands for: nothing compiled from one passes for the other."""


class Tree:
    """A copy of ``root`` at ``path``; making it brings it up to date."""

    def __init__(self, root: Path, path: Path) -> None:
        self.path, self.kernels, self._notes = path, path.with_suffix(".kernels"), path.with_suffix(".notes")
        self._count = 0
        for old in (path, self.kernels):
            shutil.rmtree(old, ignore_errors=True)
        command = ["git", "ls-files", "-z", "-co", "--exclude-standard"]
        for name in subprocess.check_output(command, cwd=root, text=True, timeout=60).split("\0"):
            if (root / name).is_file():
                (path / name).parent.mkdir(parents=True, exist_ok=True)
                shutil.copy2(root / name, path / name)
        self._make_environment()
        given = Path(os.environ["NUMBA_CACHE_DIR"])
        self.kernels.mkdir(0o700)
        for folder in {file.parent for file in path.rglob("*.py")}:  # numba's name for a folder is made from its path
            source = given / _cache_name(root / folder.relative_to(path))
            if source.is_dir():
                shutil.copytree(source, self.kernels / _cache_name(folder))

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
        sources = {path: Source(path, (self.path / path).read_text(encoding="utf-8")) for path in names.trees}
        for key, mutant in mutants.items():
            places = [(mutant.listed.path, mutant.statement)]
            if not mutant.in_function or names.in_kernel(mutant):
                places = list(names.at_work(mutant))
            for path, statement in places:
                inserted.setdefault(path, []).extend(_probe(sources[path], statement, _CALL.format(key)))
        for path, some in inserted.items():
            text = sources[path].text
            for at, new in sorted(some, key=lambda one: one[0], reverse=True):
                text = text[:at] + new + text[at:]
            self._write(path, text, self.kernels)

    def _write(self, path: str, text: str, kernels: Path) -> None:
        """Write a file and let the kernels of it that are there pass for those of the new text: numba goes by a file's hash."""
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
                pickle.dump((hashlib.sha256(text.encode()).digest(), overloads), opened, protocol=-1)

    def judge(self, mutant: Mutant, names: Names, tests: list[str], limit_s: float) -> str:
        """Return the verdict of some tests, in their order, on a mutant; the first that fails ends it."""
        path, kernels, stale = mutant.listed.path, self.kernels, names.stale_kernels(mutant)
        if stale:
            kernels = self.path.with_suffix(".mutant-kernels")
            shutil.rmtree(kernels, ignore_errors=True)
            shutil.copytree(self.kernels, kernels)
        for one in stale:
            source = self.path / one.path
            for entry in (kernels / _cache_name(source.parent)).glob(f"{source.stem}.{one.name}-*"):
                entry.unlink()
        self.path.with_suffix(".wanted").write_text("\n".join(tests))
        files = dict.fromkeys(test.partition("::")[0] for test in tests)
        options = ["-x", "-q", "-n0", "--tb=short", "--hypothesis-seed=0", "-p", "no:cacheprovider", *files]
        text = (self.path / path).read_text(encoding="utf-8")
        self._write(path, mutant.applied(text), kernels)
        try:
            code = self.pytest(
                options, kernels, limit_s + 90.0 * bool(stale), {WANTED: self.path.with_suffix(".wanted")}
            )
        finally:
            self._write(path, text, self.kernels)
        failed, ran = ([words[1] for words in self.notes() if words[0] == kind] for kind in ("failed", "ran"))
        match code:
            case 0:
                return f"survived {len(ran)} tests"
            case 5:
                return "not reached"
            case 1 | 2 | 3 | 4:
                return f"died: {failed[0] if failed else 'no test can be collected'}"
            case _:
                return f"died: the process ended with {code} in or after {tests[min(len(ran), len(tests) - 1)]}"

    def pytest(self, arguments: list[str], kernels: Path, limit_s: float, variables: Mapping[str, Path]) -> int:
        """Run pytest in the copy, ``limit_s`` of processor time at most for a process; return its status, or -9 when it hangs."""
        self._notes.write_text("")
        own: dict[str, object] = {NOTES: self._notes, _MARK: self.path, "NUMBA_CACHE_DIR": kernels, **variables}
        own |= {"PATH": f"{self.path}/.venv/bin:{os.environ['PATH']}"}
        running = subprocess.Popen(
            [str(self.path / ".venv/bin/python"), "-m", "pytest", "-p", "bench.mutation.probe", *arguments],
            cwd=self.path,
            env={key: str(value) for key, value in {**os.environ, **own}.items()},
            stdin=subprocess.DEVNULL,
            stdout=self.path.with_suffix(".said").open("w"),
            stderr=subprocess.STDOUT,
            preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_CPU, (int(limit_s) + 1, int(limit_s) + 5)),
        )
        try:
            return running.wait(4.0 * limit_s)
        except subprocess.TimeoutExpired:
            return -signal.SIGKILL
        finally:
            self._end_the_rest()
            running.wait()

    def notes(self) -> list[list[str]]:
        """Return what the last run noted."""
        return [line.split("\t") for line in self._notes.read_text(encoding="utf-8").splitlines()]

    def _end_the_rest(self) -> None:
        """Kill what a run left behind, known by a variable of its environment."""
        for process in Path("/proc").glob("[0-9]*/environ"):
            with suppress(OSError):
                if f"{_MARK}={self.path}\0".encode() in process.read_bytes():
                    os.kill(int(process.parent.name), signal.SIGKILL)


def _probe(source: Source, statement: ast.stmt, call: str) -> Iterator[tuple[int, str]]:
    """The insertions that let a statement call a probe first, all on its own lines: a kernel is known by its line."""
    match statement:
        case ast.If(test=first) | ast.While(test=first) | ast.For(iter=first) | ast.Match(subject=first):
            pass
        case ast.With(items=[ast.withitem(context_expr=first), *_]):
            pass
        case ast.FunctionDef(body=body) | ast.AsyncFunctionDef(body=body) | ast.Try(body=body):
            beside = (one for one in body if not isinstance(one, ast.FunctionDef | ast.ClassDef))
            yield from _probe(source, next(beside, body[0]), call)
            return
        case ast.Expr(value=ast.Constant()):  # a docstring stays the first
            yield source.span(statement)[1], f"; {call}"
            return
        case _:
            yield source.span(statement)[0], f"{call}; "
            return
    start, end = source.span(first)
    yield start, f"{call} or ("
    yield end, ")"


def _cache_name(folder: Path) -> str:
    """What numba calls the folder, below its cache, for the files of a source folder."""
    return f"{folder.name}_{hashlib.sha1(str(folder).encode()).hexdigest()}"
