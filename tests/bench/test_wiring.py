"""The plans of docs/build show each line of the firmwares' pin data, and can be read; the housing's figures keep to an optics of their own."""

from __future__ import annotations

import itertools
import math
import re
import xml.etree.ElementTree as ET
from types import ModuleType
from typing import Any

import pytest

from appliance.store.config import load_rig
from bench.wiring.housing import BEGIN, END, PAGE, STEEP_PX, table, window
from bench.wiring.plans import FOLDER, PLANS
from drivers.board.firmware import pins as board
from drivers.keys.firmware import pins as keys

SVG = "{http://www.w3.org/2000/svg}"
MODULES: dict[str, ModuleType] = {"wiring-board.svg": board, "wiring-keys.svg": keys}
LINES = [(name, line) for name, pins in MODULES.items() for line in pins.LINES]
RIG = load_rig()
INDEX = 1.335
"""Fresh water at 530 nm."""


def group(name: str, which: str) -> ET.Element:
    svg = ET.fromstring((FOLDER / name).read_text(encoding="utf-8"))
    (found,) = [one for one in svg.iter(f"{SVG}g") if one.get("id") == which]
    return found


def texts(element: ET.Element) -> list[str]:
    return ["".join(one.itertext()) for one in element.iter(f"{SVG}text")]


@pytest.mark.parametrize("name", PLANS)
def test_the_committed_plan_is_what_the_data_make_and_no_words_lie_on_each_other(name: str) -> None:
    sheet = PLANS[name]()
    assert (FOLDER / name).read_text(encoding="utf-8") == sheet.svg(), "draw it again: ./dev run python -m bench.wiring"
    assert len(sheet.labels) > 30
    assert all(one.left >= 0.0 and one.right <= sheet.width and one.bottom <= sheet.height for one in sheet.labels)
    assert not [(a.text, b.text) for a, b in itertools.combinations(sheet.labels, 2) if a.overlaps(b)]


@pytest.mark.parametrize(("name", "line"), LINES, ids=lambda one: getattr(one, "name", None))
def test_every_line_is_drawn_from_its_pin_to_something_with_what_holds_it_at_reset(name: str, line: Any) -> None:
    drawn = group(name, line.name)
    said = texts(drawn)
    assert any(f"GP{line.gpio}" in text for text in said)
    held = re.fullmatch(r"pull-(up|down) (\d+(?:\.\d+)? k)", line.at_reset)
    if held is None:
        assert line.at_reset in ("none", "pull-up inside")
    else:
        assert held[2] in said
        assert ("3.3 V" in said) is (held[1] == "up")
    if line.header_pin is not None:
        assert {line.name, str(line.header_pin)} <= set(said)
        points = [re.findall(r"(-?[\d.]+),", one.get("points", "")) for one in drawn.iter(f"{SVG}polyline")]
        reach = max(abs(float(x) - float(points[0][0])) for wire in points for x in wire)
        assert reach > 100, "it leads to what is behind it"


def test_the_parts_behind_the_board_are_drawn_as_the_data_say() -> None:
    buffer = texts(group("wiring-board.svg", "TRIGGER"))
    for camera, _, gate_in, gate_out in board.CAMERA_OUTPUTS:
        assert f"{camera} camera" in buffer
        assert {gate_in, gate_out} <= {text.partition(" (")[0] for text in buffer}
    assert buffer.count(f"{board.CAMERA_SERIES_OHM} Ω") == len(board.CAMERA_OUTPUTS)
    for chip in board.CHIPS:
        said = " ".join(texts(group("wiring-board.svg", f"{chip.part} {chip.address:#04x}")))
        assert all(value in said for value in chip.values)
    supply = texts(group("wiring-board.svg", "SUPPLY_SENSE"))
    above, below = (float(text.removesuffix(" k")) for text in sorted(t for t in supply if t.endswith(" k"))[::-1])
    assert (above + below) / below == board.SUPPLY_DIVIDER
    for side in ("LEFT", "RIGHT"):
        sensed = texts(group("wiring-board.svg", f"LASER_{side}_SENSE"))
        assert {"INA180A1", "1 Ω", f"{board.LASER_SENSE_MV_PER_MA:g} mV per mA"} <= set(sensed)
    for chip_name, suffix in (("LDC3114", ""), ("LDC1614", "A")):
        said = " ".join(texts(group("wiring-keys.svg", chip_name)))
        assert all(f"IN{c.channel}{suffix}" in said and f"{c.key}, bit {c.bit:#04x}" in said for c in keys.COILS)


def test_a_line_without_a_place_on_the_plan_stops_the_drawing(monkeypatch: pytest.MonkeyPatch) -> None:
    line = board.Line("HEATER", 9, 12, "out", "none", "a heater")
    monkeypatch.setattr(board, "LINES", (*board.LINES, line))
    with pytest.raises(ValueError, match="HEATER"):
        PLANS["wiring-board.svg"]()


def refracted(direction: tuple[float, float], normal_tilt: float, before: float, after: float) -> tuple[float, float]:
    """Return a ray behind a surface whose normal is tilted in the plane of x and z: Snell's law by angles."""
    angle = math.atan2(direction[0], direction[1]) - normal_tilt
    behind = math.asin(math.sin(angle) * before / after) + normal_tilt
    return math.sin(behind), math.cos(behind)


def turned(inner_urad: float, outer_urad: float) -> float:
    """Return the angle in water of the axis's ray."""
    within = refracted((0.0, 1.0), inner_urad * 1e-6, 1.0, RIG.design.port_index)
    return math.atan2(*refracted(within, outer_urad * 1e-6, RIG.design.port_index, INDEX))


def test_the_housings_page_says_what_a_traced_ray_does() -> None:
    text = PAGE.read_text(encoding="utf-8")
    remedy = "write it again: ./dev run python -m bench.wiring.housing"
    assert text.split(BEGIN)[1].split(END)[0].strip() == table(), remedy
    made = window(RIG)
    allowed = STEEP_PX * RIG.design.pixel_um * 1e-3 / RIG.design.principal_distance_mm / INDEX
    for slopes in ((made.slope_inner_urad, 0.0), (0.0, made.slope_outer_urad)):
        assert abs(abs(turned(*slopes)) / allowed - 1.0) < 0.02
    # Bowed alike, both faces nearly cancel: what is left is that of a thin shell of water.
    assert abs(turned(made.slope_inner_urad, made.slope_inner_urad)) < allowed
    half_mm = 0.5 * 4.5e-3 * math.hypot(1600, 1200)
    inside = refracted((half_mm, 11.5), 0.0, 1.0, 1.77)
    beam_mm = 30.0 * half_mm / 11.5 + 5.0 * inside[0] / inside[1]
    assert beam_mm + 0.5 * 11.5 / 8.0 < 0.5 * made.clear_mm < beam_mm + 6.0
