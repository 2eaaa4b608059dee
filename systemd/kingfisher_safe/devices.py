"""Owns what the safe screen does with board and key pad: lasers and pulses off, and whether SCAN is pressed."""

from __future__ import annotations

import binascii
import contextlib
import os
import select
import termios
import time
from collections.abc import Callable
from pathlib import Path

REPORT_BYTES = 8
SCAN = 0x01
"""docs/protocols/keys.md."""
COMMANDS = ("STOP", "LASER,0,0")
ANSWER_S = 0.3
TRIES = 3


def sentence(number: int, command: str) -> bytes:
    """A command to the board (docs/protocols/board.md)."""
    body = f"C,{number},{command}".encode("ascii")
    return b"$" + body + f"*{binascii.crc_hqx(body, 0xFFFF):04X}\r\n".encode("ascii")


def lights_off(port: Path) -> bool:
    """Stop pulses and switch the lasers off; whether the board has acknowledged both. Never raises."""
    try:
        descriptor = os.open(port, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK | os.O_CLOEXEC)
    except OSError:
        return False
    try:
        _raw(descriptor)
        return all(_acknowledged(descriptor, 64000 + number, command) for number, command in enumerate(COMMANDS))
    except OSError:
        return False
    finally:
        os.close(descriptor)


def _raw(descriptor: int) -> None:
    """Bytes as they are: no echo, no line editing."""
    with contextlib.suppress(termios.error):  # no terminal: a pipe or a socket
        mode = termios.tcgetattr(descriptor)
        mode[0] = mode[1] = mode[3] = 0
        mode[2] = termios.CS8 | termios.CREAD | termios.CLOCAL
        termios.tcsetattr(descriptor, termios.TCSANOW, mode)


def _acknowledged(descriptor: int, number: int, command: str) -> bool:
    verb = command.partition(",")[0]
    for _ in range(TRIES):
        os.write(descriptor, sentence(number, command))
        end_s, heard = time.monotonic() + ANSWER_S, b""
        while (left_s := end_s - time.monotonic()) > 0.0:
            if select.select([descriptor], [], [], left_s)[0]:
                heard = (heard + os.read(descriptor, 4096))[-4096:]
            if f"$A,{number},{verb}".encode() in heard:
                return True
    return False


class ScanKey:
    """The key pad, opened again whenever it has gone."""

    def __init__(self, find: Callable[[], Path | None]) -> None:
        self._find = find
        self._descriptor: int | None = None
        self._was_down = True
        """A key that is down from the start (stuck, or still held) is no press."""

    def pressed(self, timeout_s: float) -> bool:
        """Wait for a new press of SCAN. Never raises; without a key pad it only waits."""
        end_s = time.monotonic() + timeout_s
        while (left_s := end_s - time.monotonic()) > 0.0:
            if self._descriptor is None and not self._open():
                time.sleep(min(left_s, 0.5))
                continue
            down = self._read(left_s)
            if down is None:
                continue
            pressed, self._was_down = down and not self._was_down, down
            if pressed:
                return True
        return False

    def close(self) -> None:
        if self._descriptor is not None:
            os.close(self._descriptor)
        self._descriptor = None

    def _open(self) -> bool:
        path = self._find()
        if path is None:
            return False
        try:
            self._descriptor = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC)
        except OSError:
            return False
        self._was_down = True
        return True

    def _read(self, timeout_s: float) -> bool | None:
        """Whether SCAN is down; ``None`` where nothing, or nothing right, was said."""
        descriptor = self._descriptor
        assert descriptor is not None
        try:
            if not select.select([descriptor], [], [], timeout_s)[0]:
                return None
            report = os.read(descriptor, 64)
        except OSError:
            report = b""
        if not report:  # unplugged
            self.close()
            return None
        return scan_is_down(report)


def scan_is_down(report: bytes) -> bool | None:
    """From one report of the key pad; ``None`` where it is damaged, or SCAN's coil is."""
    if len(report) != REPORT_BYTES or report[0] != 1 or report[3] & SCAN:
        return None
    check = 0xA5
    for byte in report[:-1]:
        check ^= byte
    return bool(report[1] & SCAN) if check == report[-1] else None


def find_keys(devices: Path = Path("/dev"), hidraw: Path = Path("/sys/class/hidraw")) -> Path | None:
    """The key pad by its name from the udev rule, else by its identity; ``None`` while it is not there."""
    named = devices / "kingfisher-keys"
    if named.exists():
        return named
    for entry in sorted(hidraw.glob("hidraw*")):
        with contextlib.suppress(OSError):
            if (
                "00001209:00004B46"
                in (entry / "device" / "uevent").read_text(encoding="ascii", errors="replace").upper()
            ):
                return devices / entry.name
    return None
