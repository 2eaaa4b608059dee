"""The exporter as a kernel meets it: list, import, enumeration, transfers that end, are taken back, or lose their device."""

from __future__ import annotations

import io
import re
import struct
import zipfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress

import numpy as np
import pytest

from hw_sim.wires.usbip.exporter import Exporter
from hw_sim.world import World, WorldOptions
from tests.hw_sim.wires.usbip.host import Ended, Imported, Listed, Refused, connect, list_devices

EPIPE, ECONNRESET, EREMOTEIO = 32, 104, 121
CAMERA, KEYPAD, BOARD = "1-1", "1-3", "1-4"


@contextmanager
def exported(**options: object) -> Iterator[tuple[World, Exporter]]:
    settings = {"world": "usbip", "width_px": 128, "height_px": 96, "truth": "nominal", **options}
    with World(WorldOptions(**settings)) as world, Exporter(world, 0) as exporter:  # type: ignore[arg-type]
        yield world, exporter


@pytest.fixture
def door() -> Iterator[tuple[World, Exporter]]:
    with exported() as pair:
        yield pair


def test_the_list_names_the_four_devices_with_their_classes_and_speeds(door: tuple[World, Exporter]) -> None:
    vision = ((0xEF, 5, 0), (0xEF, 5, 1), (0xEF, 5, 2))
    assert list_devices(door[1].port) == [
        Listed("1-1", 5, 0x1209, 0x4B43, vision),
        Listed("1-2", 5, 0x1209, 0x4B43, vision),
        Listed("1-3", 2, 0x1209, 0x4B46, ((3, 0, 0),)),
        Listed("1-4", 3, 0x1209, 0x4B42, ((2, 2, 1), (0x0A, 0, 0))),
    ]


def test_only_this_machine_reaches_it(door: tuple[World, Exporter]) -> None:
    assert door[1]._door.getsockname()[0] == "127.0.0.1"


def descriptors(configuration: bytes) -> list[bytes]:
    """The chain of descriptors, each checked to lie within the whole."""
    parts, at = [], 0
    while at < len(configuration):
        assert configuration[at] >= 2
        assert at + configuration[at] <= len(configuration)
        parts.append(configuration[at : at + configuration[at]])
        at += configuration[at]
    return parts


@pytest.mark.parametrize("bus_id", ["1-1", "1-2", "1-3", "1-4"])
def test_a_kernel_can_enumerate_each_device(door: tuple[World, Exporter], bus_id: str) -> None:
    with Imported(door[1].port, bus_id) as device:
        short = device.control(0x80, 6, 0x0100, 0, 8)  # a kernel asks for eight bytes first
        assert (short.status, short.length) == (0, 8)
        whole = device.control(0x80, 6, 0x0100, 0, 64)
        assert whole.length == 18
        assert whole.data[:8] == short.data
        vendor, product = struct.unpack_from("<HH", whole.data, 8)
        assert (vendor, product) == struct.unpack_from(">HH", device.record, 0x12C)
        head = device.control(0x80, 6, 0x0200, 0, 9)
        (total,) = struct.unpack_from("<H", head.data, 2)
        parts = descriptors(device.control(0x80, 6, 0x0200, 0, total).data)
        assert sum(map(len, parts)) == total
        interfaces = [part for part in parts if part[1] == 4]
        assert [part[2] for part in interfaces] == list(range(head.data[4]))
        assert sum(part[4] for part in interfaces) == sum(part[1] == 5 for part in parts)
        serial = device.control(0x80, 6, 0x0300 | whole.data[16], 0x0409, 255).data
        assert serial[0] == len(serial)
        assert device.control(0x00, 9, head.data[5], 0).status == 0
        assert device.control(0x80, 8, 0, 0, 1).data == head.data[5:6]
        assert device.control(0x80, 6, 0x0F00 | 0x77, 0, 5).status == (0 if bus_id < "1-3" else -EPIPE)


