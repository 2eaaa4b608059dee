"""Progress bar of a long measurement, on a terminal only."""

from __future__ import annotations

import sys
import time
from typing import TextIO

WIDTH = 30


class Progress:
    """A bar for ``total`` steps."""

    def __init__(self, total: int, out: TextIO = sys.stderr) -> None:
        self._total, self._done, self._out = max(total, 1), 0, out
        self._begun = time.monotonic()

    def step(self, what: str) -> None:
        """Count one step as done, and show the next one."""
        self._done = min(self._done + 1, self._total)
        self.show(what, self._done / self._total)

    def show(self, what: str, share: float) -> None:
        """Show the present step and the ``share`` 0..1 of all that is done."""
        if not self._out.isatty():
            return
        share = min(max(share, 1e-3), 1.0)
        left_s = (time.monotonic() - self._begun) * (1.0 - share) / share
        bar = "#" * round(WIDTH * share)
        self._out.write(f"\r\x1b[K[{bar:<{WIDTH}}] {100 * share:3.0f} %  {left_s / 60:4.1f} min left  {what}")
        self._out.flush()

    def close(self) -> None:
        """Clear the line."""
        if self._out.isatty():
            self._out.write("\r\x1b[K")
            self._out.flush()
