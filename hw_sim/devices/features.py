"""The features of a camera: name in the standard, allowed values, and initial value.

A maker's camera is a tuple of these (``makers.py``). Its description (``feature_xml.py``) and its memory
(``feature_book.py``) are both made from them, so that no address is written down twice.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

Value = str | int | float | bool
INT32_HIGH = 2**31 - 1


@dataclass(frozen=True, slots=True, kw_only=True)
class Feature:
    """A feature of the standard features naming convention (SFNC), or of a maker.

    ``selector`` names the feature that selects one of several instances, as TriggerSelector does for TriggerMode.
    """

    name: str
    category: str
    tip: str
    selector: str | None = None
    shapes: bool = False
    """It changes the stream's format: read-only while TLParamsLocked is 1, or the camera acquires or streams."""
    auto: str | None = None
    """The automatic function of this feature, which is read-only unless that is Off."""


@dataclass(frozen=True, slots=True, kw_only=True)
class EnumerationFeature(Feature):
    """One of several names; ``codes`` gives the number of each."""

    codes: Mapping[str, int]
    factory: str
    differing: Mapping[str, str] = field(default_factory=dict)
    """Factory values of instances that differ from ``factory``, by the value of the selector."""

    def code(self, value: Value) -> int:
        """Return the number of a name. Raises ValueError."""
        if not isinstance(value, str) or value not in self.codes:
            raise ValueError(f"{self.name} = {value!r:.80}; allowed are {', '.join(self.codes)}")
        return self.codes[value]


@dataclass(frozen=True, slots=True, kw_only=True)
class IntegerFeature(Feature):
    """A whole number from ``low`` to ``high`` in steps."""

    factory: int
    low: int
    high: int = INT32_HIGH
    step: int = 1
    unit: str = ""
    computed: bool = False
    """Its upper limit follows from other features; the camera has a hidden register with it."""

    def code(self, value: Value) -> int:
        """Return the number. Raises ValueError."""
        if not isinstance(value, int) or isinstance(value, bool) or not self.low <= value <= self.high:
            raise ValueError(f"{self.name} = {value!r:.80}; allowed are whole numbers {self.low}..{self.high}")
        if (value - self.low) % self.step:
            raise ValueError(f"{self.name} = {value}; allowed are steps of {self.step} from {self.low}")
        return value


@dataclass(frozen=True, slots=True, kw_only=True)
class FloatFeature(Feature):
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
class BooleanFeature(Feature):
    """A switch, on or off."""

    factory: bool

    def code(self, value: Value) -> int:
        """Return 0 or 1. Raises ValueError."""
        if not isinstance(value, bool):
            raise ValueError(f"{self.name} = {value!r:.80}; allowed are true and false")
        return int(value)


@dataclass(frozen=True, slots=True, kw_only=True)
class CommandFeature(Feature):
    """A command; writing 1 executes it."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ReadOnlyInteger(Feature):
    """A read-only integer."""

    unit: str = ""


Settable = EnumerationFeature | IntegerFeature | FloatFeature | BooleanFeature
AnyFeature = Settable | CommandFeature | ReadOnlyInteger


def numbered(*names: str) -> dict[str, int]:
    """Return the names with their numbers from 0."""
    return {word: number for number, word in enumerate(names)}


def split_key(key: str) -> tuple[str, str | None]:
    """Return feature and selector value of ``TriggerMode[FrameStart]``; ``None`` without a selector."""
    name, bracket, selector_part = key.partition("[")
    return name, selector_part.removesuffix("]") if bracket else None
