"""Plan of the trigger board: each line of ``drivers/board/firmware/pins.py`` from its header pin to its part."""

from __future__ import annotations

from typing import Any

from bench.wiring.module import Pico, pull_of
from bench.wiring.sheet import COLOURS, Point, Sheet
from drivers.board.firmware import pins

KIND = {
    "VSYNC": "sync", "TRIGGER": "trigger", "LASER_LEFT": "laser", "LASER_RIGHT": "laser", "LASER_BEAT": "laser",
    "LEAK_DRIVE": "leak", "LEAK_FRONT": "leak", "LEAK_REAR": "leak", "SDA": "bus", "SCL": "bus", "SERVICE": "service",
    "LED": "service", "LASER_LEFT_SENSE": "analogue", "LASER_RIGHT_SENSE": "analogue", "SUPPLY_SENSE": "analogue",
}  # fmt: skip
COLOUR_OF = {name: COLOURS[kind] for name, kind in KIND.items()}
BUFFER_PINS = {"1A": 2, "1Y": 3, "2A": 5, "2Y": 6}
"""Pins of the 74HCT125 by the names that ``pins.CAMERA_OUTPUTS`` uses (74HC/HCT125 datasheet, pinning)."""
LEFT, RIGHT = 660, 900


def board_plan() -> Sheet:
    """Draw the sheet. Raises KeyError or ValueError for a line of the pin data that this plan has no place for."""
    sheet = Sheet(
        1560, 1215, "Trigger board",
        "Made from drivers/board/firmware/pins.py by ./dev run python -m bench.wiring. Wires cross without a connection "
        "where there is no dot.",
    )  # fmt: skip
    pico = Pico(sheet, pins.LINES, LEFT, RIGHT, COLOUR_OF)
    pico.frame(84, 1130, "Raspberry Pi Pico or Pico 2")
    _power(sheet, pico)
    _sync(sheet, pico)
    _trigger(sheet, pico)
    _lasers(sheet, pico)
    _laser_currents(sheet, pico)
    _leak(sheet, pico)
    _supply(sheet, pico)
    _service(sheet, pico)
    _sensors(sheet, pico)
    if missing := {line.name for line in pins.LINES} - pico.drawn:
        raise ValueError(f"no place on the plan for {', '.join(sorted(missing))}: draw what is behind it")
    sheet.legend(24, 1190, ["sync", "trigger", "laser", "leak", "bus", "analogue", "service", "5 V", "3.3 V", "ground"])
    return sheet


def _line(name: str) -> Any:
    (line,) = [line_of_board for line_of_board in pins.LINES if line_of_board.name == name]
    return line


def _begun(sheet: Sheet, pico: Pico, name: str, y: float, pull_x: float | None = None, beside: str = "right") -> Point:
    """Draw a pin and its resistor at reset; return where the wire goes on."""
    x, _ = pico.line(name, y)
    pull = pull_of(_line(name))
    if pull is not None:
        assert pull_x is not None, f"{name}: a place for its {pull}"
        sheet.wire((x, y), (pull_x, y), colour=COLOUR_OF[name], thick=2.4)
        sheet.dot(pull_x, y, COLOUR_OF[name])
        if pull[0] == "down":
            sheet.pull_down(pull_x, y, pull[1], beside=beside)
        else:
            sheet.pull_up(pull_x, y, pull[1], "3.3 V", beside=beside)
        return pull_x, y
    return x, y


def _power(sheet: Sheet, pico: Pico) -> None:
    x, y = pico.power(3, "GND", 128, COLOURS["ground"])
    sheet.ground(x, y)
    x, y = pico.power(40, "VBUS, 5 V from USB", 128, COLOURS["5 V"])
    sheet.flag(x, y, "5 V: 74HCT125, two laser drivers", to="right", colour=COLOURS["5 V"])
    x, y = pico.power(38, "GND", 176, COLOURS["ground"])
    sheet.ground(x, y)
    sheet.text(x + 22, y + 6, "and pins 3, 8, 13, 18, 23, 28, 33: one ground plane")
    x, y = pico.power(36, "3V3(OUT)", 224, COLOURS["3.3 V"])
    sheet.flag(
        x, y, "3.3 V: pull-ups, sensors, 74HC08, 74HC123, INA180; 300 mA at most", to="right", colour=COLOURS["3.3 V"]
    )


