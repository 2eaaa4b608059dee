"""The pin assignments of both firmwares: what a wiring drawing may rely on."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import pytest

from drivers.board.firmware import pins as board
from drivers.keys.firmware import pins as pad
from drivers.keys.report import KEY_BITS

HEADER_PINS = (1, 2, 4, 5, 6, 7, 9, 10, 11, 12, 14, 15, 16, 17, 19, 20, 21, 22, 24, 25, 26, 27, 29)
PICO_HEADER = {**dict(enumerate(HEADER_PINS)), 26: 31, 27: 32, 28: 34}
"""GPIO to pin of the header, from the Raspberry Pi Pico datasheet, figure 4."""


@pytest.mark.parametrize("lines", [board.LINES, pad.LINES], ids=["board", "pad"])
def test_each_line_has_a_pin_of_its_own_and_the_headers_number(lines: Sequence[Any]) -> None:
    assert len({line.gpio for line in lines}) == len({line.name for line in lines}) == len(lines)
    assert {line.gpio: line.header_pin for line in lines if line.gpio != 25} == {
        line.gpio: PICO_HEADER[line.gpio] for line in lines if line.gpio != 25
    }
    assert {line.direction for line in lines} <= {"in", "out", "adc", "i2c"}


def test_what_could_shine_or_fire_is_held_low_until_the_firmware_runs() -> None:
    for line in board.LINES:
        if line.name.startswith(("LASER", "TRIGGER")) and line.direction == "out":
            assert line.at_reset.startswith("pull-down"), line.name
    assert {line.gpio for line in board.LINES if line.direction == "adc"} <= {26, 27, 28}, "pins that convert"
    assert {camera: line for camera, line, _, _ in board.CAMERA_OUTPUTS} == {"left": "TRIGGER", "right": "TRIGGER"}
    coils = [(coil.channel, coil.bit, coil.key) for coil in pad.COILS]
    assert coils == [(number, bit, key.name) for number, (key, bit) in enumerate(KEY_BITS)]
    assert board.gpio("VSYNC") == 2
    for lines, known in ((board, "VSYNC, TRIGGER"), (pad, "SDA, SCL")):
        with pytest.raises(ValueError, match=f"line 'VSYN'; there are {known}"):
            lines.gpio("VSYN")


def test_the_current_into_a_cameras_opto_isolator_is_within_its_range_at_every_corner() -> None:
    least_ma, most_ma = board.CAMERA_OPTO_MA
    nominal_ma = 1000.0 * (board.CAMERA_GATE_V - board.CAMERA_OPTO_V) / board.CAMERA_SERIES_OHM
    assert least_ma < nominal_ma < most_ma
    # USB's supply is good to 5 %, diodes have 1.2 to 1.7 V, a 74HCT gives up to 0.4 V of its supply at 5 mA, resistors are good to 1 %.
    weakest_ma = 1000.0 * (0.95 * board.CAMERA_GATE_V - 0.4 - 1.7) / (1.01 * board.CAMERA_SERIES_OHM)
    strongest_ma = 1000.0 * (1.05 * board.CAMERA_GATE_V - 1.2) / (0.99 * board.CAMERA_SERIES_OHM)
    assert least_ma < weakest_ma < strongest_ma < most_ma
    e12 = (10, 12, 15, 18, 22, 27, 33, 39, 47, 56, 68, 82)
    assert board.CAMERA_SERIES_OHM in {value * 10**power for value in e12 for power in range(5)}
