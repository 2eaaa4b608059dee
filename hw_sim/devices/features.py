"""Owns what a camera's feature is: a name of the standard, the values it may take, and what it starts with.

A maker's camera is a tuple of these (``makers.py``). The description that the camera hands out (``feature_xml.py``) and the
memory behind it (``feature_book.py``) are both made from them, so that no address is written down twice.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

Value = str | int | float | bool
INT32_HIGH = 2**31 - 1


@dataclass(frozen=True, slots=True, kw_only=True)
class Feature:
    """A feature of the standard features naming convention (SFNC), or of a maker's own.

    ``selector`` names the feature that says which of several instances is meant, as TriggerSelector does for TriggerMode.
    """

    name: str
    category: str
    tip: str
    selector: str | None = None
    shapes: bool = False
    """It changes what the stream carries: read-only while TLParamsLocked is 1, or the camera acquires or streams."""
    auto: str | None = None
    """The feature that takes it over while that is not Off: read-only meanwhile."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Choice(Feature):
    """A word out of several; ``words`` gives the number of each."""

    words: Mapping[str, int]
    factory: str
    differing: Mapping[str, str] = field(default_factory=dict)
    """Factory words of those instances that begin otherwise, by the word of the selector."""

    def code(self, value: Value) -> int:
        """Return the number of a word. Raises ValueError."""
        if not isinstance(value, str) or value not in self.words:
            raise ValueError(f"{self.name} = {value!r:.80}; allowed are {', '.join(self.words)}")
        return self.words[value]


@dataclass(frozen=True, slots=True, kw_only=True)
class Whole(Feature):
    """A whole number from ``low`` to ``high`` in steps."""

    factory: int
    low: int
    high: int = INT32_HIGH
    step: int = 1
    unit: str = ""
    computed: bool = False
    """Its upper limit follows from other features; the camera has a hidden register that says it."""

    def code(self, value: Value) -> int:
        """Return the number. Raises ValueError."""
        if not isinstance(value, int) or isinstance(value, bool) or not self.low <= value <= self.high:
            raise ValueError(f"{self.name} = {value!r:.80}; allowed are whole numbers {self.low}..{self.high}")
        if (value - self.low) % self.step:
            raise ValueError(f"{self.name} = {value}; allowed are steps of {self.step} from {self.low}")
        return value


@dataclass(frozen=True, slots=True, kw_only=True)
class Real(Feature):
    """A number from ``low`` to ``high``."""

    factory: float
    low: float
    high: float
    unit: str = ""

    def code(self, value: Value) -> float:
        """Return the number. Raises ValueError."""
        if not isinstance(value, int | float) or isinstance(value, bool) or not self.low <= value <= self.high:
            raise ValueError(f"{self.name} = {value!r:.80}; allowed are {self.low:g}..{self.high:g}")
        return float(value)


@dataclass(frozen=True, slots=True, kw_only=True)
class Switch(Feature):
    """A switch, on or off."""

    factory: bool

    def code(self, value: Value) -> int:
        """Return 0 or 1. Raises ValueError."""
        if not isinstance(value, bool):
            raise ValueError(f"{self.name} = {value!r:.80}; allowed are true and false")
        return int(value)


@dataclass(frozen=True, slots=True, kw_only=True)
class Press(Feature):
    """A command; writing 1 executes it."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Shown(Feature):
    """A whole number that the camera only shows."""

    unit: str = ""


Settable = Choice | Whole | Real | Switch
AnyFeature = Settable | Press | Shown


def numbered(*words: str) -> dict[str, int]:
    """Return the words with their numbers from 0."""
    return {word: number for number, word in enumerate(words)}


def split_key(key: str) -> tuple[str, str | None]:
    """Return feature and selector's word of ``TriggerMode[FrameStart]``; ``None`` where no word is given."""
    name, bracket, rest = key.partition("[")
    return name, rest.removesuffix("]") if bracket else None
