"""The memory of a GenCP device: registers at addresses, with GenCP's rules and errors."""

from __future__ import annotations

import bisect
import struct
from collections.abc import Callable
from dataclasses import dataclass
from enum import IntEnum
from typing import Any


class Status(IntEnum):
    """GenCP and U3V status codes."""

    SUCCESS = 0x0000
    NOT_IMPLEMENTED = 0x8001
    INVALID_PARAMETER = 0x8002
    INVALID_ADDRESS = 0x8003
    WRITE_PROTECT = 0x8004
    BAD_ALIGNMENT = 0x8005
    ACCESS_DENIED = 0x8006
    BUSY = 0x8007
    INVALID_HEADER = 0x800E
    WRONG_CONFIGURATION = 0x800F
    STREAM_ENDPOINT_HALTED = 0xA002
    PAYLOAD_SIZE_NOT_ALIGNED = 0xA003
    REGISTERS_INCONSISTENT = 0xA004


class AccessError(Exception):
    """An access that the device refuses."""

    def __init__(self, status: Status) -> None:
        super().__init__(status.name)
        self.status = status


@dataclass(frozen=True, slots=True)
class Register:
    """A piece of memory. ``is_number``: aligned to 4 bytes, and written in one piece."""

    address: int
    length: int
    read: Callable[[], bytes] | None
    write: Callable[[bytes], None] | None = None
    is_number: bool = True


class Memory:
    """Registers without overlap."""

    def __init__(self) -> None:
        self._starts: list[int] = []
        self._registers: list[Register] = []

    def add(self, register: Register) -> None:
        """Add a register. Raises ValueError if it overlaps another."""
        position = bisect.bisect(self._starts, register.address)
        before = self._registers[position - 1] if position else None
        after = self._registers[position] if position < len(self._registers) else None
        if (before and before.address + before.length > register.address) or (
            after and register.address + register.length > after.address
        ):
            raise ValueError(f"register at {register.address:#x} overlaps another")
        self._starts.insert(position, register.address)
        self._registers.insert(position, register)

    def u32(self, address: int, read: Callable[[], int] | None, write: Callable[[int], None] | None = None) -> None:
        """Add a 32-bit number."""
        self._number("<I", address, read, write)

    def u64(self, address: int, read: Callable[[], int] | None, write: Callable[[int], None] | None = None) -> None:
        """Add a 64-bit number."""
        self._number("<Q", address, read, write)

    def f32(self, address: int, read: Callable[[], float]) -> None:
        """Add a read-only IEEE 754 number."""
        self.add(Register(address, 4, lambda: struct.pack("<f", read())))

    def f64(self, address: int, read: Callable[[], float], write: Callable[[float], None]) -> None:
        """Add an IEEE 754 number of 64 bits."""
        self._number("<d", address, read, write)

    def text(self, address: int, length: int, text: str) -> None:
        """Add a constant string, padded with NUL."""
        self.blob(address, text.encode("ascii").ljust(length, b"\0")[:length])

    def blob(self, address: int, data: bytes) -> None:
        """Add constant bytes."""
        self.add(Register(address, len(data), lambda: data, None, is_number=False))

    def _number(
        self, form: str, address: int, read: Callable[[], float] | None, write: Callable[[Any], None] | None
    ) -> None:
        def pack() -> bytes:
            return struct.pack(form, read()) if read is not None else b""

        def unpack(data: bytes) -> None:
            if write is not None:
                write(*struct.unpack(form, data))

        size = struct.calcsize(form)
        self.add(Register(address, size, pack if read is not None else None, unpack if write is not None else None))

    def read(self, address: int, size: int) -> bytes:
        """Return ``size`` bytes from ``address``. Raises AccessError: a hole, a write-only register, bad alignment."""
        data = b""
        for register in self._touched(address, size):
            if register.read is None:
                raise AccessError(Status.ACCESS_DENIED)
            start = max(address - register.address, 0)
            data += register.read()[start : address + size - register.address]
        return data

    def write(self, address: int, data: bytes) -> None:
        """Write all of ``data`` at ``address``. Raises AccessError for a hole, a read-only register, half a number."""
        registers = self._touched(address, len(data))
        for register in registers:
            if register.write is None:
                raise AccessError(Status.WRITE_PROTECT)
            inside = address <= register.address and register.address + register.length <= address + len(data)
            if register.is_number and not inside:
                raise AccessError(Status.INVALID_PARAMETER)
        for register in registers:
            # Only after the check of every register, so that a refused write changes nothing.
            start, end = register.address - address, register.address + register.length - address
            if register.write is not None:
                register.write(data[max(start, 0) : end])

    def _touched(self, address: int, size: int) -> list[Register]:
        if size <= 0:
            raise AccessError(Status.INVALID_PARAMETER)
        position = bisect.bisect(self._starts, address) - 1
        touched: list[Register] = []
        reached = address
        while reached < address + size:
            register = self._registers[position] if 0 <= position < len(self._registers) else None
            if register is None or not register.address <= reached < register.address + register.length:
                raise AccessError(Status.INVALID_ADDRESS)
            touched.append(register)
            reached = register.address + register.length
            position += 1
        # GenCP: numbers are read and written in units of 4 bytes; strings and files at any address.
        if (address % 4 or size % 4) and any(register.is_number for register in touched):
            raise AccessError(Status.BAD_ALIGNMENT)
        return touched
