"""Owns MicroPython's own virtual machine under Node: files in its file system, statements in, printed lines out."""

from __future__ import annotations

import ast
import os
import select
import shutil
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import pytest

ROOT = Path(__file__).parents[2]
MODULE = ROOT / ".cache" / "micropython" / "package" / "micropython.mjs"
"""The WebAssembly build that ``./dev test --stage=devices`` unpacks."""
DRIVER = Path(__file__).with_name("micropython.mjs")
HEAP_BYTES = 192 * 1024
ANSWER_TIMEOUT_S = 60.0


def missing() -> str | None:
    """Return what keeps the machine from running here, in a sentence; ``None`` if nothing does."""
    if shutil.which("node") is None:
        return "there is no node: ./dev test --stage=devices installs it"
    if not MODULE.exists():
        return f"there is no {MODULE.relative_to(ROOT)}: ./dev test --stage=devices fetches it"
    return None


def require() -> None:
    """Skip the calling test where the machine cannot run; in continuous integration (``CI=true``) fail it instead: there nobody
    would see that a third of the conformance suites was left out."""
    reason = missing()
    if reason is None:
        return
    if os.environ.get("CI") == "true":
        pytest.fail(reason)
    pytest.skip(reason)


class FailedInside(AssertionError):
    """A statement raised in the machine; the text is its traceback."""


class MicroPython:
    """One virtual machine with the project's ``files`` in its file system; ends with the context."""

    def __init__(self, files: list[Path]) -> None:
        names = [path.relative_to(ROOT).as_posix() for path in files]
        self._process = subprocess.Popen(
            ["node", DRIVER, MODULE, str(HEAP_BYTES), ROOT, *names],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            bufsize=1,
        )

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, value: BaseException | None, trace: TracebackType | None
    ) -> None:
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._process.stdin.close()
        try:
            self._process.wait(10.0)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait(10.0)
        self._process.stdout.close()

    def run(self, statement: str) -> str:
        """Execute one line of Python there and return what it printed. Raises FailedInside, TimeoutError."""
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._process.stdin.write(statement + "\n")
        self._process.stdin.flush()
        if not select.select([self._process.stdout], [], [], ANSWER_TIMEOUT_S)[0]:
            raise TimeoutError(f"no answer to {statement!r} within {ANSWER_TIMEOUT_S:g} s")
        line = self._process.stdout.readline().rstrip("\n")
        if line.startswith("ERROR "):
            raise FailedInside(line)
        return line


class _Inside:
    """An object in the machine, whose methods take and return literals."""

    def __init__(self, machine: MicroPython, name: str) -> None:
        self._machine, self._name = machine, name

    def __getattr__(self, method: str) -> Any:
        return lambda *given: ast.literal_eval(self._machine.run(f"print({self._name}.{method}{given!r})"))


@contextmanager
def desk_inside(files: list[Path], module: str, kind: str) -> Iterator[Any]:
    """Yield a desk of a firmware, made in a machine that has its ``files``; skips or fails as ``require`` does."""
    require()
    with MicroPython(files) as machine:
        machine.run(f"from {module} import {kind}; desk = {kind}()")
        yield _Inside(machine, "desk")
