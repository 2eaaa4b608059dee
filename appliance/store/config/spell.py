"""Writing a ``Rig`` as the text of a rig file, options and defaults included.

Every key is written, also where the loaded file left it to its default: a later version may have another default, and a
stored scan must keep the one it was taken with. Comments are not kept. Source: TOML 1.0.0.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path

from appliance.store.config.rig import Rig

_BARE_KEY = re.compile(r"[A-Za-z0-9_-]+")
_HEAD = "# What a scan was taken with: the rig file as the program understood it, changed by its options, with all defaults.\n"


def rig_text(rig: Rig) -> str:
    """Return the text of a rig file that loads as ``rig``, with the same ``rig_hash``.

    Raises TypeError for a value in ``rig.wires_options`` that no TOML file can hold.
    """
    return _HEAD + "".join(_table("", _plain(asdict(rig))))


def _plain(table: Mapping[str, object]) -> dict[str, object]:
    """Return the table without keys that are ``None``, which TOML cannot write."""
    return {
        key: _plain(value) if isinstance(value, Mapping) else value for key, value in table.items() if value is not None
    }


def _table(name: str, content: Mapping[str, object]) -> Iterator[str]:
    """Yield the lines of a table: its values first, then the tables within it."""
    if name:
        yield f"\n[{name}]\n"
    for key, value in content.items():
        # Before any table within it: all keys after a [header] belong to that table until the next one.
        if not isinstance(value, Mapping):
            yield f"{_key(key)} = {_value(value)}\n"
    for key, value in content.items():
        if isinstance(value, Mapping):
            yield from _table(f"{name}.{_key(key)}" if name else _key(key), value)


def _key(key: str) -> str:
    return key if _BARE_KEY.fullmatch(key) else _text(key)


def _value(value: object) -> str:
    match value:
        # Before int: in Python a bool is one, and TOML knows no True.
        case bool():
            return "true" if value else "false"
        # repr gives the shortest text that reads back as the same float, so that the hash stays.
        case int() | float():
            return repr(value)
        case str() | Path():
            return _text(str(value))
        case Mapping():
            return "{" + ", ".join(f"{_key(str(key))} = {_value(element)}" for key, element in value.items()) + "}"
        case Sequence():
            return "[" + ", ".join(_value(element) for element in value) + "]"
        case _:
            raise TypeError(f"{type(value).__name__} cannot be written to a rig file: {value!r}")


def _text(text: str) -> str:
    """Return a TOML basic string: JSON's, with DEL escaped, too."""
    return json.dumps(text, ensure_ascii=False).replace("\x7f", "\\u007f")
