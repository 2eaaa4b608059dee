"""Import of foreign images with a description: a file of points or a scan folder, and the report.

* ``import_described``: the import.
* ``draw_reasons``: an image of the left camera with the mask reason of each pixel without a point as its colour.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from appliance import __version__
from appliance.base import Progress
from appliance.desk.export.content import CAMERA_FRAME, Metadata
from appliance.desk.export.files import write_scan
from appliance.desk.export.formats import SCAN_SUFFIXES, check_suffix, require_library
from appliance.desk.foreign.assumptions import ExaminedAssumption, Outcome
from appliance.desk.foreign.camera import clean_camera, decode_camera
from appliance.desk.foreign.cross_checks import examine_images, examine_rays
from appliance.desk.foreign.decode import Reason
from appliance.desk.foreign.description import load_description
from appliance.desk.foreign.first_look import check_images
from appliance.desk.foreign.images import read_side
from appliance.desk.foreign.own_form import own_sequence, require_folder_sequence, write_own
from appliance.desk.foreign.points import ForeignCloud, ForeignScan, find_points
from appliance.desk.foreign.problem import ForeignError
from appliance.desk.report.still import picture_of_scan
from appliance.measure import JUDGES
from appliance.store import LocalFileSystem

BASELINES = "baselines"
"""Unit of a cloud whose calibration has no scale: the baseline."""
LEAST_SHARE = 0.05
"""Least share of the left pixels with coordinates that become points: fewer may be there by chance."""
MOST_DRAWN = 1_000_000
"""Points of the picture, several for each of its pixels."""
LINE_PX = 24


def import_described(
    path: Path,
    out: Path,
    progress: Progress,
    *,
    as_described: bool = False,
    reasons: Path | None = None,
    picture: Path | None = None,
) -> dict[str, Any]:
    """Write the points of the images that the description at ``path`` describes to ``out``.

    The suffix of ``out`` gives the format. Without one, a scan folder is made of images that have our own form. ``reasons``: a PNG of why pixels have no point,
    also if hardly any points are left; ``picture``: one of the points.

    Raises ForeignError, also where the images contradict the description (unless ``as_described``), where hardly any
    points are left, and for a scan folder of another form; ExportError, MissingLibraryError, StorageError.
    """
    suffix = check_suffix(out, SCAN_SUFFIXES, "a cloud") if out.suffix else ""
    if suffix:
        require_library(out)
    scan = read_foreign(path, progress)
    if scan.wrong and not as_described:
        contradictions = "; ".join(map(str, scan.wrong))
        raise ForeignError(
            f"{path}: the images contradict it: {contradictions}; correct it, or import it with --as-described"
        )
    sequence = None if suffix else require_folder_sequence(path, out, scan)
    cloud = _find_enough_points(path, scan, progress, reasons)
    progress("writing")
    report = _report(scan, cloud)
    if sequence is not None:
        return {**write_own(path, out, scan, cloud, sequence), **report}
    note = f"index {scan.rig.index:.5f}, {'air' if scan.rig.in_air else 'water'}, imported by software {__version__}"
    marks = [cloud.unchecked] if cloud.unchecked else []
    marks += [f"wrong: {assumption}" for assumption in scan.wrong]
    head = Metadata(scan.description.name, CAMERA_FRAME, (note,), tuple(marks), _unit(scan))
    del scan  # Free memory for writing the file.
    write_scan(out, cloud.cloud, head)
    if picture is not None:
        places = np.flatnonzero(cloud.cloud.mask)
        places = places[:: 1 + len(places) // MOST_DRAWN]
        drawn = picture_of_scan(cloud.cloud.points_mm.reshape(-1, 3)[places], cloud.cloud.grey.ravel()[places])
        LocalFileSystem().replace_file(picture, drawn)
    unit = head.unit or ("m" if suffix in (".e57", ".las") else "mm")
    return {"file": str(out), "format": suffix.removeprefix("."), "unit": unit, **report}


def read_foreign(path: Path, progress: Progress) -> ForeignScan:
    """Read, decode and test the images of the description at ``path``. Raises ForeignError."""
    described = load_description(path)
    read_sets = {}
    for side in described.files:
        progress(f"reading {side}")
        read_sets[side] = read_side(described, side)
    description, sets, rig = check_images(path, described, read_sets)
    cameras, tested = {}, list[ExaminedAssumption]()
    for side, images in sets.items():
        progress(f"decoding {side}")
        cameras[side] = decode_camera(images, description)
        tested += examine_images(side, cameras[side], description)
        if len(sets) > 1:
            # Only with a projector are other conventions tried on the phases; those of two cameras need much memory.
            cameras[side] = replace(cameras[side], measured={})
    progress("testing the description")
    all_tested = examine_rays(description, cameras, rig, tested)
    # One camera after the other: cleaning a large set doubles its memory.
    cleaned = {side: clean_camera(cameras.pop(side)) for side in sets}
    return ForeignScan(description, rig, cleaned, all_tested)


def _find_enough_points(path: Path, scan: ForeignScan, progress: Progress, reasons: Path | None) -> ForeignCloud:
    progress("finding points")
    cloud = find_points(scan.description, scan.rig, scan.cameras["left"], scan.cameras.get("right"))
    if reasons is not None:
        draw_reasons(cloud, reasons)
    if cloud.points == 0 or cloud.points < LEAST_SHARE * cloud.decoded_pixels:
        causes = [cloud.failure] if cloud.failure else cloud.largest_reasons(of_decoded=cloud.decoded_pixels > 0)
        raise ForeignError(
            f"{path}: {cloud.points} points from {cloud.decoded_pixels} left pixels with coordinates, between "
            f"{cloud.depths_mm[0]:.4g} and "
            f"{cloud.depths_mm[1]:.4g} {_unit(scan) or 'mm'}: {'; '.join(causes)}"
        )
    return cloud


def _unit(scan: ForeignScan) -> str:
    """Return the unit of all lengths if it is not mm, else an empty text."""
    return "" if scan.rig.scale_known else BASELINES


def _report(scan: ForeignScan, foreign_cloud: ForeignCloud) -> dict[str, Any]:
    cloud, has_point = foreign_cloud.cloud, foreign_cloud.cloud.mask
    unit = _unit(scan) or "mm"
    needed = "need four steps of 90° in two directions with bright and dark"
    if not isinstance(own_sequence(scan.description, scan.cameras["left"].images), str):
        needed = "are judged when the scan folder is reconstructed"
    tested = {
        outcome: [str(assumption) for assumption in scan.tested if assumption.outcome is outcome] for outcome in Outcome
    }
    return {
        "points": foreign_cloud.points,
        "coverage_percent": 100.0 * foreign_cloud.points / foreign_cloud.decoded_pixels,
        "decoded_percent": {side: 100.0 * camera.decoded for side, camera in scan.cameras.items()},
        f"distance_{unit}": _median(cloud.points_mm[..., 2], has_point),
        f"noise_{unit}": _median(cloud.sigma_mm, has_point),
        f"gap_{unit}": _median(cloud.ray_gap_mm, has_point),
        "index": scan.rig.index,
        f"baseline_{unit}": float(np.linalg.norm(scan.rig.rig.right.translation_mm)),
        "without_point": foreign_cloud.largest_reasons(),
        "reasons": {reason.word: count for reason, count in foreign_cloud.reasons.items()},
        "notes": list(scan.rig.notes),
        "fits": tested[Outcome.FITS],
        "wrong": tested[Outcome.WRONG],
        "unchecked": [
            *([foreign_cloud.unchecked.removeprefix("unchecked: ")] if foreign_cloud.unchecked else []),
            *tested[Outcome.UNCHECKED],
            f"{', '.join(judge.name for judge in JUDGES)}: {needed}",
        ],
    }


def _median(values: NDArray[np.float32], has_point: NDArray[np.bool_]) -> float | None:
    """Return the median of a map's finite values at points; ``None`` without any."""
    finite = values[has_point & np.isfinite(values)]
    # In place: the values of a large set need much memory.
    return float(np.median(finite, overwrite_input=True)) if finite.size else None


