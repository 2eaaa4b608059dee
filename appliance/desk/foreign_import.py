"""Owns the import of images that another rig took: a file of points, or a scan folder like our own, and the report of
both.

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
from appliance.desk.foreign.assumptions import Outcome
from appliance.desk.foreign.description import Description
from appliance.desk.foreign.first_look import look_first
from appliance.desk.foreign.images import ImageSet
from appliance.desk.foreign.own_form import own_frames, own_sequence
from appliance.desk.foreign.points import MOST_PX, ForeignCloud, find_points
from appliance.desk.foreign.problem import ForeignError
from appliance.desk.foreign.reading import ForeignScan, read_foreign
from appliance.desk.foreign.reasons import Reason
from appliance.desk.report.still import picture_of_scan
from appliance.measure import (
    JUDGES,
    SIDES,
    Calibration,
    HousedCamera,
    PatternSequence,
    QualityLimits,
    Water,
    of_side,
)
from appliance.store import (
    Instrument,
    LocalFileSystem,
    Rig,
    ScanRecord,
    SequenceInfo,
    default_rig_path,
    keep_scan,
    load_rig,
)

METHOD = "foreign"
"""Method of a calibration that was made by others."""
BASELINES = "baselines"
"""Unit of a cloud whose calibration has no scale: the distance of both cameras."""
LEAST_SHARE = 0.05
"""Least share of the left pixels with coordinates that become points: fewer are there by chance."""
MOST_DRAWN = 1_000_000
"""Points of the picture, several for each of its pixels."""
LEAST_WITHIN = 0.5
"""Least share of the points that lie within the instrument's own depths, for a scan folder."""


def check_import(path: Path, out: Path) -> None:
    """Refuse whatever can be refused at once: names, words, images that are not there, cameras' numbers, and what
    ``out`` cannot be.

    ``out`` without a suffix is a scan folder. Nothing is decoded, and no kernel is needed. Raises ForeignError,
    ExportError, MissingLibraryError.
    """
    if out.suffix:
        checked_suffix(out, SCAN_SUFFIXES, "a cloud")
        require_library(out)
    description, images = look_first(path)
    longest_px = max(max(one.shape) for one in images.values())
    if "right" not in images:
        longest_px = max(longest_px, *description.projector_px)
    if longest_px > MOST_PX and not description.one_direction:
        raise ForeignError(
            f"{path}: an image or the projector has {longest_px} px along a side; allowed for two directions are "
            f"{MOST_PX} px; cut it, or "
            "describe one direction only"
        )
    if not out.suffix:
        if out.exists():
            raise ForeignError(f"--out {out}: is there already; give the name of a folder that is not")
        if not out.absolute().parent.is_dir():
            raise ForeignError(f"--out {out}: there is no folder {out.parent}; make it first, or give another one")
        _own_sequence(path, out, description, images["left"])


