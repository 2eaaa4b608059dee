"""A pseudo terminal with something at its far end that answers in real time."""

from __future__ import annotations

import os
import select
import threading
import tty
from collections.abc import Callable


class Terminal:
    """Calls ``exchange`` with what it heard, every few ms also with nothing, and says what that returns."""

    def __init__(self, exchange: Callable[[bytes], bytes]) -> None:
        self._exchange = exchange
        self._master, self.slave = os.openpty()
        tty.setraw(self.slave)
        self.url = os.ttyname(self.slave)
        self._failure: BaseException | None = None
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._serve, daemon=True)
        self._thread.start()

    def say(self, data: bytes) -> None:
        os.write(self._master, data)

    def unplug(self) -> None:
        """Take the terminal away, once; raises what the far end has failed by."""
        if self._stop.is_set():
            return
        self._stop.set()
        self._thread.join(5.0)
        os.close(self.slave)
        os.close(self._master)
        if self._failure is not None:
            raise self._failure

    def _serve(self) -> None:
        try:
            while not self._stop.is_set():
                ready, _, _ = select.select([self._master], [], [], 0.002)
                if said := self._exchange(os.read(self._master, 4096) if ready else b""):
                    os.write(self._master, said)
        except BaseException as error:
            self._failure = error
