"""Small JSON files of the instrument: one schema, a largest size, and a checksum of the content.

A format is a frozen dataclass and a ``SealedFile`` of it. Values are checked against the fields' annotated types, and
against ranges that stand there as ``Annotated[float, Within(…)]``; conditions between values are checked by the
dataclass's constructor, or by ``check``. As JSON does not tell them apart, an integer is taken for a fraction, and a
fraction without decimals for an integer. Unknown keys are ignored: a later version may have written them.

pydantic would be too slow: a list of scans reads hundreds of manifests and labels, and should answer at once
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
NO_OWNER: Mapping[str, Any] = MappingProxyType({})
LEFT_OUT: Mapping[str, Any] = MappingProxyType({"left out": True})
"""Metadata of a field that is not written while it has its default."""


class ContentError(Exception):
    """Reason why a file cannot be used.

    ``what``: the file; ``value``: its key and the value there, or another description of the error.
    """

    def __init__(self, what: str, value: str, allowed: str = "", remedy: str = "") -> None:
        super().__init__(what, value, allowed, remedy)
        self.what = what
        self.value = value
        self.allowed = allowed
        self.remedy = remedy

    def __str__(self) -> str:
        subject = f"{self.what}: {self.value}" if self.what else self.value
        return "; ".join(part for part in (subject, self.allowed and f"allowed: {self.allowed}", self.remedy) if part)


@dataclass(frozen=True, slots=True)
class Within:
    """Range of a number, both ends included. Booleans are not numbers here."""

    low: float
    high: float
    integers_only: bool = False
    """Fractions are refused, even those without decimals."""

    def takes(self, value: Any) -> TypeGuard[float]:
        """Return True if a value of JSON lies in the range."""
        has_type = isinstance(value, int if self.integers_only else int | float) and not isinstance(value, bool)
        return has_type and self.low <= value <= self.high

    @property
    def allowed(self) -> str:
        """The range in words."""
        kind = "whole numbers" if self.integers_only else "finite numbers"
        if math.isfinite(self.high):
            return f"{self.low:g}..{self.high:g}"
        return f"{kind} from {self.low:g}" if math.isfinite(self.low) else kind


FINITE = Within(-math.inf, math.inf)


@dataclass(frozen=True, slots=True)
class Among:
    """The only values that are accepted."""

    values: tuple[Any, ...]

    def takes(self, value: Any) -> bool:
        """Return True if a value of JSON is one of them."""
        return any(type(value) is type(accepted) and value == accepted for accepted in self.values)

    @property
    def allowed(self) -> str:
        """The values in words."""
        return " or ".join(map(repr, self.values))


@dataclass(frozen=True, slots=True)
class SealedFile(Generic[T]):
    """One kind of file, whose content is the frozen dataclass ``kind``.

    ``owner`` in its methods are keys that say to whom a file belongs, each with the value that must stand there.
    """

    kind: type[T]
    schema: int
    """The only schema that this version reads."""
    max_bytes: int
    what: str = ""
    """First word of every sentence about the file, as in "noise /storage/noise.json"."""
    remedy: str = ""
    """Advice about a file that cannot be used."""
    indent: int | None = 2
    checksum: bool = True
    """True if the file has a checksum. Then its keys are sorted; else they are in the order of the fields."""
    check: Callable[[T], object] = field(default=lambda stored: stored)
    """Raises ValueError for an invalid content."""

    def content(self, stored: T, owner: Mapping[str, Any] = NO_OWNER) -> dict[str, Any]:
        """Return the object to be written, without its checksum.

        Raises TypeError for a value that JSON cannot hold.
        """
        return {"schema": self.schema, **owner, **plain(stored)}

    def encode(self, stored: T, owner: Mapping[str, Any] = NO_OWNER) -> bytes:
        """Return the file's bytes.

        Raises TypeError for a value that JSON cannot hold; NaN and infinity become null: not known.
        """
        content = self.content(stored, owner)
        if self.checksum:
            content["sha256"] = digest(content)
        return (json.dumps(content, indent=self.indent, sort_keys=self.checksum) + "\n").encode()

    def decode(self, data: bytes, name: str, owner: Mapping[str, Any] = NO_OWNER) -> T:
        """Parse and check a file's bytes.

        Raises ContentError with ``name``, the wrong value, the allowed range and the remedy.
        """
        try:
            content = self._opened(data)
            for key, expected in {"schema": self.schema, **owner}.items():
                actual = content.pop(key, None)
                if actual != expected:
                    version = ", which this version reads" if key == "schema" else ""
                    raise ContentError("", f"{key} {_short_repr(actual)}", _short_repr(expected) + version)
            stored = shaped(self.kind, content)
            self.check(stored)
            return stored
        except ContentError as error:
            raise ContentError(name, error.value, error.allowed, self.remedy) from error
        except ValueError as error:
            raise ContentError(name, str(error), remedy=self.remedy) from error

    def load(self, path: Path, owner: Mapping[str, Any] = NO_OWNER, name: str | None = None) -> T | None:
        """Read a file; ``None`` where there is none. Raises ContentError with its path, or with ``name``."""
        name = f"{self.what} {path}".lstrip() if name is None else name
        try:
            data = read_bounded(path, self.max_bytes)
        except FileNotFoundError:
            return None
        except OSError as error:
            raise ContentError(name, f"cannot be read ({error.strerror})", remedy=self.remedy) from error
        return self.decode(data, name, owner)

    def _opened(self, data: bytes) -> dict[str, Any]:
        """Return the content without its checksum. Raises ContentError for bytes that are no such file."""
        if len(data) > self.max_bytes:
            raise ContentError("", f"{len(data)} bytes", f"at most {self.max_bytes}")
        try:
            # Python's parser takes NaN, Infinity and 1e999, which are not JSON and are never written.
            content = json.loads(data, parse_constant=_not_finite, parse_float=_finite)
        # Damage can make deeply nested brackets, on which Python's parser raises RecursionError.
        except (ValueError, RecursionError) as error:
            raise ContentError("", f"not readable as JSON ({type(error).__name__}: {error})") from error
        if not isinstance(content, dict):
            raise ContentError("", f"a JSON object was expected, not {type(content).__name__}")
        if self.checksum:
            # Removed first, since the checksum does not include itself.
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


def _short_repr(value: Any) -> str:
    return f"{value!r:.60}"


def _finite(text: str) -> float:
    number = float(text)
    return number if math.isfinite(number) else _not_finite(text)


def _not_finite(text: str) -> float:
    raise ValueError(f"{text[:20]} is no number that can be stored")


# -------------------------------------------------------------------------------------- from values to JSON


def plain(value: Any) -> Any:
    """Convert a value to JSON's types: plain numbers, None for numbers that are not finite.

    Raises TypeError for a value that JSON cannot hold.
    """
    match value:
        case None | bool() | int() | str():
            return value
        case float():
            return value if math.isfinite(value) else None
        case Enum():
            return value.value
        case Mapping():
            return {str(key): plain(element) for key, element in value.items()}
        case Sequence() if not isinstance(value, bytes | bytearray | memoryview):
            return [plain(element) for element in value]
        case _ if is_dataclass(value):
            values = [(item, getattr(value, item.name)) for item in fields(value)]
            return {
                item.name: plain(entry) for item, entry in values if item.metadata != LEFT_OUT or entry != item.default
            }
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

    Raises ContentError for the first wrong value, with its path.
    """
    result: T = _shaped(kind, value, "")
    return result


