"""Owns what the safe screen does with board and key pad: lasers and pulses off, and what the keys ask for."""

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
SCAN, BACK, UP, DOWN = 0x01, 0x02, 0x04, 0x08
"""docs/protocols/keys.md."""
OFF_S = 2.0
"""BACK is held so long to ask for switching off: longer than a glove brushes it."""
NAMES = {SCAN: "scan", BACK: "back", UP: "up", DOWN: "down"}
EVERY = SCAN | BACK | UP | DOWN
SILENCE_S = 1.0
"""The pad tells its keys many times a second; what was down before a silence may have been let go."""
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


class Keys:
    """The key pad, opened again whenever it has gone."""

    def __init__(self, find: Callable[[], Path | None]) -> None:
        self._find = find
        self._descriptor: int | None = None
        self._down = EVERY
        self._heard_s = time.monotonic()
        self._back_s: float | None = None

    def pressed(self, timeout_s: float) -> str | None:
        """Wait for a new press of a key ("scan", "back", "up", "down"), or for BACK to be held ("hold"); ``None``: nothing.

        Never raises; without a key pad it only waits.
        """
        end_s = time.monotonic() + timeout_s
        while (left_s := end_s - time.monotonic()) > 0.0:
            if self._descriptor is None and not self._open():
                time.sleep(min(left_s, 0.5))
                continue
            keys = self._read(left_s)
            if keys is None:
                continue
            new, self._down = keys & ~self._down, keys
            held = self._held(time.monotonic(), new)
            for key, name in NAMES.items():
                if new & key:
                    return name
            if held:
                return "hold"
        return None

    def close(self) -> None:
        if self._descriptor is not None:
            os.close(self._descriptor)
        self._descriptor = None

    def _held(self, now_s: float, new: int) -> bool:
        """Whether BACK alone has been down, without a gap in what the pad tells, since a new press ``OFF_S`` ago."""
        silent, self._heard_s = now_s - self._heard_s > SILENCE_S, now_s
        if self._down != BACK or silent:
            self._back_s = None
        elif new & BACK:
            self._back_s = now_s
        held = self._back_s is not None and now_s - self._back_s >= OFF_S
        if held:
            self._back_s = None  # once for each press
        return held

    def _forget(self) -> None:
        """A key that is down from the start (stuck, or still held) is no press."""
        self._down = EVERY
        self._heard_s = time.monotonic()
        self._back_s = None

    def _open(self) -> bool:
        path = self._find()
        if path is None:
            return False
        try:
            self._descriptor = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC)
        except OSError:
            return False
        self._forget()
        return True

    def _read(self, timeout_s: float) -> int | None:
        """The keys that are down; ``None`` where nothing, or nothing right, was said."""
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
        return keys_down(report)


def keys_down(report: bytes) -> int | None:
    """From one report of the key pad, without keys whose coil is damaged; ``None`` where the report is."""
    if len(report) != REPORT_BYTES or report[0] != 1:
        return None
    check = 0xA5
    for byte in report[:-1]:
        check ^= byte
    return report[1] & ~report[3] if check == report[-1] else None


def find_keys(
    identity: tuple[int, int], devices: Path = Path("/dev"), hidraw: Path = Path("/sys/class/hidraw")
) -> Path | None:
    """The key pad by its name from the udev rule, else by its USB vendor and product; ``None`` while it is not there."""
    named = devices / "kingfisher-keys"
    if named.exists():
        return named
    for entry in sorted(hidraw.glob("hidraw*")):
        with contextlib.suppress(OSError):
            told = (entry / "device" / "uevent").read_text(encoding="ascii", errors="replace").upper()
            if "{:08X}:{:08X}".format(*identity) in told:
                return devices / entry.name
    return None
