"""Owns the calibration of anybody's pair of cameras from a folder of pictures: looking, adjusting, writing what came out.

Written are a calibration file as all are (``calibration.file``), the same for OpenCV (``M1 D1 M2 D2 R T``), and two pictures.
"""

from __future__ import annotations

import hashlib
import logging
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from appliance.calibrate.air.adjustment import AirCalibrationError, FittedView
from appliance.calibrate.air.any_board import (
    SMALL_SPREAD,
    FoundBoard,
    Wanted,
    find_corners_of,
    search_board,
    spread_of,
)
from appliance.calibrate.air.any_views import AnyCalibration, calibrate_any, check_pairs, view_of
from appliance.calibrate.air.board import NoBoard
from appliance.calibrate.air.coverage import Coverage, Sighting, covered
from appliance.calibrate.air.joint import BoardTolerance
from appliance.calibrate.air.linearised import BoardView
from appliance.calibrate.air.pictures import coverage_picture, residual_picture
from appliance.calibrate.any_pictures import AnyPair, NamedPictures, common_size, read_grey
from appliance.measure import AIR, IN_AIR, PARAMETER_NAMES, SIDES, Calibration, StereoRig, Water, encode_calibration
from appliance.store import LocalFileSystem, replace_file

Array = NDArray[np.float64]

log = logging.getLogger(__name__)

FLAT_MM = 1e-6
"""Standard deviation of the shapes of a board that is known to be flat."""
EXCHANGED = (
    "left and right are exchanged: the camera called right stands to the left of the other; name the pictures the other way round "
    "(--sides) before anything is measured with them"
)
CHECKED_AT = (8, 16, 32)
"""Numbers of views after which a missing picture is asked for, since looking at all others takes longest."""
MOST_NAMED = 4
"""Most views that a warning names one by one."""
FRESH = Water(20.0, 0.0, 530.0)
"""A file names a water; no window and no water takes part here."""


@dataclass(frozen=True, slots=True, eq=False)
class _Looked:
    views: tuple[BoardView, ...]
    rejected: tuple[str, ...]
    remarks: dict[str, tuple[str, ...]]
    made_from: dict[str, str]
    board_mm: Array


def calibrate_pictures(
    name: str,
    pictures: NamedPictures,
    wanted: Wanted,
    flat: bool,
    out: Path,
    made_at: datetime,
    progress: Callable[[str, float], None],
) -> dict[str, Any]:
    """Calibrate the cameras ``name`` from pictures, write ``out`` and what goes beside it; what came out, JSON-ready.

    Raises PicturesError, BoardNotFoundError, AirCalibrationError (with every reason in it), StorageError.
    """
    every = [path for pair in pictures.pairs for path in (pair.left, pair.right) if path is not None]
    size_px, wrong = common_size(every)
    for reason in wrong.values():
        log.warning("not used: %s", reason)
    good = [path for path in every if path not in wrong]
    board = search_board([(path.name, partial(read_grey, path)) for path in good], wanted, progress)
    looked = _look(pictures.pairs, board, wrong, size_px, progress)
    progress("adjusting", 1.0)
    tolerance = BoardTolerance(bow_mm=FLAT_MM) if flat else BoardTolerance()
    try:
        found = calibrate_any(looked.views, *size_px, tolerance)
    except AirCalibrationError as error:
        raise AirCalibrationError("; ".join((str(error), *looked.rejected))) from error
    seen = _coverage(found, looked, size_px)
    start = _calibration(name, found, board, looked, made_at)
    paths = {kind: out.with_name(f"{out.stem}-{kind}.png") for kind in ("coverage", "residuals")}
    views = found.air.views
    for path, data in (
        (paths["coverage"], coverage_picture(views, seen, *size_px)),
        (paths["residuals"], residual_picture(views, *size_px)),
        (out.with_suffix(".yml"), opencv_file(found.air.rig)),
        (out, encode_calibration(start)),
    ):
        replace_file(LocalFileSystem(), path, data)
    return {
        "file": str(out),
        "opencv_file": str(out.with_suffix(".yml")),
        "pictures": [str(path) for path in paths.values()],
        "told_by": pictures.told_by,
        "unnamed": [path for path in pictures.unnamed if path not in {p.name for p in paths.values()}],
        "size_px": list(size_px),
        "hash": start.hash,
        **_board_report(board, found),
        **_report(found, looked, seen),
    }


def opencv_file(rig: StereoRig) -> bytes:
    """Return the pair as OpenCV's programs read it (YAML): ``M1 D1 M2 D2``, and ``R``, ``T`` with x_right = R x_left + T, mm."""
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


