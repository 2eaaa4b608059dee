"""The exporter as a kernel meets it, by a client of its own written from ``usbip_protocol.rst``: it shares no constant with the exporter."""

from __future__ import annotations

import socket
import struct
from collections.abc import Iterator
from contextlib import suppress
from typing import NamedTuple, Self

import numpy as np
import pytest

from hw_sim.wires.usbip.exporter import Exporter
from hw_sim.wires.usbip.messages import ProtocolError, Submit, parse_command
from hw_sim.world import World, WorldOptions
from tests.hw_sim.devices.host import framed

EPIPE, ECONNRESET = 32, 104
CAMERA, BOARD = "1-1", "1-4"
VISION = ((0xEF, 5, 0), (0xEF, 5, 1), (0xEF, 5, 2))


def read_exactly(connection: socket.socket, size: int) -> bytes:
    data = b""
    while len(data) < size:
        part = connection.recv(size - len(data))
        if not part:
            raise ConnectionError(f"closed after {len(data)} of {size} bytes")
        data += part
    return data


def connect(port: int) -> socket.socket:
    return socket.create_connection(("127.0.0.1", port), 20.0)


def list_devices(port: int) -> dict[str, tuple[int, int, int, tuple[tuple[int, ...], ...]]]:
    """Speed, vendor, product and interfaces by bus id, as ``usbip list -r`` shows them."""
    with connect(port) as connection:
        connection.sendall(bytes.fromhex("0111 8005 0000 0000"))
        assert read_exactly(connection, 8) == bytes.fromhex("0111 0005 0000 0000")
        found = {}
        for _ in range(int.from_bytes(read_exactly(connection, 4), "big")):
            head = read_exactly(connection, 0x138)
            interfaces = tuple(tuple(read_exactly(connection, 4)[:3]) for _ in range(head[0x137]))
            found[head[0x100:0x120].rstrip(b"\0").decode()] = (*struct.unpack_from(">IHH", head, 0x128), interfaces)
        assert connection.recv(1) == b"", "the list is followed by the end of the connection"
        return found


class Refused(Exception):
    """The import was answered with an error."""


class Ended(NamedTuple):
    """A transfer that came back, or (``unlink``) one that was taken back."""

    status: int
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

    def submit(self, endpoint: int, length: int = 0, data: bytes = b"", setup: bytes = bytes(8)) -> int:
        """Outwards where there is ``data``, or nothing to read."""
        self._number += 1
        inward = self._inward[self._number] = bool(length) and not data
        head = struct.pack(">IIIII", 1, self._number, 0x0001_0002, inward, endpoint)
        body = struct.pack(">IiiIi", 0, length if inward else len(data), 0, 0xFFFFFFFF, 0)
        self._connection.sendall(head + body + setup + data)
        return self._number

    def unlink(self, victim: int) -> int:
        self._number += 1
        self._connection.sendall(struct.pack(">IIIIII24x", 2, self._number, 0x0001_0002, 0, 0, victim))
        return self._number

    def finish(self, number: int) -> Ended:
        """The answer to one of them; what else comes meanwhile is kept."""
        while number not in self._kept:
            head = read_exactly(self._connection, 48)
            command, ended, *zeros = struct.unpack_from(">IIIII", head)
            assert zeros == [0, 0, 0], "these are zero in what a server sends"
            assert command in (3, 4)
            status, length = struct.unpack_from(">ii", head, 20)
            data = read_exactly(self._connection, length) if command == 3 and self._inward[ended] else b""
            self._kept[ended] = Ended(status, data, command == 4)
        return self._kept.pop(number)

    def control(self, kind: int, request: int, value: int, length: int = 0) -> Ended:
        return self.finish(self.submit(0, length, setup=struct.pack("<BBHHH", kind, request, value, 0, length)))

    def bulk(self, endpoint: int, length: int = 0, data: bytes = b"") -> Ended:
        return self.finish(self.submit(endpoint, length, data))


@pytest.fixture
def world() -> Iterator[World]:
    with World(WorldOptions(world="usbip", width_px=128, height_px=96, truth="nominal")) as made:
        yield made


@pytest.fixture
def port(world: World) -> Iterator[int]:
    with Exporter(world, 0) as exporter:
        yield exporter.port


def free(port: int, bus_id: str) -> Imported:
    """The device, as soon as it can be had."""
    for _ in range(200):
        with suppress(Refused):
            return Imported(port, bus_id)
    raise AssertionError(f"{bus_id} stays taken")


