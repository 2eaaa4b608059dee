"""Owns what a person calls a scan: a name and a note, in ``label.json`` beside the manifest.

    {"schema": 1, "name": "bollard 3", "note": "north side, before cleaning", "sha256": "…"}

A file of its own: the manifest's bytes stay those of the dive, and a version that knows no labels reads the scan as before. It
travels with the folder. A damaged label is no damage to the scan.
"""

from __future__ import annotations

import unicodedata
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from appliance.checksummed_file import ChecksumError, checked_content, with_checksum
from appliance.storage.atomic import replace_file
from appliance.storage.filesystem import FileSystem

FILE_NAME = "label.json"
SCHEMA = 1
MAX_BYTES = 16_384
_CONTROL = ("Cc", "Cf", "Cs", "Co", "Cn", "Zl", "Zp")
"""Unicode's categories of what is no character to read: controls, formats, surrogates, unassigned ones, line ends."""
LONGEST_NAME, LONGEST_NOTE = 60, 1000
"""Greatest lengths in characters: a name is a column of a list, a note a paragraph."""


class LabelError(ValueError):
    """A name or a note cannot be used, or the file not be read; the text says why."""


@dataclass(frozen=True, slots=True)
class Label:
    """Name and note of a scan; ``None``: there is none."""

    name: str | None = None
    note: str | None = None


NO_LABEL = Label()


def checked(what: str, text: str, longest: int) -> str | None:
    """Return ``text`` in Unicode's composed form without blanks around it; ``None`` where nothing is left.

    ``what``: ``name`` or ``note``, for the message. Raises LabelError for control characters, among them line ends and
    those that turn the direction of writing, and for more than ``longest`` characters.
    """
    plain = unicodedata.normalize("NFC", text).strip()
    for at, character in enumerate(plain):
        if unicodedata.category(character) in _CONTROL:
            raise LabelError(f"{what}: character {at + 1} is U+{ord(character):04X}, a control character; leave it out")
    if len(plain) > longest:
        raise LabelError(f"{what}: {len(plain)} characters; allowed are {longest}; shorten it")
    return plain or None


def read(folder: Path) -> Label:
    """Return the label of a scan's folder; an empty one where there is none. Raises LabelError."""
    path = folder / FILE_NAME
    try:
        with path.open("rb") as file:
            data = file.read(MAX_BYTES + 1)
    except FileNotFoundError:
        return Label()
    except OSError as error:
        raise LabelError(f"{FILE_NAME}: {error.strerror or error}") from error
    try:
        content = checked_content(data, MAX_BYTES)
    except ChecksumError as error:
        raise LabelError(f"{FILE_NAME}: {error}") from error
    if content.get("schema") != SCHEMA:
        raise LabelError(f"{FILE_NAME}: schema {content.get('schema')!r:.40}; this version reads {SCHEMA}")
    return Label(_text(content, "name", LONGEST_NAME), _text(content, "note", LONGEST_NOTE))


def write(fs: FileSystem, folder: Path, label: Label) -> None:
    """Write the label; it is durable and whole on return. Raises StorageError."""
    replace_file(fs, folder / FILE_NAME, with_checksum({"schema": SCHEMA, "name": label.name, "note": label.note}))


def _text(content: dict[str, Any], key: str, longest: int) -> str | None:
    value = content.get(key)
    if value is None:
        return None
    if not isinstance(value, str):
        raise LabelError(f"{FILE_NAME}: {key} is {value!r:.40}; allowed is a text")
    return checked(f"{FILE_NAME}: {key}", value, longest)
