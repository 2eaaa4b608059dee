"""Owns the import of images that another rig took, as a description says: a file of points, or a scan folder like our
own, and the report of both.

It also owns the picture of reasons: of each left pixel in which colour it is said why it has no point; where there is
one, what the camera saw.
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
from appliance.desk.export.content import CAMERA_FRAME, About
from appliance.desk.export.files import write_scan
from appliance.desk.export.formats import SCAN_SUFFIXES, checked_suffix, require_library
from appliance.desk.foreign.assumptions import ExaminedAssumption, Outcome
from appliance.desk.foreign.camera import clean_camera, decode_camera
from appliance.desk.foreign.cross_checks import examine_images, examine_rays
from appliance.desk.foreign.decode import Reason
from appliance.desk.foreign.description import load_description
from appliance.desk.foreign.first_look import check_images
from appliance.desk.foreign.images import read_side
from appliance.desk.foreign.own_form import own_sequence, settled_sequence, write_own
from appliance.desk.foreign.points import ForeignCloud, ForeignScan, find_points
from appliance.desk.foreign.problem import ForeignError
from appliance.desk.report.still import picture_of_scan
from appliance.measure import JUDGES
from appliance.store import LocalFileSystem

BASELINES = "baselines"
"""Unit of a cloud whose calibration has no scale: the distance of both cameras."""
LEAST_SHARE = 0.05
"""Least share of the left pixels with coordinates that become points: fewer are there by chance."""
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
    """Write the points of the images that the description at ``path`` describes; the suffix of ``out`` says how.
    Without one, a scan folder of images that have our own form.

    ``reasons``: a PNG of why pixels have no point, also where hardly any are left; ``picture``: one of the points.

    Raises ForeignError, also where the images contradict the description (unless ``as_described``), where hardly any
    points are left, and for a scan folder of another form; ExportError, MissingLibraryError, StorageError.
    """
    suffix = checked_suffix(out, SCAN_SUFFIXES, "a cloud") if out.suffix else ""
    if suffix:
        require_library(out)
    scan = read_foreign(path, progress)
    if scan.wrong and not as_described:
        said = "; ".join(map(str, scan.wrong))
        raise ForeignError(
            f"{path}: the images contradict it: {said}; correct it, or import it all the same with --as-described"
        )
    sequence = None if suffix else settled_sequence(path, out, scan)
    found = _found(path, scan, progress, reasons)
    progress("writing")
    report = _report(scan, found)
    if sequence is not None:
        return {**write_own(path, out, scan, found, sequence), **report}
    note = f"index {scan.rig.index:.5f}, {'air' if scan.rig.in_air else 'water'}, imported by software {__version__}"
    marks = [found.unchecked] if found.unchecked else []
    marks += [f"wrong: {one}" for one in scan.wrong]
    about = About(scan.description.name, CAMERA_FRAME, (note,), tuple(marks), _unit(scan))
    del scan  # Files need room, too.
    write_scan(out, found.cloud, about)
    if picture is not None:
        there = np.flatnonzero(found.cloud.mask)
        there = there[:: 1 + len(there) // MOST_DRAWN]
        drawn = picture_of_scan(found.cloud.points_mm.reshape(-1, 3)[there], found.cloud.grey.ravel()[there])
        LocalFileSystem().replace_file(picture, drawn)
    unit = about.unit or ("m" if suffix in (".e57", ".las") else "mm")
    return {"file": str(out), "format": suffix.removeprefix("."), "unit": unit, **report}


def read_foreign(path: Path, progress: Progress) -> ForeignScan:
    """Read what the description at ``path`` describes, decode it and test it. Raises ForeignError."""
    said = load_description(path)
    read = {}
    for side in said.files:
        progress(f"reading {side}")
        read[side] = read_side(said, side)
    description, sets, rig = check_images(path, said, read)
    cameras, tested = {}, list[ExaminedAssumption]()
    for side, images in sets.items():
        progress(f"decoding {side}")
        cameras[side] = decode_camera(images, description)
        tested += examine_images(side, cameras[side], description)
        if len(sets) > 1:
            # Beside a projector other conventions are tried on the phases; those of two cameras would need much room.
            cameras[side] = replace(cameras[side], measured={})
    progress("testing the description")
    said_of_all = examine_rays(description, cameras, rig, tested)
    # One after the other: what was decoded of a large set needs as much room again.
    cleaned = {side: clean_camera(cameras.pop(side)) for side in sets}
    return ForeignScan(description, rig, cleaned, said_of_all)


def _found(path: Path, scan: ForeignScan, progress: Progress, reasons: Path | None) -> ForeignCloud:
    progress("finding points")
    found = find_points(scan.description, scan.rig, scan.cameras["left"], scan.cameras.get("right"))
    if reasons is not None:
        draw_reasons(found, reasons)
    if found.points == 0 or found.points < LEAST_SHARE * found.lit:
        why = [found.failure] if found.failure else found.largest_reasons(of_lit=found.lit > 0)
        raise ForeignError(
            f"{path}: {found.points} points are left of {found.lit} left pixels with coordinates, between "
            f"{found.depths_mm[0]:.4g} and "
            f"{found.depths_mm[1]:.4g} {_unit(scan) or 'mm'}: {'; '.join(why)}"
        )
    return found


def _unit(scan: ForeignScan) -> str:
    """Return the unit of all lengths where it is not mm."""
    return "" if scan.rig.scale_known else BASELINES


def _report(scan: ForeignScan, found: ForeignCloud) -> dict[str, Any]:
    cloud, there = found.cloud, found.cloud.mask
    unit = _unit(scan) or "mm"
    needed = "need four steps of 90° in two directions with bright and dark"
    if not isinstance(own_sequence(scan.description, scan.cameras["left"].images), str):
        needed = "are asked when the scan folder is reconstructed"
    tested = {outcome: [str(one) for one in scan.tested if one.outcome is outcome] for outcome in Outcome}
    return {
        "points": found.points,
        "coverage_percent": 100.0 * found.points / found.lit,
        "decoded_percent": {side: 100.0 * camera.decoded for side, camera in scan.cameras.items()},
        f"distance_{unit}": _median(cloud.points_mm[..., 2], there),
        f"noise_{unit}": _median(cloud.sigma_mm, there),
        f"gap_{unit}": _median(cloud.ray_gap_mm, there),
        "index": scan.rig.index,
        f"baseline_{unit}": float(np.linalg.norm(scan.rig.rig.right.translation_mm)),
        "without_point": found.largest_reasons(),
        "reasons": {one.word: count for one, count in found.reasons.items()},
        "notes": list(scan.rig.notes),
        "fits": tested[Outcome.FITS],
        "wrong": tested[Outcome.WRONG],
        "unchecked": [
            *([found.unchecked.removeprefix("unchecked: ")] if found.unchecked else []),
            *tested[Outcome.UNCHECKED],
            f"{', '.join(judge.name for judge in JUDGES)}: {needed}",
        ],
    }


def _median(values: NDArray[np.float32], there: NDArray[np.bool_]) -> float | None:
    """Return the median of a map's finite values where points are; ``None`` where it has none."""
    known = values[there & np.isfinite(values)]
    # In place: a large set's values need much room.
    return float(np.median(known, overwrite_input=True)) if known.size else None