def draw_reasons(cloud: ForeignCloud, path: Path) -> None:
    """Write the picture as PNG, with the reasons and their numbers of pixels below it.

    Raises StorageError.
    """
    grey = cloud.cloud.grey
    picture = np.repeat(grey[..., None], 3, axis=-1)
    counts = cloud.reasons
    for reason in counts:
        picture[cloud.reason_map == reason] = reason.colour
    legend = np.full((LINE_PX * (len(counts) + 1), max(grey.shape[1], 12 * LINE_PX), 3), 255, np.uint8)
    picture = np.pad(picture, ((0, 0), (0, legend.shape[1] - grey.shape[1]), (0, 0)), constant_values=255)
    entries = [(Reason.FOUND.colour, f"point: {cloud.points}")]
    entries += [(kind.colour, f"{kind.word}: {counts[kind]}") for kind in sorted(counts)]
    for line, (colour, text) in enumerate(entries):
        top = line * LINE_PX
        cv2.rectangle(legend, (4, top + 4), (LINE_PX - 4, top + LINE_PX - 4), colour, cv2.FILLED)
        cv2.putText(legend, text, (LINE_PX + 4, top + 17), cv2.FONT_HERSHEY_SIMPLEX, 0.5, (0, 0, 0), 1, cv2.LINE_AA)
    # OpenCV counts colours from blue.
    encoded = cv2.imencode(".png", np.vstack([picture, legend])[..., ::-1])[1]
    LocalFileSystem().replace_file(path, encoded.tobytes())