def _sync(sheet: Sheet, pico: Pico) -> None:
    sheet.begin("VSYNC")
    colour = COLOUR_OF["VSYNC"]
    x, y = _begun(sheet, pico, "VSYNC", 176, 540, "left")
    sheet.dot(604, y, colour)
    sheet.capacitor(604, y, "100 pF")
    sheet.wire((x, y), (320, y), colour=colour)
    sheet.resistor(450, y, "1 k")
    sheet.box(24, 96, 296, 118, "TFP401 receiver", ["HDMI in: second output of the splitter"])
    sheet.text(312, y + 4, "VSYNC, 3.3 V", anchor="end", bold=True, colour=colour)
    sheet.lines(
        36, 162, ["no EDID: set the splitter", "to the projector's.", "Or HDMI to VGA, pin 14:", "5 V, divided by 1 k : 2 k"],
        size=10,
    )  # fmt: skip
    sheet.end()


def _trigger(sheet: Sheet, pico: Pico) -> None:
    sheet.begin("TRIGGER")
    colour = COLOUR_OF["TRIGGER"]
    x, y = _begun(sheet, pico, "TRIGGER", 318, 604)
    sheet.box(340, 282, 150, 200, "74HCT125", ["both cameras, one chip"])
    sheet.wire((405, 282), (405, 262), colour=COLOURS["5 V"])
    sheet.rail(405, 262, f"{pins.CAMERA_GATE_V:g} V")
    sheet.wire((x, y), (510, y), (510, 350), colour=colour)
    for number, (camera, line, gate_in, gate_out) in enumerate(pins.CAMERA_OUTPUTS):
        assert line == "TRIGGER", "both cameras hang on one line"
        camera_y = (350, 430)[number]
        sheet.wire((510, camera_y), (490, camera_y), colour=colour)
        sheet.text(484, camera_y + 4, f"{gate_in} ({BUFFER_PINS[gate_in]})", anchor="end")
        sheet.text(346, camera_y + 4, f"{gate_out} ({BUFFER_PINS[gate_out]})")
        sheet.wire((340, camera_y), (200, camera_y), colour=colour)
        sheet.resistor(284, camera_y, f"{pins.CAMERA_SERIES_OHM} Ω")
        top = camera_y - 32
        sheet.box(24, top, 176, 62, f"{camera} camera", [])
        sheet.text(194, camera_y + 4, "trigger in +", anchor="end", size=10)
        sheet.text(194, camera_y + 22, "opto return −", anchor="end", size=10)
        sheet.text(32, camera_y + 4, "Line0, opto", size=10)
        sheet.wire((200, camera_y + 18), (232, camera_y + 18), colour=COLOURS["ground"])
        sheet.ground(232, camera_y + 18)
    sheet.wire((510, 350), (510, 430), colour=colour)
    sheet.dot(510, 350, colour)
    sheet.text(484, 466, "1OE, 2OE (1, 4)", anchor="end", size=10)
    sheet.wire((490, 462), (530, 462), colour=COLOURS["ground"])
    sheet.ground(530, 462)
    current_ma = 1000.0 * (pins.CAMERA_GATE_V - pins.CAMERA_OPTO_V) / pins.CAMERA_SERIES_OHM
    least_ma, most_ma = pins.CAMERA_OPTO_MA
    sheet.lines(
        24, 502,
        [
            f"14 = 5 V, 7 = ground, 100 nF between; 9, 10, 12, 13 to ground. {current_ma:.1f} mA into an opto-isolator",
            f"({pins.CAMERA_OPTO_V:g} V; wanted {least_ma:g} to {most_ma:g} mA). The return goes to the board alone, never to the housing.",
        ],
        size=10,
    )  # fmt: skip
    sheet.end()