def test_a_device_serves_one_host_and_comes_free_when_it_lets_go(door: tuple[World, Exporter]) -> None:
    _, exporter = door
    with Imported(exporter.port, BOARD):
        assert [d.bus_id for d in list_devices(exporter.port)] == ["1-1", "1-2", "1-3"]
        with pytest.raises(Refused):
            Imported(exporter.port, BOARD)
    with pytest.raises(Refused):
        Imported(exporter.port, "7-7")
    with wait_until_free(exporter, BOARD) as board:
        assert board.control(0x80, 6, 0x0100, 0, 18).length == 18


def wait_until_free(exporter: Exporter, bus_id: str) -> Imported:
    for _ in range(200):
        try:
            return Imported(exporter.port, bus_id)
        except Refused:
            continue
    raise AssertionError(f"{bus_id} stays taken")


def test_a_machine_that_is_reset_finds_its_devices_free(door: tuple[World, Exporter]) -> None:
    _, exporter = door
    with Imported(exporter.port, KEYPAD) as before:
        exporter.cut()
        with pytest.raises(ConnectionError):
            before.ended()
        with wait_until_free(exporter, KEYPAD) as after:
            assert after.control(0x80, 6, 0x0100, 0, 18).length == 18


# ---------------------------------------------------------------------------------------------------- key pad


def test_a_press_arrives_as_an_interrupt_report(door: tuple[World, Exporter]) -> None:
    world, exporter = door
    with Imported(exporter.port, KEYPAD) as pad:
        report = pad.control(0x81, 6, 0x2200, 0, 255).data
        assert report[:3] == bytes.fromhex("06 4b ff"), "usage page FF4B"
        assert pad.control(0x21, 0x0A, 0, 0).status == 0  # usbhid: SET_IDLE
        seen = []
        for _ in range(4):
            seen.append(pad.bulk_in(1, 8).data)
        world.press("up", hold_s=1.0)
        for _ in range(12):
            seen.append(pad.bulk_in(1, 8).data)
            if seen[-1][1] == 0x04:
                break
        assert seen[-1][1] == 0x04
        assert all(len(report) == 8 and report[0] == 1 for report in seen)


def test_a_report_that_nobody_fetched_is_overwritten(door: tuple[World, Exporter]) -> None:
    world, exporter = door
    with Imported(exporter.port, KEYPAD) as pad:
        first = pad.bulk_in(1, 8).data[2]
        world.time.sleep_s(1.1)  # four reports or so, and nobody asks
        late, next_one = pad.bulk_in(1, 8).data[2], pad.bulk_in(1, 8).data[2]
        assert (late - first) % 256 >= 3
        assert (next_one - late) % 256 == 1


# ------------------------------------------------------------------------------------------------------ board


def crc16(data: bytes) -> int:
    """CRC-16/CCITT-FALSE, bit by bit."""
    crc = 0xFFFF
    for byte in data:
        crc ^= byte << 8
        for _ in range(8):
            crc = (crc << 1 ^ (0x1021 if crc & 0x8000 else 0)) & 0xFFFF
    return crc


def ask(board: Imported, text: str) -> bytes:
    """Everything that is read until the answer to this command has come."""
    body = text.encode()
    assert board.bulk_out(2, b"$" + body + b"*%04X\r\n" % crc16(body)).status == 0
    heard = b""
    for _ in range(50):
        heard += board.bulk_in(2, 512).data
        if b"$A," in heard and heard.endswith(b"\r\n"):
            return heard
    raise AssertionError(f"no answer in {heard!r}")


