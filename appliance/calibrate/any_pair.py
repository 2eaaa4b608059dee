"""Owns the calibration of anybody's pair of cameras from a folder of pictures: looking, adjusting, writing what came out.

Written are a calibration file as all are (``calibration.file``), the same for OpenCV (``M1 D1 M2 D2 R T``), and two pictures.

It also owns which of somebody's pictures are the left camera's and which the right one's, and how any picture becomes grey values.

Files are told apart by a word in their names or in those of their folders (``left``, ``R``, ``cam1``, …), or by two patterns. What is
left of a name without that word says which pictures belong together.
"""

from __future__ import annotations

import hashlib
import logging
import math
import re
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from appliance.base import read_bounded
from appliance.calibrate.air.adjustment import BoardTolerance
from appliance.calibrate.air.any_board import SMALL_SPREAD, FoundBoard, Wanted, find_corners_of, search_board, spread_of
from appliance.calibrate.air.board import NoBoard
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
from appliance.calibrate.in_air import KINDS, PicturesError, quiet_decoder
from appliance.measure import (
    AIR,
    FULL_DN,
    IN_AIR,
    PARAMETER_NAMES,
    SIDES,
    Calibration,
    StereoRig,
    Water,
    encode_calibration,
)
from appliance.store import KNOWN, LocalFileSystem, refused, replace_file, size_px

Image = NDArray[np.uint8]

ANY_KINDS = (*KINDS, ".jpg", ".jpeg", ".ppm")
WORDS = (
    ("left", "right"),
    ("cam0", "cam1"),
    ("cam1", "cam2"),
    ("camera0", "camera1"),
    ("camera1", "camera2"),
    ("cam_0", "cam_1"),
    ("cam_1", "cam_2"),
    ("image_0", "image_1"),
    ("camleft", "camright"),
    ("caml", "camr"),
    ("links", "rechts"),
    ("gauche", "droite"),
    ("l", "r"),
)
"""Words that tell left from right, likely ones first; capitals count as small letters."""
MOST_BYTES, MOST_PIXELS = 1 << 29, 200_000_000
"""Largest file and picture that are read."""
LEAST_SIDE_PX, MOST_SIDE_PX = 64, 16384
WHITE_PERCENTILE = 99.9
"""Percentile that becomes white in a picture of more than 8 bits, whatever part of its range is used."""


@dataclass(frozen=True, slots=True)
class AnyPair:
    """Pictures of one board that were taken together; ``None`` where a camera has none."""

    name: str
    left: Path | None
    right: Path | None


@dataclass(frozen=True, slots=True)
class Patterns:
    """Patterns of paths in the folder with one ``*`` each, which stands for what both pictures of a pair share."""

    left: str
    right: str


@dataclass(frozen=True, slots=True)
class NamedPictures:
    """The pictures of a folder, told apart."""

    pairs: tuple[AnyPair, ...]
    told_by: str
    """Words or patterns that told left from right, in a phrase."""
    unnamed: tuple[str, ...]
    """Pictures of which nothing says which camera took them."""


def named_pictures(folder: Path, patterns: Patterns | None) -> NamedPictures:
    """Return the pictures in a folder and in the folders in it, told apart. Raises PicturesError."""
    if not folder.is_dir():
        raise PicturesError(f"FOLDER {folder}: no such folder; give the one that holds the pictures of the board")
    with refused("cannot read", folder):
        found = sorted(
            p for p in (*folder.glob("*"), *folder.glob("*/*")) if p.suffix.lower() in ANY_KINDS and p.is_file()
        )
    names = {p.relative_to(folder).as_posix(): p for p in found if not p.name.startswith(".")}
    if not names:
        raise PicturesError(f"FOLDER {folder}: no pictures in it; read are {', '.join(ANY_KINDS)}")
    if patterns is not None:
        sides = _by_patterns(names, patterns)
        told = f"--sides {patterns.left},{patterns.right}"
    else:
        # The words that make most pairs: a name may have several ("l" and "left", or "cam1" of both numberings).
        sides, words = max(((_by_words(names, w), w) for w in WORDS), key=lambda one: _complete(one[0]))
        told = f"{words[0]} and {words[1]} in their names"
    if not _complete(sides):
        listed = ", ".join(list(names)[:4])
        raise PicturesError(
            f"FOLDER {folder}: no name of a picture ({listed}, …) tells a left picture from the right one of its pair; say how with "
            "--sides LEFT,RIGHT, for example --sides 'a/*.png,b/*.png'"
        )
    pairs: dict[str, dict[str, Path]] = {}
    for name, (side, key) in sides.items():
        both = pairs.setdefault(key, {})
        if side in both:
            raise PicturesError(
                f"FOLDER {folder}: {both[side].name} and {names[name].name} are both the {side} picture of {key}"
            )
        both[side] = names[name]
    called = _called(pairs)
    return NamedPictures(
        tuple(
            AnyPair(called[key], both.get("left"), both.get("right"))
            for key, both in ((key, pairs[key]) for key in sorted(pairs, key=_order))
        ),
        told,
        tuple(name for name in names if name not in sides),
    )