def _lasers(sheet: Sheet, pico: Pico) -> None:
    red = COLOURS["laser"]
    sheet.box(340, 534, 150, 180, "74HC08", ["enable and gate"])
    sheet.box(340, 738, 150, 128, "74HC123", ["one-shot"])
    for name, y, gates, side in (
        ("LASER_LEFT", 590, ("1A (1)", "1B (2)", "1Y (3)"), "left"),
        ("LASER_RIGHT", 668, ("2A (4)", "2B (5)", "2Y (6)"), "right"),
    ):
        sheet.begin(name)
        x, _ = _begun(sheet, pico, name, y, 604)
        sheet.wire((x, y), (490, y), colour=red)
        sheet.text(484, y + 4, gates[0], anchor="end")
        sheet.text(484, y + 26, gates[1], anchor="end")
        sheet.wire((490, y + 22), (520, y + 22), colour=red)
        sheet.text(346, y + 15, gates[2])
        sheet.wire((340, y + 11), (236, y + 11), colour=red)
        sheet.box(24, y - 24, 212, 66, f"{side} laser's driver", [])
        sheet.text(230, y + 15, "enable", anchor="end", size=10)
        sheet.text(32, y + 15, "5 V, constant current", size=10)
        sheet.text(32, y + 31, "return: the 1 Ω on the right", size=10)
        sheet.end()
    sheet.begin("LASER_BEAT")
    x, beat_y = _begun(sheet, pico, "LASER_BEAT", 780, 604)
    sheet.wire((x, beat_y), (490, beat_y), colour=red)
    sheet.text(484, beat_y + 4, "1B (2)", anchor="end")
    sheet.text(484, 834, "1Q (13)", anchor="end")
    sheet.wire((490, 830), (520, 830), (520, 612), colour=red)
    sheet.dot(520, 690, red)
    sheet.lines(
        24, 770,
        ["74HC123: 1A (1) to ground, 1CLR (3) to 3.3 V,", "220 k from 15 to 3.3 V, 1 µF from 14 to 15;",
         "1Q drops some 100 ms after the last edge.", "Both chips: 3.3 V, 100 nF, unused inputs to", "ground. Drivers' enable pins: 10 k to ground."],
        size=10,
    )  # fmt: skip
    sheet.end()


def _laser_currents(sheet: Sheet, pico: Pico) -> None:
    for name, side, y in (("LASER_RIGHT_SENSE", "right", 440), ("LASER_LEFT_SENSE", "left", 552)):
        sheet.begin(name)
        colour = COLOUR_OF[name]
        x, _ = _begun(sheet, pico, name, y)
        sheet.box(1060, y - 36, 170, 76, "INA180A1", [])
        sheet.wire((x, y), (1060, y), colour=colour)
        sheet.text(1066, y + 4, "OUT", size=10)
        sheet.text(1066, y + 26, f"{pins.LASER_SENSE_MV_PER_MA:g} mV per mA", size=10)
        sheet.text(1224, y - 8, "IN+", anchor="end", size=10)
        sheet.text(1224, y + 20, "IN−", anchor="end", size=10)
        sheet.wire((1230, y - 12), (1300, y - 12), colour=colour)
        sheet.wire((1230, y + 22), (1300, y + 22), colour=colour)
        sheet.resistor(1300, y + 5, "1 Ω", upright=True)
        sheet.wire((1300, y + 22), (1300, y + 34), colour=COLOURS["ground"])
        sheet.ground(1300, y + 34)
        sheet.wire((1300, y - 12), (1330, y - 12), colour=COLOURS["laser"])
        sheet.dot(1300, y - 12, COLOURS["laser"])
        sheet.flag(1330, y - 12, f"return of the {side} laser", to="right", colour=COLOURS["laser"])
        sheet.end()
    sheet.text(1340, 468, f"counts as on from {pins.LASER_ON_MA:g} mA", size=10)


def _leak(sheet: Sheet, pico: Pico) -> None:
    blue = COLOURS["leak"]
    sheet.begin("LEAK_DRIVE")
    x, y = _begun(sheet, pico, "LEAK_DRIVE", 900, 604)
    sheet.wire((x, y), (320, y), colour=blue)
    sheet.resistor(450, y, "1 k")
    sheet.box(24, 876, 296, 50, "common electrodes", ["in both places, driven for 200 µs at a time"])
    sheet.end()
    for name, y, where in (("LEAK_FRONT", 982, "below the front windows"), ("LEAK_REAR", 1064, "below the rear cover")):
        sheet.begin(name)
        x, _ = _begun(sheet, pico, name, y, 604)
        sheet.wire((x, y), (320, y), colour=blue)
        sheet.box(24, y - 24, 296, 50, "electrode " + where, ["5 mm from the common one, at the lowest point"])
        sheet.end()