def test_the_board_answers_a_terminal_that_is_ready(door: tuple[World, Exporter]) -> None:
    world, exporter = door
    with Imported(exporter.port, BOARD) as board:
        coding = struct.pack("<IBBB", 9600, 0, 0, 8)
        assert board.control(0x21, 0x20, 0, 0, data=coding).status == 0
        assert board.control(0xA1, 0x21, 0, 0, 7).data == coding
        waiting = board.submit(2, length=512, inward=True)
        world.time.sleep_s(0.7)  # a heartbeat at least, but nobody listens
        taken_back = board.unlink(waiting)
        assert board.ended() == Ended(taken_back, -ECONNRESET, 0, b"", unlink=True)
        assert board.control(0x21, 0x22, 0x03, 0).status == 0
        heard = ask(board, "C,7,INFO")
        answer = next(line for line in heard.split(b"\r\n") if line.startswith(b"$A,7,INFO,"))
        assert b",KF-BRD-0001," in answer
        assert int(answer[-4:], 16) == crc16(answer[1:-5])


def test_a_transfer_that_had_ended_is_not_taken_back(door: tuple[World, Exporter]) -> None:
    with Imported(door[1].port, KEYPAD) as pad:
        number = pad.submit(1, length=8, inward=True)
        assert pad.finish(number).length == 8
        assert pad.finish(pad.unlink(number)).status == 0


def test_a_board_without_power_leaves_the_bus_and_comes_back(door: tuple[World, Exporter]) -> None:
    world, exporter = door
    with Imported(exporter.port, BOARD) as board:
        world.fault("board off")
        with pytest.raises(ConnectionError):
            board.ended()
    assert BOARD not in [device.bus_id for device in list_devices(exporter.port)]
    with pytest.raises(Refused):
        Imported(exporter.port, BOARD)
    world.clear_faults()
    with wait_until_free(exporter, BOARD) as board:
        assert board.control(0x80, 6, 0x0100, 0, 18).length == 18


# ---------------------------------------------------------------------------------------------------- cameras

READ, WRITE = 0x0800, 0x0802


def gencp(camera: Imported, command: int, payload: bytes, number: int) -> bytes:
    """A GenCP command's answer, over the control pipes."""
    packet = struct.pack("<4sHHHH", b"U3VC", 0x4000, command, len(payload), number) + payload
    assert camera.bulk_out(1, packet).status == 0
    while True:
        ack = camera.bulk_in(1, 1024).data
        magic, status, answered, size, request = struct.unpack_from("<4sHHHH", ack)
        assert (magic, request, status) == (b"U3VC", number, 0)
        if answered != 0x0805:  # PENDING_ACK: the answer is on its way
            assert size == len(ack) - 12
            return ack[12:]


def read(camera: Imported, address: int, size: int) -> bytes:
    return gencp(camera, READ, struct.pack("<QHH", address, 0, size), 1)


def write(camera: Imported, address: int, value: int) -> None:
    gencp(camera, WRITE, struct.pack("<QI", address, value), 2)


def registers(camera: Imported) -> dict[str, int]:
    """Addresses of features by their names in the camera's own XML."""
    manifest = struct.unpack("<Q", read(camera, 0x1D0, 8))[0]
    _, _, address, size = struct.unpack("<IIQQ", read(camera, manifest + 8, 24))
    data = b"".join(read(camera, address + at, min(512, size - at)) for at in range(0, size, 512))
    if data[:2] == b"PK":
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            data = archive.read(archive.namelist()[0])
    found = re.findall(rb'<IntReg Name="(\w+)Reg">.*?<Address>(0x[0-9A-Fa-f]+|\d+)</Address>', data, re.DOTALL)
    return {name.decode(): int(address, 0) for name, address in found}


