"""One process of a first run: compile pieces as ``./dev`` does, and report the cost of each kernel.

    python -m bench.compiling.pieces        with an empty folder in NUMBA_CACHE_DIR

Reads ``package.module:function`` line by line and answers in JSON: the CPU time of the piece with its imports, and of
each kernel and each stage without that of the functions it calls, which numba compiles within it.
"""

from __future__ import annotations

import importlib
import json
import sys
import time
from dataclasses import dataclass, field
from typing import Any

from numba.core import event


@dataclass
class Kernels(event.Listener):
    """Listener to the begin and end of compiling a function."""

    own_s: list[tuple[str, float]] = field(default_factory=list)
    """Module and name of each compiled function, and its own CPU time."""
    _open: list[tuple[float, float]] = field(default_factory=list)
    """Start of each function that is being compiled, and the time of those within it, s."""

    def on_start(self, event: Any) -> None:
        """Record the start of a function, which may be inside another one."""
        self._open.append((time.thread_time(), 0.0))

    def on_end(self, event: Any) -> None:
        """Add the time of a function."""
        begun_s, inner_s = self._open.pop()
        taken_s = time.thread_time() - begun_s
        if self._open:
            self._open[-1] = (self._open[-1][0], self._open[-1][1] + taken_s)
        function = event.data["dispatcher"].py_func
        self.own_s.append((f"{function.__module__}.{function.__qualname__}", taken_s - inner_s))


@dataclass
class Stages(event.Listener):
    """Hears when numba begins and ends a stage of its work on a function."""

    own_s: dict[str, float] = field(default_factory=dict)
    """Processor time of each stage, without that of other functions which are compiled within it."""
    _open: list[tuple[float, float]] = field(default_factory=list)

    def on_start(self, event: Any) -> None:
        """Record the start of a stage."""
        self._open.append((time.thread_time(), 0.0))

    def on_end(self, event: Any) -> None:
        """Add the time of a stage."""
        begun_s, inner_s = self._open.pop()
        taken_s = time.thread_time() - begun_s
        if self._open:
            self._open[-1] = (self._open[-1][0], self._open[-1][1] + taken_s)
        # numba adds the function's name in brackets.
        name = str(event.data["name"]).partition(" ")[0]
        self.own_s[name] = self.own_s.get(name, 0.0) + taken_s - inner_s


def main() -> None:
    """Call the function of each line of stdin, and print its compile times."""
    for line in sys.stdin:
        begun_s = time.process_time()
        module, _, function = line.strip().partition(":")
        kernels, stages = Kernels(), Stages()
        with event.install_listener("numba:compile", kernels), event.install_listener("numba:run_pass", stages):
            getattr(importlib.import_module(module), function)()
        answer = {"cpu_s": time.process_time() - begun_s, "kernels": kernels.own_s, "stages": stages.own_s}
        sys.stdout.write(json.dumps(answer) + "\n")
        sys.stdout.flush()


if __name__ == "__main__":
    main()
