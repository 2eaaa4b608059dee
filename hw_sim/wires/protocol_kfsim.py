"""The pyserial end of the board's wire: the port behind ``kfsim://<world>/board``.

pyserial finds this module by its name, as long as its package is in ``serial.protocol_handler_packages``.
"""

from __future__ import annotations

from typing import Any
from urllib.parse import urlsplit

from serial.serialutil import PortNotOpenError, SerialBase, SerialException, to_bytes

from hw_sim import registry
from hw_sim.devices.board import Board
from hw_sim.timing.world_time import WorldTime

_GONE = "device reports readiness to read but returned no data (device disconnected or multiple access on port?)"


class Serial(SerialBase):  # type: ignore[misc]
    """A serial port into a simulated world; timeouts count world time, line settings have no effect."""

    def __init__(self, *args: Any, **kwargs: Any) -> None:
        self._board: Board | None = None
        self._time: WorldTime | None = None
        self._cancelled = False
        self.is_open = False
        super().__init__(*args, **kwargs)

    def open(self) -> None:
        """Open the port. Raises SerialException if there is no such world, or the port is taken."""
        if self.is_open:
            raise SerialException("Port is already open.")
        if self._port is None:
            raise SerialException("Port must be configured before it can be used.")
        parts = urlsplit(self._port)
        world = registry.find(parts.netloc)
        if world is None or parts.path != "/board":
            raise SerialException(2, f"could not open port {self._port}: [Errno 2] No such file or directory")
        with world.time.condition:
            # The kernel allows two openings of a port; pyserial's exclusive mode does not, and a board has one host.
            if world.board.open:
                raise SerialException(16, f"could not open port {self._port}: [Errno 16] Device or resource busy")
            world.board.open = True
            world.board.take(world.board.waiting)
        self._board, self._time = world.board, world.time
        self.is_open = True

    def close(self) -> None:
        """Close; may be called again."""
        if not self.is_open or self._board is None or self._time is None:
            return
        self.is_open = False
        with self._time.condition:
            self._board.open = False
            self._time.condition.notify_all()

    def _ends(self) -> tuple[Board, WorldTime]:
        if not self.is_open or self._board is None or self._time is None:
            raise PortNotOpenError
        return self._board, self._time

    @property
    def in_waiting(self) -> int:
        """Bytes that can be read."""
        board, time = self._ends()
        with time.condition:
            if time.closed:
                raise SerialException(_GONE)
            return board.waiting

    @property
    def out_waiting(self) -> int:
        """Bytes that are not sent yet."""
        self._ends()
        return 0

    def read(self, size: int = 1) -> bytes:
        """Return up to ``size`` bytes; fewer after the timeout."""
        board, time = self._ends()
        with time.condition:
            self._cancelled = False
            time.wait_for(
                lambda: board.waiting >= size or self._cancelled or time.closed or not self.is_open, self._timeout
            )
            if not self.is_open:
                raise PortNotOpenError
            if time.closed:
                raise SerialException(_GONE)
            return board.take(size)

    def write(self, b: bytes) -> int:
        """Send all bytes."""
        board, time = self._ends()
        data = to_bytes(b)
        with time.condition:
            if time.closed:
                raise SerialException("write failed: [Errno 5] Input/output error")
            board.receive(data)
        return len(data)

    def flush(self) -> None:
        """No effect, as bytes are sent at once."""
        self._ends()

    def reset_input_buffer(self) -> None:
        """Discard received bytes."""
        board, time = self._ends()
        with time.condition:
            board.take(board.waiting)

    def reset_output_buffer(self) -> None:
        """No effect, as bytes are sent at once."""
        self._ends()

    def cancel_read(self) -> None:
        """Let a waiting read return with the bytes so far."""
        _, time = self._ends()
        with time.condition:
            self._cancelled = True
            time.condition.notify_all()

    def cancel_write(self) -> None:
        """No effect, as writes never wait."""

    def _reconfigure_port(self) -> None:
        """No effect, as USB has no baud rate."""

    def _update_break_state(self) -> None:
        """No effect, as there is no such line."""

    def _update_rts_state(self) -> None:
        """No effect, as there is no such line."""

    def _update_dtr_state(self) -> None:
        """No effect, as there is no such line."""

    @property
    def cts(self) -> bool:
        """Always clear to send."""
        return True

    @property
    def dsr(self) -> bool:
        """Always ready."""
        return True

    @property
    def ri(self) -> bool:
        """Never rings."""
        return False

    @property
    def cd(self) -> bool:
        """Always present."""
        return True
