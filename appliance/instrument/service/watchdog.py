"""Messages to the service manager, systemd.

    ServiceManager    the datagrams of sd_notify(3), and the interval of the signs of life
    Watchdog          reports after each cycle: ready, alive, the state, and the result of the self-test

A sign of life is sent only after a complete cycle, and only while the worker process answers or is known to be down. A
loop that hangs, or that has lost its worker, sends none.
"""

from __future__ import annotations

import json
import logging
import os
import socket
import time
from collections.abc import Callable, MutableMapping
from pathlib import Path
from types import TracebackType
from typing import Self

from appliance.instrument.machine.start import finished
from appliance.instrument.machine.states import Machine, State
from appliance.store import FileSystem, LocalFileSystem, StorageError

SOCKET = "NOTIFY_SOCKET"
WATCHDOG_US = "WATCHDOG_USEC"
WATCHDOG_PID = "WATCHDOG_PID"


class ServiceManager:
    """The process that started the service and watches it. A context manager.

    Without one (at a desk, in a test) nothing is sent. A manager that does not listen is no reason to stop: a message
    that cannot be sent at once is lost.
    """

    def __init__(self, address: str | None, watchdog_s: float | None) -> None:
        """Open the socket to the manager.

        ``address``: a path or, after ``@``, a name in the abstract namespace. ``watchdog_s``: time without a sign of
        life after which it kills this process; ``None``: never.
        """
        self.watchdog_s = watchdog_s
        # sd_notify(3): "@" stands for the zero byte at the beginning of abstract names.
        self._address = address.replace("@", "\0", 1) if address and address.startswith("@") else address
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_CLOEXEC) if address else None
        if self._socket is not None:
            # A manager with a full queue must not delay the cycle.
            self._socket.setblocking(False)

    @classmethod
    def of(cls, environment: MutableMapping[str, str]) -> Self:
        """Return the manager named in ``environment``, whose variables are removed.

        No child process may send messages in the service's name.
        """
        address = environment.pop(SOCKET, None)
        usec, pid = environment.pop(WATCHDOG_US, ""), environment.pop(WATCHDOG_PID, "")
        # The variables are inherited: with another pid they are for a parent process.
        is_for_us = usec.isdecimal() and int(usec) > 0 and pid in ("", str(os.getpid()))
        return cls(address, int(usec) / 1e6 if is_for_us else None)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._socket is not None:
            self._socket.close()

    def ready(self) -> None:
        """Report that the start is over."""
        self._send("READY=1")

    def alive(self) -> None:
        """Send the sign of life."""
        self._send("WATCHDOG=1")

    def status(self, text: str) -> None:
        """Send one line for ``systemctl status``."""
        self._send(f"STATUS={' '.join(text.split())}")

    def stopping(self) -> None:
        """Report that the end has begun."""
        self._send("STOPPING=1")

    def _send(self, message: str) -> None:
        if self._socket is None or self._address is None:
            return
        try:
            self._socket.sendto(message.encode(), self._address)
        except OSError:
            return


log = logging.getLogger("kingfisher")

SIGNS_PER_LIMIT = 4
"""Number of signs of life within the manager's time limit: three may be late."""
SELF_TEST_FILE = Path("run", "self-test.json")
"""File below the storage root; it is read by ``systemd/kingfisher_setup``."""


class Watchdog:
    """Reports the result of each cycle to the service manager."""

    def __init__(
        self,
        manager: ServiceManager,
        root: Path,
        installation: str,
        fs: FileSystem | None = None,
        now_s: Callable[[], float] = time.monotonic,
    ) -> None:
        """Prepare the reports.

        ``installation``: name of the installed version, for the program that put it on trial. ``now_s``: the manager's
        clock, independent of the devices' clock.
        """
        self._manager = manager
        self._file = root / SELF_TEST_FILE
        self._installation = installation
        self._fs = fs or LocalFileSystem()
        self._now_s = now_s
        self._state: State | None = None
        self._turned_ns: int | None = None
        self._last_sign_s: float | None = None
        self._failed: list[str] | None = None

    def report_cycle(self, machine: Machine, *, worker_answers: bool) -> None:
        """Report the result of a complete cycle to the manager."""
        # READY after the first cycle, which shows that the loop works.
        if self._state is None:
            self._manager.ready()
        if machine.state is not self._state:
            self._state = machine.state
            self._manager.status(machine.state.value)
        # With a stopped clock no deadline passes any more: that is a hang, too.
        turned = machine.now_ns != self._turned_ns
        self._turned_ns = machine.now_ns
        if turned and worker_answers:
            self._sign()
        if machine.state is not State.BOOT and finished(machine):
            self._test(machine)

    def stopping(self) -> None:
        """Report that the end has begun; pending writes are still finished."""
        self._manager.stopping()

    def _sign(self) -> None:
        limit_s, now_s = self._manager.watchdog_s, self._now_s()
        if limit_s is None or (self._last_sign_s is not None and now_s - self._last_sign_s < limit_s / SIGNS_PER_LIMIT):
            return
        self._last_sign_s = now_s
        self._manager.alive()

    def _test(self, machine: Machine) -> None:
        """Write the names of the failed parts, as on the screen, whenever they change.

        A disk that refuses has failed the test by that.
        """
        parts = [part.value for part, test in machine.parts.items() if not test.passed]
        failed = sorted([device.value for device in machine.lost] + parts)
        if failed == self._failed:
            return
        log.info("self-test: %s", "passed" if not failed else f"failed: {', '.join(failed)}")
        self._failed = failed
        try:
            self._file.parent.mkdir(parents=True, exist_ok=True)
            content = json.dumps({"installation": self._installation, "failed": failed}) + "\n"
            self._fs.replace_file(self._file, content.encode())
        except (OSError, StorageError) as error:
            log.warning("the self-test's result was not written: %s", error)
