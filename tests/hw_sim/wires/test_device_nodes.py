"""Device nodes by the kernel's rules, asked over the preload library's socket by a host that is written here again."""

from __future__ import annotations

import ctypes
import errno
import select
import socket
import struct
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from types import TracebackType
from typing import Self

import pytest

from hw_sim.devices import keypad as pad
from hw_sim.wires.umockdev.readiness import Readiness
from hw_sim.wires.umockdev.testbed import Testbed
from hw_sim.wires.umockdev.uevent import message
from hw_sim.world import World, WorldOptions

IOCTL, DONE, READ_MEMORY, WRITE_MEMORY, READ = 1, 3, 5, 6, 7
CAPABILITIES, CLAIM, RELEASE = 0x8004551A, 0x8004550F, 0x80045510
SUBMIT, DISCARD, REAP = 0x8038550A, 0x0000550B, 0x4008550D
BULK, STREAM_IN, CONTROL_IN = 3, 0x83, 0x81


class Failed(Exception):
    """A system call returned -1."""

    def __init__(self, number: int) -> None:
        super().__init__(errno.errorcode[number])
        self.number = number


class Host:
    """An opened node: system calls as the preload library sends them, served with this process's memory."""

    def __init__(self, root: Path, node: str) -> None:
        self._socket = socket.socket(socket.AF_UNIX)
        self._socket.settimeout(10)
        self._socket.connect(str(root / "ioctl" / "dev" / node))

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._socket.close()

    def call(self, command: int, first: int, second: int) -> int:
        self._socket.sendall(struct.pack("<QQQ", command, first, second))
        while True:
            numbers: tuple[int, int, int] = struct.unpack("<QqQ", self._receive(24))
            answer, one, two = numbers
            match answer:
                case 3:
                    if one < 0:
                        raise Failed(two)
                    return one
                case 5:
                    self._socket.sendall(ctypes.string_at(one, two))
                case 6:
                    ctypes.memmove(one, self._receive(two), two)

    def _receive(self, size: int) -> bytes:
        data = b""
        while len(data) < size:
            part = self._socket.recv(size - len(data))
            assert part, "the node hung up"
            data += part
        return data

    def ioctl(self, request: int, argument: ctypes.Array[ctypes.c_char] | ctypes.c_uint32) -> int:
        return self.call(IOCTL, request, ctypes.addressof(argument))


def urb(endpoint: int, buffer: ctypes.Array[ctypes.c_char]) -> ctypes.Array[ctypes.c_char]:
    """``struct usbdevfs_urb`` of a bulk transfer, on 64 bits."""
    head = struct.pack("<BBxxiIxxxxQi", BULK, endpoint, 0, 0, ctypes.addressof(buffer), len(buffer))
    return ctypes.create_string_buffer(head.ljust(56, b"\0"), 56)


def reap(host: Host) -> tuple[int, int, int]:
    """Address of the URB that is complete, its status and its length."""
    pointer = ctypes.create_string_buffer(8)
    host.ioctl(REAP, pointer)
    (address,) = struct.unpack("<Q", pointer.raw)
    raw = ctypes.string_at(address, 56)
    return address, *struct.unpack_from("<i", raw, 4), *struct.unpack_from("<i", raw, 28)


@pytest.fixture
def world() -> Iterator[World]:
    with World(WorldOptions(world="nodes", width_px=160, height_px=120, truth="nominal", pace="realtime")) as made:
        yield made


@pytest.fixture
def bed(world: World) -> Iterator[Testbed]:
    with Testbed(world) as made:
        yield made


def node(bed: Testbed, serial_guid: str) -> str | None:
    """Where a camera's node is, by what sysfs says; ``None`` where it is not on the bus."""
    for device in (bed.root / "sys" / "bus" / "usb" / "devices").iterdir():
        serial = device / "serial"
        if serial.exists() and serial.read_text().strip() == serial_guid and (device / "uevent").exists():
            lines = dict(line.split("=", 1) for line in (device / "uevent").read_text().splitlines())
            return lines["DEVNAME"]
    return None


def ready(path: Path, events: int) -> bool:
    """What ``poll`` says of a node that a host has opened."""
    with path.open("r+b", buffering=0) as opened:
        poll = select.poll()
        poll.register(opened, events)
        return bool(poll.poll(0))


