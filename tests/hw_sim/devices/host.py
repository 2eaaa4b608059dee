"""Owns a second, small host: raw USB3 Vision bytes, board lines and mode-setting calls, spelt out from the standards.

It shares nothing with the drivers, so that devices are judged by two readers of the same documents.
"""

from __future__ import annotations

import array
import binascii
import ctypes
import struct
import threading
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import serial
import usb.core
from numpy.typing import NDArray

WIDTH, HEIGHT = 400, 300
TIMEOUT_MS = 3000


class GencpError(Exception):
    """The camera refused; ``args[0]`` is the status."""


@dataclass
class GotFrame:
    leader: bytes
    payload: bytes
    trailer: bytes

    @property
    def block_id(self) -> int:
        return int(struct.unpack_from("<Q", self.leader, 8)[0])

    @property
    def time_ns(self) -> int:
        return int(struct.unpack_from("<Q", self.leader, 20)[0])

    @property
    def status(self) -> int:
        return int(struct.unpack_from("<H", self.trailer, 16)[0])

    @property
    def valid(self) -> int:
        return int(struct.unpack_from("<Q", self.trailer, 20)[0])

    @property
    def image(self) -> NDArray[np.uint8]:
        width, height = struct.unpack_from("<II", self.leader, 32)
        return np.frombuffer(self.payload, np.uint8).reshape(height, width)


class U3vHost:
    def __init__(self, backend: Any, serial_number: str) -> None:
        self.device = next(
            d
            for d in usb.core.find(find_all=True, backend=backend, bDeviceClass=0xEF)
            if usb.util.get_string(d, 7) == serial_number
        )
        self.device.set_configuration()
        self.request_id = 0
        sbrm = self.u64(0x1D8)
        self.sirm = self.u64(sbrm + 0x20)

    def command(self, code: int, payload: bytes) -> bytes:
        """Send one command; returns the payload of the final acknowledge."""
        self.request_id = self.request_id % 0xFFFF + 1
        packet = struct.pack("<IHHHH", 0x43563355, 0x4000, code, len(payload), self.request_id) + payload
        assert self.device.write(0x01, packet, TIMEOUT_MS) == len(packet)
        while True:
            raw: bytes = self.device.read(0x81, 1024, TIMEOUT_MS).tobytes()
            magic, status, answer, size, request_id = struct.unpack_from("<IHHHH", raw)
            assert (magic, request_id, size) == (0x43563355, self.request_id, len(raw) - 12)
            if status:
                raise GencpError(status)
            if answer != 0x0805:  # it takes longer
                assert answer == code + 1
                return raw[12:]

    def read(self, address: int, size: int) -> bytes:
        data = self.command(0x0800, struct.pack("<QHH", address, 0, size))
        assert len(data) == size
        return data

    def put(self, address: int, value: int) -> None:
        assert self.command(0x0802, struct.pack("<QI", address, value)) == struct.pack("<HH", 0, 4)

    def u32(self, address: int) -> int:
        return int.from_bytes(self.read(address, 4), "little")

    def u64(self, address: int) -> int:
        return int.from_bytes(self.read(address, 8), "little")

    def set_up_stream(self) -> None:
        payload = self.u64(self.sirm + 8)
        values = ((0x18, 52), (0x1C, payload), (0x20, 1), (0x24, 0), (0x28, 0), (0x2C, 32))
        for offset, value in values:
            self.put(self.sirm + offset, value)
        self.device.clear_halt(0x83)
        self.put(self.sirm + 4, 1)

    def frame(self, timeout_ms: int = TIMEOUT_MS, payload: int = WIDTH * HEIGHT) -> GotFrame:
        leader = self.device.read(0x83, 52, timeout_ms).tobytes()
        buffer = array.array("B", bytes(payload))
        got = self.device.read(0x83, buffer, timeout_ms)
        trailer = self.device.read(0x83, 32, timeout_ms).tobytes()
        return GotFrame(leader, buffer[:got].tobytes(), trailer)


def framed(body: str) -> bytes:
    return f"${body}*{binascii.crc_hqx(body.encode(), 0xFFFF):04X}\r\n".encode()


