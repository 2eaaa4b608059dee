"""A virtual screen (Xvfb), what it shows, and the keyboard and window manager before it: X11 spoken over its socket.

Requests and replies by the X Window System Protocol, version 11, appendix B; FakeInput by the XTEST extension 2.2.
"""

from __future__ import annotations

import os
import select
import shutil
import socket
import struct
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

KEYSYMS = {"Return": 0xFF0D}
"""X11/keysymdef.h; letters are their Latin-1 codes."""
SCREEN_PX = (1400, 900)
START_S = 20.0
KEY_PRESS, KEY_RELEASE, CLIENT_MESSAGE = 2, 3, 33


@dataclass(frozen=True, slots=True)
class XWindow:
    """A window of the root: number, title, and where it is."""

    number: int
    title: str
    x: int
    y: int
    width: int
    height: int


class Xvfb:
    """A running virtual screen of 1400 × 900 with one client on it. ``name`` is for ``DISPLAY``."""

    def __init__(self, name: str, framebuffer: Path) -> None:
        self.name = name
        self._framebuffer = framebuffer
        self._socket = socket.socket(socket.AF_UNIX)
        self._socket.settimeout(START_S)
        self._socket.connect(f"/tmp/.X11-unix/X{name[1:]}")
        self._socket.sendall(struct.pack("<BxHHHH2x", ord("l"), 11, 0, 0, 0))
        status, length = struct.unpack("<B5xH", self._read(8))
        setup = self._read(4 * length)
        assert status == 1, setup
        vendor_length, formats = struct.unpack_from("<H", setup, 16)[0], setup[21]
        self._root = struct.unpack_from("<I", setup, 32 + (vendor_length + 3) // 4 * 4 + 8 * formats)[0]
        self._first_key, self._last_key = setup[26], setup[27]
        self._xtest = self._ask(98, 0, struct.pack("<H2x", 5) + b"XTEST\0\0\0")[9]
        assert self._xtest, "no XTEST"
        # Without a window manager nobody gives a window the keyboard: it follows the pointer (PointerRoot).
        self._tell(42, 1, struct.pack("<II", 1, 0))

    def close(self) -> None:
        self._socket.close()

    @property
    def windows(self) -> dict[str, XWindow]:
        """The windows that have a title and can be seen, by title."""
        reply = self._ask(15, 0, struct.pack("<I", self._root))
        found = {}
        for number in struct.unpack_from(f"<{struct.unpack_from('<H', reply, 16)[0]}I", reply, 32):
            title = self._property(number, self._atom("_NET_WM_NAME"))
            visible = self._ask(3, 0, struct.pack("<I", number))[26] == 2
            if title and visible:
                x, y, width, height = struct.unpack_from("<hhHH", self._ask(14, 0, struct.pack("<I", number)), 12)
                found[title] = XWindow(number, title, x, y, width, height)
        return found

    def picture(self, window: XWindow) -> NDArray[np.uint8]:
        """(height, width, 3) uint8 RGB of what the screen shows where the window is."""
        raw = self._framebuffer.read_bytes()
        # An XWD file (X11/XWDFile.h): big-endian header, colour map of 12 bytes an entry, rows of 32-bit pixels.
        header = struct.unpack_from(">25I", raw)
        size, width, height, stride, colours = header[0], header[4], header[5], header[12], header[19]
        rows = np.frombuffer(raw, np.uint8, stride * height, size + 12 * colours).reshape(height, stride)
        pixels = rows[:, : 4 * width].reshape(height, width, 4)
        part = pixels[window.y : window.y + window.height, window.x : window.x + window.width, 2::-1]
        return np.ascontiguousarray(part)

    def point(self, window: XWindow) -> None:
        """Move the pointer into the middle of a window, which so gets the keyboard."""
        motion = struct.pack("<BBxxIII", 6, 0, 0, self._root, 0)
        x, y = window.x + window.width // 2, window.y + window.height // 2
        self._fake(motion + struct.pack("<xxxxhh8x", x, y))

    def key(self, name: str, down: bool) -> None:
        """Press or release a key of the keyboard."""
        event = struct.pack("<BBxxII", KEY_PRESS if down else KEY_RELEASE, self._keycode(name), 0, 0)
        self._fake(event + bytes(20))

    def close_window(self, window: XWindow) -> None:
        """What a window manager does when its cross is clicked (ICCCM 4.2.8.1)."""
        message = struct.pack(
            "<BBHIIII12x",
            *(CLIENT_MESSAGE, 32, 0, window.number),
            *(self._atom("WM_PROTOCOLS"), self._atom("WM_DELETE_WINDOW"), 0),
        )
        self._tell(25, 0, struct.pack("<II", window.number, 0) + message)
        self._atom("WM_PROTOCOLS")  # its reply says that the message is under way

    def _fake(self, event: bytes) -> None:
        assert len(event) == 32, len(event)
        self._tell(self._xtest, 2, event)
        self._atom("WM_PROTOCOLS")  # as above

    def _keycode(self, name: str) -> int:
        keysym = KEYSYMS.get(name) or ord(name)
        count = self._last_key - self._first_key + 1
        reply = self._ask(101, 0, struct.pack("<BB2x", self._first_key, count))
        per_code = reply[1]
        table = np.frombuffer(reply, "<u4", count * per_code, 32).reshape(count, per_code)
        return self._first_key + int(np.flatnonzero(table[:, 0] == keysym)[0])

    def _atom(self, name: str) -> int:
        request = struct.pack("<H2x", len(name)) + name.encode().ljust((len(name) + 3) // 4 * 4, b"\0")
        return int(struct.unpack_from("<I", self._ask(16, 0, request), 8)[0])

    def _property(self, window: int, atom: int) -> str:
        reply = self._ask(20, 0, struct.pack("<IIIII", window, atom, 0, 0, 256))
        length = struct.unpack_from("<I", reply, 16)[0] * (reply[1] // 8)
        return reply[32 : 32 + length].decode("utf-8", "replace")

    def _tell(self, opcode: int, detail: int, body: bytes) -> None:
        self._socket.sendall(struct.pack("<BBH", opcode, detail, 1 + len(body) // 4) + body)

    def _ask(self, opcode: int, detail: int, body: bytes) -> bytes:
        self._tell(opcode, detail, body)
        while True:
            reply = self._read(32)
            assert reply[0] != 0, f"X11 error {reply[1]} on request {reply[10]}"
            if reply[0] == 1:
                return reply + self._read(4 * struct.unpack_from("<I", reply, 4)[0])

    def _read(self, count: int) -> bytes:
        got = b""
        while len(got) < count:
            part = self._socket.recv(count - len(got))
            assert part, "the X server has gone"
            got += part
        return got


@contextmanager
def xvfb(folder: Path) -> Iterator[Xvfb]:
    """A virtual screen of its own, gone afterwards."""
    program = shutil.which("Xvfb")
    assert program is not None, "look for it first"
    reader, writer = os.pipe()
    command = [program, "-displayfd", str(writer), "-screen", "0", f"{SCREEN_PX[0]}x{SCREEN_PX[1]}x24"]
    command += ["-nolisten", "tcp", "-noreset", "-fbdir", str(folder)]
    with (folder / "xvfb.log").open("wb") as log:
        server = subprocess.Popen(command, pass_fds=(writer,), stdout=log, stderr=log, stdin=subprocess.DEVNULL)
    os.close(writer)
    try:
        ready = select.select([reader], [], [], START_S)[0]
        number = os.read(reader, 16).decode().strip() if ready else ""
        assert number, (folder / "xvfb.log").read_text()
        screen = Xvfb(f":{number}", folder / "Xvfb_screen0")
        try:
            yield screen
        finally:
            screen.close()
    finally:
        os.close(reader)
        server.terminate()
        server.wait(START_S)
