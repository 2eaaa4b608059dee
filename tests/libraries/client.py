"""A program on the far side of the device nodes, and the conversation with it."""

from __future__ import annotations

import json
import os
import queue
import signal
import subprocess
import sys
import threading
from collections.abc import Sequence
from types import TracebackType
from typing import Any, Self

from hw_sim.wires.umockdev.testbed import Testbed

END_TIMEOUT_S = 20.0


class Client:
    """A context manager: ``python -m tests.libraries.clients.<name> arguments``, under umockdev's preload library where there is a test bed.

    ``within`` are words before them: a program that runs it in some surroundings, and becomes it.
    """

    def __init__(self, bed: Testbed | None, name: str, *arguments: object, within: Sequence[str] = ()) -> None:
        self._killed = False
        self._process = subprocess.Popen(
            [*within, sys.executable, "-m", f"tests.libraries.clients.{name}", *map(str, arguments)],
            env={**os.environ, **({} if bed is None else bed.environment)},
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
        if error is None and not self._killed:
            assert code == 0, f"ended with {code}"

    @property
    def pid(self) -> int:
        return self._process.pid

    def kill(self) -> None:
        """Let it end on the spot, as if its power were cut."""
        self._killed = True
        self._process.kill()
        self._process.wait(END_TIMEOUT_S)

    def freeze(self) -> None:
        """Let it stand still: everything stays open and nothing answers."""
        self._process.send_signal(signal.SIGSTOP)

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
        assert self._process.stdin is not None
        self._process.stdin.write("\n")
        self._process.stdin.flush()
