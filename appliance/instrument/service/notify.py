"""Owns the talk with the service manager: the datagrams of sd_notify(3), and how often it wants a sign of life."""

from __future__ import annotations

import os
import socket
from collections.abc import MutableMapping
from types import TracebackType
from typing import Self

SOCKET = "NOTIFY_SOCKET"
WATCHDOG_US = "WATCHDOG_USEC"
WATCHDOG_PID = "WATCHDOG_PID"


class ServiceManager:
    """Who started the service and watches over it. A context manager.

    Without one (at a desk, in a test) nothing is sent. A manager that does not listen is no reason to stop: what cannot
    be sent at once is lost, and it draws its own conclusions.
    """

    def __init__(self, address: str | None, watchdog_s: float | None) -> None:
        """``address``: a path or, after ``@``, a name in the abstract namespace. ``watchdog_s``: after how long without
        a sign of life it kills this process; ``None``: never."""
        self.watchdog_s = watchdog_s
        # sd_notify(3): "@" stands for the zero byte with which names of the abstract namespace begin.
        self._address = address.replace("@", "\0", 1) if address and address.startswith("@") else address
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_CLOEXEC) if address else None
        if self._socket is not None:
            # The heartbeat sends: a manager with a full queue must not hold it up.
            self._socket.setblocking(False)

    @classmethod
    def of(cls, environment: MutableMapping[str, str]) -> Self:
        """Read what the manager told this process; it is taken out of ``environment``, for no child is to speak in its
        name."""
        address = environment.pop(SOCKET, None)
        usec, pid = environment.pop(WATCHDOG_US, ""), environment.pop(WATCHDOG_PID, "")
        # The variables are inherited: a pid that is not ours says that they were meant for a parent.
        meant = usec.isdecimal() and int(usec) > 0 and pid in ("", str(os.getpid()))
        return cls(address, int(usec) / 1e6 if meant else None)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._socket is not None:
            self._socket.close()

    def ready(self) -> None:
        """Say that the start is over."""
        self._tell("READY=1")

    def alive(self) -> None:
        """Send the sign of life."""
        self._tell("WATCHDOG=1")

    def status(self, text: str) -> None:
        """Send one line for ``systemctl status``."""
        self._tell(f"STATUS={' '.join(text.split())}")

    def stopping(self) -> None:
        """Say that the end has begun."""
        self._tell("STOPPING=1")

    def _tell(self, message: str) -> None:
        if self._socket is None or self._address is None:
            return
        try:
            self._socket.sendto(message.encode(), self._address)
        except OSError:
            return
