"""Owns what a small JSON file of the instrument is: of one schema, no larger than it may be, with the checksum of
everything else in it.

A format is a frozen dataclass and one ``SealedFile`` of it. Values are of the fields' annotated types, and within the
ranges that stand there as ``Annotated[float, Within(…)]``; what they mean for each other is asked by the dataclass's
constructor, or by ``check``. It takes what JSON makes of the written values: a whole number where a fraction is
expected, and a fraction that is whole where a whole number is. Keys that no field has are left alone: a later version
may have written them.

Without pydantic: a list of scans, which reads hundreds of manifests and labels, should answer at once
(``docs/adr/0035``).
"""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import MISSING, Field, dataclass, field, fields, is_dataclass
from enum import Enum
from functools import cache
from pathlib import Path
from types import MappingProxyType, NoneType, UnionType
from typing import (
    Annotated,
    Any,
    Generic,
    SupportsFloat,
    SupportsIndex,
    TypeGuard,
    TypeVar,
    Union,
    get_args,
    get_origin,
    get_type_hints,
)

from appliance.base.bounded_file import read_bounded

T = TypeVar("T")
OF_ANYBODY: Mapping[str, Any] = MappingProxyType({})
LEFT_OUT: Mapping[str, Any] = MappingProxyType({"left out": True})
"""Metadata of a field that is not written while it has its default."""


class ContentError(Exception):
    """Reason why a file cannot be used.

    ``what``: the file; ``value``: its key and the value there, or what else is wrong.
    """

    def __init__(self, what: str, value: str, allowed: str = "", remedy: str = "") -> None:
        super().__init__(what, value, allowed, remedy)
        self.what = what
        self.value = value
        self.allowed = allowed
        self.remedy = remedy

    def __str__(self) -> str:
        said = f"{self.what}: {self.value}" if self.what else self.value
        return "; ".join(part for part in (said, self.allowed and f"allowed: {self.allowed}", self.remedy) if part)


@dataclass(frozen=True, slots=True)
class Within:
    """Range of a number, both ends included. A truth value is none."""

    low: float
    high: float
    whole: bool = False
    """A fraction is not taken, even if it is whole."""

    def takes(self, value: Any) -> TypeGuard[float]:
        """Tell whether a value of JSON lies in the range."""
        right = isinstance(value, int if self.whole else int | float) and not isinstance(value, bool)
        return right and self.low <= value <= self.high

    @property
    def allowed(self) -> str:
        """The range in words."""
        kind = "whole numbers" if self.whole else "finite numbers"
        if math.isfinite(self.high):
            return f"{self.low:g}..{self.high:g}"
        return f"{kind} from {self.low:g}" if math.isfinite(self.low) else kind


FINITE = Within(-math.inf, math.inf)


@dataclass(frozen=True, slots=True)
class Among:
    """The only values that are taken."""

    values: tuple[Any, ...]

    def takes(self, value: Any) -> bool:
        """Tell whether a value of JSON is one of them."""
        return any(type(value) is type(one) and value == one for one in self.values)

    @property
    def allowed(self) -> str:
        """The values in words."""
        return " or ".join(map(repr, self.values))


