"""Owns the calibration in air from a folder of pictures: looking at them, adjusting, writing what came out.

Of the instrument's cameras a start for calibrating in water is written; of anybody's pair a calibration file as all are
(``calibration.file``), and the same for OpenCV (``M1 D1 M2 D2 R T``). Beside either lie two pictures.
"""

from __future__ import annotations

import hashlib
import logging
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from appliance.base import Progress
from appliance.calibrate.air.adjustment import BoardTolerance
from appliance.calibrate.air.any_board import Wanted, search_board
from appliance.calibrate.air.board import SMALL_SPREAD, BoardDesign, find_board, spread_of
from appliance.calibrate.air.calibrate import (
    AirCalibration,
    AirCalibrationError,
    FittedView,
    calibrate_air,
    check_pairs,
)
from appliance.calibrate.air.coverage import Coverage, coverage
from appliance.calibrate.air.linearised import BoardView
from appliance.calibrate.air.pictures import coverage_picture, residual_picture
from appliance.calibrate.pictures import Pair, common_size, named_pictures, pairs_of, read_grey, read_pair
from appliance.calibrate.water.start import start_from_air
from appliance.measure import (
    IN_AIR,
    RIG_PARAMETERS,
    SIDES,
    Calibration,
    CalibrationError,
    StereoRig,
    Water,
    encode_calibration,
)
from appliance.store import Instrument, LocalFileSystem, Rig, StorageError, load_calibration

Array = NDArray[np.float64]
Image = NDArray[np.uint8]

log = logging.getLogger(__name__)

FLAT_MM = 1e-6
"""Standard deviation of the shapes of a board that is known to be flat."""
EXCHANGED = (
    "left and right are exchanged: the camera called right stands to the left of the other; name the pictures the "
    "other way round "
    "(--sides) before anything is measured with them"
)
CHECKED_AT = (8, 16, 32)
"""Numbers of views after which a missing picture is asked for, since looking at all others takes longest."""
MOST_NAMED = 4
"""Most views that a warning names one by one."""
FRESH = Water(20.0, 0.0, 530.0)
"""A file names a water; no window and no water takes part here."""


@dataclass(frozen=True, slots=True, eq=False)
class Looked:
    """Boards found in pictures, and why in some there was none."""

    views: tuple[BoardView, ...]
    rejected: tuple[str, ...]
    remarks: Mapping[str, tuple[str, ...]]
    """Oddities of each view, by its name."""
    made_from: Mapping[str, str]
    """Each view with a checksum of its pixels."""

    def adjusted(self, size_px: tuple[int, int], tolerance: BoardTolerance, with_field: bool) -> AirCalibration:
        """Return the calibration that follows. Raises AirCalibrationError with every reason in it."""
        try:
            return calibrate_air(self.views, *size_px, tolerance, with_field)
        except AirCalibrationError as error:
            raise AirCalibrationError("; ".join((str(error), *self.rejected))) from error


def look_at(
    pairs: Sequence[Pair],
    read: Callable[[Pair], Mapping[str, Image]],
    design: BoardDesign,
    size_px: tuple[int, int],
    strict: bool,
    progress: Progress,
) -> Looked:
    """Find the board in the pictures that ``read`` gives by camera, as ``find_board`` does.

    Raises AirCalibrationError as soon as a picture is missing, and what ``read`` does.
    """
    views: list[BoardView] = []
    rejected: list[str] = []
    remarks, made_from = {}, {}
    for k, pair in enumerate(pairs):
        progress(f"looking at {pair.name}", k / len(pairs))
        images = read(pair)
        view, reasons = find_board(pair.name, images, design, strict)
        rejected += reasons
        if not len(view.corners_mm):
            continue
        views.append(view)
        spreads = {
            side: spread_of(view.sighting(side)[1], images[side].shape) for side in SIDES if view.has(side).any()
        }
        remarks[pair.name] = tuple(
            f"the board fills {100 * spread:.2g} % of the {side} picture"
            for side, spread in spreads.items()
            if spread < SMALL_SPREAD
        )
        digest = hashlib.sha256(b"".join(image.tobytes() for image in images.values())).hexdigest()
        made_from[pair.name] = f"board {pair.name}, pixels {digest[:16]}"
        if len(views) in CHECKED_AT:
            check_pairs(views, *size_px)
    return Looked(tuple(views), tuple(rejected), remarks, made_from)


def find_boards(folder: Path, design: BoardDesign, size_px: tuple[int, int], progress: Progress) -> Looked:
    """Look at every pair of the instrument's folder. Raises PicturesError, ScanError, AirCalibrationError."""

    def read(pair: Pair) -> Mapping[str, Image]:
        return dict(zip(SIDES, read_pair(pair, *size_px), strict=True))

    return look_at(pairs_of(folder), read, design, size_px, True, progress)