def test_a_whole_image_comes_through_the_stream_pipe(door: tuple[World, Exporter]) -> None:
    world, exporter = door
    with Imported(exporter.port, CAMERA) as camera:
        assert read(camera, 0x004, 64).rstrip(b"\0") == b"Kingfisher"
        at = registers(camera)
        sbrm = struct.unpack("<Q", read(camera, 0x1D8, 8))[0]
        sirm = struct.unpack("<Q", read(camera, sbrm + 0x20, 8))[0]
        payload = struct.unpack("<Q", read(camera, sirm + 0x08, 8))[0]
        assert payload == 128 * 96
        for offset, value in ((0x18, 64), (0x2C, 64), (0x1C, payload), (0x20, 1), (0x24, 0), (0x28, 0), (0x04, 1)):
            write(camera, sirm + offset, value)
        leader = camera.submit(3, length=64, inward=True)
        image = camera.submit(3, length=payload, inward=True)
        trailer = camera.submit(3, length=64, inward=True)
        write(camera, at["AcquisitionMode"], 1)  # SingleFrame
        write(camera, at["AcquisitionStart"], 1)
        assert camera.finish(leader).data[:4] == b"U3VL"
        pixels = np.frombuffer(camera.finish(image).data, np.uint8).reshape(96, 128)
        assert camera.finish(trailer).data[:4] == b"U3VT"
        seen = world.seen("left")
        assert seen is not None
        assert np.array_equal(pixels, seen)


def test_what_the_camera_does_not_know_is_a_stall(door: tuple[World, Exporter]) -> None:
    with Imported(door[1].port, CAMERA) as camera:
        assert camera.control(0x00, 0x30, 0, 0, data=bytes(6)).status == -EPIPE  # SET_SEL: no link power management
        assert camera.control(0xC0, 0x55, 0, 0, 4).status == -EPIPE
        assert camera.bulk_out(5, b"nobody").status == -EPIPE
        assert camera.control(0x80, 6, 0x0100, 0, 18).status == 0, "endpoint 0 recovers by itself"


def test_a_short_transfer_stops_those_behind_it_where_short_is_an_error(door: tuple[World, Exporter]) -> None:
    with Imported(door[1].port, CAMERA) as camera:
        first = camera.submit(1, length=512, inward=True, flags=0x0001)
        second = camera.submit(1, length=512, inward=True)
        packet = struct.pack("<4sHHHHQHH", b"U3VC", 0x4000, READ, 12, 9, 0x004, 0, 8)
        sent = camera.submit(1, data=packet, inward=False)
        answers = {ended.number: ended for ended in (camera.ended(), camera.ended())}
        assert answers[sent].status == 0
        assert (answers[first].status, answers[first].length) == (-EREMOTEIO, 20)
        again = camera.submit(1, data=packet, inward=False)
        assert camera.finish(again).status == 0
        taken_back = camera.unlink(second)
        assert camera.finish(taken_back).status == -ECONNRESET
        assert camera.bulk_in(1, 512).length == 20, "the second answer was not swallowed by the transfer taken back"


# ------------------------------------------------------------------------------------------------- other hosts


@pytest.mark.parametrize(
    "nonsense",
    [b"GET / HTTP/1.1\r\n\r\n", bytes(8), bytes.fromhex("0106 8005 0000 0000"), bytes.fromhex("0111 8009 0000 0000")],
    ids=["http", "zeros", "old version", "unknown operation"],
)
def test_who_does_not_speak_usbip_is_shown_out(door: tuple[World, Exporter], nonsense: bytes) -> None:
    with connect(door[1].port) as connection:
        connection.sendall(nonsense)
        with suppress(ConnectionResetError):  # what it did not read is thrown away with the connection
            assert connection.recv(64) == b""
    assert len(list_devices(door[1].port)) == 4


@pytest.mark.parametrize("length", [-1, 1 << 30], ids=["negative", "a gigabyte"])
def test_a_transfer_of_impossible_length_ends_the_session(door: tuple[World, Exporter], length: int) -> None:
    _, exporter = door
    with Imported(exporter.port, CAMERA) as camera:
        camera._connection.sendall(struct.pack(">IIIIIIiiIi8x", 1, 1, 0, 1, 3, 0, length, 0, 0, 0))
        with pytest.raises(ConnectionError):
            camera.ended()
    with wait_until_free(exporter, CAMERA) as camera:
        assert camera.control(0x80, 6, 0x0100, 0, 18).status == 0
