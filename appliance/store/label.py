"""The label of a scan: name and note that a person gives it, in ``label.json`` beside the manifest.

    {"schema": 1, "name": "bollard 3", "note": "north side, before cleaning", "sha256": "…"}

It has its own file, so that the manifest's bytes stay those of the dive, and a version that knows no labels reads the
scan as before. It travels with the folder. A damaged label is no damage to the scan.
"""

from __future__ import annotations

import unicodedata
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import ClassVar, Literal

from appliance.base import ContentError, SealedFile
from appliance.store.atomic import FileSystem

LABEL_FILE = "label.json"
_CONTROL = ("Cc", "Cf", "Cs", "Co", "Cn", "Zl", "Zp")
"""Unicode's categories of unreadable characters: controls, formats, surrogates, unassigned ones, line ends."""


@dataclass(frozen=True, slots=True)
class Label:
    """Name and note of a scan; ``None``: there is none."""

    name: str | None = None
    note: str | None = None

    LONGEST: ClassVar[Mapping[str, int]] = MappingProxyType({"name": 60, "note": 1000})
    """Greatest lengths in characters: a name is a column of a list, a note a paragraph."""

    @classmethod
    def checked(cls, which: Literal["name", "note"], text: str, what: str | None = None) -> str | None:
        """Return a label's ``text`` in Unicode's composed form, stripped; ``None`` if it is empty.

        ``what`` names it in the message. Raises ContentError for control characters, among them line ends and those
        that turn the direction of writing, and for more characters than ``LONGEST`` allows.
        """
        what = what or which
        plain = unicodedata.normalize("NFC", text).strip()
        for index, character in enumerate(plain):
            if unicodedata.category(character) in _CONTROL:
                raise ContentError(
                    what, f"character {index + 1} is U+{ord(character):04X}, a control character", remedy="leave it out"
                )
        if len(plain) > cls.LONGEST[which]:
            raise ContentError(what, f"{len(plain)} characters", str(cls.LONGEST[which]), "shorten it")
        return plain or None

    @classmethod
    def read(cls, folder: Path) -> Label:
        """Return the label of a scan's folder; an empty one where there is none. Raises ContentError."""
        label = LABEL.load(folder / LABEL_FILE, name=LABEL_FILE) or NO_LABEL
        return cls(
            cls.checked("name", label.name or "", f"{LABEL_FILE}: name"),
            cls.checked("note", label.note or "", f"{LABEL_FILE}: note"),
        )

    def write(self, fs: FileSystem, folder: Path) -> None:
        """Write the label; it is durable and whole on return. Raises StorageError."""
        fs.replace_file(folder / LABEL_FILE, LABEL.encode(self))


NO_LABEL = Label()
LABEL = SealedFile(Label, schema=1, max_bytes=16_384)