def calibrate_folder(
    rig: Rig, folder: Path, design: BoardDesign, out: Path, made_at: datetime, progress: Progress
) -> dict[str, Any]:
    """Calibrate in air from a folder, write ``out`` and beside it both pictures; what came out, JSON-ready.

    Raises PicturesError, ScanError, AirCalibrationError (with every reason in it), StorageError.
    """
    size_px = (rig.camera.left.width_px, rig.camera.left.height_px)
    looked = find_boards(folder, design, size_px, progress)
    progress("adjusting", 1.0)
    air = looked.adjusted(size_px, BoardTolerance(), with_field=True)
    made_from = (f"board {design}, bent by {air.shapes_mm[0]:.4f} mm", *(looked.made_from[v.name] for v in air.views))
    # Lenses and pose as measured, ports as the rig file draws them.
    start = replace(
        start_from_air(air, Instrument(rig).design(), made_from),
        made_at=made_at.astimezone(UTC).isoformat(timespec="seconds"),
        camera_serials=(rig.camera.left.serial, rig.camera.right.serial),
    )
    return _written(out, air, looked, design, start)


def calibrate_pictures(
    name: str,
    folder: Path,
    sides: tuple[str, str] | None,
    wanted: Wanted,
    flat: bool,
    out: Path,
    made_at: datetime,
    progress: Progress,
) -> dict[str, Any]:
    """Calibrate the cameras ``name`` from a folder, write ``out`` and what goes beside it; what came out, JSON-ready.

    ``sides``: as for ``named_pictures``. Raises PicturesError, AirCalibrationError (with every reason in it),
    StorageError.
    """
    pictures = named_pictures(folder, sides)
    every = [path for pair in pictures.pairs for path in (pair.left, pair.right) if path is not None]
    size_px, wrong = common_size(every)
    for reason in wrong.values():
        log.warning("not used: %s", reason)
    good = [path for path in every if path not in wrong]
    design = search_board([(path.name, partial(read_grey, path)) for path in good], wanted, progress)

    def read(pair: Pair) -> Mapping[str, Image]:
        both = zip(SIDES, (pair.left, pair.right), strict=True)
        return {side: read_grey(path) for side, path in both if path is not None and path not in wrong}

    looked = look_at(pictures.pairs, read, design, size_px, False, progress)
    looked = replace(looked, rejected=(*wrong.values(), *looked.rejected))
    progress("adjusting", 1.0)
    air = looked.adjusted(size_px, BoardTolerance(bow_mm=FLAT_MM) if flat else BoardTolerance(), with_field=False)
    symmetric = 0.5 * (air.covariance + air.covariance.T)
    start = Calibration(
        rig_serial=name,
        method=IN_AIR,
        made_at=made_at.astimezone(UTC).isoformat(timespec="seconds"),
        made_from=(f"board {design.described()}", *(looked.made_from[view.name] for view in air.views)),
        water=FRESH,
        rig=air.rig,
        residual_px=air.residual_px,
        air_covariance=tuple(tuple(float(v) for v in row) for row in symmetric),
    )
    written = _written(out, air, looked, design, start)
    LocalFileSystem().replace_file(out.with_suffix(".yml"), opencv_file(air.rig))
    return {
        **written,
        "opencv_file": str(out.with_suffix(".yml")),
        "told_by": pictures.told_by,
        "unnamed": [path for path in pictures.unnamed if path not in {Path(one).name for one in written["pictures"]}],
        "size_px": list(size_px),
    }


def _written(out: Path, air: AirCalibration, looked: Looked, design: BoardDesign, start: Calibration) -> dict[str, Any]:
    """Write ``out`` and beside it both pictures; return what came out."""
    size_px = air.rig.left.width_px, air.rig.left.height_px
    # Views that the adjustment left out do not count as coverage: that region is still missing.
    seen = coverage(air.used, *size_px)
    drawn = {
        out.with_name(f"{out.stem}-coverage.png"): coverage_picture(air.views, seen, *size_px),
        out.with_name(f"{out.stem}-residuals.png"): residual_picture(air.views, *size_px),
    }
    for path, data in (*drawn.items(), (out, encode_calibration(start))):
        LocalFileSystem().replace_file(path, data)
    return {
        "file": str(out),
        "hash": start.hash,
        "pictures": [str(path) for path in drawn],
        **_report(air, looked, design, seen),
    }


