"""Owns how a function for scripts refuses an argument of a wrong type: in one sentence that names what was given and
what is wanted.

A type checker says the same before the call, to those who run one. The types are those of the annotations, so that none
is written twice: classes, unions, numbers, texts, arrays, functions, and lists of one kind of thing. What an annotation
says beyond that is not looked at.
"""

from __future__ import annotations

import functools
import inspect
import numbers
import typing
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from types import NoneType, UnionType
from typing import Any, ParamSpec, TypeVar

import numpy as np

P = ParamSpec("P")
R = TypeVar("R")
_NUMBERS = {float: numbers.Real, int: numbers.Integral}
"""NumPy's numbers count as Python's, as they do in its arithmetic."""
_WORDS = {
    float: "a number",
    int: "a whole number",
    str: "a text",
    bool: "True or False",
    Path: "a path",
    NoneType: "None",
    np.ndarray: "a NumPy array",
    Callable: "a function",
}
_UNIONS = (typing.Union, UnionType)
_SHOWN = 40
"""Characters of a value that are shown."""


def refuse_wrong_types(function: Callable[P, R], name: str | None = None) -> Callable[P, R]:
    """Return ``function`` with its arguments compared with its annotations at every call; TypeError says which is
    wrong.

    ``name``: what callers know it by; default: its own.
    """
    signature = inspect.signature(function)
    called = name or function.__qualname__

    @functools.wraps(function)
    def checked(*args: P.args, **kwargs: P.kwargs) -> R:
        try:
            given = signature.bind(*args, **kwargs).arguments
        except TypeError as error:
            names = [one.replace(annotation=one.empty) for one in signature.parameters.values() if one.name != "self"]
            raise TypeError(f"{called}: {error}; it is {called}{inspect.Signature(names)}") from None
        # Only now: annotations are texts, and may name what a module of the other end imports.
        wanted = _annotations(function)
        for argument, value in given.items():
            if argument in wanted and not fits(value, wanted[argument]):
                raise TypeError(f"{called}: {argument} is {shown(value)}; wanted is {named(wanted[argument])}")
        return function(*args, **kwargs)

    return checked


def refuse_wrong_fields(kind: type[R]) -> type[R]:
    """Return a dataclass whose constructor compares its arguments with the fields' annotations."""
    setattr(kind, "__init__", refuse_wrong_types(kind.__init__, kind.__name__))  # noqa: B010
    return kind


@functools.cache
def _annotations(function: Callable[..., Any]) -> Mapping[str, Any]:
    return typing.get_type_hints(function)


def fits(value: object, wanted: Any) -> bool:
    """Return True if ``value`` is what the annotation ``wanted`` says; True also where an annotation says nothing that
    can be seen."""
    origin, inner = typing.get_origin(wanted), typing.get_args(wanted)
    kind = origin or wanted
    if kind in _UNIONS:
        return any(fits(value, one) for one in inner)
    if kind is typing.Literal:
        return value in inner
    if kind in _NUMBERS:
        return isinstance(value, _NUMBERS[kind]) and not isinstance(value, bool)
    if origin is not None and isinstance(value, str | bytes):
        return False  # a text is a sequence of texts, and nobody means it
    if kind is Sequence and isinstance(value, np.ndarray):
        return value.ndim > 0
    if isinstance(kind, type) and not isinstance(value, kind):
        return False
    # An iterator is not looked into, which would use it up.
    return not (inner and isinstance(value, list | tuple)) or all(fits(one, inner[0]) for one in value)


def named(wanted: Any) -> str:
    """Return an annotation in words: ``a Mesh, a FusedCloud or None``."""
    origin, inner = typing.get_origin(wanted), typing.get_args(wanted)
    kind = origin or wanted
    if kind in _UNIONS:
        *first, last = dict.fromkeys(map(named, inner))
        return f"{', '.join(first)} or {last}" if first else last
    if kind is typing.Literal:
        return " or ".join(map(repr, inner))
    if kind in _WORDS:
        return _WORDS[kind]
    return f"several of {named(inner[0])}" if inner else _a(kind.__name__)


def shown(value: object) -> str:
    """Return a value and its type in a few words, never over more than one line."""
    if value is None:
        return "None"
    if isinstance(value, np.ndarray):
        return f"a NumPy array of shape {value.shape}"
    name = _a(type(value).__name__)
    if isinstance(value, list | tuple):
        held = ", ".join(dict.fromkeys(type(one).__name__ for one in value[:_SHOWN]))
        return f"{name} of {len(value)}" + (f" ({held})" if held else "")
    if isinstance(value, str | Path | numbers.Number):
        text = repr(value) if isinstance(value, str) else str(value)
        return f"{text[:_SHOWN]}{'…' if len(text) > _SHOWN else ''}, {name}"
    return name


def _a(name: str) -> str:
    return f"{'an' if name[0] in 'AEIOaeio' else 'a'} {name}"
