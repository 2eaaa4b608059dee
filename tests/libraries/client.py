"""A program on the far side of the device nodes, and the conversation with it."""

from __future__ import annotations

import json
import os
import queue
import subprocess
import sys
import threading
from types import TracebackType
from typing import Any, Self

from hw_sim.wires.umockdev.testbed import Testbed

END_TIMEOUT_S = 20.0


class Client:
    """A context manager: ``python -m tests.libraries.clients.<name> arguments`` under umockdev's preload library."""

    def __init__(self, bed: Testbed, name: str, *arguments: object) -> None:
        self._process = subprocess.Popen(
            [sys.executable, "-m", f"tests.libraries.clients.{name}", *map(str, arguments)],
            env={**os.environ, **bed.environment},
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )
        self._said: queue.Queue[dict[str, Any] | None] = queue.Queue()
        self._heard: list[dict[str, Any]] = []
        self._thread = threading.Thread(target=self._listen, daemon=True)
        self._thread.start()

    def _listen(self) -> None:
        assert self._process.stdout is not None
        for line in self._process.stdout:
            self._said.put(json.loads(line))
        self._said.put(None)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if error is not None:
            self._process.kill()
        assert self._process.stdin is not None
        self._process.stdin.close()
        code = self._process.wait(END_TIMEOUT_S)
        self._thread.join(END_TIMEOUT_S)
        if error is None:
            assert code == 0, f"ended with {code}"

    def expect(self, key: str, value: object = None, timeout_s: float = 30.0) -> dict[str, Any]:
        """The next line with that key (and value); what comes before it is skipped."""
        while True:
            try:
                said = self._said.get(timeout=timeout_s)
            except queue.Empty:
                said = None
            if said is None:
                raise AssertionError(f"{key}={value} was not said; the last words were {self._heard[-5:]}")
            self._heard.append(said)
            if key in said and value in (None, said[key]):
                return said

    def go_on(self) -> None:
        """Let it go on from where it waits."""
        assert self._process.stdin is not None
        self._process.stdin.write("\n")
        self._process.stdin.flush()
