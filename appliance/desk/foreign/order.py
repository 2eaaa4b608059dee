"""Words for the roles of images and their order, and the sequences of known programs.

``bright dark gray-x*6 sine-x*4`` is such a text; ``(gray-x ~gray-x)*10`` repeats two images ten times, the second one
with its stripes inverted; ``sine-x2`` is of the second period of X; ``modulated-x*9`` is nine images of fringes times a
carrier, ``micro-x*12`` twelve of many periods; ``-`` is an image without a role.

* ``parse_order``, ``words_in``, ``join_words``, ``number_images``: from words to images and back.
* ``SEQUENCES``: the sequences of known programs, one row each, from which ``hypotheses`` about a folder are made.

``{x}`` and ``{y}`` stand for the numbers of bits of a direction, ``{s}`` for a number of steps; all other words are the
language of ``images.order``. A row gives the roles of its images; the width of stripes follows from the projector.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from enum import Enum
from itertools import product
from typing import Any

from appliance.desk.foreign.problem import ForeignError

MOST_IMAGES, MOST_LETTERS = 400, 6000
_REPEATED = re.compile(
    r"(?:\((?P<group>[^()*]*)\)|(?P<word>[^\s()*]+))(?:\s*\*\s*(?P<count>\d{1,9})(?!\s*[\d*])|(?<=\))(?!\s*\*))"
)
_LEFT_OVER = {
    "*": "* needs a word before it and a count after it, as in gray-x*6",
    "(": "an opening bracket has no closing one",
    ")": "a closing bracket has no opening one",
}
_WORD = re.compile(r"(bright|dark|-)|(~?gray|micro)-([xy])|(sine|modulated)-([xy])(\d{0,2})")
WORDS = (
    "bright, dark, gray-x, ~gray-x (inverted), sine-x, sine-x2 (of the second period), modulated-x (times a carrier "
    "across), micro-x (many "
    "periods), the same with y, and - for anything else"
)


class Shows(Enum):
    """Image roles."""

    BRIGHT = "bright"
    DARK = "dark"
    GRAY = "gray"
    """One bit of the stripe number."""
    INVERSE = "~gray"
    """The same bit with bright and dark exchanged."""
    SINE = "sine"
    MODULATED = "modulated"
    """Fringes times a carrier across them, whose steps come one after the other for each step of the fringes."""
    MICRO = "micro"
    """The steps of one period, then one image of each further one."""
    OTHER = "-"


FRINGES = (Shows.SINE, Shows.MODULATED, Shows.MICRO)


@dataclass(frozen=True, slots=True)
class ShownImage:
    """Role of one image of a sequence."""

    shows: Shows
    axis: str = ""
    """``x`` (vertical stripes) or ``y``; empty for an even image."""
    index: int = 0
    """Number of the bit or of the step, in the order of the images."""
    period: int = 0
    """Number of the period that a sine has, from 0."""

    @property
    def word(self) -> str:
        """The image in the words of a description."""
        return (
            f"{self.shows.value}-{self.axis}{self.period + 1 if self.period else ''}" if self.axis else self.shows.value
        )


def parse_order(text: str, key: str) -> tuple[ShownImage, ...]:
    """Return the images that ``text`` names, numbered by kind. Raises ForeignError, which names ``key``."""
    return number_images(words_in(text, key), key)


def words_in(text: str, key: str, max_words: int = MOST_IMAGES) -> list[str]:
    """Return the words of ``text`` with repetitions spelt out, up to ``max_words`` of them.

    Raises ForeignError, which names ``key``.
    """

    def spelt_out(match: re.Match[str]) -> str:
        words, count = (match["group"] or match["word"] or "").split(), int(match["count"] or 1)
        if match["count"] and not 1 <= count * len(words) <= max_words:
            raise ForeignError(
                f"{key}: *{count} repeats {count} times; allowed are 1 and more, at most {max_words} images in all"
            )
        return f" {' '.join(words * count)} "

    spelt, previous = text, ""
    while spelt != previous:
        if len(spelt) > MOST_LETTERS:
            raise ForeignError(f"{key} names more than {max_words} images, or too many words; shorten it")
        # The innermost brackets, and words beside them.
        previous, spelt = spelt, _REPEATED.sub(spelt_out, spelt)
    for sign, wrong in _LEFT_OVER.items():
        if sign in spelt:
            raise ForeignError(f"{key} is {text!r:.80}: {wrong}; correct it")
    words = spelt.split()
    if len(words) > max_words:
        raise ForeignError(f"{key} names {len(words)} images; allowed are up to {max_words}; shorten it")
    return words


def join_words(words: Sequence[str]) -> str:
    """Return words with repetitions written as such: ``gray-x*6``, ``(gray-x ~gray-x)*6``."""
    parts: list[str] = []
    k = 0
    while k < len(words):
        for length in (1, 2):
            unit, count = list(words[k : k + length]), 1
            while list(words[k + count * length : k + (count + 1) * length]) == unit:
                count += 1
            if count > 1 and len(set(unit)) == length:
                parts.append(f"{unit[0] if length == 1 else '(' + ' '.join(unit) + ')'}*{count}")
                k += count * length
                break
        else:
            parts.append(words[k])
            k += 1
    return " ".join(parts)


def number_images(words: list[str], key: str) -> tuple[ShownImage, ...]:
    """Return the images of single ``words``, bits and steps numbered in that order. Raises ForeignError."""
    counts: dict[tuple[Shows, str, int], int] = {}
    images = []
    for word in words:
        match = _WORD.fullmatch(word)
        if match is None:
            raise ForeignError(f"{key}: {word!r:.40} is no image; allowed: {WORDS}; correct it")
        shows, axis, period = (
            Shows(match[1] or match[2] or match[4]),
            match[3] or match[5] or "",
            int(match[6] or 1) - 1,
        )
        if period < 0:
            raise ForeignError(f"{key}: {word!r} names period 0; the first one is sine-x or sine-x1")
        count = counts.get((shows, axis, period), 0)
        if shows in (Shows.BRIGHT, Shows.DARK) and count:
            raise ForeignError(f"{key} names {word} twice; allowed is one; write - for the other")
        counts[shows, axis, period] = count + 1
        images.append(ShownImage(shows, axis, count, period))
    return tuple(images)


NUMBERS = {"x": range(3, 13), "y": range(3, 13), "s": range(3, 17)}
"""Usual numbers of bits of both directions and of steps."""
ROWS_LESS_COLUMNS = range(-2, 2)
"""Bits of the rows less those of the columns: a picture is up to four times as wide as high, or twice as high."""
EXCHANGED = {Shows.BRIGHT: Shows.DARK, Shows.DARK: Shows.BRIGHT}


@dataclass(frozen=True, slots=True)
class ProjectedSequence:
    """One sequence that a program projects, or that a folder's images may show."""

    program: str
    order: str = ""
    conventions: Mapping[str, Any] = field(default_factory=dict)
    """Values of fields of the conventions that the program fixes, for all directions."""
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
    """Yield the sequences of ``count`` images by the rows of the table, bright and dark in both orders."""
    for row in SEQUENCES:
        names = [name for name in NUMBERS if f"{{{name}}}" in row.order]
        least_numbers = dict.fromkeys(NUMBERS, 1)
        # The count is linear in each number: the counts of two numbers give all others.
        fewest = _count(row, least_numbers)
        images_each = [_count(row, {**least_numbers, name: 2}) - fewest for name in names]
        for numbers in product(*(NUMBERS[name] for name in names)):
            chosen = least_numbers | dict(zip(names, numbers, strict=True))
            if fewest + sum((n - 1) * each for n, each in zip(numbers, images_each, strict=True)) != count:
                continue
            if "y" in names and chosen["y"] - chosen["x"] not in ROWS_LESS_COLUMNS:
                continue
            shown = parse_order(row.order.format(**chosen), row.program)
            yield replace(row, shown=shown)
            yield replace(
                row, shown=tuple(replace(image, shows=EXCHANGED.get(image.shows, image.shows)) for image in shown)
            )


def _count(row: ProjectedSequence, numbers: Mapping[str, int]) -> int:
    return len(parse_order(row.order.format(**numbers), row.program))
