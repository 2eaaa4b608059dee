"""One imported device: its host's transfers, in order per endpoint, and the end of each."""

from __future__ import annotations

import errno
import socket
import struct
import threading
from collections import deque
from contextlib import suppress
from dataclasses import dataclass, field

from hw_sim.devices.u3v_stream import Overflow
from hw_sim.devices.usb_standard import Stall
from hw_sim.timing.world_time import LONGEST_WAIT_S, WorldTime
from hw_sim.wires.usbip import messages
from hw_sim.wires.usbip.messages import ProtocolError, Submit, Unlink
from hw_sim.wires.usbip.ports import Function

MOST_PENDING = 512
"""More pending transfers than a Linux kernel has."""
JOIN_TIMEOUT_S = 5.0


class ConnectionClosedError(Exception):
    """The host closed its end."""


def receive(connection: socket.socket, size: int) -> bytes:
    """Exactly ``size`` bytes. Raises ConnectionClosedError."""
    data = bytearray()
    while len(data) < size:
        try:
            part = connection.recv(min(size - len(data), 1 << 20))
        except OSError:
            part = b""
        if not part:
            raise ConnectionClosedError
        data += part
    return bytes(data)


@dataclass(slots=True)
class _Pending:
    """A pending transfer; ``doomed``: an earlier one ended early, and the host will withdraw this one."""

    submit: Submit
    data: bytes
    buffer: bytearray = field(default_factory=bytearray)
    filled: int = 0
    doomed: bool = False


class Session:
    """Serves an imported device until its host detaches it, or it leaves the bus.

    Two threads: one reads, one answers.
    """

    def __init__(self, connection: socket.socket, function: Function, time: WorldTime, name: str) -> None:
        self._connection, self._function, self._time = connection, function, time
        self._commands: deque[_Pending | Unlink] = deque()
        self._pipes: dict[int, deque[_Pending]] = {}
        self._over = False
        self._reader = threading.Thread(target=self._read_forever, name=f"usbip-read-{name}", daemon=True)

    def serve(self) -> None:
        """Return at the end of the session, with the connection closed."""
        with self._time.condition:
            self._enumeration = self._function.enumeration
            self._function.attach()
        self._reader.start()
        try:
            while True:
                with self._time.condition:
                    replies = self._replies()
                    while not replies and self._alive:
                        self._time.condition.wait(LONGEST_WAIT_S)
                        replies = self._replies()
                    if not self._alive:
                        return
                self._connection.sendall(b"".join(replies))
        except OSError:
            return  # the host detached it during a reply
        finally:
            with self._time.condition:
                self._over = True
                self._function.detach()
            _shut(self._connection)
            self._reader.join(JOIN_TIMEOUT_S)

    @property
    def _alive(self) -> bool:
        plugged = self._function.plugged and self._function.enumeration == self._enumeration
        return plugged and not self._over and not self._time.closed

    # ------------------------------------------------------------------------------------------ what the host wants

    def _read_forever(self) -> None:
        try:
            while True:
                command = messages.parse_command(receive(self._connection, messages.HEADER_BYTES))
                pending: _Pending | Unlink
                if isinstance(command, Unlink):
                    pending = command
                else:
                    data = b"" if command.device_to_host else receive(self._connection, command.length)
                    pending = _Pending(command, data)
                with self._time.condition:
                    if len(self._commands) + sum(map(len, self._pipes.values())) >= MOST_PENDING:
                        raise ProtocolError(f"more than {MOST_PENDING} transfers under way")
                    self._commands.append(pending)
                    self._time.condition.notify_all()
        except (ConnectionClosedError, ProtocolError):
            with self._time.condition:
                self._over = True
                self._time.condition.notify_all()

    # ------------------------------------------------------------------------------------------ how it ends

    def _replies(self) -> list[bytes]:
        """Return all replies that are ready, in order. The caller holds the lock."""
        replies: list[bytes] = []
        while self._commands:
            command = self._commands.popleft()
            if isinstance(command, Unlink):
                replies.append(self._unlink(command))
            elif command.submit.endpoint == 0:
                replies.append(self._control(command))
            elif not command.submit.device_to_host:
                replies.append(self._write(command))
            else:
                command.buffer = bytearray(command.submit.length)
                self._pipes.setdefault(command.submit.endpoint, deque()).append(command)
        for pipe in self._pipes.values():
            while pipe and (reply := self._read(pipe)) is not None:
                replies.append(reply)
        return replies

    def _control(self, transfer: _Pending) -> bytes:
        submit = transfer.submit
        kind, request, value, index, length = struct.unpack("<BBHHH", submit.setup)
        try:
            answer = self._function.control(kind, request, value, index, min(length, submit.length), transfer.data)
        except Stall:
            return messages.returned(submit, -errno.EPIPE, 0)
        length = len(answer) if submit.device_to_host else len(transfer.data)
        return messages.returned(submit, 0, length, answer if submit.device_to_host else b"")

    def _write(self, transfer: _Pending) -> bytes:
        try:
            written = self._function.write(transfer.submit.endpoint, transfer.data)
        except Stall:
            return messages.returned(transfer.submit, -errno.EPIPE, 0)
        return messages.returned(transfer.submit, 0, written)

    def _read(self, pipe: deque[_Pending]) -> bytes | None:
        """Return the reply of the pipe's first transfer; ``None``: not yet."""
        transfer = pipe[0]
        if transfer.doomed:
            return None
        memory = memoryview(transfer.buffer)
        try:
            more, done = self._function.read(transfer.submit.endpoint, memory[transfer.filled :])
        except Stall:
            pipe.popleft()
            return messages.returned(transfer.submit, -errno.EPIPE, 0)
        except Overflow:
            pipe.popleft()
            return messages.returned(transfer.submit, -errno.EOVERFLOW, 0)
        transfer.filled += more
        if not done:
            return None
        pipe.popleft()
        status = 0
        if transfer.filled < transfer.submit.length and transfer.submit.flags & messages.SHORT_NOT_OK:
            status = -errno.EREMOTEIO
            # The host's driver withdraws the transfers queued behind a short one; USB/IP has no other way for that.
            for behind in pipe:
                behind.doomed = True
        return messages.returned(transfer.submit, status, transfer.filled, memory[: transfer.filled])

    def _unlink(self, unlink: Unlink) -> bytes:
        for pipe in self._pipes.values():
            for transfer in pipe:
                if transfer.submit.number == unlink.victim:
                    pipe.remove(transfer)
                    return messages.unlinked(unlink, -errno.ECONNRESET)
        return messages.unlinked(unlink, 0)  # it has ended, and its reply was sent before


def _shut(connection: socket.socket) -> None:
    with suppress(OSError):  # the host was quicker
        connection.shutdown(socket.SHUT_RDWR)
    connection.close()
