"""The lines of the board's serial port: framing, checksum, and resynchronisation after garbage.

Pure: bytes in, sentences out. Source: ``docs/protocols/board.md``.
"""

from __future__ import annotations

import binascii
from dataclasses import dataclass
from enum import Enum

MAX_LINE = 160
"""Bytes of a line with ``$`` and ``\\r\\n``."""
SEQUENCE_MODULUS = 65536

_START = ord("$")
_END = ord("\n")
_FORBIDDEN = frozenset(",$*")


class Kind(Enum):
    """First letter of a sentence."""

    COMMAND = "C"
    ACKNOWLEDGE = "A"
    REFUSAL = "N"
    REPORT = "R"


class MalformedLine(ValueError):
    """The bytes are no sentence of the board."""


@dataclass(frozen=True, slots=True)
class Sentence:
    """One line, checked: ``$<kind>,<sequence>,<VERB>[,<field>...]*<CRC>``."""

    kind: Kind
    sequence: int
    verb: str
    fields: tuple[str, ...] = ()


def crc16(data: bytes) -> int:
    """CRC-16/CCITT-FALSE: polynomial 0x1021, initial 0xFFFF, not reflected, no final XOR.

    ``123456789`` → 0x29B1.
    """
    return binascii.crc_hqx(data, 0xFFFF)


def format_line(sentence: Sentence) -> bytes:
    """Return the bytes of a sentence. Raises ValueError for a sentence that the line cannot carry."""
    if not 0 <= sentence.sequence < SEQUENCE_MODULUS:
        raise ValueError(f"sequence number {sentence.sequence}; allowed are 0..{SEQUENCE_MODULUS - 1}")
    for part in (sentence.verb, *sentence.fields):
        if _FORBIDDEN & set(part) or not all(" " <= character <= "~" for character in part):
            raise ValueError(f"field {part!r}; allowed is printable ASCII without , $ *")
    body = ",".join((sentence.kind.value, str(sentence.sequence), sentence.verb, *sentence.fields)).encode("ascii")
    line = b"$" + body + b"*%04X\r\n" % crc16(body)
    if len(line) > MAX_LINE:
        raise ValueError(f"line of {len(line)} bytes; allowed are {MAX_LINE}")
    return line


def parse_line(line: bytes) -> Sentence:
    """Return the sentence in ``line``, which runs from ``$`` to ``\\r\\n``. Raises MalformedLine."""
    if len(line) > MAX_LINE:
        raise MalformedLine(f"{len(line)} bytes; allowed are {MAX_LINE}")
    if not line.startswith(b"$") or not line.endswith(b"\r\n"):
        raise MalformedLine("not framed by $ and CR LF")
    body, star, checksum = line[1:-2].rpartition(b"*")
    if not star or len(checksum) != 4 or not set(checksum) <= set(b"0123456789ABCDEF"):
        raise MalformedLine("no checksum of four upper-case hex digits")
    if not all(0x20 <= byte <= 0x7E for byte in body):
        raise MalformedLine("not printable ASCII")
    if int(checksum, 16) != crc16(body):
        raise MalformedLine(f"checksum {checksum.decode()}, computed {crc16(body):04X}")
    if _START in body or b"*" in body:
        raise MalformedLine("$ or * within the line")
    parts = body.decode("ascii").split(",")
    if len(parts) < 3:
        raise MalformedLine("kind, number and verb are not all there")
    try:
        kind = Kind(parts[0])
    except ValueError:
        raise MalformedLine(f"kind {parts[0]!r}") from None
    return Sentence(kind, parse_uint(parts[1], SEQUENCE_MODULUS - 1), parts[2], tuple(parts[3:]))


def parse_uint(text: str, largest: int) -> int:
    """Return a decimal number 0..``largest``: digits alone, no sign, no blanks. Raises MalformedLine."""
    # Bounded before int(): a line of digits is legal ASCII, not a legal number.
    if not text.isascii() or not text.isdigit() or len(text) > 20 or int(text) > largest:
        raise MalformedLine(f"number {text!r}; allowed are 0..{largest}")
    return int(text)


class LineSplitter:
    """Cuts a stream of bytes into candidate lines; keeps at most one unfinished line.

    Every ``$`` begins a new line, so that a half line is the only loss. ``garbage_bytes`` counts bytes outside of any
    line, ``broken_lines`` the lines that were cut off or grew too long.
    """

    def __init__(self) -> None:
        self._buffer = bytearray()
        self.garbage_bytes = 0
        self.broken_lines = 0

    def feed(self, data: bytes) -> list[bytes]:
        """Return the lines that ``data`` completes, each from ``$`` to its line feed; not parsed yet."""
        lines: list[bytes] = []
        for byte in data:
            if byte == _START:
                if self._buffer:
                    self._drop()
                self._buffer.append(byte)
            elif not self._buffer:
                # Bytes after a complete or a dropped line belong to no line.
                self.garbage_bytes += 1
            else:
                self._buffer.append(byte)
                if byte == _END:
                    lines.append(bytes(self._buffer))
                    self._buffer.clear()
                elif len(self._buffer) >= MAX_LINE:
                    self._drop()
        return lines

    def _drop(self) -> None:
        self.broken_lines += 1
        self.garbage_bytes += len(self._buffer)
        self._buffer.clear()