def common_size(pictures: Iterable[Path]) -> tuple[tuple[int, int], dict[Path, str]]:
    """Return the width and height that most pictures have, and of each other picture why it is not used: another size, or damage, since
    each is decoded once. Raises PicturesError."""
    sizes: dict[Path, tuple[int, int]] = {}
    wrong: dict[Path, str] = {}
    for path in pictures:
        data = _bytes(path)
        stated = size_px(data)
        if stated is None:
            wrong[path] = f"{path}: is no picture, or damaged ({KNOWN} is read); bring it back from a copy"
        elif not (
            min(stated) >= LEAST_SIDE_PX and max(stated) <= MOST_SIDE_PX and stated[0] * stated[1] <= MOST_PIXELS
        ):
            wrong[path] = (
                f"{path.name}: {stated[0]}x{stated[1]} px; {LEAST_SIDE_PX} to {MOST_SIDE_PX} px a side are read"
            )
        elif _decoded(data) is None:
            wrong[path] = f"{path}: is damaged and cannot be decoded; bring it back from a copy"
        else:
            sizes[path] = stated
    if not sizes:
        raise PicturesError(next(iter(wrong.values())))
    usual = Counter(sizes.values()).most_common(1)[0][0]
    for path, size in sizes.items():
        if size != usual:
            wrong[path] = f"{path.name}: {size[0]}x{size[1]} px, the other pictures have {usual[0]}x{usual[1]} px"
    return usual, wrong


def read_grey(path: Path) -> Image:
    """Return a picture (h, w) uint8: colours become grey, more than 8 bits become 8. Raises PicturesError, StorageError."""
    image = _decoded(_bytes(path))
    if image is None:
        raise PicturesError(f"{path}: is no picture, or damaged; bring it back from a copy")
    if image.ndim == 3:
        image = cv2.cvtColor(image, cv2.COLOR_BGRA2GRAY if image.shape[2] == 4 else cv2.COLOR_BGR2GRAY)
    if image.dtype != np.uint8:
        white = float(np.percentile(image, WHITE_PERCENTILE))
        image = np.clip(image * (FULL_DN / max(white, 1e-9)), 0, FULL_DN)
    return np.ascontiguousarray(np.rint(image), np.uint8)


def _decoded(data: bytes) -> NDArray[Any] | None:
    """Return the picture that a file's bytes hold, as it is stored; ``None`` where it cannot be decoded."""
    with quiet_decoder():
        try:
            return cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
        except cv2.error:
            return None


def _bytes(path: Path) -> bytes:
    try:
        return read_bounded(path, MOST_BYTES)
    except OSError as error:
        raise PicturesError(f"{path}: {error.strerror or error}; give the pictures as recorded") from error


# ------------------------------------------------------------------------------------------ names

_Sides = dict[str, tuple[str, str]]
"""Map from a path to its side, and to what is left of the path without what says so."""


def _by_words(names: Iterable[str], words: tuple[str, str]) -> _Sides:
    found: _Sides = {}
    for name in names:
        stem = str(Path(name).with_suffix("")).lower()
        # A word ends where its kind of character ends: 01L and left01 say it, label01 and cam10 do not.
        end = "[0-9]" if words[0][-1].isdigit() else "[a-z]"
        keys = [re.sub(rf"(?<![a-z]){word}(?!{end})", "*", stem) for word in words]
        hits = [(side, key) for side, key in zip(("left", "right"), keys, strict=True) if key != stem]
        if len(hits) == 1:
            found[name] = hits[0]
    return found


def _by_patterns(names: Iterable[str], patterns: Patterns) -> _Sides:
    found: _Sides = {}
    for side, pattern in (("left", patterns.left), ("right", patterns.right)):
        if pattern.count("*") != 1:
            raise PicturesError(
                f"--sides {patterns.left},{patterns.right}: each has one *, which stands for what both pictures of a pair share"
            )
        before, after = pattern.split("*")
        for name in names:
            shared = re.fullmatch(re.escape(before) + "(.+)" + re.escape(after), name)
            if shared is not None:
                if name in found:
                    raise PicturesError(f"{name} fits both sides of --sides {patterns.left},{patterns.right}")
                found[name] = (side, shared[1])
    return found


def _complete(sides: _Sides) -> int:
    both = Counter(key for _, key in set(sides.values()))
    return sum(count == 2 for count in both.values())


