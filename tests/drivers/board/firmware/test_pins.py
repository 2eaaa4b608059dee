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


def test_analogue_lines_are_on_pins_that_convert() -> None:
    assert {line.gpio for line in board.LINES if line.direction == "adc"} <= {26, 27, 28}


def test_both_cameras_hang_on_one_line_of_the_board() -> None:
    assert {camera: line for camera, line, _, _ in board.CAMERA_OUTPUTS} == {"left": "TRIGGER", "right": "TRIGGER"}


def test_the_coils_are_the_keys_of_the_report() -> None:
    assert [coil.channel for coil in pad.COILS] == [0, 1, 2, 3]
    assert [coil.bit for coil in pad.COILS] == [bit for _, bit in KEY_BITS]
    assert [coil.key for coil in pad.COILS] == [key.name for key, _ in KEY_BITS]


def test_an_unknown_line_is_refused_with_the_list() -> None:
    assert board.gpio("VSYNC") == 2
    with pytest.raises(ValueError, match="line 'VSYN'; there are VSYNC, TRIGGER"):
        board.gpio("VSYN")
    with pytest.raises(ValueError, match="there are SDA, SCL"):
        pad.gpio("X")
