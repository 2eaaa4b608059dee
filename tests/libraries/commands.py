"""The board's command line as a test types it, with its own arithmetic for the check (``docs/protocols/board.md``)."""

from __future__ import annotations


def line(words: str) -> bytes:
    """A numbered and checked line: CRC-16/CCITT-FALSE over what stands between ``$`` and ``*``."""
    body = f"C,1,{words}".encode()
    crc = 0xFFFF
    for byte in body:
        crc ^= byte << 8
        for _ in range(8):
            crc = (crc << 1 ^ (0x1021 if crc & 0x8000 else 0)) & 0xFFFF
    return b"$%s*%04X\r\n" % (body, crc)
