"""Finding the storage root where none was named: around the working directory, or in the environment.

Only for work on stored scans. An instrument keeps its scans where its rig file says, wherever it is started.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path

from appliance.store.names import scan_number

VARIABLE = "KINGFISHER_ROOT"
_SCANS = "scans"
_BESIDE = ("calibration", "next-id")
"""Folder and file of which one lies beside ``scans/`` on every instrument's disk."""


def is_root(folder: Path) -> bool:
    """Return True if ``folder`` is a storage root.

    It is if it has a folder ``scans`` with a scan in it or with an instrument's own files beside it.
    """
    # A folder `scans` alone may be of any other program.
    scans = folder / _SCANS
    try:
        if any((folder / name).exists() for name in _BESIDE):
            return scans.is_dir()
        return any(scan_number(entry.name) is not None for entry in os.scandir(scans))
    except OSError:  # none, a file, or closed to us
        return False


def root_around(folder: Path) -> Path | None:
    """Return the nearest storage root among ``folder`` and those above it, or ``None``."""
    return next((candidate for candidate in (folder, *folder.parents) if is_root(candidate)), None)


def standing_root(environment: Mapping[str, str]) -> tuple[Path | None, str]:
    """Return the storage root around the working directory, else that of ``KINGFISHER_ROOT``.

    If neither is a storage root, return ``None``. The text says in words where it was searched. Raises
    NotADirectoryError for a ``KINGFISHER_ROOT`` that is no folder.
    """
    named = environment.get(VARIABLE)
    vain = (
        f"neither the current folder nor one above it is a storage root, {VARIABLE} "
        f"{f'is {named}' if named else 'is not set'}"
    )
    try:
        around = root_around(Path.cwd())
    except FileNotFoundError:  # the working directory was removed
        around = None
    if around is not None or not named:
        return around, vain
    if not Path(named).is_dir():
        raise NotADirectoryError(f"{VARIABLE}={named}: no such folder; set it to the storage root that holds scans/")
    return Path(named), vain
