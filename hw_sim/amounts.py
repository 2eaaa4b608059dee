"""Owns how a script writes a value: ``name=amount`` words, vectors as ``x,y,z``, or ``off`` for the value's defaults."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields, is_dataclass, replace
from typing import Any, TypeVar

Value = TypeVar("Value")


def changed(value: Value, what: str, words: Sequence[str]) -> Value:
    """A frozen dataclass with the named amounts changed. ``what`` names it in errors. Raises ValueError."""
    if not is_dataclass(value) or isinstance(value, type):
        raise TypeError(f"{what}: {value!r} has no amounts")
    if tuple(words) == ("off",):
        return type(value)()
    known = {f.name: getattr(value, f.name) for f in fields(value)}
    amounts: dict[str, Any] = {}
    for word in words:
        name, sign, text = word.partition("=")
        if name not in known or not sign:
            raise ValueError(
                f"{what}: '{word}' is not understood; allowed are off, or any of {', '.join(known)} = amount"
            )
        amounts[name] = _amount(f"{what} {name}", text, known[name])
    if not amounts:
        raise ValueError(f"{what}: what of it? Give off, or any of {', '.join(known)} = amount")
    return replace(value, **amounts)


def _amount(what: str, text: str, like: object) -> float | int | tuple[float, ...]:
    try:
        if isinstance(like, tuple):
            return tuple(float(part) for part in text.split(","))
        return int(text) if isinstance(like, int) else float(text)
    except ValueError:
        kind = {tuple: "numbers with commas between them", int: "a whole number"}.get(type(like), "a number")
        raise ValueError(f"{what} = '{text}'; give {kind}") from None