def opencv_file(rig: StereoRig) -> bytes:
    """Return the pair as OpenCV's programs read it (YAML): ``M1 D1 M2 D2``, and ``R``, ``T`` with x_right = R x_left +
    T, mm."""
    store = cv2.FileStorage("pair.yml", cv2.FILE_STORAGE_WRITE | cv2.FILE_STORAGE_MEMORY | cv2.FILE_STORAGE_FORMAT_YAML)
    store.write("image_width", rig.left.width_px)
    store.write("image_height", rig.left.height_px)
    for k, camera in enumerate((rig.left, rig.right), 1):
        (fu, fv), (cu, cv) = camera.lens.f_px, camera.lens.c_px
        store.write(f"M{k}", np.array([[fu, 0.0, cu], [0.0, fv, cv], [0.0, 0.0, 1.0]]))
        store.write(f"D{k}", np.array([camera.lens.distortion]))
    R, T = _opencv_pose(rig)
    store.write("R", R)
    store.write("T", T[:, None])
    return store.releaseAndGetString().encode()


def _opencv_pose(rig: StereoRig) -> tuple[Array, Array]:
    R = np.asarray(rig.right.rotation, np.float64).T
    return R, -R @ np.asarray(rig.right.translation_mm, np.float64)


def install(rig: Rig, file: Path) -> tuple[Path, Path | None]:
    """Make a calibration in air the instrument's: where it lies, and where the one before it now does.

    Raises CalibrationError for another instrument's, StorageError.
    """
    start = load_calibration(file)
    if start.method != IN_AIR or start.rig_serial != rig.rig.serial:
        raise CalibrationError(
            f"{file} is of instrument {start.rig_serial}, method {start.method}; wanted is one in air of "
            f"{rig.rig.serial}"
        )
    target = Instrument(rig).air_file
    before = None
    LocalFileSystem().make_folders(target.parent)
    if target.is_file():
        with StorageError.naming("cannot read", target):
            data = target.read_bytes()
        # Named by its content: the same file is kept once, however often it is installed.
        before = target.with_name(f"air-{hashlib.sha256(data).hexdigest()[:8]}.json")
        LocalFileSystem().replace_file(before, data)
    LocalFileSystem().replace_file(target, encode_calibration(start))
    return target, before


def _report(air: AirCalibration, looked: Looked, design: BoardDesign, seen: Coverage) -> dict[str, Any]:
    left, right = air.rig.left, air.rig.right
    sd = dict(zip(RIG_PARAMETERS.names[RIG_PARAMETERS.air], np.sqrt(np.diag(air.covariance)), strict=True))
    baseline = np.array(right.translation_mm)
    baseline_mm = float(np.linalg.norm(baseline))
    # Error of the length along the baseline alone: √(eᵀ Σ e), with its unit vector e.
    way, shifts = baseline / baseline_mm, slice(19, 22)
    R, T = _opencv_pose(air.rig)
    small = [view.name for view in air.views if looked.remarks[view.name]]
    warnings = [*([EXCHANGED] if air.exchanged else []), *(f"coverage is poor: {text}" for text in seen.missing)]
    if small:
        warnings.append(
            f"the board is small in {len(small)} of {len(air.views)} views "
            f"({', '.join(small[:MOST_NAMED])}{', …' if len(small) > MOST_NAMED else ''}): "
            f"below {100 * SMALL_SPREAD:g} % of the picture a view counts by the little that it tells; bring the board "
            "nearer"
        )
    return {
        "board": design.described(),
        "board_squares": [design.across, design.down],
        "square_mm": design.square_mm,
        "marker_mm": design.marker_mm,
        "dictionary_family": design.family,
        "legacy_layout": design.legacy,
        "board_shapes_mm": [float(v) for v in air.shapes_mm],
        "views": [_view_report(view, looked) for view in air.views],
        "pairs": list(air.pairs),
        "left_out": [*looked.rejected, *air.left_out],
        "warnings": warnings,
        "exchanged": air.exchanged,
        "residual_px": air.residual_px,
        "principal_distance_px": [left.lens.f_px[0], right.lens.f_px[0]],
        "principal_distance_sd_px": [float(sd[f"{side} principal distance (px)"]) for side in SIDES],
        "principal_point_px": [list(left.lens.c_px), list(right.lens.c_px)],
        "distortion": [list(left.lens.distortion), list(right.lens.distortion)],
        "rotation": R.tolist(),
        "translation_mm": T.tolist(),
        "baseline_mm": baseline_mm,
        "baseline_sd_mm": math.sqrt(float(way @ air.covariance[shifts, shifts] @ way)),
    }


def _view_report(view: FittedView, looked: Looked) -> dict[str, Any]:
    return {
        "name": view.name,
        "corners": [len(view.left_px), len(view.right_px)],
        "residual_px": view.residual_px,
        "noise_px": list(view.noise_px),
        "remarks": [*looked.remarks[view.name], *view.remarks],
    }