@dataclass(frozen=True, slots=True)
class SealedFile(Generic[T]):
    """One kind of file, whose content is the frozen dataclass ``kind``.

    ``of`` in its methods are the keys that say whose a file is, and what must stand there.
    """

    kind: type[T]
    schema: int
    """The only one that this version reads."""
    max_bytes: int
    what: str = ""
    """Its first word in every sentence about it, as in "noise /storage/noise.json"."""
    remedy: str = ""
    """Advice about a file that cannot be used."""
    indent: int | None = 2
    checksum: bool = True
    """It has one, and its keys are in order; else they are in that of the fields."""
    check: Callable[[T], object] = field(default=lambda stored: stored)
    """Raises ValueError for a content that cannot be."""

    def content(self, stored: T, of: Mapping[str, Any] = OF_ANYBODY) -> dict[str, Any]:
        """Return what is written, but for the checksum. Raises TypeError for a value that JSON cannot hold."""
        return {"schema": self.schema, **of, **plain(stored)}

    def encode(self, stored: T, of: Mapping[str, Any] = OF_ANYBODY) -> bytes:
        """Return the file's bytes.

        Raises TypeError for a value that JSON cannot hold; NaN and infinity become null: not known.
        """
        content = self.content(stored, of)
        if self.checksum:
            content["sha256"] = digest(content)
        return (json.dumps(content, indent=self.indent, sort_keys=self.checksum) + "\n").encode()

    def decode(self, data: bytes, name: str, of: Mapping[str, Any] = OF_ANYBODY) -> T:
        """Parse and check a file's bytes. Raises ContentError naming ``name``, what is wrong and the remedy."""
        try:
            content = self._opened(data)
            for key, wanted in {"schema": self.schema, **of}.items():
                found = content.pop(key, None)
                if found != wanted:
                    version = ", which this version reads" if key == "schema" else ""
                    raise ContentError("", f"{key} {_shown(found)}", _shown(wanted) + version)
            stored = shaped(self.kind, content)
            self.check(stored)
            return stored
        except ContentError as error:
            raise ContentError(name, error.value, error.allowed, self.remedy) from error
        except ValueError as error:
            raise ContentError(name, str(error), remedy=self.remedy) from error

    def load(self, path: Path, of: Mapping[str, Any] = OF_ANYBODY, name: str | None = None) -> T | None:
        """Read a file; ``None`` where there is none. Raises ContentError naming it by its path, or by ``name``."""
        name = f"{self.what} {path}".lstrip() if name is None else name
        try:
            data = read_bounded(path, self.max_bytes)
        except FileNotFoundError:
            return None
        except OSError as error:
            raise ContentError(name, f"cannot be read ({error.strerror})", remedy=self.remedy) from error
        return self.decode(data, name, of)

    def _opened(self, data: bytes) -> dict[str, Any]:
        """Return the content without its checksum. Raises ContentError for any other bytes, however large or deep."""
        if len(data) > self.max_bytes:
            raise ContentError("", f"{len(data)} bytes", f"at most {self.max_bytes}")
        try:
            # Python's parser takes NaN, Infinity and 1e999, none of which is JSON or was ever written.
            content = json.loads(data, parse_constant=_not_finite, parse_float=_finite)
        # Deeply nested brackets, which damage can make of anything, end Python's parser with a RecursionError.
        except (ValueError, RecursionError) as error:
            raise ContentError("", f"not readable as JSON ({type(error).__name__}: {error})") from error
        if not isinstance(content, dict):
            raise ContentError("", f"a JSON object was expected, not {type(content).__name__}")
        if self.checksum:
            # Taken out first, as it was not there when the sum was made.
            stated, actual = content.pop("sha256", None), digest(content)
            if stated != actual:
                raise ContentError(
                    "", f"checksum {str(stated)[:80]!r}, but the content has {actual}: it was changed or damaged"
                )
        return content


def digest(content: Mapping[str, Any]) -> str:
    """Return SHA-256 (hex) of the compact form with sorted keys."""
    # Of the content, not of the file's bytes: indentation and the order of keys may change without the checksum.
    return hashlib.sha256(json.dumps(content, sort_keys=True, separators=(",", ":")).encode()).hexdigest()


def _shown(value: Any) -> str:
    return f"{value!r:.60}"


def _finite(text: str) -> float:
    number = float(text)
    return number if math.isfinite(number) else _not_finite(text)


def _not_finite(text: str) -> float:
    raise ValueError(f"{text[:20]} is no number that can be stored")


# -------------------------------------------------------------------------------------- from values to JSON


