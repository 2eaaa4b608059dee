"""Writes a tree of values as TOML, so that a rig file can be damaged in its meaning and not only in its bytes."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from typing import Any


def toml_of(tree: Mapping[str, Any]) -> str:
    """The text. What TOML has no word for (null, other numbers) comes out as text that is none."""
    return "".join(_tables(tree, ()))


def _tables(tree: Mapping[str, Any], path: tuple[str, ...]) -> list[str]:
    plain = [f"{_key(key)} = {_value(value)}\n" for key, value in tree.items() if not isinstance(value, Mapping)]
    said = [f"[{'.'.join(map(_key, path))}]\n", *plain] if path else plain
    for key, value in tree.items():
        if isinstance(value, Mapping):
            said += _tables(value, (*path, str(key)))
    return said


def _key(key: object) -> str:
    text = str(key)
    return text if text.replace("_", "").replace("-", "").isalnum() and text.isascii() else json.dumps(text)


def _value(value: Any) -> str:
    match value:
        case None:
            return "null"
        case bool():
            return "true" if value else "false"
        case float():
            return repr(value) if math.isfinite(value) else str(value)
        case int():
            return hex(value) if abs(value) > 10**300 else str(value)
        case Mapping():
            return "{" + ", ".join(f"{_key(key)} = {_value(one)}" for key, one in value.items()) + "}"
        case list():
            return "[" + ", ".join(map(_value, value)) + "]"
        case _:
            return json.dumps(str(value))
