"""Editing keys of a rig file line by line, with comments and order kept and the result checked."""

from __future__ import annotations

import copy
import re
import tomllib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from appliance.store import ConfigError, LocalFileSystem, parse_rig
from appliance.workshop.finding import BringupError

_HEADER = re.compile(r"^\s*\[(?P<name>[^\[\]]+)\]\s*(#.*)?$")

Value = int | str | float | Sequence[float]


class KeyValue(NamedTuple):
    """Place of a key in a rig file."""

    table: str
    """Name of the table, like ``camera.left``."""
    key: str


def with_keys(text: str, values: Mapping[KeyValue, Value]) -> str:
    """Return the text of a rig file with ``values`` and all other text unchanged.

    Raises BringupError where a key cannot be changed in its line (a value over several lines, an inline table), or the
    result is no rig file.
    """
    lines = text.split("\n")
    # One key at a time: each may add a line and so move those that follow.
    for place, value in values.items():
        lines = _with_key(lines, place, value)
    new = "\n".join(lines)
    # Read back and compared with the intended content: an edit by lines may hit text that only looks like the key.
    if _content(new) != _intended(tomllib.loads(text), values):
        names = ", ".join(f"{place.table}.{place.key}" for place in values)
        raise BringupError(f"the rig file cannot be edited line by line; set by hand: {names}")
    try:
        parse_rig(new, "what was measured")
    except ConfigError as error:
        raise BringupError(f"the measured values make no valid rig file: {error}") from error
    return new


def replace_rig(path: Path, old: str, new: str) -> Path:
    """Replace a rig file and return the path of its old text: beside it, under the first free number.

    Raises StorageError.
    """
    number = 1
    while (copy_path := path.with_name(f"{path.name}.before-{number}")).exists():
        number += 1
    # The copy first: at any instant one of the two files has the old text.
    LocalFileSystem().replace_file(copy_path, old.encode())
    LocalFileSystem().replace_file(path, new.encode())
    return copy_path


def _content(text: str) -> dict[str, Any] | None:
    try:
        return tomllib.loads(text)
    except tomllib.TOMLDecodeError:
        return None  # half of a value over several lines was replaced


def _with_key(lines: list[str], place: KeyValue, value: Value) -> list[str]:
    first, last = _extent(lines, place.table)
    spelled = _toml_value(value)
    pattern = re.compile(rf"^(\s*){re.escape(place.key)}(\s*)=(\s*)([^#]*?)(\s*(?:#.*)?)$")
    for k in range(first, last):
        match = pattern.match(lines[k])
        if match:
            indent, before, after, _, comment = match.groups()
            line = f"{indent}{place.key}{before}={after}{spelled}{comment}".rstrip()
            return [*lines[:k], line, *lines[k + 1 :]]
    # Behind the table's last key: the lines after it may be a comment about the next table.
    insertion = max((k + 1 for k in range(first, last) if re.match(r"^\s*[\w\"-]+\s*=", lines[k])), default=first)
    return [*lines[:insertion], f"{place.key} = {spelled}", *lines[insertion:]]


def _extent(lines: Sequence[str], table: str) -> tuple[int, int]:
    """Return the range of lines of a table, from behind its header to the next one."""
    begins = None
    for k, line in enumerate(lines):
        match = _HEADER.match(line)
        if match is None:
            continue
        if begins is not None:
            return begins, k
        if match["name"].strip() == table:
            begins = k + 1
    if begins is None:
        raise BringupError(f"the rig file has no line [{table}]; add it, or set its keys by hand")
    return begins, len(lines)


def _intended(content: dict[str, Any], values: Mapping[KeyValue, Value]) -> dict[str, Any]:
    expected = copy.deepcopy(content)
    for place, value in values.items():
        inner = expected
        for part in place.table.split("."):
            inner = inner.setdefault(part, {})
        inner[place.key] = value if isinstance(value, str | int | float) else list(value)
    return expected


def _toml_value(value: Value) -> str:
    if isinstance(value, str):
        return f'"{value}"'
    if isinstance(value, int | float):
        return repr(value)
    return "[" + ", ".join(repr(float(element)) for element in value) + "]"
