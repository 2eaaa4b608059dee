"""Owns ``manifest.json``: the file that makes a folder a scan, and says what every other file in it must be.

JSON with sorted keys; ``sha256`` is that of the compact form of everything else, so that a changed number is noticed.
"""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields, is_dataclass, replace
from enum import Enum
from pathlib import Path
from typing import Any, SupportsFloat, SupportsIndex

from appliance.storage.atomic import Stamp
from appliance.storage.names import NameShapeError, component, is_component
from appliance.storage.record import ScanRecord
from appliance.storage.shape import ShapeError, shaped

SCHEMA = 1
FILE_NAME = "manifest.json"
INCOMPLETE_NAME = "incomplete.json"
"""The file that stands in its place where a scan broke off (``incomplete``): such a folder is no scan."""
MAX_BYTES = 16 * 1024 * 1024


class ManifestError(Exception):
    """A manifest cannot be used; the text says which and why."""


class Stage(Enum):
    """Stages that a scan goes through."""

    RAW = "raw"
    """The frames are durable; nothing else was added."""
    COMPLETE = "complete"
    """Published or rejected by the diver's decision."""


class Decision(Enum):
    """Decisions of the diver about a scan."""

    UNDECIDED = "undecided"
    KEPT = "kept"
    REJECTED = "rejected"


@dataclass(frozen=True, slots=True)
class Manifest:
    """The whole manifest. ``files`` maps the name of every file but the manifest to its length and checksum."""

    scan_id: str
    stage: Stage
    decision: Decision
    record: ScanRecord
    files: Mapping[str, Stamp]
    reason: str = ""
    """Reason of the rejection."""
    recovered: bool = False
    """True if the scan was found unpublished at a start and published then."""
    frame_crc32: Mapping[str, tuple[str, ...]] = field(kw_only=True)
    """CRC-32 (hexadecimal) of each frame, by the name of the file of frames, so that it can be said which one is damaged."""


def encode(manifest: Manifest) -> bytes:
    """Return the file's bytes. Raises TypeError for a value JSON cannot hold; NaN and infinity become null: not
    known."""
    content = as_json(manifest)
    return (json.dumps({**content, "sha256": _digest(content)}, indent=1, sort_keys=True) + "\n").encode()


def as_json(manifest: Manifest) -> dict[str, Any]:
    """Return the content as JSON holds it. Raises TypeError as ``encode``."""
    # Times have no null in the schema: one that is not known is left out.
    times_s = {name: s for name, s in manifest.record.stage_times_s.items() if math.isfinite(s)}
    return {"schema": SCHEMA, **_plain(replace(manifest, record=replace(manifest.record, stage_times_s=times_s)))}


def decode(data: bytes, name: str) -> Manifest:
    """Parse and check a manifest's bytes. Raises ManifestError naming ``name``."""
    try:
        # Python's parser takes NaN, Infinity and 1e999, none of which is JSON or was ever written.
        content = json.loads(data, parse_constant=_not_finite, parse_float=_finite)
    except (ValueError, RecursionError) as error:
        raise ManifestError(f"{name}: not readable as JSON ({error})") from error
    if not isinstance(content, dict):
        raise ManifestError(f"{name}: a JSON object was expected, not {type(content).__name__}")
    stated = content.pop("sha256", None)
    if stated != _digest(content):
        raise ManifestError(f"{name}: its checksum does not fit its content")
    schema = content.pop("schema", None)
    if schema != SCHEMA:
        raise ManifestError(f"{name}: schema {schema!r:.40}; this version reads schema {SCHEMA}")
    try:
        manifest = shaped(Manifest, content)
    except ShapeError as error:
        raise ManifestError(f"{name}: {error}") from None
    return checked_names(manifest, name)


def checked_names(manifest: Manifest, name: str) -> Manifest:
    """Return ``manifest``. Raises ManifestError naming ``name`` where it names something that no part of a path may be called."""
    # Scans are copied around and come from strangers, too: a name must not lead out of the scan's folder, nor out of one that is named
    # after the scan.
    try:
        component(manifest.scan_id, "scan_id")
    except NameShapeError as error:
        raise ManifestError(f"{name}: {error}") from None
    for file_name in manifest.files:
        if not is_component(file_name) or file_name == FILE_NAME:
            raise ManifestError(f"{name}: {file_name!r:.60} is not the name of a file beside it")
    return manifest


def read(folder: Path) -> Manifest:
    """Return the manifest of a scan's folder. Raises ManifestError."""
    path = folder / FILE_NAME
    try:
        with path.open("rb") as file:
            data = file.read(MAX_BYTES + 1)
    except FileNotFoundError:
        if (folder / INCOMPLETE_NAME).exists():
            raise ManifestError(
                f"{folder}: an incomplete recording is no scan, and nothing is measured, evaluated or calibrated with it; "
                "`kingfisher rescue` makes an unchecked cloud of it"
            ) from None
        raise ManifestError(f"{path}: missing") from None
    except OSError as error:
        raise ManifestError(f"{path}: {error.strerror or error}") from error
    if len(data) > MAX_BYTES:
        raise ManifestError(f"{path}: larger than {MAX_BYTES} bytes")
    return decode(data, str(path))


def _finite(text: str) -> float:
    number = float(text)
    return number if math.isfinite(number) else _not_finite(text)


def _not_finite(text: str) -> float:
    raise ValueError(f"{text[:20]} is no number that can be stored")


def _digest(content: Mapping[str, Any]) -> str:
    return hashlib.sha256(json.dumps(content, sort_keys=True, separators=(",", ":")).encode()).hexdigest()


def _plain(value: Any) -> Any:
    """Convert a value to what JSON holds: plain numbers, None for what is not finite."""
    match value:
        case None | bool() | str():
            return value
        case Enum():
            return value.value
        case Mapping():
            return {str(key): _plain(one) for key, one in value.items()}
        case Sequence() if not isinstance(value, bytes | bytearray | memoryview):
            return [_plain(one) for one in value]
        case _ if is_dataclass(value):
            return {one.name: _plain(getattr(value, one.name)) for one in fields(value)}
        case _ if str(getattr(value, "dtype", None)) == "bool":  # NumPy's, which need not be loaded for that
            return bool(value)
        case SupportsIndex():  # int and NumPy's integers
            return int(value)
        case SupportsFloat():  # float and NumPy's
            number = float(value)
            return number if math.isfinite(number) else None
        case _:
            raise TypeError(f"{type(value).__name__} cannot be written to a manifest: {value!r}")
