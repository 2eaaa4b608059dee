"""NumPy archives of scans on their pixel grids: arrays (h, w) named with units, and metadata as JSON.

    x_mm y_mm z_mm sigma_mm ray_gap_mm modulation_dn   float32, NaN where a pixel has no point
    grey                                               uint8, the left camera's bright image, also without points
    mask                                               bool, the pixel has a point
    about                                              text: JSON with title, frame, unit and notes

An object's scans are unmoved. Each has these arrays under its name (``000003/x_mm``), and

    rotation (3, 3), translation_mm (3,)    float64: a point p of the scan is at rotation · p + translation_mm in the object's frame
    place_covariance (6, 6)                 float64: of rotation (rad) and shift (mm) about its own middle, bending of the object included
    middle_mm (3,)                          float64: that middle, in the object's frame

and once ``scans``, the names in their order, and ``about``. ``numpy.load`` reads it without pickles, and only the
arrays that are used.
"""

from __future__ import annotations

import json
import zipfile
from collections.abc import Iterable, Iterator
from functools import partial
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from appliance.desk.export.content import Metadata
from appliance.desk.surface.fusion import PlacedScan
from appliance.measure import OrganisedCloud
from appliance.store import LocalFileSystem

LEVEL = 1
"""Level of compression: the usual one takes six times as long for a tenth less, as noise is hard to compress."""
Named = tuple[str, NDArray[Any]]


def write_grid(path: Path, cloud: OrganisedCloud, metadata: Metadata) -> None:
    """Write the archive of one scan. Raises StorageError."""
    _replace(path, _arrays(cloud, metadata.unit or "mm"), metadata)


def write_scans(path: Path, scans: Iterable[PlacedScan], metadata: Metadata) -> None:
    """Write the archive of an object's scans; one scan is held at a time.

    Raises StorageError, and the errors of ``scans``.
    """
    _replace(path, _arrays_of_all(scans), metadata)


def _arrays_of_all(scans: Iterable[PlacedScan]) -> Iterator[Named]:
    names = []
    for scan in scans:
        names.append(scan.name)
        placed = {
            "rotation": scan.rotation,
            "translation_mm": scan.translation_mm,
            "place_covariance": scan.covariance,
            "middle_mm": scan.middle_mm,
        }
        poses = ((name, values) for name, values in placed.items() if values is not None)
        yield from ((f"{scan.name}/{name}", values) for name, values in chain(_arrays(scan.cloud), poses))
    yield "scans", np.array(names)


def _arrays(cloud: OrganisedCloud, unit: str = "mm") -> Iterator[Named]:
    """Yield the arrays of a scan, each (h, w), with their names; ``unit`` is that of its lengths."""
    yield from ((f"{axis}_{unit}", cloud.points_mm[..., k]) for k, axis in enumerate("xyz"))
    yield f"sigma_{unit}", cloud.sigma_mm
    yield f"ray_gap_{unit}", cloud.ray_gap_mm
    yield "modulation_dn", cloud.modulation_dn
    yield "grey", cloud.grey
    yield "mask", cloud.mask


def _replace(path: Path, arrays: Iterable[Named], metadata: Metadata) -> None:
    LocalFileSystem().replace_by(path, partial(_write, arrays=arrays, metadata=metadata))


def _write(path: Path, arrays: Iterable[Named], metadata: Metadata) -> None:
    content = {
        "title": metadata.title,
        "frame": metadata.frame,
        "unit": metadata.unit or "mm",
        "notes": [*metadata.mark_lines(), *metadata.notes],
    }
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED, compresslevel=LEVEL) as archive:
        for name, values in chain(arrays, [("about", np.array(json.dumps(content, ensure_ascii=False)))]):
            with archive.open(f"{name}.npy", "w", force_zip64=True) as member:
                # Force order C, which a view of one axis has not; a text stays without an axis.
                np.lib.format.write_array(member, np.asarray(values, order="C"), allow_pickle=False)
