"""The queue of bytes for the host: whole lines, a limit, and pieces that USB takes without stalling."""

PIECE = 63
"""Bytes handed to USB at once: a transfer of exactly one 64-byte packet waited for a second one
(MicroPython #15960).
"""


class Outbox:
    """Bytes on their way to the host.

    A line that does not fit is lost as a whole, and its report number is missing.
    """

    def __init__(self, capacity: int) -> None:
        self._capacity = capacity
        self._bytes = b""

    def add(self, line: bytes) -> bool:
        """Append a line; ``False`` if there is no room for all of it."""
        if len(self._bytes) + len(line) > self._capacity:
            return False
        self._bytes += line
        return True

    def piece(self) -> bytes:
        """Return the next bytes to send, 63 at most."""
        return self._bytes[:PIECE]

    def sent(self, count: int) -> None:
        """Drop ``count`` bytes, which USB has taken."""
        self._bytes = self._bytes[count:]

    def clear(self) -> None:
        """Drop all bytes, so that a new listener begins with a whole line."""
        self._bytes = b""
