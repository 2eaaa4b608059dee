"""The trigger board on the bus: a CDC-ACM serial device (USB class 2, PSTN subclass 2).

All calls with the world's lock held.
"""

from __future__ import annotations

import struct

from hw_sim.devices import usb_standard as usb
from hw_sim.devices.board import SERIAL, Board
from hw_sim.devices.usb_standard import StandardRequests
from hw_sim.faults import FaultBook

VENDOR, PRODUCT, RELEASE = 0x1209, 0x4B42, 0x0142
MANUFACTURER, NAME = "Kingfisher", "Trigger board"
NOTIFY_IN, DATA_IN, DATA_OUT = 0x81, 0x82, 0x02
PACKET = 512
_COMMUNICATION, _DATA = (2, 2, 1), (0x0A, 0, 0)
_CLASS_INTERFACE = 0x24
_TERMINAL_READY = 0x01


class UsbBoard:
    """The board behind its endpoints. It sends while the host's terminal is ready (DTR)."""

    speed = 3
    """High speed, 480 Mbit/s, as USB/IP and Linux number it."""

    def __init__(self, board: Board, faults: FaultBook) -> None:
        self._board, self._faults = board, faults
        self._line_coding = struct.pack("<IBBB", 115200, 0, 0, 8)
        # CDC 1.2 and PSTN 1.2: the functional descriptors of an abstract control model.
        functional = (
            struct.pack("<BBBH", 5, _CLASS_INTERFACE, 0x00, 0x0110)  # header
            + struct.pack("<BBBBB", 5, _CLASS_INTERFACE, 0x01, 0, 1)  # no call management
            + struct.pack("<BBBB", 4, _CLASS_INTERFACE, 0x02, 0x02)  # line coding and control line state
            + struct.pack("<BBBBB", 5, _CLASS_INTERFACE, 0x06, 0, 1)  # union of interfaces 0 and 1
        )
        body = (
            struct.pack("<BBBBBBBB", 8, usb.ASSOCIATION, 0, 2, *_COMMUNICATION, 0)
            + usb.interface(0, 1, _COMMUNICATION)
            + functional
            + usb.endpoint(NOTIFY_IN, usb.INTERRUPT, 16, 9)
            + usb.interface(1, 2, _DATA)
            + usb.endpoint(DATA_IN, usb.BULK, PACKET, 0)
            + usb.endpoint(DATA_OUT, usb.BULK, PACKET, 0)
        )
        self._standard = StandardRequests(
            usb.device(0x0200, (0xEF, 2, 1), 64, VENDOR, PRODUCT, RELEASE),
            usb.configuration(2, 200, body),
            (MANUFACTURER, NAME, SERIAL),
        )

    @property
    def plugged(self) -> bool:
        """True if it is on the bus, that is, if it has power."""
        return self._faults.active("board", "off") is None

    @property
    def enumeration(self) -> int:
        """Always 0: a reset of the firmware does not leave the bus."""
        return 0

    def attach(self) -> None:
        """Connect the board to a host: it starts as after plugging in."""
        self._standard.restart()
        self._board.open = False

    def detach(self) -> None:
        """Disconnect the board from its host."""
        self._board.open = False

    def device_descriptor(self) -> bytes:
        """Return the device descriptor: 18 bytes."""
        return self._standard.device

    def configuration_descriptor(self) -> bytes:
        """Return the complete configuration descriptor."""
        return self._standard.configuration

    def control(self, kind: int, request: int, value: int, index: int, length: int, data: bytes) -> bytes:
        """Do a control transfer; return the data of an IN request. Raises Stall."""
        match kind, request:
            case 0x21, 0x20 if len(data) == len(self._line_coding):  # SET_LINE_CODING
                self._line_coding = data
                return b""
            case 0xA1, 0x21:  # GET_LINE_CODING
                return self._line_coding[:length]
            case 0x21, 0x22:  # SET_CONTROL_LINE_STATE
                self._terminal(bool(value & _TERMINAL_READY))
                return b""
            case 0x21, 0x23:  # SEND_BREAK
                return b""
            case _:
                return self._standard.answer(kind, request, value, index)[:length]

    def _terminal(self, ready: bool) -> None:
        if ready and not self._board.open:
            self._board.take(self._board.waiting)  # output before the terminal was ready is lost
        self._board.open = ready

    def write(self, endpoint: int, data: bytes) -> int:
        """Do a bulk OUT transfer; return the number of bytes. Raises Stall."""
        if endpoint != DATA_OUT or endpoint in self._standard.halted:
            raise usb.Stall
        self._board.receive(data)
        return len(data)

    def read(self, endpoint: int, buffer: memoryview) -> tuple[int, bool]:
        """Copy the board's output into ``buffer``; return the byte count, and whether the transfer ends.

        Raises Stall.
        """
        if endpoint in self._standard.halted:
            raise usb.Stall
        if endpoint == NOTIFY_IN:
            return 0, False
        if endpoint != DATA_IN:
            raise usb.Stall
        output = self._board.take(len(buffer))
        buffer[: len(output)] = output
        return len(output), bool(output)
