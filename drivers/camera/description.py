"""Fetching a camera's GenICam description: from its manifest to XML text."""

from __future__ import annotations

import hashlib
import io
import zipfile
import zlib

from drivers.api import DeviceRefused
from drivers.camera import u3v
from drivers.camera.bootstrap import ManifestEntry, parse_manifest_entry
from drivers.camera.control import ControlChannel

MAX_ENTRIES = 64
MAX_FILE_SIZE = 16 * 1024 * 1024
"""Limit of a description's size: the largest published ones have about 2 MB; above it the manifest
counts as damaged.
"""
MOST_SAID = 300
"""Largest number of characters quoted of an unpacker's message, which may itself quote the archive."""
_ATTEMPTS = 2
_REMEDY = "Update the camera's firmware"


class BadDescription(ValueError):
    """The file differs from its entry in the manifest."""


def check_sha1(data: bytes, sha1: bytes | None) -> None:
    """Raise BadDescription when ``data`` does not hash to ``sha1``; ``None`` means the camera gave none."""
    if sha1 is not None and hashlib.sha1(data, usedforsecurity=False).digest() != sha1:
        raise BadDescription("the description does not match its SHA-1")


def unpack(data: bytes, file_format: int) -> str:
    """Return the XML text of a raw or zipped description. Raises BadDescription."""
    if file_format == u3v.MANIFEST_FORMAT_ZIP:
        data = _unzip(data)
    elif file_format != u3v.MANIFEST_FORMAT_RAW:
        raise BadDescription(f"description in format {file_format}; known are 0 (raw) and 1 (zip)")
    text = data.rstrip(b"\0").decode("utf-8-sig", errors="replace")
    if not text.lstrip().startswith("<"):
        raise BadDescription("the description is not XML")
    return text


def _unzip(data: bytes) -> bytes:
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            members = [m for m in archive.infolist() if m.filename and not m.is_dir()]
            xml = [m for m in members if m.filename.lower().endswith(".xml")] or members
            if not xml:
                raise BadDescription("the zipped description is empty")
            if xml[0].compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):  # others ask for memory at will
                raise BadDescription(f"the description is packed by method {xml[0].compress_type}; known are 0 and 8")
            with archive.open(xml[0]) as member:
                # The stated size may lie: read one byte more than allowed, never the whole of a zip bomb.
                text = member.read(MAX_FILE_SIZE + 1)
    except (zipfile.BadZipFile, zlib.error, EOFError, NotImplementedError, RuntimeError, OSError, ValueError) as error:
        if isinstance(error, BadDescription):
            raise
        raise BadDescription(f"the zipped description cannot be read ({str(error)[:MOST_SAID]})") from error
    if len(text) > MAX_FILE_SIZE:
        raise BadDescription(f"the description unpacks to more than {MAX_FILE_SIZE} bytes")
    return text


def choose(entries: list[ManifestEntry]) -> ManifestEntry | None:
    """Return the newest entry that can be read, the first of equals; ``None`` without one."""
    usable = [
        e
        for e in entries
        if e.file_format in (u3v.MANIFEST_FORMAT_RAW, u3v.MANIFEST_FORMAT_ZIP) and 0 < e.size <= MAX_FILE_SIZE
    ]
    return max(usable, key=lambda e: e.file_version, default=None)


def read_description(control: ControlChannel, name: str, manifest_address: int) -> str:
    """Fetch the camera's GenICam description as XML text.

    A file whose SHA-1 is wrong is fetched once more. Raises DeviceRefused, DeviceGone.
    """
    count = control.read_u64(manifest_address)
    if not 1 <= count <= MAX_ENTRIES:
        raise DeviceRefused(name, f"the manifest claims {count} files; 1 to {MAX_ENTRIES} are allowed", _REMEDY)
    table = control.read(manifest_address + u3v.MANIFEST_COUNT_SIZE, count * u3v.MANIFEST_ENTRY_SIZE)
    step = u3v.MANIFEST_ENTRY_SIZE
    entry = choose([parse_manifest_entry(table[i : i + step]) for i in range(0, len(table), step)])
    if entry is None:
        raise DeviceRefused(name, "the manifest holds no readable description", _REMEDY)
    problem = ""
    for _ in range(_ATTEMPTS):
        data = control.read(entry.address, entry.size)
        try:
            check_sha1(data, entry.sha1)
            return unpack(data, entry.file_format)
        except BadDescription as error:
            problem = str(error)
    raise DeviceRefused(name, problem, _REMEDY)