def plain(value: Any) -> Any:
    """Convert a value to what JSON holds: plain numbers, None for what is not finite.

    Raises TypeError for what it cannot hold.
    """
    match value:
        case None | bool() | int() | str():
            return value
        case float():
            return value if math.isfinite(value) else None
        case Enum():
            return value.value
        case Mapping():
            return {str(key): plain(one) for key, one in value.items()}
        case Sequence() if not isinstance(value, bytes | bytearray | memoryview):
            return [plain(one) for one in value]
        case _ if is_dataclass(value):
            named = [(one, getattr(value, one.name)) for one in fields(value)]
            return {one.name: plain(held) for one, held in named if one.metadata != LEFT_OUT or held != one.default}
        case _ if str(getattr(value, "dtype", None)) == "bool":  # NumPy's, which need not be loaded for that
            return bool(value)
        case SupportsIndex():  # NumPy's integers
            return int(value)
        case SupportsFloat():  # NumPy's other numbers
            number = float(value)
            return number if math.isfinite(number) else None
        case _:
            raise TypeError(f"{type(value).__name__} cannot be written as JSON: {value!r}")


# -------------------------------------------------------------------------------------- from JSON to values


def shaped(kind: type[T], value: object) -> T:
    """Return the dataclass ``kind`` with the fields of a JSON object.

    Raises ContentError for the first that is wrong, by its path.
    """
    made: T = _shaped(kind, value, "")
    return made


def _shaped(kind: Any, value: object, path: str) -> Any:
    """Return ``value`` as the annotation ``kind`` has it."""
    origin, arguments = get_origin(kind), get_args(kind)
    if kind is Any:
        return value
    if origin is Annotated:
        for condition in arguments[1:]:
            if not condition.takes(value):
                raise _wrong(path, condition.allowed, value)
        return _shaped(arguments[0], value, path)
    if origin in (Union, UnionType):
        if value is None and NoneType in arguments:
            return None
        (other,) = (option for option in arguments if option is not NoneType)
        return _shaped(other, value, path)
    if origin is not None and issubclass(origin, Mapping):
        if not isinstance(value, dict):
            raise _wrong(path, "an object", value)
        return {key: _shaped(arguments[1], one, f"{path}.{key}") for key, one in value.items()}
    if origin is tuple:
        return _sequence(arguments, value, path)
    if is_dataclass(kind):
        return _fields(kind, value, path)
    return _single(kind, value, path)


def _sequence(kinds: tuple[Any, ...], value: object, path: str) -> tuple[Any, ...]:
    if not isinstance(value, list):
        raise _wrong(path, "a list", value)
    if kinds[-1] is not Ellipsis and len(value) != len(kinds):
        raise _wrong(path, f"a list of {len(kinds)}", value)
    of_each = [kinds[0]] * len(value) if kinds[-1] is Ellipsis else kinds
    return tuple(_shaped(kind, one, f"{path}.{k}") for k, (kind, one) in enumerate(zip(of_each, value, strict=True)))


def _fields(kind: Any, value: object, path: str) -> Any:
    if not isinstance(value, dict):
        raise _wrong(path, "an object", value)
    given = {}
    for name, hint, needed in _hints(kind):
        if name in value:
            given[name] = _shaped(hint, value[name], f"{path}.{name}")
        elif needed:
            raise ContentError("", f"{path}.{name}".lstrip(".") + " is missing")
    try:
        return kind(**given)
    except ValueError as error:
        raise ContentError("", f"{path}: {error}".lstrip(".: ")) from error


@cache
def _hints(kind: Any) -> tuple[tuple[str, Any, bool], ...]:
    """Return the name of each field, its type, and whether it must be there."""
    hints = get_type_hints(kind, include_extras=True)
    return tuple(
        (one.name, _there(hints[one.name], one), one.default is MISSING and one.default_factory is MISSING)
        for one in fields(kind)
    )


def _there(hint: Any, one: Field[Any]) -> Any:
    """Return the type of a field that is there: null does not stand for one that is left out."""
    if one.metadata == LEFT_OUT and get_origin(hint) in (Union, UnionType):
        return next(option for option in get_args(hint) if option is not NoneType)
    return hint


def _single(kind: Any, value: object, path: str) -> Any:
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


def _wrong(path: str, allowed: str, value: object) -> ContentError:
    return ContentError("", f"{path.lstrip('.') or 'the whole'} is {_shown(value)}", allowed)
