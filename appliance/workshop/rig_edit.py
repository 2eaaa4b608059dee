"""Owns changing keys of a rig file as a person would: line by line, comments and order kept, and read back before it
counts."""

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
    """Return the text of a rig file with ``values``, everything else as it was.

    Raises BringupError where a key cannot be changed in its line (a value over several lines, an inline table), or what
    comes out is no rig file.
    """
    lines = text.split("\n")
    # One after the other: each may add a line and so move what follows.
    for place, value in values.items():
        lines = _with_key(lines, place, value)
    new = "\n".join(lines)
    # Read back and compared with what was meant: an edit by lines may hit what only looks like the key.
    if _content(new) != _meant(tomllib.loads(text), values):
        names = ", ".join(f"{place.table}.{place.key}" for place in values)
        raise BringupError(f"the rig file is written in a way that cannot be edited by lines; set by hand: {names}")
    try:
        parse_rig(new, "what was measured")
    except ConfigError as error:
        raise BringupError(f"what was measured makes no rig file: {error}") from error
    return new


def replace_rig(path: Path, old: str, new: str) -> Path:
    """Replace a rig file and return where its old text is kept: beside it, under the first free number.

    Raises StorageError.
    """
    number = 1
    while (kept := path.with_name(f"{path.name}.before-{number}")).exists():
        number += 1
    # The copy first: at any instant one of the two files has the old text.
    LocalFileSystem().replace_file(kept, old.encode())
    LocalFileSystem().replace_file(path, new.encode())
    return kept


def _content(text: str) -> dict[str, Any] | None:
    try:
        return tomllib.loads(text)
    except tomllib.TOMLDecodeError:
        return None  # half of a value over several lines was replaced


def _with_key(lines: list[str], place: KeyValue, value: Value) -> list[str]:
    first, last = _extent(lines, place.table)
    spelled = _spelled(value)
    pattern = re.compile(rf"^(\s*){re.escape(place.key)}(\s*)=(\s*)([^#]*?)(\s*(?:#.*)?)$")
    for k in range(first, last):
        found = pattern.match(lines[k])
        if found:
            indent, before, after, _, comment = found.groups()
            line = f"{indent}{place.key}{before}={after}{spelled}{comment}".rstrip()
            return [*lines[:k], line, *lines[k + 1 :]]
    # Behind the table's last key: what follows it may be a comment about the next table.
    at = max((k + 1 for k in range(first, last) if re.match(r"^\s*[\w\"-]+\s*=", lines[k])), default=first)
    return [*lines[:at], f"{place.key} = {spelled}", *lines[at:]]


def _extent(lines: Sequence[str], table: str) -> tuple[int, int]:
    """Return the lines of a table, from behind its header to the next one."""
    begins = None
    for k, line in enumerate(lines):
        found = _HEADER.match(line)
        if found is None:
            continue
        if begins is not None:
            return begins, k
        if found["name"].strip() == table:
            begins = k + 1
    if begins is None:
        raise BringupError(f"the rig file has no line [{table}]; add it, or set its keys by hand")
    return begins, len(lines)


def _meant(content: dict[str, Any], values: Mapping[KeyValue, Value]) -> dict[str, Any]:
    meant = copy.deepcopy(content)
    for place, value in values.items():
        inner = meant
        for part in place.table.split("."):
            inner = inner.setdefault(part, {})
        inner[place.key] = value if isinstance(value, str | int | float) else list(value)
    return meant


def _spelled(value: Value) -> str:
    if isinstance(value, str):
        return f'"{value}"'
    if isinstance(value, int | float):
        return repr(value)
    return "[" + ", ".join(repr(float(one)) for one in value) + "]"
