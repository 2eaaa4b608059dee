"""Owns the sequences of images that known programs project: one row each, from which hypotheses about a folder are made.

``{x}`` and ``{y}`` stand for the numbers of bits of a direction, ``{s}`` for a number of steps; everything else is the language of
``images.order``. A row says what its images show; how wide its stripes are follows from the projector.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from itertools import product
from typing import Any

from appliance.desk.foreign.order import ShownImage, Shows, parse_order

NUMBERS = {"x": range(3, 13), "y": range(3, 13), "s": range(3, 17)}
"""Bits of both directions and steps that programs have."""
ROWS_LESS_COLUMNS = range(-2, 2)
"""Bits of the rows less those of the columns: a picture is up to four times as wide as high, or twice as high."""
EXCHANGED = {Shows.BRIGHT: Shows.DARK, Shows.DARK: Shows.BRIGHT}


@dataclass(frozen=True, slots=True)
class ProjectedSequence:
    """One sequence that a program projects, or that a folder's images may show."""

    program: str
    order: str = ""
    conventions: Mapping[str, Any] = field(default_factory=dict)
    """Fields of the conventions of all directions that the program fixes."""
    shown: tuple[ShownImage, ...] = ()
    """Images that ``order`` names; empty in the table, where numbers are left open."""


SLSTUDIO: Mapping[str, Any] = {"sign": -1, "from_middle": True}
SEQUENCES = (
    ProjectedSequence("scan3d-capture, 3DUNDERWORLD, procamcalib", "bright dark (gray-x ~gray-x)*{x} (gray-y ~gray-y)*{y}"),
    ProjectedSequence("OpenCV GrayCodePattern, white and black last", "(gray-x ~gray-x)*{x} (gray-y ~gray-y)*{y} bright dark"),
    ProjectedSequence("OpenCV GrayCodePattern", "(gray-x ~gray-x)*{x} (gray-y ~gray-y)*{y}"),
    ProjectedSequence("pairs, rows first", "bright dark (gray-y ~gray-y)*{y} (gray-x ~gray-x)*{x}"),
    ProjectedSequence("pairs of the columns", "bright dark (gray-x ~gray-x)*{x}"),
    ProjectedSequence("pairs of the columns, white and black last", "(gray-x ~gray-x)*{x} bright dark"),
    ProjectedSequence("pairs of the columns alone", "(gray-x ~gray-x)*{x}"),
    ProjectedSequence("SLStudio GrayCode", "bright dark gray-x*{x}"),
    ProjectedSequence("columns, references last", "gray-x*{x} bright dark"),
    ProjectedSequence("both directions without inverses", "bright dark gray-x*{x} gray-y*{y}"),
    ProjectedSequence("both directions, references last", "gray-x*{x} gray-y*{y} bright dark"),
    ProjectedSequence("inverses as a block", "bright dark gray-x*{x} ~gray-x*{x}"),
    ProjectedSequence("inverses as a block, no references", "gray-x*{x} ~gray-x*{x}"),
    ProjectedSequence("both directions, a block each", "gray-x*{x} ~gray-x*{x} gray-y*{y} ~gray-y*{y}"),
    ProjectedSequence("references, a block each", "bright dark gray-x*{x} ~gray-x*{x} gray-y*{y} ~gray-y*{y}"),
    ProjectedSequence("references, both directions, inverses behind", "bright dark gray-x*{x} gray-y*{y} ~gray-x*{x} ~gray-y*{y}"),
    ProjectedSequence("both directions, inverses behind", "gray-x*{x} gray-y*{y} ~gray-x*{x} ~gray-y*{y}"),
    ProjectedSequence("SLMaster: steps, then Gray code", "sine-x*{s} gray-x*{x}"),
    ProjectedSequence("Gray code, then steps", "gray-x*{x} sine-x*{s}"),
    ProjectedSequence("references, Gray code, steps", "bright dark gray-x*{x} sine-x*{s}"),
    ProjectedSequence("references, steps, Gray code", "bright dark sine-x*{s} gray-x*{x}"),
    ProjectedSequence("Gray code, references, steps", "gray-x*{x} bright dark sine-x*{s}"),
    ProjectedSequence("steps, Gray code, references", "sine-x*{s} gray-x*{x} bright dark"),
    ProjectedSequence("Gray code, steps, references", "gray-x*{x} sine-x*{s} bright dark"),
    ProjectedSequence("black, Gray code, steps, white, as names are sorted", "dark gray-x*{x} sine-x*{s} bright"),
    ProjectedSequence("black, Gray code, white, as names are sorted", "dark gray-x*{x} bright"),
    ProjectedSequence("pairs, then steps", "bright dark (gray-x ~gray-x)*{x} sine-x*{s}"),
    ProjectedSequence("Kingfisher", "bright dark gray-x*{x} sine-x*{s} gray-y*{y} sine-y*{s}"),
    ProjectedSequence("steps and Gray code in both directions", "sine-x*{s} gray-x*{x} sine-y*{s} gray-y*{y}"),
    ProjectedSequence("Gray code and steps in both directions", "gray-x*{x} sine-x*{s} gray-y*{y} sine-y*{s}"),
    ProjectedSequence("Gray code of the coarsest of three periods", "sine-x*{s} sine-x2*{s} sine-x3*{s} gray-x*{x} bright dark"),
    ProjectedSequence("Gray code of the coarser of two periods", "sine-x*{s} sine-x2*{s} gray-x*{x} bright dark"),
    ProjectedSequence("SLStudio phase shifting", "sine-x*{s}", SLSTUDIO),
    ProjectedSequence("SLStudio phase shifting of two periods", "sine-x*{s} sine-x2*{s}", SLSTUDIO),
    ProjectedSequence("SLStudio micro phase shifting", "micro-x*12", {
        "size_px": 1824.0, "periods_px": (75.02, 70.0, 71.32, 72.47, 73.72, 76.23, 77.35, 78.4, 79.22, 80.0),
        "steps_deg": ((0.0, 120.0, 240.0), *[(0.0,)] * 9), "starts_deg": (0.0, *[180.0, 0.0] * 4, 180.0), "from_middle": True,
    }),
    ProjectedSequence("SLStudio modulated phase shifting", "modulated-x*9 sine-x2*3", {
        "size_px": 1824.0, "periods_px": (76.0, 1824.0), "steps_deg": ((0.0, 120.0, 240.0),) * 2, "carriers": (3, 0), **SLSTUDIO,
    }),
    ProjectedSequence("heterodyne, three periods", "sine-x*{s} sine-x2*{s} sine-x3*{s}"),
    ProjectedSequence("four periods", "sine-x*{s} sine-x2*{s} sine-x3*{s} sine-x4*{s}"),
    ProjectedSequence("two periods in both directions", "sine-x*{s} sine-x2*{s} sine-y*{s} sine-y2*{s}"),
    ProjectedSequence("two periods in both directions, references", "bright dark sine-x*{s} sine-x2*{s} sine-y*{s} sine-y2*{s}"),
    ProjectedSequence("three periods in both directions", "sine-x*{s} sine-x2*{s} sine-x3*{s} sine-y*{s} sine-y2*{s} sine-y3*{s}"),
)  # fmt: skip


def hypotheses(count: int) -> Iterator[ProjectedSequence]:
    """Yield what ``count`` images may show, by the rows of the table whose numbers of bits and steps come out; references both ways."""
    for row in SEQUENCES:
        names = [name for name in NUMBERS if f"{{{name}}}" in row.order]
        ones = dict.fromkeys(NUMBERS, 1)
        # Each word counts as many images whatever its number: two lengths tell all of them.
        fewest = _count(row, ones)
        more = [_count(row, {**ones, name: 2}) - fewest for name in names]
        for numbers in product(*(NUMBERS[name] for name in names)):
            chosen = ones | dict(zip(names, numbers, strict=True))
            if fewest + sum((n - 1) * each for n, each in zip(numbers, more, strict=True)) != count:
                continue
            if "y" in names and chosen["y"] - chosen["x"] not in ROWS_LESS_COLUMNS:
                continue
            shown = parse_order(row.order.format(**chosen), row.program)
            yield replace(row, shown=shown)
            yield replace(row, shown=tuple(replace(one, shows=EXCHANGED.get(one.shows, one.shows)) for one in shown))


def _count(row: ProjectedSequence, numbers: Mapping[str, int]) -> int:
    return len(parse_order(row.order.format(**numbers), row.program))
