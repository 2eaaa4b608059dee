"""Pictures of cameras in the manner of three makers: borders, mirrors, binning, grey values, formats, chunks."""

from __future__ import annotations

import struct
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from hw_sim.devices.picture import Processing, payload
from hw_sim.devices.u3v_stream import Region
from tests.hw_sim.conftest import HandTime
from tests.hw_sim.devices.bus import BORDERS, COLUMNS, ROWS, careful, picture

PERSONALITIES = ("blackfly", "ace", "alvium")
Image = NDArray[np.uint8]


@pytest.mark.parametrize("personality", PERSONALITIES)
def test_the_worlds_picture_lies_in_the_middle_of_a_larger_sensor(hand_time: HandTime, personality: str) -> None:
    bus = careful(hand_time, personality)
    wide, high = BORDERS[personality]
    assert (bus.get("SensorWidth"), bus.get("SensorHeight")) == (COLUMNS + wide, ROWS + high)
    assert np.array_equal(bus.image(), picture())
    bus.set(OffsetX=0, OffsetY=0)
    bus.set(Width=COLUMNS + wide, Height=ROWS + high)
    whole = bus.image()
    assert np.array_equal(whole[high // 2 : high // 2 + ROWS, wide // 2 : wide // 2 + COLUMNS], picture())
    assert whole[: high // 2].max(initial=0) <= 2
    assert whole[:, : wide // 2].max() <= 2, "dark"


def binned(image: Image) -> Image:
    means: NDArray[np.float64] = image.reshape(ROWS // 2, 2, COLUMNS // 2, 2).mean(axis=(1, 3))
    return np.floor(means + 0.5).astype(np.uint8)


def bent(image: Image) -> NDArray[np.float64]:
    return 255.0 * np.sqrt(image / 255.0)


HALVED = {"BinningHorizontal": 2, "BinningVertical": 2, "OffsetX": 4, "OffsetY": 10, "Width": 80, "Height": 60}
EVERY_SECOND = {"DecimationHorizontal": 2, "OffsetX": 80, "Width": 80}
RAMP = np.tile(np.arange(ROWS)[:, None], (1, COLUMNS))


@pytest.mark.parametrize(
    ("personality", "values", "expected"),
    [
        ("blackfly", {"ReverseX": True}, lambda image: image[:, ::-1]),
        ("alvium", {"ReverseY": True}, lambda image: image[::-1]),
        ("blackfly", HALVED, binned),
        ("ace", EVERY_SECOND, lambda image: image[:, ::2]),
        ("ace", {"OffsetX": 160 + 12}, lambda image: np.pad(image, ((0, 0), (0, 12)), constant_values=2)[:, 12:]),
        ("blackfly", {"BlackLevel": 10 / 2.55}, lambda image: image + 8),
        ("ace", {"BlackLevel": 22.0}, lambda image: image + 20),
        ("blackfly", {"Gamma": 0.5}, lambda image: image),
        ("blackfly", {"GammaEnable": True, "Gamma": 0.5}, bent),
        ("blackfly", {"LUTEnable": True}, bent),
        ("alvium", {"TestPattern": "GreyVerticalRamp"}, lambda image: RAMP),
    ],
)
def test_each_value_does_to_the_picture_what_it_says(
    hand_time: HandTime, personality: str, values: dict[str, Any], expected: Callable[[Image], Image]
) -> None:
    bus = careful(hand_time, personality)
    bus.set(**values)
    assert np.abs(bus.image() - expected(picture()).astype(float)).max() <= 0.51


def test_what_saturates_is_the_highest_code_whatever_the_black_level() -> None:
    light = np.full((1, 16), 255, np.uint8)
    region = Region(16, 1, 0, 0)
    assert set(payload(light, (16, 1), Processing(black_dn=0.0), region)) == {255}
    assert set(payload(light, (16, 1), Processing(black_dn=0.0, gamma=2.0), region)) == {255}


def unpacked(data: bytes, bits: int) -> NDArray[np.uint16]:
    """Codes without gaps, lowest bits first, one at a time."""
    number = int.from_bytes(data, "little")
    codes = [number >> bits * k & (1 << bits) - 1 for k in range(COLUMNS * 2)]
    return np.array(codes, np.uint16).reshape(2, COLUMNS)


@pytest.mark.parametrize(
    ("personality", "word", "code", "bits", "padded"),
    [
        ("ace", "Mono10", 0x01100003, 10, True),
        ("ace", "Mono10p", 0x010A0046, 10, False),
        ("alvium", "Mono12", 0x01100005, 12, True),
        ("alvium", "Mono12p", 0x010C0047, 12, False),
        ("blackfly", "Mono16", 0x01100007, 16, True),
    ],
)
def test_formats_of_more_bits_are_packed_as_their_names_say(
    hand_time: HandTime, personality: str, word: str, code: int, bits: int, padded: bool
) -> None:
    bus = careful(hand_time, personality)
    bus.set(PixelFormat=word, Height=2)
    wire_bits = 16 if padded else bits
    assert bus.get("PayloadSize") == COLUMNS * 2 * wire_bits // 8
    bus.start()
    bus.pulses(1)
    (frame,) = bus.frames()
    assert struct.unpack_from("<III", frame.leader, 28) == (code, COLUMNS, 2)
    assert struct.unpack_from("<QI", frame.trailer, 20) == (len(frame.payload), 2)
    expected = picture()[:2].astype(np.uint16) << bits - 8
    assert np.array_equal(unpacked(frame.payload, wire_bits), expected)


def test_chunks_follow_the_image_and_lengthen_payload_and_trailer(hand_time: HandTime) -> None:
    bus = careful(hand_time, "ace")
    bus.set(ChunkModeActive=True)
    assert bus.get("PayloadSize") == COLUMNS * ROWS + 24
    bus.start()
    bus.pulses(2)
    frame = bus.frames()[-1]
    bus.stop()
    assert struct.unpack_from("<H", frame.leader, 18)[0] == 0x4001, "image with chunks"
    size = COLUMNS * ROWS
    assert frame.payload[:size] == picture().tobytes()
    assert struct.unpack_from("<IIQII", frame.payload, size) == (1, size, 1, 2, 8), "and number 1 is the frame's"
    assert struct.unpack_from("<H", frame.trailer, 6)[0] == len(frame.trailer) == 36
    bus.set(Width=16)
    bus.start()
    bus.pulses(1)
    assert struct.unpack_from("<QI", bus.frames()[-1].trailer, 20) == (16 * ROWS + 24, ROWS), "chunks are no rows"
