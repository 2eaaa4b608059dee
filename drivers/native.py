"""The instrument's own wires: the system's USB, HID, graphics card and clock."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import hidraw

from drivers.api import Calendar, CardNode, Clock, DeviceRefused, Wires, WiresOptions
from drivers.output.node import DrmNode
from drivers.wall_clock import KernelCalendar


class MonotonicClock:
    """``drivers.api.Clock`` over CLOCK_MONOTONIC, the clock of the kernel's flip time stamps."""

    def now_ns(self) -> int:
        """Return the monotonic time in ns."""
        return time.monotonic_ns()

    def sleep_s(self, duration_s: float) -> None:
        """Return after ``duration_s``; at once when it is not positive."""
        if duration_s > 0.0:
            time.sleep(duration_s)

    def wait_for(self, condition: threading.Condition, predicate: Callable[[], bool], timeout_s: float) -> bool:
        """Wait with ``condition`` held until ``predicate()`` or the timeout; return the predicate's value."""
        return condition.wait_for(predicate, timeout_s)


class NativeWires:
    """``drivers.api.Wires`` of the machine this runs on."""

    def __init__(self) -> None:
        self.usb_backend: Any = None
        """pyusb picks libusb-1.0."""
        self.hidraw: Any = hidraw
        self.clock: Clock = MonotonicClock()
        self.calendar: Calendar = KernelCalendar()

    def cards(self) -> tuple[str, ...]:
        """Return the paths of all graphics cards of this machine, by name."""
        return tuple(sorted(str(path) for path in Path("/dev/dri").glob("card*")))

    def open_card(self, path: str) -> CardNode:
        """Open the DRM node at ``path``. Raises DeviceGone, DeviceRefused."""
        return DrmNode(path)


@contextmanager
def open(options: WiresOptions) -> Iterator[Wires]:  # the name that rig files use
    """Yield the instrument's wires; they take no options. Raises DeviceRefused for any."""
    if options:
        raise DeviceRefused(
            "wires", f"unknown options {', '.join(sorted(options))}", "drivers.native:open takes none; remove them"
        )
    yield NativeWires()