@pytest.mark.parametrize(("for_writing", "events"), [(False, select.POLLIN), (True, select.POLLOUT)])
def test_poll_tells_what_was_said(tmp_path: Path, for_writing: bool, events: int) -> None:
    path = tmp_path / "node"
    readiness = Readiness(path, for_writing)
    with path.open("r+b", buffering=0) as opened:
        poll = select.poll()
        poll.register(opened, events)
        told = []
        for say in (False, True, True, False, True, False):
            readiness.set(say)
            told.append(bool(poll.poll(0)))
        assert told == [False, True, True, False, True, False]
        readiness.close()
        assert poll.poll(0), "whoever waits for a device that is gone learns of it"


def test_an_interface_has_one_owner(world: World, bed: Testbed) -> None:
    where = node(bed, world.cameras["left"].identity.guid) or ""
    number = ctypes.c_uint32(0)
    with Host(bed.root, where) as first, Host(bed.root, where) as second:
        first.ioctl(CLAIM, number)
        with pytest.raises(Failed, match="EBUSY"):
            second.ioctl(CLAIM, number)
        first.ioctl(RELEASE, number)
        second.ioctl(CLAIM, number)
        with pytest.raises(Failed, match="ENOENT"):
            second.ioctl(CLAIM, ctypes.c_uint32(7))
        with pytest.raises(Failed, match="ENOTTY"):
            second.ioctl(0x0000_5463, number)


def test_a_transfer_that_is_given_up_comes_back_as_such(world: World, bed: Testbed) -> None:
    where = node(bed, world.cameras["left"].identity.guid) or ""
    path = bed.root / "dev" / where
    buffer = ctypes.create_string_buffer(1024)
    wanted = urb(CONTROL_IN, buffer)
    with Host(bed.root, where) as host:
        host.ioctl(SUBMIT, wanted)
        with pytest.raises(Failed, match="EAGAIN"):
            reap(host)
        assert not ready(path, select.POLLOUT)
        host.ioctl(DISCARD, wanted)
        assert ready(path, select.POLLOUT)
        assert reap(host) == (ctypes.addressof(wanted), -errno.ENOENT, 0)
        assert not ready(path, select.POLLOUT)
        with pytest.raises(Failed, match="EINVAL"):
            host.ioctl(DISCARD, wanted)


def test_an_unplugged_camera_ends_what_waits_and_refuses_the_rest(world: World, bed: Testbed) -> None:
    where = node(bed, world.cameras["left"].identity.guid) or ""
    wanted = urb(STREAM_IN, ctypes.create_string_buffer(1024))
    with Host(bed.root, where) as host:
        host.ioctl(SUBMIT, wanted)
        world.fault("camera.left off")
        poll_until(lambda: not (bed.root / "dev" / where).exists())
        assert reap(host) == (ctypes.addressof(wanted), -errno.ESHUTDOWN, 0)
        with pytest.raises(Failed, match="ENODEV"):
            reap(host)
        with pytest.raises(Failed, match="ENODEV"):
            host.ioctl(CAPABILITIES, ctypes.c_uint32(0))
    world.clear_faults()
    poll_until(lambda: node(bed, world.cameras["left"].identity.guid) is not None)
    assert node(bed, world.cameras["left"].identity.guid) != where, "it comes back under another address"


def test_a_read_of_the_pad_gives_one_report(world: World, bed: Testbed) -> None:
    memory = ctypes.create_string_buffer(64)
    with Host(bed.root, "hidraw0") as host:
        for _ in range(2):
            length = host.call(READ, ctypes.addressof(memory), 64)
            assert length == 8
            assert memory.raw[0] == pad.REPORT_NUMBER
        world.fault("keypad off")

        def drain() -> None:
            """Reports that were sent before can still be read."""
            for _ in range(10):
                host.call(READ, ctypes.addressof(memory), 64)

        with pytest.raises(Failed, match="EIO"):
            drain()


def test_a_message_has_the_form_of_udev() -> None:
    data = message(
        "add", "devices/x/2-1", 7, {"SUBSYSTEM": "usb", "DEVTYPE": "usb_device", "DEVNAME": "/dev/bus/usb/002/003"}
    )
    assert data[:12] == b"libudev\0\xfe\xed\xca\xfe"
    size, offset, length = struct.unpack_from("<III", data, 12)
    assert size == offset == 40
    assert len(data) == offset + length
    said = dict(pair.split("=", 1) for pair in data[offset:-1].decode().split("\0"))
    assert said["DEVPATH"] == "/devices/x/2-1"
    assert (said["ACTION"], said["SEQNUM"], said["DEVTYPE"]) == ("add", "7", "usb_device")


def poll_until(happened: Callable[[], bool]) -> None:
    """Within 5 s."""
    end = time.monotonic() + 5
    while not happened():
        assert time.monotonic() < end
        time.sleep(0.01)
