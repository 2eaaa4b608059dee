"""Drawing of a plan as SVG: wires, parts, pins and words on a sheet, with the position of each word."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from xml.sax.saxutils import escape, quoteattr

INK, PAPER, FAINT = "#1b1f24", "#ffffff", "#6a737d"
GROUND, SUPPLY_5V, SUPPLY_3V3 = "#1b1f24", "#7f0000", "#c2185b"
COLOURS = {
    "sync": "#6a1b9a",
    "trigger": "#e65100",
    "laser": "#d50000",
    "leak": "#0277bd",
    "bus": "#2e7d32",
    "analogue": "#795548",
    "service": "#546e7a",
    "5 V": SUPPLY_5V,
    "3.3 V": SUPPLY_3V3,
    "ground": GROUND,
}
"""Colours of wires by function."""
CHARACTER = 0.56
"""Width of a character over the font height: that of DejaVu Sans and Arial, rather too wide than too narrow."""
Point = tuple[float, float]


@dataclass(frozen=True, slots=True)
class Word:
    """A text and the rectangle that it takes."""

    text: str
    left: float
    top: float
    right: float
    bottom: float

    def overlaps(self, neighbour: Word) -> bool:
        return (
            self.left < neighbour.right
            and neighbour.left < self.right
            and self.top < neighbour.bottom
            and neighbour.top < self.bottom
        )


@dataclass(slots=True)
class Sheet:
    """A sheet of ``width`` by ``height`` units; parts are drawn in the order of the calls."""

    width: int
    height: int
    title: str
    subtitle: str
    labels: list[Word] = field(default_factory=list)
    _body: list[str] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.text(24, 34, self.title, size=20, bold=True)
        self.text(24, 56, self.subtitle, size=12, colour=FAINT)

    def svg(self) -> str:
        """Return the text of the SVG file."""
        head = (
            f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {self.width} {self.height}" width="{self.width}" '
            f'height="{self.height}" font-family="DejaVu Sans, Arial, sans-serif" role="img">\n'
            f"<title>{escape(self.title)}</title>\n"
            f'<rect width="{self.width}" height="{self.height}" fill="{PAPER}"/>\n'
        )
        return head + "\n".join(self._body) + "\n</svg>\n"

    # ---------------------------------------------------------------------------------------------- words and groups

    def begin(self, name: str) -> None:
        """Open a group, by which a test finds the parts of one wire."""
        self._body.append(f"<g id={quoteattr(name)}>")

    def end(self) -> None:
        self._body.append("</g>")

    def text(
        self,
        x: float,
        y: float,
        text: str,
        *,
        size: float = 11,
        anchor: str = "start",
        bold: bool = False,
        colour: str = INK,
    ) -> None:
        """Write ``text`` with its base line at ``y``; ``anchor`` (start, middle or end) lies at ``x``."""
        weight = ' font-weight="bold"' if bold else ""
        self._body.append(
            f'<text x="{x:g}" y="{y:g}" font-size="{size:g}" text-anchor="{anchor}" fill="{colour}"{weight}>'
            f"{escape(text)}</text>"
        )
        wide = CHARACTER * size * len(text) * (1.08 if bold else 1.0)
        left = x - wide * {"start": 0.0, "middle": 0.5, "end": 1.0}[anchor]
        self.labels.append(Word(text, left, y - 0.78 * size, left + wide, y + 0.22 * size))

    def lines(self, x: float, y: float, texts: Iterable[str], *, size: float = 11, colour: str = FAINT) -> None:
        for number, text in enumerate(texts):
            self.text(x, y + number * size * 1.35, text, size=size, colour=colour)

    # ---------------------------------------------------------------------------------------------- wires and parts

    def wire(self, *points: Point, colour: str, thick: float = 2.0, dashed: bool = False) -> None:
        dash = ' stroke-dasharray="6 4"' if dashed else ""
        path = " ".join(f"{x:g},{y:g}" for x, y in points)
        self._body.append(
            f'<polyline points="{path}" fill="none" stroke="{colour}" stroke-width="{thick:g}" stroke-linejoin="round"{dash}/>'
        )

    def dot(self, x: float, y: float, colour: str) -> None:
        """Draw a junction: wires that cross without one are not connected."""
        self._body.append(f'<circle cx="{x:g}" cy="{y:g}" r="3.6" fill="{colour}"/>')

    def resistor(self, x: float, y: float, value: str, *, upright: bool = False, beside: str = "right") -> None:
        """Draw a resistor with its middle at ``x, y``; an upright one has its value beside it."""
        wide, high = (12, 34) if upright else (40, 14)
        self._body.append(
            f'<rect x="{x - wide / 2:g}" y="{y - high / 2:g}" width="{wide}" height="{high}" fill="{PAPER}" '
            f'stroke="{INK}" stroke-width="1.6"/>'
        )
        if upright:
            self.text(
                x + (11 if beside == "right" else -11), y + 4, value, anchor="start" if beside == "right" else "end"
            )
        else:
            self.text(x, y - 11, value, anchor="middle")

    def capacitor(self, x: float, y: float, value: str, *, beside: str = "right") -> None:
        """Draw a capacitor from ``x, y`` down to ground."""
        self.wire((x, y), (x, y + 16), colour=INK, thick=1.6)
        for gap in (16, 22):
            self.wire((x - 10, y + gap), (x + 10, y + gap), colour=INK, thick=2.2)
        self.wire((x, y + 22), (x, y + 36), colour=INK, thick=1.6)
        self.ground(x, y + 36)
        self.text(x + (14 if beside == "right" else -14), y + 23, value, anchor="start" if beside == "right" else "end")

    def ground(self, x: float, y: float) -> None:
        for half, down in ((11, 0), (7, 5), (3, 10)):
            self.wire((x - half, y + down), (x + half, y + down), colour=GROUND, thick=2.0)

    def pull_down(self, x: float, y: float, value: str, *, beside: str = "right") -> None:
        self.wire((x, y), (x, y + 12), colour=INK, thick=1.6)
        self.resistor(x, y + 29, value, upright=True, beside=beside)
        self.wire((x, y + 46), (x, y + 54), colour=INK, thick=1.6)
        self.ground(x, y + 54)

    def pull_up(self, x: float, y: float, value: str, supply: str, *, beside: str = "right") -> None:
        self.wire((x, y), (x, y - 12), colour=INK, thick=1.6)
        self.resistor(x, y - 29, value, upright=True, beside=beside)
        self.wire((x, y - 46), (x, y - 56), colour=INK, thick=1.6)
        self.rail(x, y - 56, supply)

    def rail(self, x: float, y: float, supply: str) -> None:
        """Draw the end of a wire at a supply: a bar with its voltage above."""
        colour = COLOURS.get(supply, SUPPLY_3V3)
        self.wire((x - 11, y), (x + 11, y), colour=colour, thick=3.0)
        self.text(x, y - 5, supply, anchor="middle", size=10, colour=colour, bold=True)

    def box(
        self, x: float, y: float, wide: float, high: float, title: str, notes: Sequence[str] = (), *,
        fill: str = "#f6f8fa", dashed: bool = False,
    ) -> None:  # fmt: skip
        """Draw a part with its name above, inside, and notes below the name."""
        dash = ' stroke-dasharray="7 4"' if dashed else ""
        self._body.append(
            f'<rect x="{x:g}" y="{y:g}" width="{wide:g}" height="{high:g}" rx="5" fill="{fill}" stroke="{INK}" '
            f'stroke-width="1.8"{dash}/>'
        )
        if title:
            self.text(x + wide / 2, y + 19, title, anchor="middle", size=13, bold=True)
        for number, note in enumerate(notes):
            self.text(x + wide / 2, y + 36 + 14 * number, note, anchor="middle", size=10.5, colour=FAINT)

    def flag(self, x: float, y: float, text: str, *, to: str, colour: str) -> None:
        """Draw the end of a wire that goes on elsewhere under this name, to the ``left`` or ``right``."""
        wide = CHARACTER * 11 * len(text) + 20
        sign = 1 if to == "right" else -1
        points = [(0, 0), (9, -11), (wide, -11), (wide, 11), (9, 11)]
        shape = " ".join(f"{x + sign * across:g},{y + down:g}" for across, down in points)
        self._body.append(f'<polygon points="{shape}" fill="{PAPER}" stroke="{colour}" stroke-width="1.6"/>')
        self.text(x + sign * (wide + 7) / 2, y + 4, text, anchor="middle", colour=colour)

    def legend(self, x: float, y: float, names: Sequence[str], *, apart: float = 112) -> None:
        for number, name in enumerate(names):
            left = x + apart * number
            self.wire((left, y - 4), (left + 26, y - 4), colour=COLOURS[name], thick=3.0)
            self.text(left + 32, y, name)
