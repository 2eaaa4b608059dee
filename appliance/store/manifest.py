"""Owns ``manifest.json``: the file that makes a folder a scan, and says what every other file in it must be.

JSON with sorted keys; ``sha256`` is that of the compact form of everything else, so that a changed number is noticed.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from enum import Enum
from pathlib import Path
from typing import Any, TypeVar

from appliance.base import ContentError, SealedFile
from appliance.store.atomic import Stamp
from appliance.store.names import component, is_component
from appliance.store.record import ScanRecord

MANIFEST_FILE = "manifest.json"
INCOMPLETE_MANIFEST_FILE = "incomplete.json"
"""The file that stands in its place where a scan broke off (``incomplete``): such a folder is no scan."""


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


def refuse_names(manifest: Manifest) -> None:
    """Raises ValueError where a manifest names something that no part of a path may be called."""
    # Scans are copied around and come from strangers, too: a name must not lead out of the scan's folder, nor out of one that is named
    # after the scan.
    component(manifest.scan_id, "scan_id")
    for file_name in manifest.files:
        if not is_component(file_name) or file_name == MANIFEST_FILE:
            raise ValueError(f"{file_name!r:.60} is not the name of a file beside it")


MANIFEST = SealedFile(Manifest, schema=1, max_bytes=16 * 1024 * 1024, indent=1, check=refuse_names)
AnyManifest = TypeVar("AnyManifest", bound=Manifest)


def encode(manifest: Manifest) -> bytes:
    """Return the file's bytes. Raises TypeError for a value JSON cannot hold; NaN and infinity become null: not
    known."""
    return MANIFEST.encode(with_known_times(manifest))


def manifest_json(manifest: Manifest) -> dict[str, Any]:
    """Return the content as JSON holds it. Raises TypeError as ``encode``."""
    return MANIFEST.content(with_known_times(manifest))


def with_known_times(manifest: AnyManifest) -> AnyManifest:
    """Return the manifest without times that are not known: they have no null in the schema."""
    times_s = {name: s for name, s in manifest.record.stage_times_s.items() if math.isfinite(s)}
    return replace(manifest, record=replace(manifest.record, stage_times_s=times_s))


def read(folder: Path) -> Manifest:
    """Return the manifest of a scan's folder. Raises ContentError."""
    path = folder / MANIFEST_FILE
    found = MANIFEST.load(path, name=str(path))
    if found is not None:
        return found
    if (folder / INCOMPLETE_MANIFEST_FILE).exists():
        raise ContentError(
            str(folder),
            "an incomplete recording is no scan, and nothing is measured, evaluated or calibrated with it",
            remedy="`kingfisher rescue` makes an unchecked cloud of it",
        )
    raise ContentError(str(path), "missing")
