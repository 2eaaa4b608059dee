"""Owns the reading of YAML that OpenCV refuses: blocks with lists at the level of their key, as Python's and Kalibr's programs write them.

Of YAML it knows what calibrations consist of: mappings, lists in blocks and in brackets, numbers, words, comments. Anchors, texts over
several lines and mappings in braces are left as words.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

MOST_LINES, MOST_DEEP = 20_000, 12
_COMMENT = re.compile(r"(^|\s)#.*$")
_PAIR = re.compile(r"""(?P<key>[^\s\[\]{}"'#:][^:\[\]{}]*?|"[^"]*"|'[^']*')\s*:(?:\s+(?P<value>.*))?""")
_ITEM = re.compile(r"-(?:\s+(?P<rest>.*))?")
_FLOW = re.compile(r"\s*([\[\],]|[^\[\],]+)")


class YamlError(ValueError):
    """The text is no YAML that is known here; it says which line."""


@dataclass(frozen=True, slots=True)
class _Line:
    number: int
    indent: int
    text: str


def parse_yaml(text: str) -> Any:
    """Return the mapping or list that ``text`` holds: dicts, lists, floats and texts; ``None`` for nothing. Raises YamlError."""
    lines = _lines(text)
    if not lines:
        return None
    value, at = _block(lines, 0, 0)
    if at < len(lines):
        raise YamlError(f"line {lines[at].number}: it belongs to nothing above it")
    return value


def _lines(text: str) -> list[_Line]:
    found: list[_Line] = []
    open_brackets = 0
    for number, raw in enumerate(text.splitlines(), 1):
        if number > MOST_LINES:
            raise YamlError(f"it has more than {MOST_LINES} lines")
        line = _COMMENT.sub("", raw.expandtabs(4)).rstrip()
        if not line.strip() or line.startswith(("%", "---", "...")):
            continue
        if open_brackets:
            # A list in brackets goes on over lines, whatever their indent.
            last = found[-1]
            found[-1] = _Line(last.number, last.indent, f"{last.text} {line.strip()}")
        else:
            found.append(_Line(number, len(line) - len(line.lstrip()), line.strip()))
        open_brackets += line.count("[") - line.count("]")
    if open_brackets > 0:
        raise YamlError(f"line {found[-1].number}: a bracket is opened that is not closed")
    return found


def _block(lines: list[_Line], at: int, depth: int) -> tuple[Any, int]:
    """Return what begins at line ``at``, and the line behind it."""
    if depth > MOST_DEEP:
        raise YamlError(f"line {lines[at].number}: more than {MOST_DEEP} levels")
    if _ITEM.fullmatch(lines[at].text):
        return _list(lines, at, depth)
    if _PAIR.fullmatch(lines[at].text):
        return _mapping(lines, at, depth)
    return _scalar(lines[at].text), at + 1


def _list(lines: list[_Line], at: int, depth: int) -> tuple[list[Any], int]:
    indent, items = lines[at].indent, []
    while at < len(lines) and lines[at].indent == indent and (item := _ITEM.fullmatch(lines[at].text)):
        rest = item["rest"]
        if rest:
            # What stands behind the dash is a line of its own, as far in as it stands.
            lines[at] = _Line(lines[at].number, indent + item.start("rest"), rest)
            value, at = _block(lines, at, depth + 1)
        elif at + 1 < len(lines) and lines[at + 1].indent > indent:
            value, at = _block(lines, at + 1, depth + 1)
        else:
            value, at = None, at + 1
        items.append(value)
    return items, at


def _mapping(lines: list[_Line], at: int, depth: int) -> tuple[dict[str, Any], int]:
    indent: int = lines[at].indent
    found: dict[str, Any] = {}
    while at < len(lines) and lines[at].indent == indent and (pair := _PAIR.fullmatch(lines[at].text)):
        key, value = pair["key"].strip("\"'"), (pair["value"] or "").strip()
        below = lines[at + 1] if at + 1 < len(lines) else None
        if value and not value.startswith(("!", "&")):
            found[key], at = _scalar(value), at + 1
        elif below is not None and (
            below.indent > indent or (below.indent == indent and _ITEM.fullmatch(below.text) is not None)
        ):
            found[key], at = _block(lines, at + 1, depth + 1)
        else:
            found[key], at = None, at + 1
    return found, at


def _scalar(text: str) -> Any:
    if text.startswith("["):
        tokens = [token.strip() for token in _FLOW.findall(text)]
        value, at = _flow(tokens, 0, 0)
        if at != len(tokens):
            raise YamlError(f"{text[:40]!r}: something stands behind a list")
        return value
    try:
        return float(text)
    except ValueError:
        return text.strip("\"'")


def _flow(tokens: Sequence[str], at: int, depth: int) -> tuple[list[Any], int]:
    """Return the list in brackets that opens at token ``at``, and the token behind it."""
    items: list[Any] = []
    at += 1
    while at < len(tokens) and tokens[at] != "]" and depth < MOST_DEEP:
        if tokens[at] == "[":
            value, at = _flow(tokens, at, depth + 1)
            items.append(value)
        else:
            if tokens[at] not in (",", ""):
                items.append(_scalar(tokens[at]))
            at += 1
    if at >= len(tokens) or tokens[at] != "]":
        raise YamlError("a bracket is opened that is not closed, or too deep")
    return items, at + 1
