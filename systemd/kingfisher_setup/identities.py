"""Owns which USB identities the instrument's device rules look for: the rig file's, or else those of the shipped rules."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from kingfisher_setup.errors import SetupError

Identity = tuple[int, int]
"""USB vendor and product."""

SHIPPED: Mapping[str, Identity] = {"board": (0x1209, 0x4B42), "keys": (0x1209, 0x4B46)}
"""As they stand in ``70-kingfisher.rules``, by the rig file's table."""
MOST = 0xFFFF
_IDENTITY = re.compile(r'(ATTRS?\{idVendor\}==")([0-9a-f]{4})(", ATTRS?\{idProduct\}==")([0-9a-f]{4})')


def named(rig: Path) -> dict[str, Identity]:
    """Return the identities of a rig file. Raises SetupError for a file, or a number, that cannot be one."""
    try:
        content: Mapping[str, Any] = tomllib.loads(rig.read_text(encoding="utf-8-sig"))
    except (OSError, ValueError, RecursionError) as error:
        raise SetupError(f"{rig}: {error}; correct the rig file") from error
    found = {}
    for table, shipped in SHIPPED.items():
        keys = content.get(table)
        if not isinstance(keys, dict):
            raise SetupError(f"{rig}: there is no table [{table}]; add it")
        found[table] = (
            _number(rig, table, "vendor_id", keys.get("vendor_id", shipped[0])),
            _number(rig, table, "product_id", keys.get("product_id", shipped[1])),
        )
    return found


def named_or_shipped(rig: Path) -> dict[str, Identity]:
    """Return the same, and the shipped ones where the rig file cannot be read: versions must change all the same."""
    try:
        return named(rig)
    except SetupError:
        return dict(SHIPPED)


def with_identities(rules: str, identities: Mapping[str, Identity]) -> str:
    """Return shipped rules with other identities in the lines that name the shipped ones."""
    tables = {SHIPPED[table]: identity for table, identity in identities.items()}

    def exchanged(found: re.Match[str]) -> str:
        vendor, product = tables.get((int(found[2], 16), int(found[4], 16)), (int(found[2], 16), int(found[4], 16)))
        return f"{found[1]}{vendor:04x}{found[3]}{product:04x}"

    # One pass over all: the board's new identity may be the pad's shipped one.
    return _IDENTITY.sub(exchanged, rules)


def _number(rig: Path, table: str, key: str, value: object) -> int:
    if isinstance(value, bool) or not isinstance(value, int) or not 0 <= value <= MOST:
        raise SetupError(f"{rig}: {table}.{key} {value!r}; allowed: 0..{MOST:#06x}; correct the rig file")
    return value
