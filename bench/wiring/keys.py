"""Plan of the keypad: each line of ``drivers/keys/firmware/pins.py``, either coil chip, and the coils."""

from __future__ import annotations

from typing import Any

from bench.wiring.module import Pico, pull_of
from bench.wiring.sheet import COLOURS, Sheet
from drivers.keys.firmware import pins

KIND = {
    "SDA": "bus", "SCL": "bus", "COILS_READY": "trigger", "COILS_POWER": "sync", "SERVICE": "service", "LED": "service",
}  # fmt: skip
COLOUR_OF = {name: COLOURS[kind] for name, kind in KIND.items()}
LEFT, RIGHT = 930, 1170
HEIGHTS = {"SDA": 250, "SCL": 330, "COILS_READY": 420, "COILS_POWER": 510}


def keys_plan() -> Sheet:
    """Draw the sheet. Raises KeyError or ValueError for a line of the pin data that this plan has no place for."""
    sheet = Sheet(
        1560, 900, "Key pad",
        "Made from drivers/keys/firmware/pins.py by ./dev run python -m bench.wiring. One of the two coil chips is fitted; "
        "the firmware finds out which.",
    )  # fmt: skip
    pico = Pico(sheet, pins.LINES, LEFT, RIGHT, COLOUR_OF)
    pico.frame(84, 640, "Raspberry Pi Pico")
    x, y = pico.power(3, "GND", 128, COLOURS["ground"])
    sheet.ground(x, y)
    x, y = pico.power(40, "VBUS: not used", 128, COLOURS["5 V"])
    x, y = pico.power(38, "GND", 176, COLOURS["ground"])
    sheet.ground(x, y)
    x, y = pico.power(36, "3V3(OUT)", 224, COLOURS["3.3 V"])
    sheet.flag(x, y, "3.3 V: chip or its regulator", to="right", colour=COLOURS["3.3 V"])
    _ldc3114(sheet)
    _ldc1614(sheet)
    _buses(sheet, pico)
    _service(sheet, pico)
    sheet.begin("LED")
    (led,) = [line for line in pins.LINES if line.name == "LED"]
    pico.drawn.add("LED")
    sheet.text((LEFT + RIGHT) / 2, 606, f"LED, GP{led.gpio}, on the module:", anchor="middle", size=10)
    sheet.text((LEFT + RIGHT) / 2, 620, led.purpose.partition(": ")[2], anchor="middle", size=10)
    sheet.end()
    if missing := {line.name for line in pins.LINES} - pico.drawn:
        raise ValueError(f"no place on the plan for {', '.join(sorted(missing))}: draw what is behind it")
    sheet.legend(24, 876, ["bus", "service", "5 V", "3.3 V", "ground"])
    for left, name, kind in ((600, "chip's interrupt", "trigger"), (760, "chip's power pin", "sync")):
        sheet.wire((left, 872), (left + 26, 872), colour=COLOURS[kind], thick=3.0)
        sheet.text(left + 32, 876, name)
    return sheet


def _buses(sheet: Sheet, pico: Pico) -> None:
    """Draw the four nets from the module to the start of either chip."""
    for number, (name, y) in enumerate(HEIGHTS.items()):
        sheet.begin(name)
        (line,) = [pin for pin in pins.LINES if pin.name == name]
        x, _ = pico.line(name, y)
        pull = pull_of(line)
        assert pull is not None, f"{name}: nothing holds it at reset"
        assert pull[0] == "up", f"{name}: a pull-{pull[0]} has no place here"
        pulled = 880
        sheet.wire((x, y), (pulled, y), colour=COLOUR_OF[name], thick=2.4)
        sheet.dot(pulled, y, COLOUR_OF[name])
        sheet.pull_up(pulled, y, pull[1], "3.3 V", beside="left")
        bus = _bus_x(number)
        sheet.wire((pulled, y), (bus, y), (bus, UPPER[name]), colour=COLOUR_OF[name])
        sheet.wire((bus, y), (bus, LOWER[name]), colour=COLOUR_OF[name])
        sheet.dot(bus, y, COLOUR_OF[name])
        sheet.wire((bus, UPPER[name]), (640, UPPER[name]), colour=COLOUR_OF[name])
        sheet.wire((bus, LOWER[name]), (520, LOWER[name]), colour=COLOUR_OF[name])
        sheet.end()


def _bus_x(number: int) -> float:
    return 820 - 24 * number


UPPER = {"SDA": 168, "SCL": 204, "COILS_READY": 270, "COILS_POWER": 306}
LOWER = {"SDA": 640, "SCL": 676, "COILS_READY": 712, "COILS_POWER": 748}


