"""Owns the check of generated values: every field is of the type that its annotation says, all the way down.

mypy does not see through ``st.builds``, so a strategy could deliver payloads that the product can never meet, and leave out
those that it does. ``built`` takes its place and refuses them while the tests run.
"""

from __future__ import annotations

import ast
import importlib
import inspect
import sys
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import fields, is_dataclass
from functools import cache
from types import NoneType, UnionType
from typing import Any, Literal, TypeVar, Union, get_args, get_origin, get_type_hints

from hypothesis import strategies as st

T = TypeVar("T")


class MistypedError(TypeError):
    """A generator built a value that strict typing would have refused."""


def built(
    make: Callable[..., T], *args: st.SearchStrategy[Any], **kwargs: st.SearchStrategy[Any]
) -> st.SearchStrategy[T]:
    """Like ``st.builds``; drawing from it raises ``MistypedError`` where a field, at any depth, is not of its annotated type."""
    return st.builds(make, *args, **kwargs).map(well_typed)


def well_typed(value: T) -> T:
    """The value itself, a dataclass. Raises ``MistypedError`` that names the path to the first field of a wrong type."""
    wrong = _wrong_in(value, type(value).__name__)
    if wrong is not None:
        raise MistypedError(wrong)
    return value


def _wrong_in(value: object, path: str) -> str | None:
    """What is wrong with the fields of a dataclass instance; ``None``: nothing."""
    kind: Any = type(value)
    hints: dict[str, Any] = _hints(kind)
    return _first(_wrong(getattr(value, name), hint, f"{path}.{name}") for name, hint in hints.items())


@cache
def _hints(kind: type) -> dict[str, Any]:
    """The annotations of a dataclass, those too whose types its module imports for the type checker only."""
    hints = get_type_hints(kind, localns=_imported_for_typing(kind.__module__))
    return {one.name: hints[one.name] for one in fields(kind)}


def _imported_for_typing(module: str) -> dict[str, Any]:
    """What stands under ``if TYPE_CHECKING:`` in a module, imported."""
    found: dict[str, Any] = {}
    for statement in ast.parse(inspect.getsource(sys.modules[module])).body:
        if (
            isinstance(statement, ast.If)
            and isinstance(statement.test, ast.Name)
            and statement.test.id == "TYPE_CHECKING"
        ):
            for line in statement.body:
                if isinstance(line, ast.ImportFrom) and line.module is not None:
                    origin = importlib.import_module(line.module)
                    found |= {one.asname or one.name: getattr(origin, one.name) for one in line.names}
    return found


def _wrong(value: Any, hint: Any, path: str) -> str | None:
    """What is wrong with a value that should be of an annotated type; ``None``: nothing. Raises TypeError for an
    annotation that it cannot judge, so that none is taken for right unseen."""
    origin, parameters = get_origin(hint), get_args(hint)
    if hint is Any:
        return None
    if origin in (Union, UnionType):
        return None if any(_wrong(value, one, path) is None for one in parameters) else _differs(value, hint, path)
    if origin is Literal:
        return None if value in parameters else _differs(value, hint, path)
    if origin is tuple:
        if not isinstance(value, tuple):
            return _differs(value, hint, path)
        wanted = parameters[:1] * len(value) if parameters[1:] == (...,) else parameters
        if len(value) != len(wanted):
            return _differs(value, hint, path)
        return _first(
            _wrong(one, kind, f"{path}[{k}]") for k, (one, kind) in enumerate(zip(value, wanted, strict=True))
        )
    if inspect.isclass(origin) and issubclass(origin, Mapping):
        if not isinstance(value, origin):
            return _differs(value, hint, path)
        pairs = [(key, parameters[0]) for key in value] + [(one, parameters[1]) for one in value.values()]
        return _first(_wrong(one, kind, f"{path}{{}}") for one, kind in pairs)
    if inspect.isclass(origin) and issubclass(origin, Sequence | set | frozenset):
        if not isinstance(value, origin):
            return _differs(value, hint, path)
        return _first(_wrong(one, parameters[0], f"{path}[]") for one in value)
    if not inspect.isclass(hint):
        raise TypeError(f"{path}: an annotation {hint!r} cannot be judged yet")
    allowed = (float, int) if hint is float else (NoneType if hint is None else hint,)
    if not isinstance(value, allowed):
        return _differs(value, hint, path)
    return _wrong_in(value, path) if is_dataclass(value) else None


def _first(found: Iterable[str | None]) -> str | None:
    return next((wrong for wrong in found if wrong is not None), None)


def _differs(value: Any, hint: Any, path: str) -> str:
    return f"{path} is {value!r} of type {type(value).__name__}, annotated {hint}"
