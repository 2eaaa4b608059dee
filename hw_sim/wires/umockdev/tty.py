"""The serial line of the simulated board: a pseudo terminal whose far end is the board's firmware."""

from __future__ import annotations

import contextlib
import os
import pty
import select
import threading
import tty
from pathlib import Path

from hw_sim.devices.board import Board
from hw_sim.timing.world_time import WorldTime

CHUNK = 4096
LOOK_S = 0.02
"""Largest delay at which a host's opening or closing of the port is noticed."""


class BoardLine:
    """``/dev/ttyACM0`` as a link to a pseudo terminal; the board is notified when a host opens it."""

    def __init__(self, node: Path, board: Board, time: WorldTime) -> None:
        """``node`` must not exist yet."""
        self._node, self._board, self._time = node, board, time
        self._master, slave = pty.openpty()
        tty.setraw(slave)
        self.terminal = os.ttyname(slave)
        # Linux hangs the master up (POLLHUP) while no process has the slave open, so that the host is noticed.
        os.close(slave)
        os.set_blocking(self._master, False)
        self._ending = threading.Event()
        node.parent.mkdir(parents=True, exist_ok=True)
        node.symlink_to(self.terminal)
        self._threads = [
            threading.Thread(target=work, name=f"tty {name}", daemon=True)
            for name, work in (("in", self._hear), ("out", self._speak))
        ]
        for thread in self._threads:
            thread.start()

    def close(self) -> None:
        """Cut the line: the host's reads end."""
        self._ending.set()
        with self._time.condition:
            self._time.condition.notify_all()
        for thread in self._threads:
            thread.join(5.0)
        self._set_open(False)
        self._node.unlink(missing_ok=True)
        os.close(self._master)

    def _hear(self) -> None:
        poll = select.poll()
        poll.register(self._master, select.POLLIN)
        while not self._ending.is_set():
            events = dict(poll.poll(LOOK_S * 1000)).get(self._master, 0)
            self._set_open(not events & select.POLLHUP)
            if events & select.POLLIN:
                with contextlib.suppress(OSError):  # the host has just closed it: found at the next look
                    data = os.read(self._master, CHUNK)
                    with self._time.condition:
                        self._board.receive(data)
                        self._time.condition.notify_all()
            elif events & select.POLLHUP:
                self._ending.wait(LOOK_S)

    def _set_open(self, is_open: bool) -> None:
        with self._time.condition:
            if is_open != self._board.open:
                self._board.open = is_open
                self._board.take(self._board.waiting)
                self._time.condition.notify_all()

    def _speak(self) -> None:
        while not self._ending.is_set():
            with self._time.condition:
                if not self._board.waiting:
                    self._time.condition.wait(LOOK_S)
                data = self._board.take(CHUNK)
            while data and not self._ending.is_set():
                try:
                    data = data[os.write(self._master, data) :]
                except BlockingIOError:
                    self._ending.wait(LOOK_S)