def _look(
    pairs: Sequence[AnyPair],
    board: FoundBoard,
    wrong: dict[Path, str],
    size_px: tuple[int, int],
    progress: Callable[[str, float], None],
) -> _Looked:
    """Find the board in every picture that is not ``wrong``. Raises AirCalibrationError as soon as a picture is missing."""
    board_mm = np.asarray(board.design.pattern().getChessboardCorners(), np.float64)
    views, rejected, remarks, made_from = [], list(wrong.values()), {}, {}
    for k, pair in enumerate(pairs):
        progress(f"looking at {pair.name}", k / len(pairs))
        seen: dict[str, dict[int, Array]] = {}
        digest = hashlib.sha256()
        small = []
        for side, path in (("left", pair.left), ("right", pair.right)):
            if path is None or path in wrong:
                continue
            image = read_grey(path)
            digest.update(image.tobytes())
            found = find_corners_of(image, board)
            if isinstance(found, NoBoard):
                rejected.append(f"{pair.name}: {found.reason.format(side=side)}")
                continue
            seen[side] = found
            spread = spread_of(np.stack(list(found.values())), image.shape)
            if spread < SMALL_SPREAD:
                small.append(f"the board fills {100 * spread:.2g} % of the {side} picture")
        view = view_of(pair.name, board_mm, seen.get("left"), seen.get("right"))
        if len(view.corners_mm):
            views.append(view)
            remarks[pair.name] = tuple(small)
            made_from[pair.name] = f"board {pair.name}, pixels {digest.hexdigest()[:16]}"
            if len(views) in CHECKED_AT:
                check_pairs(views, *size_px)
    return _Looked(tuple(views), tuple(rejected), remarks, made_from, board_mm)


def _coverage(found: AnyCalibration, looked: _Looked, size_px: tuple[int, int]) -> Coverage:
    """Return what the views used cover; a lean counts whichever camera saw it."""
    by_place = {}
    for view in looked.views:
        for side, px in (("left", view.left_px), ("right", view.right_px)):
            by_place[view.name, side] = {tuple(uv): mm for uv, mm in zip(px.tolist(), view.corners_mm, strict=True)}
    sightings: dict[str, list[Sighting]] = {side: [] for side in SIDES}
    leant = []
    for used in found.air.views:
        for side, px in (("left", used.left_px), ("right", used.right_px)):
            if len(px):
                known = by_place[used.name, side]
                sightings[side].append((np.stack([known[tuple(uv)] for uv in px.tolist()]), px))
        leant.append(sightings["left" if len(used.left_px) else "right"][-1])
    return covered(sightings["left"], sightings["right"], leant, *size_px)


def _calibration(
    name: str, found: AnyCalibration, board: FoundBoard, looked: _Looked, made_at: datetime
) -> Calibration:
    air = found.air
    symmetric = 0.5 * (air.covariance + air.covariance.T)
    return Calibration(
        rig_serial=name,
        method=IN_AIR,
        made_at=made_at.astimezone(UTC).isoformat(timespec="seconds"),
        made_from=(f"board {board}", *(looked.made_from[view.name] for view in air.views)),
        water=FRESH,
        rig=air.rig,
        residual_px=air.residual_px,
        air_covariance=tuple(tuple(float(v) for v in row) for row in symmetric),
    )


def _board_report(board: FoundBoard, found: AnyCalibration) -> dict[str, Any]:
    design = board.design
    return {
        "board": str(board),
        "board_squares": [design.across, design.down],
        "square_mm": design.square_mm,
        "marker_mm": design.marker_mm,
        "dictionary_family": board.family,
        "legacy_layout": design.legacy,
        "board_shapes_mm": [float(v) for v in found.shapes_mm],
    }


def _report(found: AnyCalibration, looked: _Looked, seen: Coverage) -> dict[str, Any]:
    air = found.air
    left, right = air.rig.left, air.rig.right
    sd = dict(zip(PARAMETER_NAMES[AIR], np.sqrt(np.diag(air.covariance)), strict=True))
    baseline = np.array(right.translation_mm)
    baseline_mm = float(np.linalg.norm(baseline))
    # Error of the length along the baseline alone: √(eᵀ Σ e), with its unit vector e.
    way, shifts = baseline / baseline_mm, slice(19, 22)
    R, T = _opencv_pose(air.rig)
    warnings = [f"coverage is poor: {text}" for text in seen.missing]
    small = [view.name for view in air.views if looked.remarks[view.name]]
    if small:
        warnings.append(
            f"the board is small in {len(small)} of {len(air.views)} views ({', '.join(small[:MOST_NAMED])}{', …' if len(small) > MOST_NAMED else ''}): "
            f"below {100 * SMALL_SPREAD:g} % of the picture a view counts by the little that it tells; bring the board nearer"
        )
    if found.exchanged:
        warnings.insert(0, EXCHANGED)
    return {
        "views": [_view_report(view, found, looked) for view in air.views],
        "pairs": list(found.pairs),
        "left_out": [*looked.rejected, *air.left_out],
        "warnings": warnings,
        "exchanged": found.exchanged,
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


def _view_report(view: FittedView, found: AnyCalibration, looked: _Looked) -> dict[str, Any]:
    return {
        "name": view.name,
        "corners": [len(view.left_px), len(view.right_px)],
        "residual_px": view.residual_px,
        "noise_px": list(found.noise_px[view.name]),
        "remarks": [*looked.remarks[view.name], *view.remarks],
    }
