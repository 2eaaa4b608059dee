"""Type checks of arguments for the functions that scripts call.

A wrong type is refused by one sentence that names the argument, its value and the type that belongs there. A type
checker says the same before the call, to those who run one. The types are those of the annotations, so that none is
written twice: classes, unions, numbers, texts, arrays, functions and sequences of one type. Anything else in an
annotation is not checked.
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
    """Return ``function`` with its arguments checked against its annotations at every call.

    Raises TypeError, which names the wrong argument. ``name``: the name of the function in the text; default: its
    qualified name.
    """
    signature = inspect.signature(function)
    shown_name = name or function.__qualname__

    @functools.wraps(function)
    def checked(*args: P.args, **kwargs: P.kwargs) -> R:
        try:
            arguments = signature.bind(*args, **kwargs).arguments
        except TypeError as error:
            names = [
                parameter.replace(annotation=parameter.empty)
                for parameter in signature.parameters.values()
                if parameter.name != "self"
            ]
            raise TypeError(f"{shown_name}: {error}; it is {shown_name}{inspect.Signature(names)}") from None
        # Only now: annotations are texts, and may name a class whose module is imported later.
        annotations = _annotations(function)
        for argument, value in arguments.items():
            if argument in annotations and not fits(value, annotations[argument]):
                raise TypeError(
                    f"{shown_name}: {argument} is {value_text(value)}; wanted is {annotation_text(annotations[argument])}"
                )
        return function(*args, **kwargs)

    return checked


def refuse_wrong_fields(kind: type[R]) -> type[R]:
    """Return a dataclass whose constructor checks its arguments against the fields' annotations."""
    setattr(kind, "__init__", refuse_wrong_types(kind.__init__, kind.__name__))  # noqa: B010
    return kind


@functools.cache
def _annotations(function: Callable[..., Any]) -> Mapping[str, Any]:
    return typing.get_type_hints(function)


def fits(value: object, annotation: Any) -> bool:
    """Return True if ``value`` has the type that ``annotation`` names.

    True also for annotations that cannot be checked.
    """
    origin, inner = typing.get_origin(annotation), typing.get_args(annotation)
    kind = origin or annotation
    if kind in _UNIONS:
        return any(fits(value, option) for option in inner)
    if kind is typing.Literal:
        return value in inner
    if kind in _NUMBERS:
        return isinstance(value, _NUMBERS[kind]) and not isinstance(value, bool)
    if origin is not None and isinstance(value, str | bytes):
        return False  # a text is also a sequence of texts, but is never meant as one
    if kind is Sequence and isinstance(value, np.ndarray):
        return value.ndim > 0
    if isinstance(kind, type) and not isinstance(value, kind):
        return False
    # The elements of an iterator are not checked, since that would use it up.
    return not (inner and isinstance(value, list | tuple)) or all(fits(option, inner[0]) for option in value)


def annotation_text(annotation: Any) -> str:
    """Return an annotation as English text: ``a Mesh, a FusedCloud or None``."""
    origin, inner = typing.get_origin(annotation), typing.get_args(annotation)
    kind = origin or annotation
    if kind in _UNIONS:
        *first, last = dict.fromkeys(map(annotation_text, inner))
        return f"{', '.join(first)} or {last}" if first else last
    if kind is typing.Literal:
        return " or ".join(map(repr, inner))
    if kind in _WORDS:
        return _WORDS[kind]
    return f"several of {annotation_text(inner[0])}" if inner else _a(kind.__name__)


def value_text(value: object) -> str:
    """Return a value and its type as a short text of one line."""
    if value is None:
        return "None"
    if isinstance(value, np.ndarray):
        return f"a NumPy array of shape {value.shape}"
    name = _a(type(value).__name__)
    if isinstance(value, list | tuple):
        types = ", ".join(dict.fromkeys(type(element).__name__ for element in value[:_SHOWN]))
        return f"{name} of {len(value)}" + (f" ({types})" if types else "")
    if isinstance(value, str | Path | numbers.Number):
        text = repr(value) if isinstance(value, str) else str(value)
        return f"{text[:_SHOWN]}{'…' if len(text) > _SHOWN else ''}, {name}"
    return name


def _a(name: str) -> str:
    return f"{'an' if name[0] in 'AEIOaeio' else 'a'} {name}"
