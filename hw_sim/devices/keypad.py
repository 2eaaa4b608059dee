"""The keypad: four bouncing coils, and their reports (``docs/protocols/keys.md``).

Reports out through ``listen``; all calls with the world's lock held.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import numpy as np

from hw_sim.faults import FaultBook
from hw_sim.timing.world_time import START_NS, WorldTime

VENDOR, PRODUCT, RELEASE = 0x1209, 0x4B46, 0x0103
MANUFACTURER, NAME, SERIAL = "Kingfisher", "Key pad", "KF-KEY-0001"
USAGE_PAGE, USAGE = 0xFF4B, 0x0001
REPORT_DESCRIPTOR = bytes.fromhex("064bff0901a101850109021500 26ff007508950781 02c0".replace(" ", ""))
"""Vendor page FF4B, usage 1: one input report, number 1, seven bytes after the number."""
BITS = {"scan": 0x01, "back": 0x02, "up": 0x04, "down": 0x08}
REPORT_NUMBER, FIRMWARE, CHECK = 0x01, 3, 0xA5
PERIOD_NS = 250_000_000
BOUNCE_NS = 18_000_000
LONGEST_HOLD_S = 3600.0


class Keypad:
    """The keypad's firmware and its coils."""

    def __init__(self, time: WorldTime, faults: FaultBook, seed: int) -> None:
        self._time, self._faults = time, faults
        self._rng = np.random.default_rng([seed, 0x4E7])
        self._coils = 0
        self._edges = 0
        self._latest_edge = dict.fromkeys(BITS, 0)
        self._counter = 0
        self._listeners: list[Callable[[bytes], None]] = []
        self.plugged = True
        self.enumeration = 0
        """Counts how often it was plugged in."""
        self._last_keys = 0
        self._time.at(time.now_ns() + PERIOD_NS, self._periodic)

    def press(self, key: str, hold_s: float) -> None:
        """Press a key now for ``hold_s``; both edges bounce. Raises ValueError for an unknown key or no time."""
        if key not in BITS:
            raise ValueError(f"key '{key}'; allowed are {', '.join(BITS)}")
        if not 0 < hold_s <= LONGEST_HOLD_S:
            raise ValueError(f"hold_s={hold_s}; allowed is more than 0, up to {LONGEST_HOLD_S:g} s")
        now_ns, hold_ns = self._time.now_ns(), int(hold_s * 1e9)
        # A short press may end before it has settled: later bounces are those of the release.
        self._edge(now_ns, key, True, min(BOUNCE_NS, hold_ns))
        self._edge(now_ns + hold_ns, key, False, BOUNCE_NS)

    def touch(self, key: str, at_ns: int) -> None:
        """Press a key at ``at_ns``, or now if that is past, and hold it. Raises ValueError for an unknown key."""
        self._finger(key, True, at_ns)

    def let_go(self, key: str, at_ns: int) -> None:
        """Release the key, at ``at_ns`` or now. Raises ValueError for an unknown key."""
        self._finger(key, False, at_ns)

    def _finger(self, key: str, down: bool, at_ns: int) -> None:
        if key not in BITS:
            raise ValueError(f"key '{key}'; allowed are {', '.join(BITS)}")
        self._edge(max(at_ns, self._time.now_ns()), key, down, BOUNCE_NS)

    def _edge(self, time_ns: int, key: str, down: bool, within_ns: int) -> None:
        """Plan a change at ``time_ns`` and up to three bounces after it, the last of which settles."""
        self._edges += 1
        number, bit = self._edges, BITS[key]

        def begin(t: int) -> None:
            self._latest_edge[key] = number
            self._set(bit, down, t)

        def bounce(closed: bool, t: int) -> None:
            if self._latest_edge[key] == number:  # no later edge has come
                self._set(bit, closed, t)

        self._time.at(time_ns, begin)
        # An even number, so that the last bounce ends in the new state.
        bounces = 2 * int(self._rng.integers(0, 4))
        after_ns = np.sort(self._rng.integers(min(500_000, within_ns // 2), max(1, within_ns), bounces))
        for i, offset_ns in enumerate(after_ns.tolist()):
            self._time.at(time_ns + offset_ns, partial(bounce, not down if i % 2 == 0 else down))

    def _set(self, bit: int, closed: bool, time_ns: int) -> None:
        self._coils = self._coils | bit if closed else self._coils & ~bit
        self._changed(time_ns)

    @property
    def keys(self) -> int:
        """The coils as the keypad reads them."""
        stuck = sum(bit for key, bit in BITS.items() if self._faults.active(f"key.{key}", "stuck"))
        return self._coils | stuck

    def refresh(self, time_ns: int) -> None:
        """Check the faults again: one may have begun or ended."""
        plugged = self._faults.active("keypad", "off") is None
        if plugged != self.plugged:
            self.plugged = plugged
            self._counter = 0
            self.enumeration += plugged
            self._listeners.clear()
        self._changed(time_ns)

    def listen(self, receive: Callable[[bytes], None]) -> None:
        """Send every report to ``receive`` until the keypad is unplugged or ``forget``."""
        self._listeners.append(receive)

    def forget(self, receive: Callable[[bytes], None]) -> None:
        """End ``listen``."""
        if receive in self._listeners:
            self._listeners.remove(receive)

    def _changed(self, time_ns: int) -> None:
        if self.keys != self._last_keys:
            self._report(time_ns)

    def _periodic(self, time_ns: int) -> None:
        self._report(time_ns)
        self._time.at(time_ns + PERIOD_NS, self._periodic)

    def _report(self, time_ns: int) -> None:
        self._last_keys = self.keys
        if not self.plugged:
            return
        time_ms = (time_ns - START_NS) // 1_000_000 & 0xFFFF
        body = bytes([REPORT_NUMBER, self._last_keys, self._counter, 0, time_ms & 0xFF, time_ms >> 8, FIRMWARE])
        self._counter = (self._counter + 1) & 0xFF
        check = CHECK
        for byte in body:
            # Exclusive or of all bytes, which detects every single wrong bit.
            check ^= byte
        report = body + bytes([check])
        if self._faults.active("keypad", "garbage"):
            report = self._spoil(report)
        for receive in self._listeners:
            receive(report)
        self._time.condition.notify_all()

    def _spoil(self, report: bytes) -> bytes:
        """Return a report with one error: wrong checksum, wrong number, too short, or noise."""
        match int(self._rng.integers(0, 4)):
            case 0:
                return report[:-1] + bytes([report[-1] ^ 0x5A])
            case 1:
                return bytes([0x7F]) + report[1:]
            case 2:
                return report[: int(self._rng.integers(1, len(report)))]
            case _:
                return bytes([REPORT_NUMBER]) + self._rng.integers(0, 256, 7, np.uint8).tobytes()
