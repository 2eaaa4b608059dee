"""Owns the sequences of images that known programs project: one row each, from which hypotheses about a folder are made.

``{x}`` and ``{y}`` stand for the numbers of bits of a direction, ``{s}`` for a number of steps; everything else is the language of
``images.order``. A row says what its images show; how wide its stripes are follows from the projector.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from itertools import product
from typing import Any

from appliance.foreign.order import ShownImage, parse_order

BITS = range(3, 13)
STEPS = range(3, 17)
ROWS_LESS_COLUMNS = range(-2, 2)
"""Bits of the rows less those of the columns: a picture is up to four times as wide as high, or twice as high."""


@dataclass(frozen=True, slots=True)
class Sequence:
    """One sequence that a program projects."""

    program: str
    order: str
    conventions: Mapping[str, Any] = field(default_factory=dict)
    """Fields of the conventions of all directions that the program fixes."""


SLSTUDIO: Mapping[str, Any] = {"sign": -1, "from_middle": True}
SEQUENCES = (
    Sequence("scan3d-capture, 3DUNDERWORLD, procamcalib", "bright dark (gray-x ~gray-x)*{x} (gray-y ~gray-y)*{y}"),
    Sequence("OpenCV GrayCodePattern, white and black last", "(gray-x ~gray-x)*{x} (gray-y ~gray-y)*{y} bright dark"),
    Sequence("OpenCV GrayCodePattern", "(gray-x ~gray-x)*{x} (gray-y ~gray-y)*{y}"),
    Sequence("pairs, rows first", "bright dark (gray-y ~gray-y)*{y} (gray-x ~gray-x)*{x}"),
    Sequence("pairs of the columns", "bright dark (gray-x ~gray-x)*{x}"),
    Sequence("pairs of the columns, white and black last", "(gray-x ~gray-x)*{x} bright dark"),
    Sequence("pairs of the columns alone", "(gray-x ~gray-x)*{x}"),
    Sequence("SLStudio GrayCode", "bright dark gray-x*{x}"),
    Sequence("columns, references last", "gray-x*{x} bright dark"),
    Sequence("both directions without inverses", "bright dark gray-x*{x} gray-y*{y}"),
    Sequence("both directions, references last", "gray-x*{x} gray-y*{y} bright dark"),
    Sequence("inverses as a block", "bright dark gray-x*{x} ~gray-x*{x}"),
    Sequence("inverses as a block, no references", "gray-x*{x} ~gray-x*{x}"),
    Sequence("both directions, a block each", "gray-x*{x} ~gray-x*{x} gray-y*{y} ~gray-y*{y}"),
    Sequence("references, a block each", "bright dark gray-x*{x} ~gray-x*{x} gray-y*{y} ~gray-y*{y}"),
    Sequence(
        "references, both directions, inverses behind", "bright dark gray-x*{x} gray-y*{y} ~gray-x*{x} ~gray-y*{y}"
    ),
    Sequence("both directions, inverses behind", "gray-x*{x} gray-y*{y} ~gray-x*{x} ~gray-y*{y}"),
    Sequence("SLMaster: steps, then Gray code", "sine-x*{s} gray-x*{x}"),
    Sequence("Gray code, then steps", "gray-x*{x} sine-x*{s}"),
    Sequence("references, Gray code, steps", "bright dark gray-x*{x} sine-x*{s}"),
    Sequence("references, steps, Gray code", "bright dark sine-x*{s} gray-x*{x}"),
    Sequence("Gray code, references, steps", "gray-x*{x} bright dark sine-x*{s}"),
    Sequence("steps, Gray code, references", "sine-x*{s} gray-x*{x} bright dark"),
    Sequence("Gray code, steps, references", "gray-x*{x} sine-x*{s} bright dark"),
    Sequence("black, Gray code, steps, white, as names are sorted", "dark gray-x*{x} sine-x*{s} bright"),
    Sequence("black, Gray code, white, as names are sorted", "dark gray-x*{x} bright"),
    Sequence("pairs, then steps", "bright dark (gray-x ~gray-x)*{x} sine-x*{s}"),
    Sequence("Kingfisher", "bright dark gray-x*{x} sine-x*{s} gray-y*{y} sine-y*{s}"),
    Sequence("steps and Gray code in both directions", "sine-x*{s} gray-x*{x} sine-y*{s} gray-y*{y}"),
    Sequence("Gray code and steps in both directions", "gray-x*{x} sine-x*{s} gray-y*{y} sine-y*{s}"),
    Sequence("Gray code of the coarsest of three periods", "sine-x*{s} sine-x2*{s} sine-x3*{s} gray-x*{x} bright dark"),
    Sequence("Gray code of the coarser of two periods", "sine-x*{s} sine-x2*{s} gray-x*{x} bright dark"),
    Sequence("SLStudio phase shifting", "sine-x*{s}", SLSTUDIO),
    Sequence("SLStudio phase shifting of two periods", "sine-x*{s} sine-x2*{s}", SLSTUDIO),
    Sequence(
        "SLStudio micro phase shifting",
        "micro-x*12",
        {
            "size_px": 1824.0,
            "periods_px": (75.02, 70.0, 71.32, 72.47, 73.72, 76.23, 77.35, 78.4, 79.22, 80.0),
            "steps_deg": ((0.0, 120.0, 240.0), *[(0.0,)] * 9),
            "starts_deg": (0.0, *[180.0, 0.0] * 4, 180.0),
            "from_middle": True,
        },
    ),
    Sequence(
        "SLStudio modulated phase shifting",
        "modulated-x*9 sine-x2*3",
        {
            "size_px": 1824.0,
            "periods_px": (76.0, 1824.0),
            "steps_deg": ((0.0, 120.0, 240.0),) * 2,
            "carriers": (3, 0),
            **SLSTUDIO,
        },
    ),
    Sequence("heterodyne, three periods", "sine-x*{s} sine-x2*{s} sine-x3*{s}"),
    Sequence("four periods", "sine-x*{s} sine-x2*{s} sine-x3*{s} sine-x4*{s}"),
    Sequence("two periods in both directions", "sine-x*{s} sine-x2*{s} sine-y*{s} sine-y2*{s}"),
    Sequence("two periods in both directions, references", "bright dark sine-x*{s} sine-x2*{s} sine-y*{s} sine-y2*{s}"),
    Sequence(
        "three periods in both directions", "sine-x*{s} sine-x2*{s} sine-x3*{s} sine-y*{s} sine-y2*{s} sine-y3*{s}"
    ),
)


@dataclass(frozen=True, slots=True)
class Hypothesis:
    """Supposition of what a folder's images show."""

    program: str
    shown: tuple[ShownImage, ...]
    conventions: Mapping[str, Any] = field(default_factory=dict)


