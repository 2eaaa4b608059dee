"""Owns the way from JSON's plain values to frozen dataclasses: every field is there and of its annotated type, or one error.

Manifests are read with it, hundreds at a time, by commands that should answer at once; what a rig file needs (ranges, words for
people) is not here. It takes what JSON makes of the written values: a whole number where a fraction is expected, and a fraction
that is whole where a whole number is. Keys that no field has are left alone: a later version may have written them.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import MISSING, fields, is_dataclass
from enum import Enum
from functools import cache
from types import NoneType, UnionType
from typing import Any, TypeVar, Union, get_args, get_origin, get_type_hints

T = TypeVar("T")


class ShapeError(ValueError):
    """A value is missing or not of its type; the text begins with the path to it."""


def shaped(kind: type[T], value: object) -> T:
    """Return the dataclass ``kind`` with the fields of a JSON object. Raises ShapeError for the first that is wrong."""
    made: T = _shaped(kind, value, "")
    return made


def _shaped(kind: Any, value: object, path: str) -> Any:
    """Return ``value`` as the annotation ``kind`` has it."""
    origin = get_origin(kind)
    if kind is Any:
        return value
    if origin in (Union, UnionType):
        options = get_args(kind)
        if value is None and NoneType in options:
            return None
        (other,) = (option for option in options if option is not NoneType)
        return _shaped(other, value, path)
    if origin is not None and issubclass(origin, Mapping):
        of = get_args(kind)[1]
        if not isinstance(value, dict):
            raise _wrong(path, "an object", value)
        return {key: _shaped(of, one, f"{path}.{key}") for key, one in value.items()}
    if origin is tuple:
        if not isinstance(value, Sequence) or isinstance(value, str):
            raise _wrong(path, "a list", value)
        return tuple(_shaped(get_args(kind)[0], one, f"{path}.{k}") for k, one in enumerate(value))
    if is_dataclass(kind):
        return _fields(kind, value, path)
    return _plain(kind, value, path)


def _fields(kind: Any, value: object, path: str) -> Any:
    if not isinstance(value, dict):
        raise _wrong(path, "an object", value)
    given = {}
    for name, hint, needed in _hints(kind):
        if name in value:
            given[name] = _shaped(hint, value[name], f"{path}.{name}")
        elif needed:
            raise ShapeError(f"{path}.{name}".lstrip(".") + ": missing")
    return kind(**given)


@cache
def _hints(kind: Any) -> tuple[tuple[str, Any, bool], ...]:
    """Return the name of each field, its type, and whether it must be there."""
    hints = get_type_hints(kind)
    return tuple((f.name, hints[f.name], f.default is MISSING and f.default_factory is MISSING) for f in fields(kind))


def _plain(kind: Any, value: object, path: str) -> Any:
    """Return a text, a number, a yes or no, or one of an enumeration's values."""
    if kind is str and isinstance(value, str):
        return value
    if isinstance(value, int | float):
        try:
            if kind is bool and value in (0, 1):
                return bool(value)
            if kind is int and value == int(value):
                return int(value)
            if kind is float:
                return float(value)
        except (OverflowError, ValueError):  # not finite, or more digits than a fraction has room for
            raise _wrong(path, "a number", value) from None
    if isinstance(kind, type) and issubclass(kind, Enum):
        found = next((one for one in kind if one.value == value), None)
        if found is None:
            raise _wrong(path, " or ".join(repr(one.value) for one in kind), value)
        return found
    raise _wrong(path, {str: "a text", bool: "true or false", int: "a whole number"}.get(kind, "a number"), value)


def _wrong(path: str, wanted: str, value: object) -> ShapeError:
    return ShapeError(f"{path.lstrip('.') or 'the whole'}: {wanted} is expected, not {value!r:.40}")
