"""Owns the words in which a description says what each image shows, and in which order.

``bright dark gray-x*6 sine-x*4`` is one such text; ``(gray-x ~gray-x)*10`` repeats two images ten times, the second one with its
stripes inverted; ``sine-x2`` is of the second period of X; ``modulated-x*9`` is nine images of fringes times a carrier, ``micro-x*12``
twelve of many periods; ``-`` is an image that shows something else.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from enum import Enum

from appliance.foreign.problem import ForeignError

MOST_IMAGES, MOST_BRACKETS = 400, 50
_TOKEN = re.compile(r"\s*(\(|\)|\*\s*\d+|~?[a-z]+(?:-[xy]\d{0,2})?|-)")
_WORD = re.compile(r"(~?)(bright|dark|gray|sine|modulated|micro|-)(?:-([xy])(\d{0,2}))?")
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
    INVERSE = "inverse"
    """The same bit with bright and dark exchanged."""
    SINE = "sine"
    MODULATED = "modulated"
    """Fringes times a carrier across them, whose steps come one after the other for each step of the fringes."""
    MICRO = "micro"
    """The steps of one period, then one image of each further one."""
    OTHER = "other"


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
        if self.shows is Shows.OTHER:
            return "-"
        kind = "~gray" if self.shows is Shows.INVERSE else self.shows.value
        return f"{kind}-{self.axis}{self.period + 1 if self.period else ''}" if self.axis else kind


def parse_order(text: str, key: str) -> tuple[ShownImage, ...]:
    """Return the images that ``text`` names, numbered by kind. Raises ForeignError, which names ``key``."""
    tokens = _tokens(text, key)
    if tokens.count("(") > MOST_BRACKETS:
        raise ForeignError(f"{key} opens {tokens.count('(')} brackets; allowed are up to {MOST_BRACKETS}; shorten it")
    words, at = _group(tokens, 0, key)
    if at != len(tokens):
        raise ForeignError(f"{key} is {text!r:.80}: a bracket is closed that was not opened; correct it")
    return numbered(words, key)


def numbered(words: list[str], key: str) -> tuple[ShownImage, ...]:
    """Return the images of single ``words``, bits and steps numbered in that order. Raises ForeignError."""
    counts: dict[tuple[Shows, str, int], int] = {}
    images = []
    for word in words:
        found = _WORD.fullmatch(word)
        kind = found[2] if found else ""
        varies = kind not in ("bright", "dark", "-")
        numbers = bool(found and found[4]) and kind not in ("sine", "modulated")
        if found is None or varies != bool(found[3]) or (found[1] and kind != "gray") or numbers:
            raise ForeignError(f"{key}: {word!r:.40} is no image; allowed: {WORDS}; correct it")
        shows = Shows.OTHER if kind == "-" else Shows.INVERSE if found[1] else Shows(kind)
        axis, period = found[3] or "", int(found[4] or 1) - 1
        if period < 0:
            raise ForeignError(f"{key}: {word!r} names period 0; the first one is sine-x or sine-x1")
        count = counts.get((shows, axis, period), 0)
        if shows in (Shows.BRIGHT, Shows.DARK) and count:
            raise ForeignError(f"{key} names {word} twice; there is one at most; write - for the other")
        counts[shows, axis, period] = count + 1
        images.append(ShownImage(shows, axis, count, period))
    return tuple(images)


def _tokens(text: str, key: str) -> list[str]:
    tokens, at = [], 0
    while text[at:].strip():
        found = _TOKEN.match(text, at)
        if found is None:
            raise ForeignError(f"{key}: {text[at : at + 20].strip()!r} is no image; allowed: {WORDS}; correct it")
        tokens.append(found[1].replace(" ", ""))
        at = found.end()
    return tokens


def _group(tokens: list[str], at: int, key: str) -> tuple[list[str], int]:
    """Return the words from token ``at`` to the closing bracket or the end, and the token behind them."""
    words: list[str] = []
    last: list[str] = []
    while at < len(tokens) and tokens[at] != ")":
        token = tokens[at]
        at += 1
        if token.startswith("*"):
            if not last:
                raise ForeignError(f"{key}: {token} stands behind nothing that could be repeated; correct it")
            count = int(token[1:])
            if not 1 <= count <= MOST_IMAGES or len(words) + len(last) * count > MOST_IMAGES:
                raise ForeignError(
                    f"{key}: {token} repeats {count} times; allowed are 1 and more, {MOST_IMAGES} images in all"
                )
            words += last * (count - 1)
            last = []
            continue
        if token == "(":
            last, at = _group(tokens, at, key)
            if at >= len(tokens):
                raise ForeignError(f"{key}: a bracket is opened that is not closed; add )")
            at += 1
        else:
            last = [token]
        words += last
        if len(words) > MOST_IMAGES:
            raise ForeignError(f"{key} names more than {MOST_IMAGES} images; shorten it")
    return words, at
