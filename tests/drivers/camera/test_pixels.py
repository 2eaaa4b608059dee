"""Pixels of more than 8 bits: every layout is packed here bit by bit, and the upper eight must come back."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from drivers.camera.pixels import FORMATS


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


def padded(values: list[int], bits: int) -> bytes:
    return b"".join(value.to_bytes(-(-bits // 8), "little") for value in values)


@pytest.mark.parametrize(
    ("name", "code", "bits", "packed"),
    [
        ("Mono8", 0x01080001, 8, padded),
        ("Mono10", 0x01100003, 10, padded),
        ("Mono10p", 0x010A0046, 10, without_gaps),
        ("Mono10Packed", 0x010C0004, 10, in_threes),
        ("Mono12", 0x01100005, 12, padded),
        ("Mono12p", 0x010C0047, 12, without_gaps),
        ("Mono12Packed", 0x010C0006, 12, in_threes),
    ],
)
def test_the_upper_eight_bits_come_back(
    name: str, code: int, bits: int, packed: Callable[[list[int], int], bytes]
) -> None:
    """Codes are PFNC's 32-bit values."""
    wire = FORMATS[name]
    values = [int(one) for one in np.random.default_rng(7).integers(0, 1 << bits, 240)]
    values[:4] = [0, (1 << bits) - 1, 1 << (bits - 1), (1 << (bits - 8)) - 1]
    sent = packed(values, bits)
    raw, image = np.frombuffer(sent, np.uint8).copy(), np.zeros(len(values), np.uint8)
    if wire.reduce is None:
        image[:] = raw
    else:
        wire.reduce(raw, image)
    assert image.tolist() == [value >> (bits - 8) for value in values]
    assert (wire.payload_size(len(values)), wire.code) == (len(sent), code)


def test_pixels_that_fill_no_whole_group_have_no_size() -> None:
    assert FORMATS["Mono10p"].payload_size(1600 * 1200 + 2) is None
    assert FORMATS["Mono12p"].payload_size(3) is None