def _called(keys: Iterable[str]) -> Mapping[str, str]:
    """Return a short name for each key; the key itself where names would be the same."""
    short = {key: re.sub(r"^[\W_]+|[\W_]+$", "", key.replace("*", "")) or key for key in keys}
    twice = {name for name, count in Counter(short.values()).items() if count > 1}
    return {key: key if name in twice else name for key, name in short.items()}


def _order(key: str) -> list[tuple[int, str]]:
    """Return what sorts numbers in names by their value: v2 before v12."""
    return [(int(part), "") if part.isdigit() else (-1, part) for part in re.split(r"(\d+)", key)]


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
        found = calibrate_air(looked.views, *size_px, tolerance, with_field=False)
    except AirCalibrationError as error:
        raise AirCalibrationError("; ".join((str(error), *looked.rejected))) from error
    seen = coverage(found.used, *size_px)
    start = _calibration(name, found, board, looked, made_at)
    paths = {kind: out.with_name(f"{out.stem}-{kind}.png") for kind in ("coverage", "residuals")}
    views = found.views
    for path, data in (
        (paths["coverage"], coverage_picture(views, seen, *size_px)),
        (paths["residuals"], residual_picture(views, *size_px)),
        (out.with_suffix(".yml"), opencv_file(found.rig)),
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
        view = BoardView.of(pair.name, board_mm, seen.get("left"), seen.get("right"))
        if len(view.corners_mm):
            views.append(view)
            remarks[pair.name] = tuple(small)
            made_from[pair.name] = f"board {pair.name}, pixels {digest.hexdigest()[:16]}"
            if len(views) in CHECKED_AT:
                check_pairs(views, *size_px)
    return _Looked(tuple(views), tuple(rejected), remarks, made_from, board_mm)


def _calibration(
    name: str, found: AirCalibration, board: FoundBoard, looked: _Looked, made_at: datetime
) -> Calibration:
    symmetric = 0.5 * (found.covariance + found.covariance.T)
    return Calibration(
        rig_serial=name,
        method=IN_AIR,
        made_at=made_at.astimezone(UTC).isoformat(timespec="seconds"),
        made_from=(f"board {board}", *(looked.made_from[view.name] for view in found.views)),
        water=FRESH,
        rig=found.rig,
        residual_px=found.residual_px,
        air_covariance=tuple(tuple(float(v) for v in row) for row in symmetric),
    )


def _board_report(board: FoundBoard, found: AirCalibration) -> dict[str, Any]:
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


def _report(found: AirCalibration, looked: _Looked, seen: Coverage) -> dict[str, Any]:
    left, right = found.rig.left, found.rig.right
    sd = dict(zip(PARAMETER_NAMES[AIR], np.sqrt(np.diag(found.covariance)), strict=True))
    baseline = np.array(right.translation_mm)
    baseline_mm = float(np.linalg.norm(baseline))
    # Error of the length along the baseline alone: √(eᵀ Σ e), with its unit vector e.
    way, shifts = baseline / baseline_mm, slice(19, 22)
    R, T = _opencv_pose(found.rig)
    warnings = [f"coverage is poor: {text}" for text in seen.missing]
    small = [view.name for view in found.views if looked.remarks[view.name]]
    if small:
        warnings.append(
            f"the board is small in {len(small)} of {len(found.views)} views ({', '.join(small[:MOST_NAMED])}{', …' if len(small) > MOST_NAMED else ''}): "
            f"below {100 * SMALL_SPREAD:g} % of the picture a view counts by the little that it tells; bring the board nearer"
        )
    if found.exchanged:
        warnings.insert(0, EXCHANGED)
    return {
        "views": [_view_report(view, looked) for view in found.views],
        "pairs": list(found.pairs),
        "left_out": [*looked.rejected, *found.left_out],
        "warnings": warnings,
        "exchanged": found.exchanged,
        "residual_px": found.residual_px,
        "principal_distance_px": [left.lens.f_px[0], right.lens.f_px[0]],
        "principal_distance_sd_px": [float(sd[f"{side} principal distance (px)"]) for side in SIDES],
        "principal_point_px": [list(left.lens.c_px), list(right.lens.c_px)],
        "distortion": [list(left.lens.distortion), list(right.lens.distortion)],
        "rotation": R.tolist(),
        "translation_mm": T.tolist(),
        "baseline_mm": baseline_mm,
        "baseline_sd_mm": math.sqrt(float(way @ found.covariance[shifts, shifts] @ way)),
    }


def _view_report(view: FittedView, looked: _Looked) -> dict[str, Any]:
    return {
        "name": view.name,
        "corners": [len(view.left_px), len(view.right_px)],
        "residual_px": view.residual_px,
        "noise_px": list(view.noise_px),
        "remarks": [*looked.remarks[view.name], *view.remarks],
    }