def draw_reasons(cloud: ForeignCloud, path: Path) -> None:
    """Write the picture as PNG, with the reasons and their numbers of pixels below it. Raises StorageError."""
    grey = cloud.cloud.grey
    picture = np.repeat(grey[..., None], 3, axis=-1)
    counts = cloud.reasons
    for reason in counts:
        picture[cloud.reason_map == reason] = reason.colour
    legend = np.full((LINE_PX * (len(counts) + 1), max(grey.shape[1], 12 * LINE_PX), 3), 255, np.uint8)
    picture = np.pad(picture, ((0, 0), (0, legend.shape[1] - grey.shape[1]), (0, 0)), constant_values=255)
    named = [(Reason.FOUND.colour, f"point: {cloud.points}")]
    named += [(one.colour, f"{one.word}: {counts[one]}") for one in sorted(counts)]
    for line, (colour, text) in enumerate(named):
        top = line * LINE_PX
        cv2.rectangle(legend, (4, top + 4), (LINE_PX - 4, top + LINE_PX - 4), colour, cv2.FILLED)
        cv2.putText(legend, text, (LINE_PX + 4, top + 17), cv2.FONT_HERSHEY_SIMPLEX, 0.5, (0, 0, 0), 1, cv2.LINE_AA)
    # OpenCV counts colours from blue.
    made = cv2.imencode(".png", np.vstack([picture, legend])[..., ::-1])[1]
    LocalFileSystem().replace_file(path, made.tobytes())
