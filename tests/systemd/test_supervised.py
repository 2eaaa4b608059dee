"""The whole service under a pretended service manager: it says ready, gives signs of life, and falls silent when it hangs."""

from __future__ import annotations

import json
import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import pytest

from tests.support.commands import ROOT, kingfisher

SMALL_RIG = ROOT / "hw_sim" / "rigs" / "small.toml"
WATCHDOG_S = 2.0
START_S = 120.0
"""On a busy machine."""


@dataclass(frozen=True, slots=True)
class Supervised:
    """A running service and the socket at which its manager listens."""

    process: subprocess.Popen[str]
    socket: socket.socket
    root: Path

    def next(self, timeout_s: float) -> str | None:
        """The next datagram; ``None`` if there is none in this time."""
        self.socket.settimeout(timeout_s)
        try:
            return self.socket.recv(4096).decode()
        except TimeoutError:
            return None

    def wait_for(self, text: str, timeout_s: float = START_S) -> None:
        end_s = time.monotonic() + timeout_s
        while (said := self.next(max(0.01, end_s - time.monotonic()))) != text:
            assert said is not None, f"no {text}: {self.process.poll()}"


@contextmanager
def supervised(folder: Path) -> Iterator[Supervised]:
    """``kingfisher sim`` with a manager's environment."""
    address = folder / "notify"
    words = ("sim", "--rig", SMALL_RIG, "--root", folder / "root", "seed=3")
    environment = {"NOTIFY_SOCKET": str(address), "WATCHDOG_USEC": str(int(WATCHDOG_S * 1e6))}
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as listening, (folder / "stderr").open("w") as stderr:
        listening.bind(str(address))
        process = subprocess.Popen(
            [sys.executable, "-m", "appliance.cli", *map(str, words)],
            cwd=ROOT, stdout=subprocess.DEVNULL, stderr=stderr, text=True, env=os.environ | of_manager(folder) | environment,
        )  # fmt: skip
        try:
            yield Supervised(process, listening, folder / "root")
        finally:
            process.kill()
            process.wait(30)


def of_manager(folder: Path) -> dict[str, str]:
    """What a service finds in its environment."""
    return {"RUNTIME_DIRECTORY": str(folder), "INVOCATION_ID": "4711"}


def test_a_main_loop_that_hangs_falls_silent_and_says_where_when_it_is_ended(tmp_path: Path) -> None:
    with supervised(tmp_path) as service:
        service.wait_for("READY=1")
        service.wait_for("STATUS=SELF_TEST")
        for _ in range(3):
            service.wait_for("WATCHDOG=1", WATCHDOG_S)
        # Nobody reads this pipe: who opens it to write waits for ever. The status is written from the main loop.
        os.mkfifo(service.root / "run" / ".status.json.draft")
        deadline_s = time.monotonic() + START_S
        while service.next(WATCHDOG_S) is not None:
            assert time.monotonic() < deadline_s, "it never fell silent"
        assert service.process.poll() is None, "it hangs: all its other threads are well"
        service.process.send_signal(signal.SIGABRT)  # as the manager does
        assert service.process.wait(30) == -signal.SIGABRT
    main_thread = (tmp_path / "stderr").read_text().partition("Current thread")[2]
    assert ("instrument/service/status.py" in main_thread, "in run_cycle" in main_thread) == (True, True)


@pytest.mark.dive
def test_it_runs_through_its_self_test_and_ends_when_asked(tmp_path: Path) -> None:
    with supervised(tmp_path) as service:
        service.wait_for("STATUS=AIM")
        service.process.terminate()
        service.wait_for("STOPPING=1", 30)
        assert service.process.wait(60) == 0
        assert json.loads((service.root / "run" / "self-test.json").read_text())["installation"] == "source"
    assert not (tmp_path / "last-words.json").exists()  # nothing went wrong
    assert not (tmp_path / "power-off").exists()  # stopped, not switched off


@pytest.mark.parametrize(
    ("right", "wrong", "kind", "words"),
    [
        ("exposure_ms = ", "exposure_ms = 99", "config", "exposure_ms"),
        ("hw_sim.wires:open", "drivers.native:open", "device", "width_px"),
    ],
)
def test_what_keeps_it_from_starting_is_left_for_the_safe_screen(
    tmp_path: Path, right: str, wrong: str, kind: str, words: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    rig = tmp_path / "rig.toml"
    rig.write_text(SMALL_RIG.read_text().replace(right, wrong))
    for name, value in of_manager(tmp_path).items():
        monkeypatch.setenv(name, value)
    assert kingfisher("run", "--rig", rig).code in (1, 2)
    left = json.loads((tmp_path / "last-words.json").read_text())
    assert (left["invocation"], left["kind"], words in left["text"]) == ("4711", kind, True)
