"""Owns how a small checksummed file of what an instrument measured of itself is opened, and how its faults are told."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from appliance.bounded_file import read_bounded
from appliance.checksummed_file import ChecksumError, checked_content

MAX_BYTES = 64 * 1024


class MeasuredFileError(Exception):
    """Such a file cannot be used; the text says which, why and what to do."""


@dataclass(frozen=True, slots=True)
class MeasuredFile:
    """One kind of these files: its name, its version, and how its faults are told."""

    what: str
    """Its first word in every sentence about it, as in "noise /storage/noise.json"."""
    schema: int
    """The only one that this version reads."""
    remedy: str
    """Advice about a file that cannot be used."""
    error: type[MeasuredFileError]

    def wrong(self, name: str, what: str) -> MeasuredFileError:
        """Return the error that names the file, what is wrong with it, and the remedy."""
        return self.error(f"{name}: {what}; {self.remedy}")

    def content(self, data: bytes, name: str) -> dict[str, Any]:
        """Return the content of a file's bytes, whose keys are not yet checked. Raises ``error``."""
        try:
            content = checked_content(data, MAX_BYTES)
        except ChecksumError as error:
            raise self.wrong(name, str(error)) from error
        if content.get("schema") != self.schema:
            found = content.get("schema")
            raise self.wrong(name, f"schema {found!r:.40}; this version reads schema {self.schema}")
        return content

    def data(self, path: Path) -> tuple[bytes, str] | None:
        """Return a file's bytes and its name for messages; ``None`` where there is no such file. Raises ``error``."""
        name = f"{self.what} {path}"
        try:
            return read_bounded(path, MAX_BYTES), name
        except FileNotFoundError:
            return None
        except OSError as error:
            raise self.wrong(name, f"cannot be read ({error.strerror})") from error