class BoardHost:
    def __init__(self, url: str = "kfsim://main/board") -> None:
        self.port = serial.serial_for_url(url, timeout=1.0)
        self.number = 100
        self.reports: list[list[str]] = []
        self.received = b""

    def next_line(self) -> list[str] | None:
        """The words of the next good line, ``None`` after the timeout."""
        while b"\n" not in self.received:
            more = self.port.read(max(1, self.port.in_waiting))
            if not more:
                return None
            self.received += more
        raw, _, self.received = self.received.partition(b"\n")
        body = raw[raw.rfind(b"$") + 1 :].rpartition(b"*")[0].decode(errors="replace")
        return body.split(",") if raw.endswith(framed(body)[:-1]) else ["garbage"]

    def ask(self, *words: object) -> list[str]:
        """Send a command, return the words behind its verb; a refusal is ['N', code, text]."""
        self.number += 1
        self.port.write(framed(",".join(["C", str(self.number), *map(str, words)])))
        while (got := self.next_line()) is not None:
            if got[0] in "AN" and got[1] == str(self.number):
                return got[3:] if got[0] == "A" else ["N", *got[3:]]
            self.reports.append(got)
        raise AssertionError(f"no answer to {words}")

    def wait_report(self, verb: str, most: int = 200) -> list[str]:
        for _ in range(most):
            got = self.next_line()
            assert got is not None, f"no {verb}; got {self.reports[-3:]}"
            self.reports.append(got)
            if got[0] == "R" and got[2] == verb:
                return got
        raise AssertionError(f"no {verb} among {most} lines")


def iowr(number: int, size: int) -> int:
    return 3 << 30 | size << 16 | ord("d") << 8 | number


class CardHost:
    """One head of the card, with dumb buffers to flip to."""

    def __init__(self, node: Any, connector_type: int) -> None:
        self.node = node
        crtcs, connectors = self.resources()
        index, self.connector = next(
            (i, c) for i, c in enumerate(connectors) if self.connector_info(c)["type"] == connector_type
        )
        self.crtc = crtcs[index]
        self.mode = self.connector_info(self.connector)["modes"][0]
        self.size = struct.unpack_from("<IH8xH", self.mode)[1:]
        self.fbs: list[tuple[int, NDArray[np.uint8]]] = []

    def call(self, number: int, form: str, *values: int) -> list[int]:
        buffer = bytearray(struct.pack(form, *values))
        self.node.ioctl(iowr(number, len(buffer)), buffer)
        return list(struct.unpack(form, buffer))

    def resources(self) -> tuple[list[int], list[int]]:
        form = "<4Q8I"
        counts = self.call(0xA0, form, *[0] * 12)[4:8]
        arrays = [(ctypes.c_uint32 * max(1, n))() for n in counts]
        self.call(0xA0, form, *(ctypes.addressof(a) for a in arrays), *counts, 0, 0, 0, 0)
        return list(arrays[1]), list(arrays[2])

    def connector_info(self, connector: int) -> dict[str, Any]:
        form = "<4Q12I"
        counts = self.call(0xA7, form, 0, 0, 0, 0, 0, 0, 0, 0, connector, 0, 0, 0, 0, 0, 0, 0)[4:7]
        modes = ctypes.create_string_buffer(68 * counts[0])
        props, values = (ctypes.c_uint32 * counts[1])(), (ctypes.c_uint64 * counts[1])()
        encoders = (ctypes.c_uint32 * counts[2])()
        pointers = [ctypes.addressof(x) for x in (encoders, modes, props, values)]
        got = self.call(0xA7, form, *pointers, *counts, 0, connector, 0, 0, 0, 0, 0, 0, 0)
        return {
            "type": got[9],
            "connected": got[11] == 1,
            "modes": [modes.raw[i : i + 68] for i in range(0, 68 * counts[0], 68)],
            "properties": dict(zip(props, values, strict=True)),
        }

    def set_property(self, name: str, choice: str) -> None:
        form = "<QQII32sII"
        for prop in self.connector_info(self.connector)["properties"]:
            buffer = bytearray(struct.pack(form, 0, 0, prop, 0, b"", 0, 0))
            self.node.ioctl(iowr(0xAA, len(buffer)), buffer)
            *_, got_name, _, enums = struct.unpack(form, buffer)
            if got_name.rstrip(b"\0").decode() != name:
                continue
            entries = ctypes.create_string_buffer(40 * enums)
            buffer = bytearray(struct.pack(form, 0, ctypes.addressof(entries), prop, 0, b"", 0, enums))
            self.node.ioctl(iowr(0xAA, len(buffer)), buffer)
            choices = {text.rstrip(b"\0").decode(): value for value, text in struct.iter_unpack("<Q32s", entries.raw)}
            self.call(0xBA, "<QIIII", choices[choice], prop, self.connector, 0xC0C0C0C0, 0)
            return
        raise AssertionError(f"no property {name}")

    def buffer(self, image: NDArray[np.uint8]) -> int:
        """A new framebuffer with that (h, w) grey image; returns its index."""
        height, width = image.shape
        _, _, _, _, handle, pitch, size = self.call(0xB2, "<6IQ", height, width, 32, 0, 0, 0, 0)
        offset = self.call(0xB3, "<IIQ", handle, 0, 0)[2]
        rows = np.frombuffer(self.node.map(size, offset), np.uint8)[: pitch * height].reshape(height, pitch)
        pixels = rows[:, : 4 * width].reshape(height, width, 4)
        pixels[:, :, :3] = image[:, :, None]
        fb = self.call(0xAE, "<7I", 0, width, height, pitch, 32, 24, handle)[0]
        self.fbs.append((fb, pixels))
        return len(self.fbs) - 1

    def set_mode(self, index: int) -> None:
        connectors = (ctypes.c_uint32 * 1)(self.connector)
        head = struct.pack("<QIIIIIII", ctypes.addressof(connectors), 1, self.crtc, self.fbs[index][0], 0, 0, 0, 1)
        buffer = bytearray(head + self.mode)
        self.node.ioctl(iowr(0xA2, len(buffer)), buffer)

    def flip(self, index: int, user_data: int = 0) -> None:
        self.call(0xB0, "<IIIIQ", self.crtc, self.fbs[index][0], 1, 0, user_data)

    def wait_flip(self, timeout_s: float = 3.0) -> dict[str, int]:
        assert self.node.wait_readable(timeout_s)
        kind, length, user, seconds, micros, sequence, crtc = struct.unpack("<IIQIIII", self.node.read(1024))
        assert (kind, length) == (2, 32)
        return {"user": user, "time_ns": (seconds * 1_000_000 + micros) * 1000, "sequence": sequence, "crtc": crtc}

    def show(self, index: int) -> dict[str, int]:
        self.flip(index, index)
        return self.wait_flip()


