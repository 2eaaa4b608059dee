"""The GenCP control channel: command packets in, acknowledge packets out, strictly one at a time."""

from __future__ import annotations

import struct
from collections import deque
from collections.abc import Callable

from hw_sim.devices.gencp_memory import AccessError, Memory, Status
from hw_sim.timing.world_time import WorldTime

MAX_COMMAND, MAX_ACKNOWLEDGE = 1024, 1024
MAX_RESPONSE_MS = 20
PENDING_MS = 200
ACKS_KEPT = 4
"""Largest number of unread acknowledges; the oldest are dropped."""

# USB3 Vision, control protocol: prefix 'U3VC', flags, command id, length of the payload, request id, little-endian.
_MAGIC = 0x43563355
_HEADER = struct.Struct("<IHHHH")
_WANTS_ACK = 0x4000
_READ, _WRITE, _PENDING = 0x0800, 0x0802, 0x0805


class ControlChannel:
    """The device's end of the channel.

    ``duration_ns(address)`` is the duration of a write there; beyond the response time a PENDING_ACK is sent.
    """

    def __init__(self, time: WorldTime, memory: Memory, duration_ns: Callable[[int], int]) -> None:
        self._time, self._memory, self._duration_ns = time, memory, duration_ns
        self._acks: deque[bytes] = deque(maxlen=ACKS_KEPT)
        self._busy = False
        self._life = 0

    def reset(self) -> None:
        """Drop the command under way."""
        self._life += 1
        self._busy = False
        self._acks.clear()

    def receive(self, packet: bytes) -> None:
        """Handle one transfer of the host; invalid commands are ignored."""
        if len(packet) < _HEADER.size:
            return
        magic, flags, command, size, request_id = _HEADER.unpack_from(packet)
        if magic != _MAGIC:
            return
        payload = packet[_HEADER.size :]
        wants_ack = bool(flags & _WANTS_ACK)
        if self._busy:
            refusal = Status.BUSY
        elif size != len(payload):
            refusal = Status.INVALID_HEADER
        elif command not in (_READ, _WRITE):
            refusal = Status.NOT_IMPLEMENTED
        else:
            self._start(command, wants_ack, payload, request_id)
            return
        if wants_ack:
            self._acknowledge(refusal, command | 1, request_id, b"")

    def _start(self, command: int, wants_ack: bool, payload: bytes, request_id: int) -> None:
        address = int.from_bytes(payload[:8], "little")
        duration_ns = self._duration_ns(address) if command == _WRITE else 0
        if duration_ns <= MAX_RESPONSE_MS * 1_000_000:
            self._finish(command, wants_ack, payload, request_id)
            return
        # GenCP, PENDING_ACK: a command that exceeds the response time is announced with its duration.
        self._busy = True
        if wants_ack:
            self._acknowledge(Status.SUCCESS, _PENDING, request_id, struct.pack("<HH", 0, PENDING_MS))
        life = self._life

        def finish(_: int) -> None:
            if self._life == life:
                self._busy = False
                self._finish(command, wants_ack, payload, request_id)

        self._time.at(self._time.now_ns() + duration_ns, finish)

    def _finish(self, command: int, wants_ack: bool, payload: bytes, request_id: int) -> None:
        life = self._life
        try:
            status, answer = Status.SUCCESS, self._read(payload) if command == _READ else self._write(payload)
        except AccessError as error:
            status, answer = error.status, b""
        # A device that has just reset itself no longer answers.
        if wants_ack and self._life == life:
            self._acknowledge(status, command | 1, request_id, answer)

    def _read(self, payload: bytes) -> bytes:
        if len(payload) != 12:
            raise AccessError(Status.INVALID_PARAMETER)
        address, _, size = struct.unpack("<QHH", payload)
        if size > MAX_ACKNOWLEDGE - _HEADER.size:
            raise AccessError(Status.INVALID_PARAMETER)
        return self._memory.read(address, size)

    def _write(self, payload: bytes) -> bytes:
        if len(payload) <= 8 or len(payload) > MAX_COMMAND - _HEADER.size:
            raise AccessError(Status.INVALID_PARAMETER)
        data = payload[8:]
        self._memory.write(int.from_bytes(payload[:8], "little"), data)
        return struct.pack("<HH", 0, len(data))

    def _acknowledge(self, status: Status, command: int, request_id: int, payload: bytes) -> None:
        self._acks.append(_HEADER.pack(_MAGIC, status, command, len(payload), request_id) + payload)
        self._time.condition.notify_all()

    def take(self) -> bytes | None:
        """Return and remove the oldest unread acknowledge; ``None``: there is none."""
        return self._acks.popleft() if self._acks else None
