"""Owns a USB/IP client of its own, written from the kernel's ``usbip_protocol.rst``: it shares no constant with the exporter."""

from __future__ import annotations

import socket
import struct
from dataclasses import dataclass
from typing import Self

TIMEOUT_S = 20.0


def read_exactly(connection: socket.socket, size: int) -> bytes:
    data = b""
    while len(data) < size:
        part = connection.recv(size - len(data))
        if not part:
            raise ConnectionError(f"closed after {len(data)} of {size} bytes")
        data += part
    return data


def connect(port: int) -> socket.socket:
    return socket.create_connection(("127.0.0.1", port), TIMEOUT_S)


@dataclass(frozen=True)
class Listed:
    """A device as ``usbip list -r`` shows it."""

    bus_id: str
    speed: int
    vendor: int
    product: int
    interfaces: tuple[tuple[int, int, int], ...]


def list_devices(port: int) -> list[Listed]:
    with connect(port) as connection:
        connection.sendall(bytes.fromhex("0111 8005 0000 0000"))
        assert read_exactly(connection, 8) == bytes.fromhex("0111 0005 0000 0000")
        (count,) = struct.unpack(">I", read_exactly(connection, 4))
        found = []
        for _ in range(count):
            head = read_exactly(connection, 0x138)
            bus_id = head[0x100:0x120].rstrip(b"\0").decode()
            speed, vendor, product = struct.unpack_from(">IHH", head, 0x128)
            interfaces = [tuple(read_exactly(connection, 4)[:3]) for _ in range(head[0x137])]
            found.append(Listed(bus_id, speed, vendor, product, tuple(interfaces)))  # type: ignore[arg-type]
        assert connection.recv(1) == b"", "the list is followed by the end of the connection"
        return found


class Refused(Exception):
    """The import was answered with an error."""


@dataclass(frozen=True)
class Ended:
    """A transfer that came back, or (``unlink``) one that was taken back."""

    number: int
    status: int
    length: int
    data: bytes
    unlink: bool = False


class Imported:
    """A device that was imported, at the level of URBs."""

    def __init__(self, port: int, bus_id: str) -> None:
        self._connection = connect(port)
        self._number = 0
        self._inward: dict[int, bool] = {}
        self._kept: dict[int, Ended] = {}
        self._connection.sendall(bytes.fromhex("0111 8003 0000 0000") + bus_id.encode().ljust(32, b"\0"))
        version, code, status = struct.unpack(">HHI", read_exactly(self._connection, 8))
        assert (version, code) == (0x0111, 0x0003)
        if status:
            self._connection.close()
            raise Refused(status)
        self.record = read_exactly(self._connection, 0x138)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._connection.close()

    def submit(
        self,
        endpoint: int,
        *,
        length: int = 0,
        data: bytes = b"",
        setup: bytes = bytes(8),
        inward: bool,
        flags: int = 0,
    ) -> int:
        self._number += 1
        size = length if inward else len(data)
        head = struct.pack(">IIIII", 1, self._number, 0x0001_0002, inward, endpoint)
        body = struct.pack(">IiiIi", flags, size, 0, 0xFFFFFFFF, 0)
        self._inward[self._number] = inward
        self._connection.sendall(head + body + setup + (b"" if inward else data))
        return self._number

    def unlink(self, victim: int) -> int:
        self._number += 1
        self._connection.sendall(struct.pack(">IIIIII24x", 2, self._number, 0x0001_0002, 0, 0, victim))
        return self._number

    def ended(self) -> Ended:
        """The next answer, whatever it belongs to."""
        head = read_exactly(self._connection, 48)
        command, number, devid, direction, endpoint = struct.unpack_from(">IIIII", head)
        assert (devid, direction, endpoint) == (0, 0, 0), "these are zero in what a server sends"
        if command == 4:
            return Ended(number, struct.unpack_from(">i", head, 20)[0], 0, b"", True)
        assert command == 3
        status, length = struct.unpack_from(">ii", head, 20)
        return Ended(number, status, length, read_exactly(self._connection, length) if self._inward[number] else b"")

    def finish(self, number: int) -> Ended:
        """The answer to one of them; what else comes meanwhile is kept."""
        while number not in self._kept:
            ended = self.ended()
            self._kept[ended.number] = ended
        return self._kept.pop(number)

    def control(self, kind: int, request: int, value: int, index: int, length: int = 0, data: bytes = b"") -> Ended:
        setup = struct.pack("<BBHHH", kind, request, value, index, len(data) or length)
        return self.finish(self.submit(0, length=length, data=data, setup=setup, inward=bool(kind & 0x80)))

    def bulk_in(self, endpoint: int, length: int) -> Ended:
        return self.finish(self.submit(endpoint, length=length, inward=True))

    def bulk_out(self, endpoint: int, data: bytes) -> Ended:
        return self.finish(self.submit(endpoint, data=data, inward=False))
