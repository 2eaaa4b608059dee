"""The thread that advances the world, and the time of the next vertical blank."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from typing import Protocol

from hw_sim.timing.world_time import LONGEST_WAIT_S, WorldTime

HOST_TIMEOUT_S = 5.0
"""Longest real time that a recording world waits for its host."""
CATCH_UP_NS = 1_000_000_000
"""Largest delay that a real-time world catches up."""


class Recording(Protocol):
    """The state that decides whether the next blank waits for the host. Called with the lock held."""

    @property
    def armed(self) -> int | None:
        """Number of the sequence that is recorded; ``None``: there is none."""

    @property
    def host_ready(self) -> bool:
        """True if a flip of the projector is pending and both cameras have room."""

    @property
    def developing(self) -> bool:
        """True if images of a sequence are still being made, even if all its pulses have been fired."""


class WorldThread:
    """Calls ``on_blank(time_ns)`` at each vertical blank and runs the events between them, in one thread."""

    def __init__(
        self,
        world_time: WorldTime,
        recording: Recording,
        on_blank: Callable[[int], None],
        pace: str,
        idle_speed: float,
    ) -> None:
        """``pace``: one of ``hw_sim.options.PACES``; ``idle_speed`` counts in lock-step only."""
        self._time = world_time
        self._recording = recording
        self._on_blank = on_blank
        self._pace = pace
        self._idle_speed = idle_speed if pace == "lockstep" else 1.0
        self._given_up: int | None = None
        """The armed sequence whose host was waited for in vain."""
        self._waiting_since_ns: int | None = None
        """Real time since when nothing but the host keeps the next blank from coming."""
        self.failure: BaseException | None = None
        """The error that ended the world before its time."""
        self._thread = threading.Thread(target=self._run, name="world", daemon=True)

    def start(self) -> None:
        self._thread.start()

    def set_pace(self, pace: str) -> None:
        """Go on at another pace, one of ``hw_sim.options.PACES``. The caller holds the lock."""
        self._pace = pace
        self._waiting_since_ns = None

    def wait_until_ended(self) -> None:
        """Wait, after the time is closed, until the thread has ended. Raises RuntimeError if it does not."""
        if self._thread.ident is None:
            return
        self._thread.join(10.0)
        if self._thread.is_alive():
            raise RuntimeError("the world's thread does not end")

    def _run(self) -> None:
        with self._time.condition:
            try:
                while not self._time.closed:
                    if self._waits_for_nobody:
                        self._real_time_once()
                    else:
                        self._lock_step_once()
            except Exception as failure:
                self.failure = failure
                self._time.close()

    @property
    def _waits_for_nobody(self) -> bool:
        if self._pace == "attended":
            return not self._records and not self._recording.developing
        return self._pace == "realtime"

    @property
    def _records(self) -> bool:
        sequence = self._recording.armed
        return sequence is not None and sequence != self._given_up

    # -- lock-step: the host's readiness decides while a sequence is recorded, real time otherwise

    def _lock_step_once(self) -> None:
        sequence = self._recording.armed
        recording = self._records
        # If the host is ready early, the blank comes at once, regardless of real time.
        hurry = recording and self._recording.host_ready
        blank_ns = self._time.blank_ns + self._time.period_ns
        happening = self._time.due(blank_ns)
        real_s = self._time.real_until_s(happening.time_ns if happening else blank_ns)
        if recording and not hurry and real_s <= 0 and happening is None:
            self._wait_for_host(sequence)
            return
        self._waiting_since_ns = None
        if not hurry and real_s > 0:
            self._time.condition.wait(min(real_s, LONGEST_WAIT_S))
        elif happening is None:
            self._blank(time.monotonic_ns())
        elif happening.ready is None or happening.ready():
            self._time.happen()
        else:
            self._time.condition.wait(LONGEST_WAIT_S)

    def _wait_for_host(self, sequence: int | None) -> None:
        now_ns = time.monotonic_ns()
        if self._waiting_since_ns is None:
            self._waiting_since_ns = now_ns
        left_s = HOST_TIMEOUT_S - (now_ns - self._waiting_since_ns) / 1e9
        if left_s > 0:
            self._time.condition.wait(min(left_s, LONGEST_WAIT_S))
        else:
            # The host died or lost count: this sequence continues in real time, so that no wait is for ever.
            self._given_up = sequence

    # -- real time: blanks come whatever the host does

    def _real_time_once(self) -> None:
        blank_ns = self._time.blank_ns + self._time.period_ns
        happening = self._time.due(blank_ns)
        real_s = self._time.real_until_s(happening.time_ns if happening else blank_ns)
        if real_s > 0:
            self._time.condition.wait(min(real_s, LONGEST_WAIT_S))
        elif happening is not None:
            self._time.happen()
        else:
            # From its due time, not from its real time: otherwise delays would accumulate.
            due_ns, now_ns = self._time.real_ns(blank_ns), time.monotonic_ns()
            self._blank(due_ns if now_ns - due_ns < CATCH_UP_NS else now_ns)

    def _blank(self, real_ns: int) -> None:
        self._time.blank(self._idle_speed, real_ns, self._on_blank)
