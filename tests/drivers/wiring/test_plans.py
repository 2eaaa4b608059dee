"""The plans have every wire of the pin data, are those that were committed, and can be read."""

from __future__ import annotations

import itertools
import re
import xml.etree.ElementTree as ET
from types import ModuleType
from typing import Any

import pytest

from drivers.board.firmware import pins as board
from drivers.keys.firmware import pins as keys
from tests.drivers.board.firmware.desk import Desk
from tests.drivers.wiring.plans import FOLDER, PLANS

SVG = "{http://www.w3.org/2000/svg}"
MODULES: dict[str, ModuleType] = {"wiring-board.svg": board, "wiring-keys.svg": keys}
LINES = [(name, line) for name, pins in MODULES.items() for line in pins.LINES]


def committed(name: str) -> ET.Element:
    return ET.fromstring((FOLDER / name).read_text(encoding="utf-8"))


def texts(element: ET.Element) -> list[str]:
    return ["".join(one.itertext()) for one in element.iter(f"{SVG}text")]


def group(name: str, which: str) -> ET.Element:
    (found,) = [one for one in committed(name).iter(f"{SVG}g") if one.get("id") == which]
    return found


def ends(element: ET.Element) -> list[tuple[tuple[float, float], ...]]:
    return [
        tuple((float(x), float(y)) for x, y in re.findall(r"(-?[\d.]+),(-?[\d.]+)", one.get("points", "")))
        for one in element.iter(f"{SVG}polyline")
    ]


@pytest.mark.parametrize("name", PLANS)
def test_the_committed_plan_is_what_the_data_make(name: str) -> None:
    assert (FOLDER / name).read_text(encoding="utf-8") == PLANS[name]().svg(), (
        "draw it again, and look at it: ./dev run python -m tests.drivers.wiring"
    )


@pytest.mark.parametrize(("name", "line"), LINES, ids=lambda one: getattr(one, "name", None))
def test_every_line_of_the_data_is_drawn_from_its_pin_to_something(name: str, line: Any) -> None:
    drawn = group(name, line.name)
    said = texts(drawn)
    assert any(f"GP{line.gpio}" in text for text in said)
    if line.header_pin is None:
        return
    assert line.name in said
    assert str(line.header_pin) in said
    # The number stands in the pin's square; a wire begins at its middle's height beside the module, and leads away.
    (number,) = [one for one in drawn.iter(f"{SVG}text") if "".join(one.itertext()) == str(line.header_pin)][:1]
    at_y = float(number.get("y", "0")) - 4
    wires = [points for points in ends(drawn) if points[0][1] == at_y]
    first = wires[0]
    reach = max(abs(x - first[0][0]) for points in ends(drawn) for x, _ in points)
    assert reach > 100, "it leads to what is behind it"


@pytest.mark.parametrize(("name", "line"), LINES, ids=lambda one: getattr(one, "name", None))
def test_what_holds_a_line_at_reset_is_drawn_with_its_value(name: str, line: Any) -> None:
    held = re.fullmatch(r"pull-(up|down) (\d+(?:\.\d+)? k)", line.at_reset)
    said = texts(group(name, line.name))
    if held is None:
        assert line.at_reset in ("none", "pull-up inside")
        return
    assert held[2] in said
    assert ("3.3 V" in said) is (held[1] == "up")


def test_the_parts_behind_the_board_are_drawn_as_the_data_say() -> None:
    buffer = texts(group("wiring-board.svg", "TRIGGER"))
    for camera, _, gate_in, gate_out in board.CAMERA_OUTPUTS:
        assert f"{camera} camera" in buffer
        assert any(text.startswith(f"{gate_in} (") for text in buffer)
        assert any(text.startswith(f"{gate_out} (") for text in buffer)
    assert buffer.count(f"{board.CAMERA_SERIES_OHM} Ω") == len(board.CAMERA_OUTPUTS)
    for chip in board.CHIPS:
        said = " ".join(texts(group("wiring-board.svg", f"{chip.part} {chip.address:#04x}")))
        assert all(value in said for value in chip.values)
    supply = texts(group("wiring-board.svg", "SUPPLY_SENSE"))
    above, below = (float(text.removesuffix(" k")) for text in sorted(t for t in supply if t.endswith(" k"))[::-1])
    assert (above + below) / below == board.SUPPLY_DIVIDER
    for side in ("LEFT", "RIGHT"):
        sensed = texts(group("wiring-board.svg", f"LASER_{side}_SENSE"))
        assert "INA180A1" in sensed
        assert "1 Ω" in sensed
        assert f"{board.LASER_SENSE_MV_PER_MA:g} mV per mA" in sensed


@pytest.mark.parametrize("chip", ["LDC3114", "LDC1614"])
def test_each_coil_is_drawn_at_its_channel_with_its_key(chip: str) -> None:
    said = texts(group("wiring-keys.svg", chip))
    for coil in keys.COILS:
        assert f"{coil.key}, bit {coil.bit:#04x}" in said
        assert f"IN{coil.channel}" + ("A" if chip == "LDC1614" else "") in said


@pytest.mark.parametrize("name", PLANS)
def test_no_words_lie_on_each_other_or_beyond_the_sheet(name: str) -> None:
    sheet = PLANS[name]()
    assert len(sheet.words) > 30
    for one in sheet.words:
        assert one.left >= 0.0, one.text
        assert one.right <= sheet.width, one.text
        assert one.bottom <= sheet.height, one.text
    hidden = [(a.text, b.text) for a, b in itertools.combinations(sheet.words, 2) if a.overlaps(b)]
    assert not hidden


def test_a_line_without_a_place_on_the_plan_stops_the_drawing(monkeypatch: pytest.MonkeyPatch) -> None:
    line = board.Line("HEATER", 9, 12, "out", "none", "a heater")
    monkeypatch.setattr(board, "LINES", (*board.LINES, line))
    with pytest.raises(ValueError, match="no place on the plan for HEATER"):
        PLANS["wiring-board.svg"]()


def test_the_lines_to_paste_are_obeyed_by_the_firmware() -> None:
    page = (FOLDER.parent / "build" / "wiring.md").read_text(encoding="utf-8")
    lines = re.findall(r"`(\$C,\d+,([A-Z]+)[^`]*)`", page)
    assert [verb for _, verb in lines] == ["INFO", "VSYNC", "SENSE", "LASER", "LASER"]
    desk = Desk()
    desk.exchange(b"", 100_000)
    for line, verb in lines:
        said = desk.exchange(line.encode() + b"\r\n", 20_000).decode()
        assert re.search(rf"\$A,\d+,{verb}", said), line
