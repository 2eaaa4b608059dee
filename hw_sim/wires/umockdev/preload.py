"""The protocol of umockdev's preload library: system calls on opened device nodes, and their answers.

``libumockdev-preload.so`` in the host's process connects to ``<root>/ioctl/<node>`` for each opening of a node that has
a socket there, and sends each ``ioctl``, ``read`` and ``write``; until the answer, its memory can be read and written.
Source: umockdev 0.17, ``src/libumockdev-preload.c`` (remote_emulate).
"""

from __future__ import annotations

import contextlib
import os
import socket
import struct
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Protocol

_PACKET = struct.Struct("<QqQ")
"""Command and two arguments."""
_ANSWER = struct.Struct("<Qqq")
_DONE, _RUN, _READ_MEMORY, _WRITE_MEMORY = 3, 4, 5, 6
ANSWER_TIMEOUT_S = 10.0
"""A host whose memory is read is waiting for an answer, so that it replies at once unless it is stopped."""
SOCKET_PATH_BYTES = 107


class HostGone(Exception):
    """The process that made the system call has ended."""


class NotOurs(Exception):
    """The call has no answer here: the host makes its own system call, on the file in place of the node."""


class HostMemory:
    """Memory of the process with the system call. Raises HostGone; OSError(EFAULT) for no address."""

    def __init__(self, connection: socket.socket) -> None:
        self._connection = connection

    def copy_from_user(self, address: int, size: int) -> bytes:
        """Return ``size`` bytes at ``address``."""
        if size == 0:
            return b""
        if address == 0:
            raise OSError(14, "Bad address")
        _send(self._connection, _PACKET.pack(_READ_MEMORY, address, size))
        return _receive(self._connection, size)

    def copy_to_user(self, address: int, data: bytes | bytearray | memoryview) -> None:
        """Put ``data`` at ``address``."""
        view = memoryview(data).cast("B")
        if len(view) == 0:
            return
        if address == 0:
            raise OSError(14, "Bad address")
        _send(self._connection, _PACKET.pack(_WRITE_MEMORY, address, len(view)))
        _send(self._connection, view)


class OpenedNode(Protocol):
    """One opening of a device node: the kernel's end of it. Raises OSError as the system calls do."""

    def ioctl(self, request: int, argument: int, memory: HostMemory) -> int:
        """Do the call. Raises NotOurs.

        ``argument`` is the third one as it came, mostly an address in ``memory``.
        """

    def read(self, size: int) -> bytes:
        """Return the bytes for the reader's buffer."""

    def write(self, data: bytes) -> int:
        """Take ``data``; return the number of bytes taken."""

    def close(self) -> None:
        """End the opening: its last descriptor is closed, or its process has ended."""


class Plain:
    """A node without a kernel driver of ours, such as a terminal: all calls go to its file."""

    def ioctl(self, request: int, argument: int, memory: HostMemory) -> int:
        raise NotOurs

    def read(self, size: int) -> bytes:
        raise NotOurs

    def write(self, data: bytes) -> int:
        raise NotOurs

    def close(self) -> None:
        """No effect, as it has no state."""


OTHER_NODES = "_default"
"""The node whose server answers for all nodes without a server; the preload library needs it."""


class NodeServer:
    """Answers for one device node until it is closed; openings outlive it, as they do an unplugged device."""

    def __init__(self, root: Path, node: str, opened: Callable[[], OpenedNode]) -> None:
        """``node``: path below ``/dev``, or OTHER_NODES. ``opened`` is called for each opening."""
        self._path = root / "ioctl" / (node if node == OTHER_NODES else f"dev/{node}")
        self._opened, self._node = opened, node
        if len(os.fsencode(self._path)) > SOCKET_PATH_BYTES:
            raise ValueError(f"{self._path}: a socket's path has at most {SOCKET_PATH_BYTES} bytes; use a shorter root")
        self._path.parent.mkdir(parents=True, exist_ok=True)
        self._listener = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        self._listener.bind(str(self._path))
        self._listener.listen(16)
        self._thread = threading.Thread(target=self._accept, name=f"node {node}", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Accept no more openings; may be called again."""
        self._path.unlink(missing_ok=True)
        with contextlib.suppress(OSError):
            self._listener.shutdown(socket.SHUT_RDWR)
        self._listener.close()
        self._thread.join(5.0)

    def _accept(self) -> None:
        while True:
            try:
                connection, _ = self._listener.accept()
            except OSError:
                return
            threading.Thread(target=self._serve, args=(connection,), name=f"opened {self._node}", daemon=True).start()

    def _serve(self, connection: socket.socket) -> None:
        with connection:
            opened = self._opened()
            try:
                while True:
                    connection.settimeout(None)
                    packet = _PACKET.unpack(_receive(connection, _PACKET.size))
                    # Between calls the host may be silent without limit; during one it waits for our answer and replies
                    # at once.
                    connection.settimeout(ANSWER_TIMEOUT_S)
                    try:
                        result = _answer(opened, HostMemory(connection), *packet)
                    except NotOurs:
                        _send(connection, _ANSWER.pack(_RUN, 0, 0))
                        connection.settimeout(None)  # it may wait, as a system call does
                        _, *result = _ANSWER.unpack(_receive(connection, _ANSWER.size))
                    _send(connection, _ANSWER.pack(_DONE, *result))
            except HostGone:
                pass
            finally:
                opened.close()


def _answer(opened: OpenedNode, memory: HostMemory, command: int, first: int, second: int) -> list[int]:
    """Return result and errno of one system call."""
    try:
        match command:
            case 1:  # ioctl
                return [opened.ioctl(first & 0xFFFFFFFF, second, memory), 0]
            case 7:  # read
                data = opened.read(second)
                memory.copy_to_user(first, data)
                return [len(data), 0]
            case 8:  # write
                return [opened.write(memory.copy_from_user(first, second)), 0]
            case _:
                raise HostGone(f"command {command} is none of umockdev 0.17")
    except OSError as error:
        return [-1, error.errno or 5]


def _send(connection: socket.socket, data: bytes | bytearray | memoryview) -> None:
    try:
        connection.sendall(data)
    except OSError as error:
        raise HostGone(str(error)) from error


def _receive(connection: socket.socket, size: int) -> bytes:
    buffer = bytearray(size)
    view, filled = memoryview(buffer), 0
    while filled < size:
        try:
            count = connection.recv_into(view[filled:])
        except OSError as error:
            raise HostGone(str(error)) from error
        if count == 0:
            raise HostGone("closed")
        filled += count
    return bytes(buffer)