def _shaped(kind: Any, value: object, path: str) -> Any:
    """Return ``value`` converted to the annotation ``kind``."""
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
        (required,) = (option for option in arguments if option is not NoneType)
        return _shaped(required, value, path)
    if origin is not None and issubclass(origin, Mapping):
        if not isinstance(value, dict):
            raise _wrong(path, "an object", value)
        return {key: _shaped(arguments[1], element, f"{path}.{key}") for key, element in value.items()}
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
    return tuple(
        _shaped(kind, element, f"{path}.{k}") for k, (kind, element) in enumerate(zip(of_each, value, strict=True))
    )


def _fields(kind: Any, value: object, path: str) -> Any:
    if not isinstance(value, dict):
        raise _wrong(path, "an object", value)
    arguments = {}
    for name, hint, needed in _hints(kind):
        if name in value:
            arguments[name] = _shaped(hint, value[name], f"{path}.{name}")
        elif needed:
            raise ContentError("", f"{path}.{name}".lstrip(".") + " is missing")
    try:
        return kind(**arguments)
    except ValueError as error:
        raise ContentError("", f"{path}: {error}".lstrip(".: ")) from error


@cache
def _hints(kind: Any) -> tuple[tuple[str, Any, bool], ...]:
    """Return for each field: name, type, and whether it must be present."""
    hints = get_type_hints(kind, include_extras=True)
    return tuple(
        (item.name, _present_type(hints[item.name], item), item.default is MISSING and item.default_factory is MISSING)
        for item in fields(kind)
    )


def _present_type(hint: Any, item: Field[Any]) -> Any:
    """Return the type of a field that is present: null does not stand for one that is left out."""
    if item.metadata == LEFT_OUT and get_origin(hint) in (Union, UnionType):
        return next(option for option in get_args(hint) if option is not NoneType)
    return hint


def _single(kind: Any, value: object, path: str) -> Any:
    """Return a text, a number, a boolean, or a member of an enumeration."""
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
        member = next((option for option in kind if option.value == value), None)
        if member is None:
            raise _wrong(path, " or ".join(repr(option.value) for option in kind), value)
        return member
    raise _wrong(path, {str: "a text", bool: "true or false", int: "a whole number"}.get(kind, "a number"), value)


def _wrong(path: str, allowed: str, value: object) -> ContentError:
    return ContentError("", f"{path.lstrip('.') or 'the whole'} is {_short_repr(value)}", allowed)