def _ldc3114(sheet: Sheet) -> None:
    sheet.begin("LDC3114")
    sheet.box(24, 84, 700, 390, "", fill="#ffffff", dashed=True)
    sheet.text(36, 106, "Either: LDC3114, 1.8 V", size=13, bold=True)
    sheet.box(560, 132, 80, 196, "shifter", ["1.8 and", "3.3 V"])
    sheet.box(330, 132, 170, 260, f"LDC3114, {pins.LDC3114_ADDRESS:#x}", [])
    for name, label in (("SDA", "SDA"), ("SCL", "SCL"), ("COILS_READY", "INTB"), ("COILS_POWER", "LPWRB")):
        y = UPPER[name]
        sheet.wire((560, y), (500, y), colour=COLOUR_OF[name])
        sheet.text(494, y + 4, label, anchor="end", size=10.5)
    sheet.wire((500, 350), (530, 350), colour=COLOURS["3.3 V"])
    sheet.text(494, 354, "VDD", anchor="end", size=10.5)
    sheet.flag(530, 350, "1.8 V regulator, 1 µF", to="right", colour=COLOURS["3.3 V"])
    for number, coil in enumerate(pins.COILS):
        _coil(sheet, 330, 176 + 46 * number, coil, f"IN{coil.channel}", "COM")
    sheet.text(336, 354, "COM", size=10.5)
    sheet.wire((330, 350), (300, 350), colour=COLOURS["analogue"])
    sheet.capacitor(300, 350, "C_COM: data sheet, from coil and Q", beside="left")
    sheet.lines(
        36, 424,
        ["Each coil and its capacitor lie between its IN and COM. The chip's own buttons and baseline are off;",
         "OUT0 to OUT3 stay open. 100 nF at VDD; pull-ups on the shifter's 1.8 V side where it has none of its own."],
        size=10,
    )  # fmt: skip
    sheet.end()


def _ldc1614(sheet: Sheet) -> None:
    sheet.begin("LDC1614")
    sheet.box(24, 500, 700, 344, "", fill="#ffffff", dashed=True)
    sheet.text(36, 522, "Or: LDC1614, 3.3 V", size=13, bold=True)
    sheet.box(330, 548, 190, 236, f"LDC1614, {pins.LDC1614_ADDRESS:#x}", ["ADDR to ground"])
    for name, label in (("SDA", "SDA"), ("SCL", "SCL"), ("COILS_READY", "INTB"), ("COILS_POWER", "SD")):
        sheet.text(514, LOWER[name] + 4, label, anchor="end", size=10.5)
    sheet.text(514, 614, "CLKIN", anchor="end", size=10.5)
    sheet.wire((520, 610), (552, 610), colour=COLOURS["service"])
    sheet.flag(552, 610, "oscillator, 40 MHz", to="right", colour=COLOURS["service"])
    sheet.text(514, 776, "VDD", anchor="end", size=10.5)
    sheet.wire((520, 772), (552, 772), colour=COLOURS["3.3 V"])
    sheet.flag(552, 772, "3.3 V, 1 µF and 100 nF", to="right", colour=COLOURS["3.3 V"])
    for number, coil in enumerate(pins.COILS):
        _coil(sheet, 330, 598 + 46 * number, coil, f"IN{coil.channel}A", f"IN{coil.channel}B")
    sheet.lines(
        36, 808,
        ["Each coil and its capacitor lie between its own two pins. The drive current (register 0x1E on) is to be matched",
         "to the coils (data sheet): 0.2 mA in the firmware is a guess."],
        size=10,
    )  # fmt: skip
    sheet.end()


def _coil(sheet: Sheet, x: float, y: float, coil: Any, first: str, second: str) -> None:
    """Draw one coil with its capacitor to the left of a chip's edge at ``x``."""
    brown = COLOURS["analogue"]
    sheet.text(x + 6, y + 4, first, size=10.5)
    sheet.wire((x, y), (180, y), colour=brown)
    sheet.text(172, y - 3, f"{coil.key}, bit {coil.bit:#04x}", anchor="end", bold=True)
    sheet.text(172, y + 11, f"coil and C to {second}", anchor="end", size=10)
    loops = " ".join("a 6 6 0 0 1 12 0" for _ in range(4))
    sheet._body.append(f'<path d="M 196 {y:g} {loops}" fill="none" stroke="{brown}" stroke-width="2"/>')


def _service(sheet: Sheet, pico: Pico) -> None:
    sheet.begin("SERVICE")
    colour = COLOUR_OF["SERVICE"]
    x, y = pico.line("SERVICE", 420)
    sheet.wire((x, y), (1240, y), colour=colour)
    sheet.dot(1240, y, colour)
    sheet.wire((1240, y), (1266, y - 12), colour=colour)
    sheet.dot(1270, y, colour)
    sheet.wire((1270, y), (1300, y), colour=colour)
    sheet.ground(1300, y)
    sheet.lines(1200, y + 36, ["jumper: closed while flashing, open in use;", "pull-up inside the chip"], size=10)
    sheet.end()
