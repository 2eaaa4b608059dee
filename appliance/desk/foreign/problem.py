"""Errors of the import of foreign images, and checked access to the tables of a description.

Each error is one line that names the key, its value, the allowed values and the remedy.
"""

from __future__ import annotations

import difflib
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import Any


class ForeignError(Exception):
    """A description cannot be followed, or its images are missing or contradict it."""


@dataclass(frozen=True, slots=True)
class Table:
    """A table of a description; an unknown key in it is an error."""

    name: str
    """Its name with a dot behind it (``projector.``); empty for the whole file."""
    content: Mapping[str, Any]

    def wrong(self, key: str, allowed: str, remedy: str) -> ForeignError:
        """Return the error for a key whose value is not allowed."""
        return ForeignError(f"{self.name}{key} is {self.content.get(key)!r:.80}; allowed: {allowed}; {remedy}")

    def only(self, *allowed: str) -> None:
        """Raise ForeignError, with the nearest allowed key, if a key is not among ``allowed``."""
        for key in self.content:
            if key not in allowed:
                near = difflib.get_close_matches(key, allowed, 1)
                hint = f"did you mean {near[0]}?" if near else f"known are: {', '.join(allowed)}"
                raise ForeignError(f"{self.name}{key:.60}: unknown key; {hint}")

    def table(self, key: str, *allowed: str) -> Table | None:
        """Return the table below ``key``, ``None`` if it is missing; ``allowed`` are its keys, none: any."""
        value = self.content.get(key)
        if value is None:
            return None
        if not isinstance(value, Mapping):
            raise self.wrong(key, "a table", f"write [{self.name}{key}]")
        subtable = Table(f"{self.name}{key}.", value)
        if allowed:
            subtable.only(*allowed)
        return subtable

    def needed(self, key: str, *allowed: str) -> Table:
        """Return the table below ``key``. Raises ForeignError if it is missing."""
        table = self.table(key, *allowed)
        if table is None:
            raise ForeignError(f"[{key}] is missing; add it (`kingfisher import FOLDER` writes a first description)")
        return table

    def text(self, key: str, default: str | None = None) -> str:
        """Return a text. Raises ForeignError if it is missing and has no ``default``."""
        value = self.content.get(key, default)
        if not isinstance(value, str):
            raise self.wrong(key, "a text", "put it between quotation marks")
        return value

    def choice(self, key: str, allowed: Collection[str], default: str) -> str:
        """Return one of the words ``allowed``."""
        value = self.content.get(key, default)
        if not isinstance(value, str) or value not in allowed:
            raise self.wrong(key, ", ".join(allowed), "choose one of them")
        return str(value)

    def flag(self, key: str) -> bool:
        """Return true or false; false if the key is missing."""
        value = self.content.get(key, False)
        if not isinstance(value, bool):
            raise self.wrong(key, "true or false", "write it without quotation marks")
        return value

    def number(self, key: str, low: float, high: float, default: float | None = None) -> float:
        """Return a number ``low`` to ``high``. Raises ForeignError if it is missing and has no ``default``."""
        return _number(self, key, self.content.get(key, default), low, high)

    def optional(self, key: str, low: float, high: float) -> float | None:
        """Return a number ``low`` to ``high``; ``None`` if the key is missing."""
        return self.number(key, low, high) if key in self.content else None

    def whole(self, key: str, low: int, high: int) -> int:
        """Return a whole number ``low`` to ``high``."""
        return self.wholes(key, low, high, 1)[0]

    def wholes(self, key: str, low: int, high: int, max_count: int = 16) -> tuple[int, ...]:
        """Return whole numbers ``low`` to ``high``; one number is a list of one."""
        values = self.numbers(key, low, high, "a whole number")
        if len(values) > max_count or any(value != int(value) for value in values):
            raise self.wrong(key, f"a whole number {low}..{high}", "correct it")
        return tuple(int(value) for value in values)

    def numbers(
        self, key: str, low: float, high: float, what: str = "a number", default: object = None
    ) -> tuple[float, ...]:
        """Return a list of numbers ``low`` to ``high``; one number is a list of one."""
        value = self.content.get(key, default)
        items = value if isinstance(value, Sequence) and not isinstance(value, str) else [value]
        if not items:
            raise self.wrong(key, f"numbers {low:g}..{high:g}", "name at least one")
        return tuple(_number(self, key, item, low, high, what) for item in items)


def _number(table: Table, key: str, value: object, low: float, high: float, what: str = "a number") -> float:
    allowed = f"{what} {low:g}..{high:g}"
    if value is None:
        raise ForeignError(f"{table.name}{key} is missing; allowed: {allowed}; add it")
    # Whole numbers may be longer than any float, and NaN is in no range.
    if isinstance(value, bool) or not isinstance(value, int | float) or not low <= value <= high:
        raise table.wrong(key, allowed, "write one of these")
    return float(value)
