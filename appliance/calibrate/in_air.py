"""Calibration in air from a folder of pictures: find the boards, adjust, write the result.

For the instrument's cameras the result is a start for calibrating in water. For any other stereo pair it is a
calibration file as all are (``calibration.file``), and one for OpenCV (``M1 D1 M2 D2 R T``). Two pictures lie beside
either.
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
from appliance.calibrate.air.any_board import BoardDescription, search_board
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
"""Standard deviation of the shapes of a board that is stated to be flat."""
EXCHANGED = (
    "left and right are exchanged: the right camera stands to the left of the other; exchange the names of "
    "the images, or the patterns of --sides"
)
CHECKED_AT = (8, 16, 32)
"""Numbers of views after which missing pictures are searched for, because finding all boards takes longest."""
MOST_NAMED = 4
"""Largest number of views that a warning names."""
FRESH = Water(20.0, 0.0, 530.0)
"""Stated because a file needs a water; a calibration in air has neither ports nor water."""


@dataclass(frozen=True, slots=True, eq=False)
class BoardSearch:
    """Boards in a folder of pictures, and why some pictures have none."""

    views: tuple[BoardView, ...]
    rejected: tuple[str, ...]
    remarks: Mapping[str, tuple[str, ...]]
    """Remarks on each view, by its name."""
    made_from: Mapping[str, str]
    """Description of each view with a hash of its pixels, by its name."""

    def adjusted(self, size_px: tuple[int, int], tolerance: BoardTolerance, with_field: bool) -> AirCalibration:
        """Return the air calibration by these views.

        Raises AirCalibrationError with the reasons of all rejected views.
        """
        try:
            return calibrate_air(self.views, *size_px, tolerance, with_field)
        except AirCalibrationError as error:
            raise AirCalibrationError("; ".join((str(error), *self.rejected))) from error


def find_views(
    pairs: Sequence[Pair],
    read: Callable[[Pair], Mapping[str, Image]],
    design: BoardDesign,
    size_px: tuple[int, int],
    strict: bool,
    progress: Progress,
) -> BoardSearch:
    """Find the board in the pictures of each pair, which ``read`` returns by camera, as ``find_board`` does.

    Raises AirCalibrationError as soon as a picture is missing, and the errors of ``read``.
    """
    views: list[BoardView] = []
    rejected: list[str] = []
    remarks, made_from = {}, {}
    for k, pair in enumerate(pairs):
        progress(f"detecting the board in {pair.name}", k / len(pairs))
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
            f"the board fills {100 * spread:.2g} % of the {side} image"
            for side, spread in spreads.items()
            if spread < SMALL_SPREAD
        )
        digest = hashlib.sha256(b"".join(image.tobytes() for image in images.values())).hexdigest()
        made_from[pair.name] = f"board {pair.name}, pixels {digest[:16]}"
        if len(views) in CHECKED_AT:
            check_pairs(views, *size_px)
    return BoardSearch(tuple(views), tuple(rejected), remarks, made_from)


def find_boards(folder: Path, design: BoardDesign, size_px: tuple[int, int], progress: Progress) -> BoardSearch:
    """Find the board in every pair of the instrument's folder.

    Raises PicturesError, ScanError, AirCalibrationError.
    """

    def read(pair: Pair) -> Mapping[str, Image]:
        return dict(zip(SIDES, read_pair(pair, *size_px), strict=True))

    return find_views(pairs_of(folder), read, design, size_px, True, progress)


def calibrate_folder(
    rig: Rig, folder: Path, design: BoardDesign, out: Path, made_at: datetime, progress: Progress
) -> dict[str, Any]:
    """Calibrate in air from a folder, write ``out`` and both pictures, and return the result, JSON-ready.

    Raises PicturesError, ScanError, AirCalibrationError (with all reasons), StorageError.
    """
    size_px = (rig.camera.left.width_px, rig.camera.left.height_px)
    search = find_boards(folder, design, size_px, progress)
    progress("adjusting", 1.0)
    air = search.adjusted(size_px, BoardTolerance(), with_field=True)
    made_from = (f"board {design}, bent by {air.shapes_mm[0]:.4f} mm", *(search.made_from[v.name] for v in air.views))
    # Lenses and pose as measured, ports as nominal in the rig file.
    start = replace(
        start_from_air(air, Instrument(rig).design(), made_from),
        made_at=made_at.astimezone(UTC).isoformat(timespec="seconds"),
        camera_serials=(rig.camera.left.serial, rig.camera.right.serial),
    )
    return _write_files(out, air, search, design, start)


def calibrate_pictures(
    name: str,
    folder: Path,
    sides: tuple[str, str] | None,
    description: BoardDescription,
    flat: bool,
    out: Path,
    made_at: datetime,
    progress: Progress,
) -> dict[str, Any]:
    """Calibrate the cameras ``name`` from a folder, write ``out`` and more, and return the result, JSON-ready.

    ``sides``: as for ``named_pictures``. The OpenCV file and both pictures lie beside ``out``. Raises PicturesError,
    AirCalibrationError (with all reasons), StorageError.
    """
    pictures = named_pictures(folder, sides)
    paths = [path for pair in pictures.pairs for path in (pair.left, pair.right) if path is not None]
    size_px, unusable = common_size(paths)
    for reason in unusable.values():
        log.warning("not used: %s", reason)
    usable = [path for path in paths if path not in unusable]
    design = search_board([(path.name, partial(read_grey, path)) for path in usable], description, progress)

    def read(pair: Pair) -> Mapping[str, Image]:
        sources = zip(SIDES, (pair.left, pair.right), strict=True)
        return {side: read_grey(path) for side, path in sources if path is not None and path not in unusable}

    search = find_views(pictures.pairs, read, design, size_px, False, progress)
    search = replace(search, rejected=(*unusable.values(), *search.rejected))
    progress("adjusting", 1.0)
    air = search.adjusted(size_px, BoardTolerance(bow_mm=FLAT_MM) if flat else BoardTolerance(), with_field=False)
    symmetric = 0.5 * (air.covariance + air.covariance.T)
    start = Calibration(
        rig_serial=name,
        method=IN_AIR,
        made_at=made_at.astimezone(UTC).isoformat(timespec="seconds"),
        made_from=(f"board {design.described()}", *(search.made_from[view.name] for view in air.views)),
        water=FRESH,
        rig=air.rig,
        residual_px=air.residual_px,
        air_covariance=tuple(tuple(float(v) for v in row) for row in symmetric),
    )
    written = _write_files(out, air, search, design, start)
    LocalFileSystem().replace_file(out.with_suffix(".yml"), opencv_file(air.rig))
    return {
        **written,
        "opencv_file": str(out.with_suffix(".yml")),
        "told_by": pictures.naming,
        "unnamed": [
            path
            for path in pictures.unnamed
            if path not in {Path(written_path).name for written_path in written["pictures"]}
        ],
        "size_px": list(size_px),
    }


def _write_files(
    out: Path, air: AirCalibration, search: BoardSearch, design: BoardDesign, start: Calibration
) -> dict[str, Any]:
    """Write ``out`` and both pictures beside it; return the result, JSON-ready."""
    size_px = air.rig.left.width_px, air.rig.left.height_px
    # Views that the adjustment left out do not count: their region is still missing.
    covered = coverage(air.used, *size_px)
    drawings = {
        out.with_name(f"{out.stem}-coverage.png"): coverage_picture(air.views, covered, *size_px),
        out.with_name(f"{out.stem}-residuals.png"): residual_picture(air.views, *size_px),
    }
    for path, data in (*drawings.items(), (out, encode_calibration(start))):
        LocalFileSystem().replace_file(path, data)
    return {
        "file": str(out),
        "hash": start.hash,
        "pictures": [str(path) for path in drawings],
        **_report(air, search, design, covered),
    }


def opencv_file(rig: StereoRig) -> bytes:
    """Return the stereo pair as OpenCV's programs read it (YAML): ``M1 D1 M2 D2``, and ``R``, ``T``.

    x_right = R x_left + T, in mm.
    """
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
    """Put an air calibration in use, and return its path and that of the former one, ``None`` without one.

    Raises CalibrationError for one of another instrument, StorageError.
    """
    start = load_calibration(file)
    if start.method != IN_AIR or start.rig_serial != rig.rig.serial:
        raise CalibrationError(
            f"{file} is of instrument {start.rig_serial}, method {start.method}; allowed are air calibrations of "
            f"{rig.rig.serial}"
        )
    target = Instrument(rig).air_file
    before = None
    LocalFileSystem().make_folders(target.parent)
    if target.is_file():
        with StorageError.naming("cannot read", target):
            data = target.read_bytes()
        # Named by its content, so that the same file is kept once however often it is installed.
        before = target.with_name(f"air-{hashlib.sha256(data).hexdigest()[:8]}.json")
        LocalFileSystem().replace_file(before, data)
    LocalFileSystem().replace_file(target, encode_calibration(start))
    return target, before


def _report(air: AirCalibration, search: BoardSearch, design: BoardDesign, covered: Coverage) -> dict[str, Any]:
    left, right = air.rig.left, air.rig.right
    sd = dict(zip(RIG_PARAMETERS.names[RIG_PARAMETERS.air], np.sqrt(np.diag(air.covariance)), strict=True))
    baseline = np.array(right.translation_mm)
    baseline_mm = float(np.linalg.norm(baseline))
    # Error of the length along the baseline alone: √(eᵀ Σ e), with its unit vector e.
    unit_vector, shifts = baseline / baseline_mm, slice(19, 22)
    R, T = _opencv_pose(air.rig)
    small_views = [view.name for view in air.views if search.remarks[view.name]]
    warnings = [*([EXCHANGED] if air.exchanged else []), *(f"coverage is poor: {text}" for text in covered.missing)]
    if small_views:
        warnings.append(
            f"the board is small in {len(small_views)} of {len(air.views)} views "
            f"({', '.join(small_views[:MOST_NAMED])}{', …' if len(small_views) > MOST_NAMED else ''}): "
            f"below {100 * SMALL_SPREAD:g} % of the image a view has a small weight; bring the board nearer"
        )
    return {
        "board": design.described(),
        "board_squares": [design.across, design.down],
        "square_mm": design.square_mm,
        "marker_mm": design.marker_mm,
        "dictionary_family": design.family,
        "legacy_layout": design.legacy,
        "board_shapes_mm": [float(v) for v in air.shapes_mm],
        "views": [_view_report(view, search) for view in air.views],
        "pairs": list(air.pairs),
        "left_out": [*search.rejected, *air.left_out],
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
        "baseline_sd_mm": math.sqrt(float(unit_vector @ air.covariance[shifts, shifts] @ unit_vector)),
    }


def _view_report(view: FittedView, search: BoardSearch) -> dict[str, Any]:
    return {
        "name": view.name,
        "corners": [len(view.left_px), len(view.right_px)],
        "residual_px": view.residual_px,
        "noise_px": list(view.noise_px),
        "remarks": [*search.remarks[view.name], *view.remarks],
    }
