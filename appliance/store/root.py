"""Owns how a storage root is found where none was named: around the folder in which somebody stands, or in the
environment.

Only for what is done with stored scans. An instrument keeps its scans where its rig file says, wherever it is started.
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
    """Return True if ``folder`` is a storage root: ``scans/`` in it, and a scan in that or an instrument's own files
    beside it."""
    # `scans` alone may be anybody's folder.
    scans = folder / _SCANS
    try:
        if any((folder / name).exists() for name in _BESIDE):
            return scans.is_dir()
        return any(scan_number(entry.name) is not None for entry in os.scandir(scans))
    except OSError:  # none, a file, or closed to us
        return False


def root_around(folder: Path) -> Path | None:
    """Return the nearest storage root among ``folder`` and those above it; ``None`` where there is none."""
    return next((one for one in (folder, *folder.parents) if is_root(one)), None)


def standing_root(environment: Mapping[str, str]) -> tuple[Path | None, str]:
    """Return the storage root around the working directory, else that of ``KINGFISHER_ROOT``, or ``None`` where neither
    says one; and in words where it was looked for in vain.

    Raises NotADirectoryError for a ``KINGFISHER_ROOT`` that is no folder.
    """
    named = environment.get(VARIABLE)
    vain = (
        f"neither the folder you stand in nor one above it is a storage root, {VARIABLE} "
        f"{f'is {named}' if named else 'is not set'}"
    )
    try:
        around = root_around(Path.cwd())
    except FileNotFoundError:  # somebody removed the folder that we stand in
        around = None
    if around is not None or not named:
        return around, vain
    if not Path(named).is_dir():
        raise NotADirectoryError(f"{VARIABLE}={named}: no such folder; set it to the storage root that holds scans/")
    return Path(named), vain
