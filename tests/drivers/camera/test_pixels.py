"""Pixels of more than 8 bits: every layout is packed here bit by bit, and the upper eight must come back."""

from __future__ import annotations

import numpy as np
import pytest

from drivers.camera.pixels import FORMATS

CODES = {
    "Mono8": 0x01080001,
    "Mono10": 0x01100003,
    "Mono10p": 0x010A0046,
    "Mono10Packed": 0x010C0004,
    "Mono12": 0x01100005,
    "Mono12p": 0x010C0047,
    "Mono12Packed": 0x010C0006,
}
"""PFNC 32-bit values."""


def without_gaps(values: list[int], bits: int) -> bytes:
    """Pack from the least significant bit on: pixel after pixel, byte after byte."""
    whole = sum(value << (bits * k) for k, value in enumerate(values))
    return whole.to_bytes(-(-bits * len(values) // 8), "little")


def in_threes(values: list[int], bits: int) -> bytes:
    """Pack as GigE Vision did: upper eight bits of the first, what is below of both, upper eight of the second."""
    low = bits - 8
    packed = bytearray()
    for first, second in zip(values[::2], values[1::2], strict=True):
        rest = (first & ((1 << low) - 1)) | (second & ((1 << low) - 1)) << 4
        packed += bytes((first >> low, rest, second >> low))
    return bytes(packed)


@pytest.mark.parametrize("name", list(CODES))
def test_the_upper_eight_bits_come_back(name: str) -> None:
    wire = FORMATS[name]
    bits = int("".join(digit for digit in name if digit.isdigit()))
    values = [int(one) for one in np.random.default_rng(7).integers(0, 1 << bits, 240)]
    values[:4] = [0, (1 << bits) - 1, 1 << (bits - 1), (1 << (bits - 8)) - 1]
    match name:
        case "Mono8":
            sent = bytes(values)
        case "Mono10" | "Mono12":
            sent = b"".join(value.to_bytes(2, "little") for value in values)
        case "Mono10p" | "Mono12p":
            sent = without_gaps(values, bits)
        case _:
            sent = in_threes(values, bits)
    raw = np.frombuffer(sent, np.uint8).copy()
    image = np.zeros(len(values), np.uint8)
    if wire.reduce is None:
        image[:] = raw
    else:
        wire.reduce(raw, image)
    assert image.tolist() == [value >> (bits - 8) for value in values]
    assert (wire.payload_size(len(values)), wire.code) == (len(sent), CODES[name])


def test_pixels_that_fill_no_whole_group_have_no_size() -> None:
    assert FORMATS["Mono10p"].payload_size(1600 * 1200 + 2) is None
    assert FORMATS["Mono12p"].payload_size(3) is None
