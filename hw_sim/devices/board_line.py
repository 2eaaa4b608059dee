"""The trigger board's line format: kind, number, fields and checksum (``docs/protocols/board.md``)."""

from __future__ import annotations

from dataclasses import dataclass

LONGEST_LINE = 160


@dataclass(frozen=True, slots=True)
class Command:
    """A command with a valid checksum."""

    number: int
    verb: str
    arguments: tuple[str, ...]


def crc16(data: bytes) -> int:
    """Return CRC-16/CCITT-FALSE: polynomial 0x1021, initial value 0xFFFF, not reflected, no final XOR."""
    crc = 0xFFFF
    for byte in data:
        crc ^= byte << 8
        for _ in range(8):
            crc = (crc << 1) ^ 0x1021 if crc & 0x8000 else crc << 1
            crc &= 0xFFFF
    return crc


def line(kind: str, number: int, *fields: object) -> bytes:
    """Return one line with its checksum and line end."""
    body = ",".join([kind, str(number), *(str(word) for word in fields)]).encode("ascii")
    return b"$%s*%04X\r\n" % (body, crc16(body))


class CommandReader:
    """Parses commands from a stream; starts again at each ``$``; keeps at most one line."""

    def __init__(self) -> None:
        self._line = bytearray()

    def feed(self, data: bytes) -> list[Command]:
        """Return the commands that ``data`` completes. Invalid bytes are dropped."""
        commands = []
        for byte in data:
            if byte == ord("$"):
                self._line = bytearray(b"$")
            elif self._line:
                self._line.append(byte)
                if byte == ord("\n"):
                    command = _parse(bytes(self._line))
                    if command is not None:
                        commands.append(command)
                    self._line.clear()
                elif len(self._line) >= LONGEST_LINE:
                    self._line.clear()
        return commands


def _parse(raw: bytes) -> Command | None:
    if not raw.endswith(b"\r\n") or len(raw) > LONGEST_LINE:
        return None
    body, star, crc = raw[1:-2].rpartition(b"*")
    if not star or b"*" in body or any(not 0x20 <= byte <= 0x7E for byte in raw[:-2]) or crc != b"%04X" % crc16(body):
        return None
    fields = body.decode("ascii").split(",")
    if len(fields) < 3 or fields[0] != "C" or not fields[1].isdecimal() or int(fields[1]) > 0xFFFF:
        return None
    return Command(int(fields[1]), fields[2], tuple(fields[3:]))
