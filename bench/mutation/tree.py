"""Private copy of the project in which mutants run: its files, its environment, its compiled kernels."""

from __future__ import annotations

import hashlib
import os
import pickle
import re
import resource
import shutil
import signal
import subprocess
import sys
import venv
from contextlib import suppress
from pathlib import Path

from bench.mutation.mutants import Mutant
from bench.mutation.names import Names

_MARK = "KINGFISHER_MUTATION_TREE"
_LATER_NS = 10_000_000_000
"""Difference of the modification times of a mutant and its file, so that no compiled file counts for both."""


class Tree:
    """A copy of ``root`` at ``path``; making it brings it up to date."""

    def __init__(self, root: Path, path: Path) -> None:
        self.path, self.kernels, self._said = path, path.with_suffix(".kernels"), path.with_suffix(".said")
        self._count = 0
        for old in (path, self.kernels):
            shutil.rmtree(old, ignore_errors=True)
        command = ["git", "ls-files", "-z", "-co", "--exclude-standard"]
        for name in subprocess.check_output(command, cwd=root, text=True, timeout=60).split("\0"):
            if (root / name).is_file():
                (path / name).parent.mkdir(parents=True, exist_ok=True)
                shutil.copy2(root / name, path / name)
        self._make_environment()
        kernel_cache = Path(os.environ["NUMBA_CACHE_DIR"])
        self.kernels.mkdir(0o700)
        for folder in {file.parent for file in path.rglob("*.py")}:  # numba's name for a folder is made from its path
            source = kernel_cache / _cache_name(root / folder.relative_to(path))
            if source.is_dir():
                shutil.copytree(source, self.kernels / _cache_name(folder))

    def _make_environment(self) -> None:
        """Make .venv with the packages of this one and the project's own from the copy."""
        venv.create(self.path / ".venv", symlinks=True)
        site = next((self.path / ".venv").glob("lib/python*/site-packages"))
        packages = next(Path(sys.prefix).glob("lib/python*/site-packages"))
        sources = (self.path, self.path / "systemd", self.path / "appliance/desk/python")
        (site / "packages.pth").write_text("\n".join(map(str, (*sources, packages))))
        for script in (Path(sys.prefix) / "bin").iterdir():
            target = self.path / ".venv/bin" / script.name
            if script.is_file() and not target.exists():
                shutil.copy2(script, target)
                with suppress(UnicodeDecodeError):
                    target.write_text(target.read_text().replace(sys.prefix, str(self.path / ".venv")))

    def _write(self, path: str, text: str, kernels: Path) -> None:
        """Write a file, and make its compiled kernels valid for the new text, because numba compares a file's hash."""
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
        """Return the verdict of tests, in their order, on a mutant; the first failure ends it."""
        path, kernels, stale = mutant.listed.path, self.kernels, names.stale_kernels(mutant)
        if stale:
            kernels = self.path.with_suffix(".mutant-kernels")
            shutil.rmtree(kernels, ignore_errors=True)
            shutil.copytree(self.kernels, kernels)
        for kernel in stale:
            source = self.path / kernel.path
            for entry in (kernels / _cache_name(source.parent)).glob(f"{source.stem}.{kernel.name}-*"):
                entry.unlink()
        text = (self.path / path).read_text(encoding="utf-8")
        self._write(path, mutant.applied(text), kernels)
        try:
            code = self._pytest(tests, kernels, limit_s + 90.0 * bool(stale))
        finally:
            self._write(path, text, self.kernels)
        output = self._said.read_text(encoding="utf-8", errors="replace")
        failed = re.search(r"^(?:FAILED|ERROR) (.*?)(?: - |$)", output, re.M)
        match code:
            case 0:
                passed = re.search(r"(\d+) passed", output)
                return f"survived {passed[1] if passed else 0} tests"
            case 5:
                return "not reached"
            case 1 | 2 | 3 | 4:
                return f"died: {failed[1] if failed else 'no test can be collected'}"
            case _:
                return f"died: the process ended with {code}"

    def _pytest(self, tests: list[str], kernels: Path, limit_s: float) -> int:
        """Run tests in the copy, with at most ``limit_s`` of CPU time a process; return pytest's status, or -9 if it
        hangs."""
        environment = {
            _MARK: self.path,
            "NUMBA_CACHE_DIR": kernels,
            "PATH": f"{self.path}/.venv/bin:{os.environ['PATH']}",
        }
        options = ("-x", "-q", "-n0", "--tb=no", "-rfE", "--hypothesis-seed=0", "-p", "no:cacheprovider")
        running = subprocess.Popen(
            [str(self.path / ".venv/bin/python"), "-m", "pytest", *options, *tests],
            cwd=self.path,
            env={key: str(value) for key, value in {**os.environ, **environment}.items()},
            stdin=subprocess.DEVNULL,
            stdout=self._said.open("w"),
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

    def _end_the_rest(self) -> None:
        """Kill the processes that a run left behind; a variable of their environment identifies them."""
        for process in Path("/proc").glob("[0-9]*/environ"):
            with suppress(OSError):
                if f"{_MARK}={self.path}\0".encode() in process.read_bytes():
                    os.kill(int(process.parent.name), signal.SIGKILL)


def _cache_name(folder: Path) -> str:
    """Return numba's name of the cache folder for the files of a source folder."""
    return f"{folder.name}_{hashlib.sha1(str(folder).encode()).hexdigest()}"