def stripes(period: int, phase: int = 0) -> NDArray[np.uint8]:
    columns = np.arange(1024)
    row = (127.5 + 127.5 * np.cos(2 * np.pi * (columns / period + phase / 4))).round().astype(np.uint8)
    return np.tile(row, (768, 1))


def greys(values: Sequence[int]) -> list[NDArray[np.uint8]]:
    return [np.full((768, 1024), value, np.uint8) for value in values]


@dataclass
class Recorder:
    """Records a sequence as an instrument does: arm the board, flip the projector, read both cameras."""

    cameras: dict[str, U3vHost]
    board: BoardHost
    projector: CardHost
    shades: list[int]
    payload: int

    def record(
        self,
        delay_us: int = 500,
        width_us: int = 8000,
        between: Callable[[int], None] = lambda k: None,
        frames: int | None = None,
        timeout_ms: int = 300,
    ) -> dict[str, list[GotFrame | str]]:
        """All frames of each side, in the order they came; what failed is there by the name of its error.

        ``between(k)`` is called before each flip: a slow host waits there. ``frames``: how many are expected.
        """
        got: dict[str, list[GotFrame | str]] = {side: [] for side in self.cameras}
        count = len(self.shades)

        def read(side: str) -> None:
            for _ in range(count if frames is None else frames):
                try:
                    got[side].append(self.cameras[side].frame(timeout_ms, self.payload))
                except usb.core.USBError as error:
                    got[side].append(type(error).__name__)
                    if not isinstance(error, usb.core.USBTimeoutError):
                        return

        readers = [threading.Thread(target=read, args=(side,)) for side in self.cameras]
        self.projector.show(0)
        now = int(self.board.ask("VSYNC")[0])
        assert self.board.ask("ARM", count, now + 3, delay_us, width_us)[0] == str(count)
        for reader in readers:
            reader.start()
        self.flips = [self.projector.show(0) for _ in range(2)]
        for k, shade in enumerate(self.shades):
            between(k)
            self.flips.append(self.projector.show(shade))
        for reader in readers:
            reader.join(20)
            assert not reader.is_alive()
        return got


def good(frames: list[GotFrame | str]) -> list[GotFrame]:
    return [f for f in frames if isinstance(f, GotFrame) and f.leader[:4] == b"U3VL" and f.status == 0]