def hypotheses(count: int) -> Iterator[Hypothesis]:
    """Yield what ``count`` images may show, by the rows of the table whose numbers of bits and steps come out; references both ways."""
    for row in SEQUENCES:
        for order in dict.fromkeys((row.order, row.order.replace("bright dark", "dark bright"))):
            for numbers in _numbers(order, count):
                yield Hypothesis(row.program, parse_order(order.format(**numbers), row.program), row.conventions)


def _numbers(order: str, count: int) -> Iterator[dict[str, int]]:
    """Yield the numbers of bits and steps with which an order names ``count`` images."""
    ranges = {name: values for name, values in (("x", BITS), ("y", BITS), ("s", STEPS)) if f"{{{name}}}" in order}
    ones = dict.fromkeys(ranges, 1)
    # Each word counts as many images whatever its number: two lengths tell all of them.
    fewest = len(parse_order(order.format(**ones), order))
    more = {name: len(parse_order(order.format(**{**ones, name: 2}), order)) - fewest for name in ranges}
    for values in product(*ranges.values()):
        numbers = dict(zip(ranges, values, strict=True))
        if fewest + sum(more[name] * (number - 1) for name, number in numbers.items()) != count:
            continue
        if {"x", "y"} <= set(numbers) and numbers["y"] - numbers["x"] not in ROWS_LESS_COLUMNS:
            continue
        yield numbers
