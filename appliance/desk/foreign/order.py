"""Owns the words in which a description says what each image shows, and in which order.

``bright dark gray-x*6 sine-x*4`` is one such text; ``(gray-x ~gray-x)*10`` repeats two images ten times, the second one with its
stripes inverted; ``sine-x2`` is of the second period of X; ``modulated-x*9`` is nine images of fringes times a carrier, ``micro-x*12``
twelve of many periods; ``-`` is an image that shows something else.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from enum import Enum

from appliance.desk.foreign.problem import ForeignError

MOST_IMAGES, MOST_LETTERS = 400, 6000
_REPEATED = re.compile(
    r"(?:\((?P<group>[^()*]*)\)|(?P<word>[^\s()*]+))(?:\s*\*\s*(?P<count>\d{1,9})(?!\s*[\d*])|(?<=\))(?!\s*\*))"
)
_LEFT_OVER = {
    "*": "* stands between something and how often it is there, as in gray-x*6",
    "(": "a bracket is opened that is not closed",
    ")": "a bracket is closed that was not opened",
}
_WORD = re.compile(r"(bright|dark|-)|(~?gray|micro)-([xy])|(sine|modulated)-([xy])(\d{0,2})")
WORDS = (
    "bright, dark, gray-x, ~gray-x (inverted), sine-x, sine-x2 (of the second period), modulated-x (times a carrier across), micro-x (many "
    "periods), the same with y, and - for anything else"
)


class Shows(Enum):
    """Kinds of images."""

    BRIGHT = "bright"
    DARK = "dark"
    GRAY = "gray"
    """One bit of the stripes' numbers."""
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
    """One image of a sequence."""

    shows: Shows
    axis: str = ""
    """``x`` (vertical stripes) or ``y``; empty where nothing varies."""
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
    return numbered(words_in(text, key), key)


def words_in(text: str, key: str, most: int = MOST_IMAGES) -> list[str]:
    """Return the words of ``text`` with repetitions spelt out, up to ``most`` of them. Raises ForeignError, which names ``key``."""

    def spelt_out(found: re.Match[str]) -> str:
        words, count = (found["group"] or found["word"] or "").split(), int(found["count"] or 1)
        if found["count"] and not 1 <= count * len(words) <= most:
            raise ForeignError(f"{key}: *{count} repeats {count} times; allowed are 1 and more, {most} images in all")
        return f" {' '.join(words * count)} "

    spelt, before = text, ""
    while spelt != before:
        if len(spelt) > MOST_LETTERS:
            raise ForeignError(f"{key} names more than {most} images, or too much else; shorten it")
        # The innermost brackets, and words beside them.
        before, spelt = spelt, _REPEATED.sub(spelt_out, spelt)
    for sign, wrong in _LEFT_OVER.items():
        if sign in spelt:
            raise ForeignError(f"{key} is {text!r:.80}: {wrong}; correct it")
    words = spelt.split()
    if len(words) > most:
        raise ForeignError(f"{key} names {len(words)} images; allowed are up to {most}; shorten it")
    return words


def numbered(words: list[str], key: str) -> tuple[ShownImage, ...]:
    """Return the images of single ``words``, bits and steps numbered in that order. Raises ForeignError."""
    counts: dict[tuple[Shows, str, int], int] = {}
    images = []
    for word in words:
        found = _WORD.fullmatch(word)
        if found is None:
            raise ForeignError(f"{key}: {word!r:.40} is no image; allowed: {WORDS}; correct it")
        shows, axis, period = (
            Shows(found[1] or found[2] or found[4]),
            found[3] or found[5] or "",
            int(found[6] or 1) - 1,
        )
        if period < 0:
            raise ForeignError(f"{key}: {word!r} names period 0; the first one is sine-x or sine-x1")
        count = counts.get((shows, axis, period), 0)
        if shows in (Shows.BRIGHT, Shows.DARK) and count:
            raise ForeignError(f"{key} names {word} twice; there is one at most; write - for the other")
        counts[shows, axis, period] = count + 1
        images.append(ShownImage(shows, axis, count, period))
    return tuple(images)