def test_a_kernel_can_enumerate_each_device_and_one_host_has_it(port: int) -> None:
    listed = list_devices(port)
    assert listed == {
        "1-1": (5, 0x1209, 0x4B43, VISION),
        "1-2": (5, 0x1209, 0x4B43, VISION),
        "1-3": (2, 0x1209, 0x4B46, ((3, 0, 0),)),
        "1-4": (3, 0x1209, 0x4B42, ((2, 2, 1), (0x0A, 0, 0))),
    }
    for bus_id in listed:
        with Imported(port, bus_id) as device:
            assert bus_id not in list_devices(port)
            with pytest.raises(Refused):
                Imported(port, bus_id)
            short, whole = (device.control(0x80, 6, 0x0100, length).data for length in (8, 64))
            assert (whole[:8], len(whole)) == (short, 18)
            assert struct.unpack_from("<HH", whole, 8) == struct.unpack_from(">HH", device.record, 0x12C)
            head = device.control(0x80, 6, 0x0200, 9).data
            (total,) = struct.unpack_from("<H", head, 2)
            chain, parts = device.control(0x80, 6, 0x0200, total).data, []
            while chain:
                assert 2 <= chain[0] <= len(chain)
                parts.append(chain[: chain[0]])
                chain = chain[chain[0] :]
            interfaces = [part for part in parts if part[1] == 4]
            assert [part[2] for part in interfaces] == list(range(head[4]))
            assert sum(part[4] for part in interfaces) == sum(part[1] == 5 for part in parts)
            serial = device.control(0x80, 6, 0x0300 | whole[16], 255).data
            assert serial[0] == len(serial)
            assert device.control(0x00, 9, head[5]).status == 0
            assert device.control(0x80, 8, 0, 1).data == head[5:6]
            assert device.control(0xC0, 0x55, 0, 4).status == -EPIPE, "what it does not know is a stall"
        free(port, bus_id).__exit__()


@pytest.mark.parametrize(
    ("command", "direction", "endpoint", "length", "packets", "named"),
    [
        *((1, 1, 15, 16 << 20, 0, None), (3, 1, 1, 64, 0, "command 0x3"), (1, 1, 1, 64, 7, "7 isochronous")),
        *(
            (1, 1, 1, (16 << 20) + 1, 0, "16777217 bytes"),
            (1, 2, 1, 64, 0, "direction 2"),
            (1, 1, 16, 64, 0, "endpoint 16"),
        ),
    ],
)
def test_a_command_that_no_device_here_can_obey_is_refused(
    command: int, direction: int, endpoint: int, length: int, packets: int, named: str | None
) -> None:
    header = struct.pack(">IIIIIIiiIi8x", command, 5, 1, direction, endpoint, 0, length, 0, packets, 0)
    if named is None:
        assert parse_command(header) == Submit(5, 0x80 | endpoint, True, 0, length, bytes(8))
    else:
        with pytest.raises(ProtocolError, match=named):
            parse_command(header)


def test_the_board_answers_a_terminal_that_is_ready_and_leaves_the_bus_without_power(world: World, port: int) -> None:
    with Imported(port, BOARD) as board:
        waiting = board.submit(2, 512)
        world.time.sleep_s(0.7)  # a heartbeat at least, but nobody listens
        assert board.finish(board.unlink(waiting)) == Ended(-ECONNRESET, b"", unlink=True)
        assert board.control(0x21, 0x22, 0x03).status == 0
        assert board.bulk(2, data=framed("C,7,STOP")).status == 0
        heard = b""
        while framed("A,7,STOP") not in heard:
            heard += board.bulk(2, 512).data
        world.fault("board off")
        with pytest.raises(ConnectionError):
            board.bulk(2, 512)
    assert BOARD not in list_devices(port)
    world.clear_faults()
    free(port, BOARD).__exit__()


def gencp(camera: Imported, command: int, payload: bytes) -> bytes:
    """A GenCP command's answer, over the control pipes."""
    packet = struct.pack("<4sHHHH", b"U3VC", 0x4000, command, len(payload), 1) + payload
    assert camera.bulk(1, data=packet).status == 0
    while True:
        ack = camera.bulk(1, 1024).data
        magic, status, answered = struct.unpack_from("<4sHH", ack)
        assert (magic, status) == (b"U3VC", 0)
        if answered != 0x0805:  # PENDING_ACK: the answer is on its way
            return ack[12:]


def test_a_whole_image_comes_through_the_stream_pipe(world: World, port: int) -> None:
    with Imported(port, CAMERA) as camera:
        sirm, payload = 0x1_1000, 128 * 96
        assert int.from_bytes(gencp(camera, 0x0800, struct.pack("<QHH", sirm + 8, 0, 8)), "little") == payload
        setup = ((0x18, 64), (0x2C, 64), (0x1C, payload), (0x20, 1), (0x24, 0), (0x28, 0), (0x04, 1))
        for offset, value in setup:
            gencp(camera, 0x0802, struct.pack("<QI", sirm + offset, value))
        leader, image, trailer = (camera.submit(3, length) for length in (64, payload, 64))
        for address in (0x200100, 0x200104):  # SingleFrame, AcquisitionStart
            gencp(camera, 0x0802, struct.pack("<QI", address, 1))
        assert camera.finish(leader).data[:4] == b"U3VL"
        pixels = np.frombuffer(camera.finish(image).data, np.uint8).reshape(96, 128)
        assert camera.finish(trailer).data[:4] == b"U3VT"
        seen = world.seen("left")
        assert seen is not None
        assert np.array_equal(pixels, seen)