def import_cloud(
    path: Path,
    out: Path,
    progress: Progress,
    *,
    as_described: bool = False,
    reasons: Path | None = None,
    picture: Path | None = None,
) -> dict[str, Any]:
    """Write the points of the images that the description at ``path`` describes; the suffix of ``out`` says how.

    ``reasons``: a PNG of why pixels have no point, also where hardly any are left; ``picture``: one of the points.

    Raises ForeignError, also where the images contradict the description (unless ``as_described``) and where hardly any
    points are left; ExportError, MissingLibraryError, StorageError.
    """
    suffix = checked_suffix(out, SCAN_SUFFIXES, "a cloud")
    require_library(out)
    scan = _read(path, progress, as_described)
    found = _found(path, scan, progress, reasons)
    progress("writing")
    note = f"index {scan.rig.index:.5f}, {'air' if scan.rig.in_air else 'water'}, imported by software {__version__}"
    marks = [found.unchecked] if found.unchecked else []
    marks += [f"wrong: {one}" for one in scan.wrong]
    about = About(scan.description.name, CAMERA_FRAME, (note,), tuple(marks), _unit(scan))
    report = _report(scan, found)
    del scan  # Files need room, too.
    write_scan(out, found.cloud, about)
    if picture is not None:
        there = np.flatnonzero(found.cloud.mask)
        there = there[:: 1 + len(there) // MOST_DRAWN]
        drawn = picture_of_scan(found.cloud.points_mm.reshape(-1, 3)[there], found.cloud.grey.ravel()[there])
        LocalFileSystem().replace_file(picture, drawn)
    unit = about.unit or ("m" if suffix in (".e57", ".las") else "mm")
    return {"file": str(out), "format": suffix.removeprefix("."), "unit": unit, **report}


def import_scan(
    path: Path, out: Path, progress: Progress, *, as_described: bool = False, reasons: Path | None = None
) -> dict[str, Any]:
    """Make the scan folder ``out`` of images that have our own form.

    Raises as ``import_cloud``, and ForeignError for another form.
    """
    check_import(path, out)
    scan = _read(path, progress, as_described)
    images = {side: camera.images for side, camera in scan.cameras.items()}
    sequence = _own_sequence(path, out, scan.description, images["left"])
    if not scan.rig.scale_known:
        raise ForeignError(
            f"{path}: no scan folder can be made: the calibration has no scale; give the translation's length in mm"
        )
    if scan.wrong:
        raise ForeignError(f"{path}: no scan folder can be made of images that are described wrongly; correct it")
    found = _found(path, scan, progress, reasons)
    limits = QualityLimits()
    depth_mm = found.cloud.points_mm[..., 2][found.cloud.mask]
    within = float(np.mean((depth_mm > limits.min_depth_mm) & (depth_mm < limits.max_depth_mm)))
    if within < LEAST_WITHIN:
        raise ForeignError(
            f"{path}: no scan folder can be made: {100 * within:.0f} % of the points lie in the instrument's depths of "
            f"{limits.min_depth_mm:g} to {limits.max_depth_mm:g} mm; write a cloud with --out {out.name}.ply"
        )
    progress("writing")
    calibration = calibration_of(scan)
    rig = _rig(scan, calibration)
    frames = {side: own_frames(sequence, scan.description, one) for side, one in images.items()}
    water = calibration.water
    record = ScanRecord(
        SequenceInfo.of(sequence), rig.rig_hash, calibration.hash, __version__, None, False, 0,
        water={
            "salinity_psu": water.salinity_psu, "temperature_c": water.temperature_c, "wavelength_nm": water.wavelength_nm,
            "index": water.index,
        },
    )  # fmt: skip
    keep_scan(out, frames, record, Instrument(rig).origin(calibration))
    return {"folder": str(out), "frames": len(sequence), "period_px": sequence.period_px, **_report(scan, found)}


def _own_sequence(path: Path, out: Path, description: Description, images: ImageSet) -> PatternSequence:
    found = own_sequence(description, images)
    if isinstance(found, str):
        raise ForeignError(f"{path}: no scan folder can be made: {found}; write a cloud with --out {out.name}.ply")
    return found


def _read(path: Path, progress: Progress, as_described: bool) -> ForeignScan:
    scan = read_foreign(path, progress)
    if scan.wrong and not as_described:
        said = "; ".join(map(str, scan.wrong))
        raise ForeignError(
            f"{path}: the images contradict it: {said}; correct it, or import it all the same with --as-described"
        )
    return scan


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
        "reasons": found.reasons,
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


def calibration_of(scan: ForeignScan) -> Calibration:
    """Return the calibration file that says what the description says of the cameras."""
    if scan.rig.calibration is not None:
        return scan.rig.calibration
    medium = scan.description.medium
    straight = all(camera.lens_in_water for camera in (scan.rig.rig.left, scan.rig.rig.right))
    if any(len(camera.lens.distortion) > 5 for camera in (scan.rig.rig.left, scan.rig.rig.right)):
        raise ForeignError(
            "no scan folder can be made: our calibration files hold the distortion k1, k2, p1, p2, k3 only"
        )
    if not straight and medium.temperature_c is None:
        raise ForeignError(
            "no scan folder can be made: behind ports the index of a scan folder follows from temperature and "
            "salinity; give "
            "water.temperature_c in place of water.index"
        )
    water = Water(
        20.0 if medium.temperature_c is None else medium.temperature_c, medium.salinity_psu, medium.wavelength_nm
    )
    return Calibration(scan.description.name, METHOD, "unknown", ("images of another rig",), water, scan.rig.rig)


def _rig(scan: ForeignScan, calibration: Calibration) -> Rig:
    """Return the packaged rig with the foreign cameras and projector in place of its own."""
    rig = load_rig(default_rig_path())
    serials = calibration.camera_serials or tuple(f"{scan.description.name} {side}" for side in SIDES)

    def camera(side: str, serial: str) -> Any:
        seen: HousedCamera = of_side(scan.rig.rig, side)
        return replace(of_side(rig.camera, side), serial=serial, width_px=seen.width_px, height_px=seen.height_px)

    width_px, height_px = scan.description.projector_px
    return replace(
        rig,
        rig=replace(rig.rig, name=scan.description.name, serial=calibration.rig_serial),
        camera=replace(rig.camera, left=camera("left", serials[0]), right=camera("right", serials[1])),
        projector=replace(rig.projector, width_px=width_px, height_px=height_px),
    )


COLOURS = {
    Reason.SATURATED: (255, 255, 0),
    Reason.WEAK: (16, 16, 72),
    Reason.CONTRADICTION: (214, 39, 40),
    Reason.OUTSIDE: (148, 103, 189),
    Reason.NO_RAY: (140, 86, 75),
    Reason.NO_MATCH: (31, 119, 180),
    Reason.GAP: (255, 127, 14),
    Reason.SIGMA: (44, 160, 44),
    Reason.DEPTH: (23, 190, 207),
    Reason.NEIGHBOURS: (227, 119, 194),
}
"""Red, green, blue of each reason."""
LINE_PX = 24


def draw_reasons(cloud: ForeignCloud, path: Path) -> None:
    """Write the picture as PNG, with the reasons and their numbers of pixels below it. Raises StorageError."""
    grey = cloud.cloud.grey
    picture = np.repeat(grey[..., None], 3, axis=-1)
    for reason, colour in COLOURS.items():
        picture[cloud.reason_map == reason] = colour
    counts = cloud.reasons
    legend = np.full((LINE_PX * (len(counts) + 1), max(grey.shape[1], 12 * LINE_PX), 3), 255, np.uint8)
    picture = np.pad(picture, ((0, 0), (0, legend.shape[1] - grey.shape[1]), (0, 0)), constant_values=255)
    named = [((128, 128, 128), f"point: {cloud.points}")]
    named += [(COLOURS[one], f"{one.word}: {counts[one.word]}") for one in COLOURS if one.word in counts]
    for line, (colour, text) in enumerate(named):
        top = line * LINE_PX
        cv2.rectangle(legend, (4, top + 4), (LINE_PX - 4, top + LINE_PX - 4), colour, cv2.FILLED)
        cv2.putText(legend, text, (LINE_PX + 4, top + 17), cv2.FONT_HERSHEY_SIMPLEX, 0.5, (0, 0, 0), 1, cv2.LINE_AA)
    # OpenCV counts colours from blue.
    made = cv2.imencode(".png", np.vstack([picture, legend])[..., ::-1])[1]
    LocalFileSystem().replace_file(path, made.tobytes())
