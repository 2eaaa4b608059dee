"""Names of the worlds for measuring verdicts, and their recordings of cases."""

from __future__ import annotations

from pathlib import Path

from bench.verdict.kept_scans import KeptScans, Scans
from bench.verdict.outside import OutsideScans

ORDINARY, OUTSIDE = "ordinary", "outside"
WORLDS = (ORDINARY, OUTSIDE)


def scans_of(world: str, folder: Path | None) -> Scans:
    """Return the recordings of the cases of movement in ``world``, kept in ``folder``. Raises ValueError for an unknown world."""
    if world == ORDINARY:
        return KeptScans(folder)
    if world == OUTSIDE:
        return OutsideScans(folder)
    raise ValueError(f"world '{world}'; allowed are {', '.join(WORLDS)}")
