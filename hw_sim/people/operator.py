"""The common part of all operators of the instrument: a thread, the status file, presses of keys."""

from __future__ import annotations

import threading
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

from hw_sim.people import status_file

if TYPE_CHECKING:
    from hw_sim.world import World

POLL_S = 0.05
PRESS_S = 0.15
"""Duration of a press, and of the pause after it."""
POWER_OFF_HOLD_S = 1.2
POWER_OFF_TRIES = 15
POWER_OFF_TRY_S = 2.0
SWITCH_OFF = "SWITCH OFF"
"""The answer, as docs/protocols/status.md names it."""


class OperatorError(Exception):
    """An expected event did not happen; the text says which."""


class Operator:
    """Operates the instrument in a thread. ``failure`` has the error afterwards."""

    def __init__(self, world: World, status: Path) -> None:
        self.world = world
        self.status_path = status
        self._stopped = False
        self.failure: str | None = None
        self.finished = False
        """True once the script came to its end."""
        self._thread = threading.Thread(target=self._run, name="diver", daemon=True)

    def act(self) -> None:
        """Do the operator's work; return early when ``over``. Raises OperatorError."""
        raise NotImplementedError

    def start(self) -> None:
        """Begin in a thread."""
        self._thread.start()

    def stop(self, grace_s: float) -> None:
        """Wait up to ``grace_s`` of real time for the end, then end it. Raises RuntimeError if it hangs."""
        self._thread.join(grace_s)
        with self.world.time.condition:
            # Set under the world's lock, so that a wait in world time notices it at once.
            self._stopped = True
            self.world.time.condition.notify_all()
        self._thread.join(10.0)
        if self._thread.is_alive():
            raise RuntimeError("the diver's thread does not end")

    def _run(self) -> None:
        try:
            self.act()
            self.finished = self.finished or not self.over
        except Exception as error:
            self.failure = str(error)
            # The failure ends the wait for the diver.
            self.switch_off()

    @property
    def over(self) -> bool:
        """True if the world has ended, or the operator is stopped."""
        return self._stopped or self.world.time.closed

    def status(self) -> status_file.Status:
        """Return the present content of the status file; empty without a file."""
        return status_file.read(self.status_path)

    def press(self, key: str, hold_s: float = PRESS_S) -> None:
        """Press and release."""
        self.world.press(key, hold_s)
        self.sleep(hold_s + PRESS_S)

    def sleep(self, duration_s: float) -> None:
        """Return after ``duration_s`` of world time, or when it is ``over``."""
        with self.world.time.condition:
            self.world.time.wait_for(lambda: self.over, duration_s)

    def until(self, predicate: Callable[[], bool], timeout_s: float) -> bool:
        """Return True if ``predicate`` becomes true within ``timeout_s`` of world time."""
        end_ns = self.world.time_ns + int(timeout_s * 1e9)
        while not predicate():
            if self.over or self.world.time_ns > end_ns:
                return predicate()
            self.sleep(POLL_S)
        return True

    def switch_off(self) -> bool:
        """Repeat the power-off gesture until the service shuts down; return True if it did.

        The gesture is BACK held, and its question answered with DOWN and SCAN.
        """
        for _ in range(POWER_OFF_TRIES):
            self.press("back", POWER_OFF_HOLD_S)
            if self.until(lambda: self._selected() is not None or self._off(), POWER_OFF_TRY_S) and not self._off():
                self.press("down")
                if self.until(lambda: self._selected() == SWITCH_OFF, POWER_OFF_TRY_S):
                    self.press("scan")
            if self.until(self._off, POWER_OFF_TRY_S):
                return True
            if self.over:
                break
        return False

    def _selected(self) -> str | None:
        """Return the selected answer to the question on the screen; ``None``: no question."""
        question = self.status().get("question")
        return str(question.get("selected")) if isinstance(question, dict) else None

    def _off(self) -> bool:
        """Return True if the instrument is off: the service says so, or has removed its status."""
        return self.status().get("state") in (None, "SHUTDOWN")
