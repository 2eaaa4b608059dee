"""Owns which object the scans on a disk belong to, as the diver said it: numbers that the manifests carry.

A number is given once. ``choices.json`` remembers the largest one; where that file was lost, or came from elsewhere,
the manifests tell. Numbers ascend with the scans', so that the newest scan that carries one carries the largest.
"""

from __future__ import annotations

from appliance.base import ContentError
from appliance.store import manifest as form
from appliance.store.library import Library, LibraryFolder

LOOKED_AT = 500
"""Largest number of manifests that are read for it, the newest ones: a start must not take longer with every dive."""


def largest_number(library: Library) -> int:
    """Return the largest number that one of the newest scans carries, wherever it lies; 0 where none does.

    Raises OSError.
    """
    for folder in library.newest_first()[:LOOKED_AT]:
        try:
            number = form.read(folder).record.object
        except ContentError:
            continue  # damaged: the next older one tells
        if number is not None:
            return number
    return 0


def scans_of_object(library: Library, number: int) -> list[str]:
    """Return the published scans that belong to an object, by their numbers in the order they were taken."""
    return [
        entry.scan_id
        for entry in library.entries(LibraryFolder.SCANS)
        if entry.manifest is not None and entry.manifest.record.object == number
    ]


def numbers_of_object(library: Library) -> list[int]:
    """Return every number that a published scan carries, ascending."""
    entries = library.entries(LibraryFolder.SCANS)
    found = {None if entry.manifest is None else entry.manifest.record.object for entry in entries}
    return sorted(number for number in found if number is not None)
