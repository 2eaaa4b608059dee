"""Drawing of a Raspberry Pi Pico on a plan: the header's pins in their order, and the wires that begin there."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any

from bench.wiring.sheet import FAINT, INK, PAPER, Point, Sheet

LAST_OF_THE_LEFT = 20
"""Header pins 1 to 20 run down the left side, 40 to 21 down the right one (Pico datasheet, figure 4)."""
LEAD = 26


@dataclass(slots=True)
class Pico:
    """A module with the lines of a firmware at the heights that the plan gives them."""

    sheet: Sheet
    lines: Iterable[Any]
    left: float
    right: float
    colour_of: Mapping[str, str]
    drawn: set[str] = field(default_factory=set)

    def frame(self, top: float, bottom: float, title: str) -> None:
        middle = (self.left + self.right) / 2
        self.sheet.box(self.left, top, self.right - self.left, bottom - top, title, fill="#eef4ea")
        self.sheet.box(middle - 26, top - 14, 52, 20, "", fill="#d0d7de")
        self.sheet.text(middle, top + 0, "USB", anchor="middle", size=10)

    def line(self, name: str, y: float) -> Point:
        """Draw the pin of a line and the beginning of its wire; return the wire's end."""
        (line,) = [pin for pin in self.lines if pin.name == name]
        self.drawn.add(name)
        side = self._pin(str(line.header_pin), y, int(line.header_pin))
        inside = self.left + 24 if side < 0 else self.right - 24
        anchor = "start" if side < 0 else "end"
        self.sheet.text(inside, y - 1, name, anchor=anchor, bold=True, size=11, colour=self.colour_of[name])
        self.sheet.text(inside, y + 12, f"GP{line.gpio}, {line.direction}", anchor=anchor, size=9.5, colour=FAINT)
        end = (self.left - LEAD, y) if side < 0 else (self.right + LEAD, y)
        self.sheet.wire((self.left if side < 0 else self.right, y), end, colour=self.colour_of[name], thick=2.4)
        return end

    def power(self, pin: int, name: str, y: float, colour: str) -> Point:
        """Draw a pin of the supply or of ground."""
        side = self._pin(str(pin), y, pin)
        self.sheet.text(
            self.left + 24 if side < 0 else self.right - 24,
            y + 4,
            name,
            anchor="start" if side < 0 else "end",
            size=10.5,
        )
        end = (self.left - LEAD, y) if side < 0 else (self.right + LEAD, y)
        self.sheet.wire((self.left if side < 0 else self.right, y), end, colour=colour, thick=2.4)
        return end

    def _pin(self, number: str, y: float, pin: int) -> int:
        side = -1 if pin <= LAST_OF_THE_LEFT else 1
        x = self.left + 1 if side < 0 else self.right - 19
        self.sheet._body.append(
            f'<rect x="{x:g}" y="{y - 8:g}" width="18" height="16" fill="{PAPER}" stroke="{INK}" stroke-width="1.2"/>'
        )
        self.sheet.text(x + 9, y + 4, number, anchor="middle", size=10, bold=True)
        return side


def pull_of(line: Any) -> tuple[str, str] | None:
    """Return direction and value (``down``, ``10 k``) of the outer resistor that holds a line at reset."""
    parts = str(line.at_reset).partition(" ")
    if parts[0] not in ("pull-down", "pull-up") or parts[2] == "inside":
        return None
    return parts[0].removeprefix("pull-"), parts[2]
