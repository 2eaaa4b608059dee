"""A serial port whose address is what it says: ``fuzz://<hex>.<hex>``, one piece a read; then it is pulled out.

It answers INFO as a board does, so that the driver opens; pyserial finds it by its name.
"""

from __future__ import annotations

import threading
from typing import Any

from serial.serialutil import SerialBase, SerialException

from drivers.board.line import Kind, Sentence, format_line, parse_line


class Serial(SerialBase):  # type: ignore[misc]
    """Line settings and time-outs mean nothing to it."""

    def open(self) -> None:
        """Ready to be asked."""
        _, _, text = str(self._port).partition("://")
        self._pieces = [bytes.fromhex(piece) for piece in text.split(".") if piece]
        self._answer = b""
        self._asked = threading.Event()
        self.is_open = True

    def close(self) -> None:
        """It is closed."""
        self.is_open = False

    @property
    def in_waiting(self) -> int:
        """Whatever there is."""
        return 4096

    def read(self, size: int = 1) -> bytes:
        """The answer, then piece after piece. Raises SerialException behind the last."""
        if not self._asked.wait(0.05):
            return b""
        if self._answer:
            answer, self._answer = self._answer, b""
            return answer
        if not self._pieces:
            raise SerialException("pulled out")
        return self._pieces.pop(0)

    def write(self, data: Any) -> int:
        """Only INFO is ever asked."""
        asked = parse_line(bytes(data))
        said = Sentence(Kind.ACKNOWLEDGE, asked.sequence, asked.verb, ("1.2.0", "KB-0007", "TPROJ+TCASE+LEAK"))
        self._answer = format_line(said)
        self._asked.set()
        return len(data)

    def _reconfigure_port(self) -> None:
        """There is nothing to set."""
