"""The lines between the windows' process and the world's, over its standard input and output.

    windows → world   open · failed TEXT · want · down KEY NS · up KEY NS · quit TEXT
                      shift X Y NS · turn X Y NS · wheel N NS: the mouse, in px of a camera's image
    world → windows   show [NAME=WIDTHxHEIGHT …]: the answer to each want, with the images that have changed

The memory of the images belongs to the world's process from ``want`` to ``show``, otherwise to the windows'.
"""

from __future__ import annotations

import os
import select
from collections.abc import Mapping

LONGEST_LINE = 4096


class Lines:
    """Lines from a descriptor; every wait has a timeout. A line that does not end within 4 kB is an error."""

    def __init__(self, descriptor: int) -> None:
        self._descriptor = descriptor
        self._come = b""
        self.ended = False
        """The other side has closed, or is gone, and everything it said was read."""

    def read(self, timeout_s: float) -> str | None:
        """The next one; ``None`` if it has not come within ``timeout_s``, or never will. Raises ValueError."""
        if b"\n" not in self._come and select.select([self._descriptor], [], [], timeout_s)[0]:
            data = os.read(self._descriptor, LONGEST_LINE)
            self.ended = not data
            self._come += data
        line, newline, remainder = self._come.partition(b"\n")
        if not newline:
            if len(line) > LONGEST_LINE:
                raise ValueError(f"a line of more than {LONGEST_LINE} bytes")
            return None
        self._come = remainder
        return line.decode("utf-8", "replace")


def say(descriptor: int, *message: str) -> bool:
    """Write one line; return False if the reader is gone."""
    line = " ".join(" ".join(message).split()) + "\n"
    try:
        os.write(descriptor, line.encode()[:LONGEST_LINE])
    except BrokenPipeError:
        return False
    return True


def format_sizes(sizes: Mapping[str, tuple[int, int]]) -> list[str]:
    """``name=WxH`` of each."""
    return [f"{name}={width}x{height}" for name, (width, height) in sizes.items()]


def parse_sizes(texts: list[str]) -> dict[str, tuple[int, int]]:
    """The inverse. Raises ValueError."""
    sizes = {}
    for text in texts:
        name, _, size = text.partition("=")
        width, height = size.split("x")
        sizes[name] = (int(width), int(height))
    return sizes
