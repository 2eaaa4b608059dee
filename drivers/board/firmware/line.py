"""The lines of the serial port on the board's side: checksum, framing, and commands from any bytes.

Source: ``docs/protocols/board.md``. Runs under MicroPython and CPython alike.
"""

from array import array

LONGEST = 160
"""Bytes of a line with ``$`` and CR LF."""
LARGEST_NUMBER = 65535


def _table() -> array:  # type: ignore[type-arg]
    """Return a table with CRC-16/CCITT-FALSE of each single byte, which saves eight turns for every byte."""
    table = array("H")
    for byte in range(256):
        crc = byte << 8
        for _ in range(8):
            crc = (crc << 1 ^ 0x1021 if crc & 0x8000 else crc << 1) & 0xFFFF
        table.append(crc)
    return table


_CRC = _table()


def crc16(data: bytes) -> int:
    """Return CRC-16/CCITT-FALSE: polynomial 0x1021, initial value 0xFFFF, not reflected, no final XOR."""
    crc = 0xFFFF
    table = _CRC
    for byte in data:
        crc = (crc << 8 & 0xFF00) ^ table[crc >> 8 ^ byte]
    return crc


def sentence(kind: str, number: int, parts: list[str]) -> bytes:
    """Return one line with checksum and line end.

    The parts are the board's own: printable, none with ``,`` ``$`` ``*``.
    """
    body = ",".join([kind, str(number)] + parts).encode()
    return b"$" + body + b"*" + f"{crc16(body):04X}".encode() + b"\r\n"


class Command:
    """A command with a valid checksum: its number, its verb and its arguments as text."""

    def __init__(self, number: int, verb: str, arguments: list[str]) -> None:
        self.number = number
        self.verb = verb
        self.arguments = arguments

    def same_as(self, earlier: "Command | None") -> bool:
        """Return True if the host has sent this command again."""
        return (
            earlier is not None
            and self.number == earlier.number
            and self.verb == earlier.verb
            and self.arguments == earlier.arguments
        )


class CommandFinder:
    """Finds commands in arriving bytes; begins anew at each ``$`` and keeps at most one line."""

    def __init__(self) -> None:
        self._line = b""

    def feed(self, data: bytes) -> list[Command]:
        """Return the commands that ``data`` completes; all other bytes are dropped."""
        commands: list[Command] = []
        # ``split`` runs in C: byte by byte in Python, a long line would take a third of the answer's 20 ms.
        pieces = data.split(b"$")
        for i in range(len(pieces)):
            if i:
                self._line = b"$"
            if self._line:
                self._go_on(pieces[i], commands)
        return commands

    def _go_on(self, piece: bytes, commands: list[Command]) -> None:
        end = piece.find(b"\n") + 1
        if not end:
            self._line += piece
            if len(self._line) >= LONGEST:
                self._line = b""
            return
        command = parsed(self._line + piece[:end])
        self._line = b""
        if command is not None:
            commands.append(command)


def parsed(line: bytes) -> Command | None:
    """Return the command in ``line``, which runs from ``$`` to its line feed, or ``None``."""
    if not 9 <= len(line) <= LONGEST or line[-2:] != b"\r\n" or line[-7:-6] != b"*":
        return None
    body = line[1:-7]
    if min(body) < 0x20 or max(body) > 0x7E or b"*" in body or line[-6:-2] != f"{crc16(body):04X}".encode():
        return None
    parts = body.decode().split(",")
    if len(parts) < 3 or parts[0] != "C":
        return None
    number = decimal(parts[1], LARGEST_NUMBER)
    if number is None:
        return None
    return Command(number, parts[2], parts[3:])


def decimal(text: str, largest: int) -> int | None:
    """Return the number 0..``largest`` that ``text`` writes with up to ten digits alone.

    Return ``None`` for any other text.
    """
    if not text.isdigit() or len(text) > 10:
        return None
    number = int(text)
    return number if number <= largest else None
