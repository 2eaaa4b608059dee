"""Owns the NumPy archive of one scan on its pixel grid: every array (h, w), names with units, and what it is as JSON.

    x_mm y_mm z_mm sigma_mm ray_gap_mm modulation_dn   float32, NaN where a pixel has no point
    grey                                               uint8, the left camera's bright image, also without points
    mask                                               bool, the pixel has a point
    about                                              text: JSON with title, frame, unit and notes

``numpy.load`` reads it without pickles.
"""

from __future__ import annotations

import io
import json
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from appliance.desk.export.content import About
from appliance.measure import OrganisedCloud
from appliance.store import Bytes, LocalFileSystem

LEVEL = 1
"""Level of compression: noise has little to be found, and the usual one takes six times as long for a tenth less."""


def write_grid(path: Path, cloud: OrganisedCloud, about: About) -> None:
    """Write the archive. Raises StorageError."""
    LocalFileSystem().replace_file(path, encode_npz(cloud, about))


def encode_npz(cloud: OrganisedCloud, about: About) -> Bytes:
    """Return the archive, compressed."""
    said = {
        "title": about.title,
        "frame": about.frame,
        "unit": about.unit or "mm",
        "notes": [*about.mark_lines(), *about.notes],
    }
    made = io.BytesIO()
    whole: dict[str, Any] = {
        **arrays_of(cloud, about.unit or "mm"),
        "about": np.array(json.dumps(said, ensure_ascii=False)),
    }
    with zipfile.ZipFile(made, "w", zipfile.ZIP_DEFLATED, compresslevel=LEVEL) as archive:
        for name, values in whole.items():
            with archive.open(f"{name}.npy", "w", force_zip64=True) as member:
                np.lib.format.write_array(member, values, allow_pickle=False)
    return made.getbuffer()


def arrays_of(cloud: OrganisedCloud, unit: str = "mm") -> dict[str, NDArray[Any]]:
    """Return the arrays of a scan, each (h, w), by their names; ``unit``: what its lengths are in."""
    return {
        f"x_{unit}": cloud.points_mm[..., 0],
        f"y_{unit}": cloud.points_mm[..., 1],
        f"z_{unit}": cloud.points_mm[..., 2],
        f"sigma_{unit}": cloud.sigma_mm,
        f"ray_gap_{unit}": cloud.ray_gap_mm,
        "modulation_dn": cloud.modulation_dn,
        "grey": cloud.grey,
        "mask": cloud.mask,
    }
