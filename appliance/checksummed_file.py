"""Owns what a small file of the instrument looks like: a JSON object with the checksum of everything else in it."""

from __future__ import annotations

import hashlib
import json
import sys
from collections.abc import Mapping
from typing import Any, TypeGuard


class ChecksumError(ValueError):
    """Bytes are not what was sealed; the text says what is wrong with them, not whose they are."""


def digest(content: Mapping[str, Any]) -> str:
    """Return SHA-256 (hex) of the compact form with sorted keys."""
    # Of the content, not of the file's bytes: indentation and the order of keys may change without the checksum.
    return hashlib.sha256(json.dumps(content, sort_keys=True, separators=(",", ":")).encode()).hexdigest()


def with_checksum(content: Mapping[str, Any], indent: int | None = 2) -> bytes:
    """Return the file's bytes: ``content`` with sorted keys, and its checksum as ``sha256``."""
    return (json.dumps({**content, "sha256": digest(content)}, indent=indent, sort_keys=True) + "\n").encode()


def checked_content(data: bytes, max_bytes: int) -> dict[str, Any]:
    """Return the content without its checksum. Raises ChecksumError for any other bytes, however large or deep."""
    if len(data) > max_bytes:
        raise ChecksumError(f"{len(data)} bytes; at most {max_bytes} are allowed")
    try:
        content = json.loads(data)
    # Deeply nested brackets, which damage can make of anything, end Python's parser with a RecursionError.
    except (ValueError, RecursionError) as error:
        raise ChecksumError(f"not readable as JSON ({type(error).__name__}: {error})") from error
    if not isinstance(content, dict):
        raise ChecksumError(f"a JSON object was expected, not {type(content).__name__}")
    # Taken out first, as it was not there when the sum was made.
    stated, actual = content.pop("sha256", None), digest(content)
    if stated != actual:
        raise ChecksumError(f"checksum {str(stated)[:80]!r}, but the content has {actual}: it was changed or damaged")
    return content


def is_number(value: Any) -> TypeGuard[float]:
    """Tell whether a value of such a file is a finite number, which a truth value is not."""
    # Compared, not converted: a whole number of JSON may be larger than any float.
    return isinstance(value, int | float) and not isinstance(value, bool) and abs(value) <= sys.float_info.max