def _supply(sheet: Sheet, pico: Pico) -> None:
    sheet.begin("SUPPLY_SENSE")
    colour = COLOUR_OF["SUPPLY_SENSE"]
    x, y = _begun(sheet, pico, "SUPPLY_SENSE", 300)
    below_k = 10.0
    above_k = below_k * (pins.SUPPLY_DIVIDER - 1.0)
    sheet.wire((x, y), (1240, y), colour=colour)
    sheet.dot(1000, y, colour)
    sheet.pull_down(1000, y, f"{below_k:g} k")
    sheet.resistor(1100, y, f"{above_k:g} k")
    most_v = pins.ADC_FULL_MV / 1000.0 * pins.SUPPLY_DIVIDER
    sheet.flag(1240, y, f"supply, up to {most_v:.0f} V", to="right", colour=colour)
    sheet.end()


def _service(sheet: Sheet, pico: Pico) -> None:
    sheet.begin("SERVICE")
    colour = COLOUR_OF["SERVICE"]
    x, y = _begun(sheet, pico, "SERVICE", 640)
    sheet.wire((x, y), (990, y), colour=colour)
    sheet.dot(990, y, colour)
    sheet.wire((990, y), (1016, y - 12), colour=colour)
    sheet.dot(1020, y, colour)
    sheet.wire((1020, y), (1050, y), colour=colour)
    sheet.ground(1050, y)
    sheet.text(1076, y + 4, "jumper: closed while flashing, open in use; pull-up inside the chip", size=10)
    sheet.end()


def _sensors(sheet: Sheet, pico: Pico) -> None:
    green = COLOURS["bus"]
    first = 716
    sheet.begin("SCL")
    x, scl_y = _begun(sheet, pico, "SCL", 760, 970)
    sheet.wire((x, scl_y), (1130, scl_y), (1130, first + 36 + 108 * (len(pins.CHIPS) - 1)), colour=green)
    sheet.end()
    sheet.begin("SDA")
    x, sda_y = _begun(sheet, pico, "SDA", 866, 970)
    last_y = first + 62 + 108 * (len(pins.CHIPS) - 1)
    sheet.wire((x, sda_y), (1090, sda_y), colour=green)
    sheet.dot(1090, sda_y, green)
    sheet.wire((1090, first + 62), (1090, last_y), colour=green)
    sheet.end()
    for number, chip in enumerate(pins.CHIPS):
        top = first + 108 * number
        sheet.begin(f"{chip.part} {chip.address:#04x}")
        sheet.box(1180, top, 350, 84, f"{chip.part}, {chip.address:#04x}", [])
        for y, bus_x, name in ((top + 36, 1130, "SCL"), (top + 62, 1090, "SDA")):
            sheet.wire((bus_x, y), (1180, y), colour=green)
            sheet.dot(bus_x, y, green)
            sheet.text(1188, y + 4, name, size=10)
        sheet.lines(
            1240, top + 40, [f"gives {', '.join(chip.values)}", *_how_addressed(chip)], size=10.5,
        )  # fmt: skip
        sheet.end()
    sheet.text(1180, first + 108 * len(pins.CHIPS) + 4, f"3.3 V, 100 nF each; I2C{pins.I2C_NUMBER} at {pins.I2C_HZ // 1000} kHz. One that does not answer", size=10)  # fmt: skip
    sheet.text(1180, first + 108 * len(pins.CHIPS) + 18, "at the start is not fitted.", size=10)
    sheet.begin("LED")
    led = _line("LED")
    pico.drawn.add("LED")
    sheet.text((LEFT + RIGHT) / 2, 1100, f"LED, GP{led.gpio}, on the module:", anchor="middle", size=10)
    sheet.text((LEFT + RIGHT) / 2, 1114, led.purpose.partition(": ")[2], anchor="middle", size=10)
    sheet.end()


def _how_addressed(chip: Any) -> list[str]:
    """Return how the part gets its address (TMP117 datasheet, table 7-1; SHT4x datasheet, ordering)."""
    if chip.part == "TMP117":
        return [{0x48: "ADD0 to ground", 0x49: "ADD0 to 3.3 V"}[chip.address], WHERE[chip.values[0]]]
    return ["SHT40-AD1B", "in the air of the housing"]


WHERE = {"TPROJ": "on the projector's heat sink", "TCASE": "on the inside of the wall"}
