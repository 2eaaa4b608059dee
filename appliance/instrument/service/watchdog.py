"""Owns what the running service tells its manager: ready, alive, what it does, and how its self-test ended.

A sign of life is earned: it is sent from the heartbeat only, after a beat that came to its end, and only while the
worker process answers or is known not to be there. A loop that hangs, or that has lost sight of its worker, falls
silent.
"""

from __future__ import annotations

import json
import logging
import time
from collections.abc import Callable
from pathlib import Path

from appliance.instrument.machine.start import finished
from appliance.instrument.machine.states import Machine, State
from appliance.instrument.service.notify import ServiceManager
from appliance.store import FileSystem, LocalFileSystem, StorageError

log = logging.getLogger("kingfisher")

SIGNS_PER_LIMIT = 4
"""Number of signs of life that fit into the manager's patience: three may be late."""
SELF_TEST_FILE = Path("run", "self-test.json")
"""File below the storage root; it is read by ``systemd/kingfisher_setup``."""


class Watchdog:
    """Called after each heartbeat with what it has led to."""

    def __init__(
        self,
        manager: ServiceManager,
        root: Path,
        installation: str,
        fs: FileSystem | None = None,
        now_s: Callable[[], float] = time.monotonic,
    ) -> None:
        """``installation``: the name of the installed version, as the one who put it on trial knows it.
        ``now_s``: the manager's time, whatever clock the devices go by."""
        self._manager = manager
        self._file = root / SELF_TEST_FILE
        self._installation = installation
        self._fs = fs or LocalFileSystem()
        self._now_s = now_s
        self._state: State | None = None
        self._turned_ns: int | None = None
        self._told_s: float | None = None
        self._failed: list[str] | None = None

    def beaten(self, machine: Machine, *, worker_answers: bool) -> None:
        """Tell the manager what a heartbeat that has ended shows."""
        # READY after the first heartbeat, not after the start: until then nothing has shown that the loop goes round.
        if self._state is None:
            self._manager.ready()
        if machine.state is not self._state:
            self._state = machine.state
            self._manager.status(machine.state.value)
        # A loop that goes round in a stopped clock judges no deadline any more: that is a hang, too.
        turned = machine.now_ns != self._turned_ns
        self._turned_ns = machine.now_ns
        if turned and worker_answers:
            self._sign()
        if machine.state is not State.BOOT and finished(machine):
            self._test(machine)

    def stopping(self) -> None:
        """Tell the manager that the end was decided; what is being written is still finished."""
        self._manager.stopping()

    def _sign(self) -> None:
        limit_s, now_s = self._manager.watchdog_s, self._now_s()
        if limit_s is None or (self._told_s is not None and now_s - self._told_s < limit_s / SIGNS_PER_LIMIT):
            return
        self._told_s = now_s
        self._manager.alive()

    def _test(self, machine: Machine) -> None:
        """Write what failed, named as on the screen, whenever it changes.

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
