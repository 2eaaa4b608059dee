"""Owns the calibration in air from a folder of pictures: reading them, judging them, writing what came out.

The folder holds pairs ``NAME_left.png`` and ``NAME_right.png`` (8 bit, grey; also tif, bmp, pgm), or folders: of scans,
whose bright frames are taken, or ``NAME/left.png`` and ``NAME/right.png`` (``view_folder``). ``docs/calibration.md`` says how to record them.

It also owns a folder of views of a board while it is being filled: each view durable and whole, or not there.

board.json      which board, which instrument
01/left.png     a view; its folder gets its name when both pictures are on the disk
01/right.png
"""

from __future__ import annotations

import hashlib
import math
import re
import shutil
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from appliance.base import ContentError, SealedFile, read_bounded
from appliance.calibrate.air.board import BoardDesign, NoBoard, find_board, parse_board
from appliance.calibrate.air.calibrate import AirCalibration, AirCalibrationError, calibrate_air
from appliance.calibrate.air.coverage import Coverage, coverage
from appliance.calibrate.air.linearised import BoardView
from appliance.calibrate.air.pictures import coverage_picture, residual_picture
from appliance.calibrate.water.start import start_from_air
from appliance.measure import (
    AIR,
    IN_AIR,
    PARAMETER_NAMES,
    SIDES,
    Calibration,
    CalibrationError,
    build_sequence,
    encode_calibration,
)
from appliance.store import (
    KNOWN,
    MANIFEST_FILE,
    Instrument,
    LocalFileSystem,
    Rig,
    load_calibration,
    load_scan,
    make_folders,
    move_folder,
    refused,
    replace_file,
    size_px,
    write_new,
)

Image = NDArray[np.uint8]

SESSION = "board.json"
LEFT, RIGHT = "left.png", "right.png"


@dataclass(frozen=True, slots=True)
class _Begun:
    """Content of ``board.json``."""

    rig_serial: str
    board: str


BEGUN = SealedFile(
    _Begun, schema=1, max_bytes=64 * 1024, indent=1, checksum=False, check=lambda begun: parse_board(begun.board),
    remedy="restore it, or remove it and give --board",
)  # fmt: skip


class ViewFolder:
    """A folder for views of one board by one instrument."""

    def __init__(self, folder: Path, rig_serial: str, design: BoardDesign | None) -> None:
        """Make the folder, or go on with one. ``design`` ``None``: the folder's, else the usual board.

        Raises ContentError for a folder of another board or instrument, StorageError.
        """
        self.folder = folder
        self._fs = LocalFileSystem()
        make_folders(self._fs, folder)
        begun = read_session(folder)
        if begun is None:
            self.design = design or BoardDesign()
            replace_file(self._fs, folder / SESSION, BEGUN.encode(_Begun(rig_serial, str(self.design))))
        else:
            serial, self.design = begun
            if serial != rig_serial:
                raise ContentError(
                    f"FOLDER {folder}", f"views of instrument {serial}; this one is {rig_serial}", remedy="give another"
                )
            if design is not None and design != self.design:
                raise ContentError(
                    f"FOLDER {folder}", f"views of board {self.design}, not {design}", remedy="give another folder"
                )
        self._tidy()

    def next_name(self) -> str:
        """Return the number of the next view: numbers only grow."""
        # The number after the largest, not the first free one: a view that somebody took away must not come back as
        # another.
        numbers = [int(path.name) for path in self.folder.iterdir() if re.fullmatch(r"\d{2,6}", path.name)]
        return f"{max(numbers, default=0) + 1:02}"

    def save(self, name: str, left: Image, right: Image) -> None:
        """Write a view; durable on return. Raises StorageError, and nothing of it is then there under ``name``."""
        # Both pictures in a hidden folder first: a folder with a number has them both.
        draft = self.folder / f".{name}"
        with refused("cannot make", draft):
            self._fs.make_folder(draft)
        for file, image in ((LEFT, left), (RIGHT, right)):
            done, data = cv2.imencode(".png", image)
            if not done:
                raise ValueError(f"a picture of {image.shape} could not be encoded as PNG")
            write_new(self._fs, draft / file, [bytes(data)])
        move_folder(self._fs, draft, self.folder / name)

    def _tidy(self) -> None:
        """Take away what a loss of power left of a view that was never there."""
        for path in self.folder.iterdir():
            if re.fullmatch(r"\.\d{2,6}", path.name) and path.is_dir():
                with refused("cannot remove the unfinished", path):
                    shutil.rmtree(path)


def read_session(folder: Path) -> tuple[str, BoardDesign] | None:
    """Return instrument and board of a folder that ``--live`` filled; ``None`` for any other. Raises ContentError."""
    path = folder / SESSION
    begun = BEGUN.load(path, name=str(path))
    return None if begun is None else (begun.rig_serial, parse_board(begun.board))


KINDS = (".png", ".tif", ".tiff", ".bmp", ".pgm")
_LEAST_BYTES, _BYTES_PER_PIXEL = 1_000_000, 16
"""Most bytes that a file may have: headers and notes, and four channels of 32 bits. The cameras' pictures have one byte a pixel."""
RESULTS = ("air-coverage.png", "air-residuals.png")


class PicturesError(Exception):
    """A folder of pictures cannot be used; the text names the file, what is wrong and the remedy."""


@dataclass(frozen=True, slots=True)
class Pair:
    """One board, both cameras: where its pictures are."""

    name: str
    left: Path
    right: Path
    """The same as ``left`` where it is a scan's folder."""


@dataclass(frozen=True, slots=True, eq=False)
class FoundBoards:
    """Boards found in a folder, and why in some pairs there was none."""

    views: tuple[BoardView, ...]
    rejected: tuple[str, ...]
    made_from: tuple[str, ...]
    """Each pair with a checksum of its pixels."""


def pairs_of(folder: Path) -> list[Pair]:
    """Return the pairs of a folder, by name. Raises PicturesError: nothing there, or one picture of a pair is
    missing."""
    if not folder.is_dir():
        raise PicturesError(f"FOLDER {folder}: no such folder; give the one that holds the pictures of the board")
    sides: dict[str, dict[str, Path]] = {}
    found = []
    for path in sorted(folder.iterdir()):
        stem, _, side = path.stem.rpartition("_")
        # A manifest makes a folder a scan, whatever else it holds.
        if path.is_dir() and (path / MANIFEST_FILE).is_file():
            found.append(Pair(path.name, path, path))
        elif (path / LEFT).is_file() and (path / RIGHT).is_file() and not path.name.startswith("."):
            found.append(Pair(path.name, path / LEFT, path / RIGHT))
        elif path.suffix.lower() in KINDS and stem and side in SIDES and not path.name.startswith("."):
            # left.png beside left.tif: nobody can say which of both belongs to the right picture.
            if side in sides.setdefault(stem, {}):
                raise PicturesError(f"FOLDER {folder}: {path.name} is there twice, with two endings; remove one")
            sides[stem][side] = path
    for name, both in sides.items():
        if len(both) == 1:
            (one,) = both
            other = "right" if one == "left" else "left"
            raise PicturesError(
                f"FOLDER {folder}: {both[one].name} has no {name}_{other}{both[one].suffix}; add it, or remove the one"
            )
        found.append(Pair(name, both["left"], both["right"]))
    if not found:
        raise PicturesError(
            f"FOLDER {folder}: no pairs of pictures in it; they are called NAME_left.png and NAME_right.png"
        )
    return sorted(found, key=lambda pair: pair.name)


def read_pair(pair: Pair, width_px: int, height_px: int) -> tuple[Image, Image]:
    """Return both pictures (h, w) uint8. Raises PicturesError, ScanError."""
    if pair.left == pair.right:
        scan = load_scan(pair.left)
        made = scan.manifest.record.sequence
        bright = build_sequence(made.period_px, made.width_px, made.height_px).bright
        left, right = (np.array(scan.frames[side][bright]) for side in SIDES)
    else:
        left, right = (_picture(path, (width_px, height_px)) for path in (pair.left, pair.right))
    for image, path in ((left, pair.left), (right, pair.right)):
        _check_size(path, (image.shape[1], image.shape[0]), (width_px, height_px))
    return left, right


def find_boards(
    pairs: Sequence[Pair], design: BoardDesign, size_px: tuple[int, int], progress: Callable[[str, float], None]
) -> FoundBoards:
    """Look at every pair. Raises PicturesError, ScanError."""
    views, rejected, made_from = [], [], []
    for k, pair in enumerate(pairs):
        progress(f"looking at {pair.name}", k / len(pairs))
        left, right = read_pair(pair, *size_px)
        found = find_board(pair.name, left, right, design)
        if isinstance(found, NoBoard):
            rejected.append(found.reason)
        else:
            views.append(found)
            digest = hashlib.sha256(left.tobytes() + right.tobytes()).hexdigest()
            made_from.append(f"board {pair.name}, pixels {digest[:16]}")
    return FoundBoards(tuple(views), tuple(rejected), tuple(made_from))


def calibrate_folder(
    rig: Rig,
    folder: Path,
    design: BoardDesign,
    out: Path,
    made_at: datetime,
    progress: Callable[[str, float], None],
) -> dict[str, Any]:
    """Calibrate in air from a folder, write ``out`` and beside it both pictures; what came out, JSON-ready.

    Raises PicturesError, ScanError, AirCalibrationError (with every reason in it), StorageError.
    """
    size_px = (rig.camera.left.width_px, rig.camera.left.height_px)
    found = find_boards(pairs_of(folder), design, size_px, progress)
    progress("adjusting", 1.0)
    try:
        air = calibrate_air(found.views, *size_px)
    except AirCalibrationError as error:
        raise AirCalibrationError("; ".join((str(error), *found.rejected))) from error
    # Views that the adjustment left out do not count as coverage: that region is still missing.
    seen = coverage(air.used, *size_px)
    start = start_of(rig, air, design, found, made_at)
    for path, data in (
        (out.with_name(RESULTS[0]), coverage_picture(air.views, seen, *size_px)),
        (out.with_name(RESULTS[1]), residual_picture(air.views, *size_px)),
        (out, encode_calibration(start)),
    ):
        replace_file(LocalFileSystem(), path, data)
    return _report(out, air, start, seen, found.rejected)


def start_of(rig: Rig, air: AirCalibration, design: BoardDesign, found: FoundBoards, made_at: datetime) -> Calibration:
    """Return lenses and pose as measured, ports as the rig file draws them: where calibrating in water begins."""
    used = {view.name for view in air.views}
    made_from = (
        f"board {design}, bent by {air.shapes_mm[0]:.4f} mm",
        *(text for view, text in zip(found.views, found.made_from, strict=True) if view.name in used),
    )
    start = start_from_air(air, Instrument(rig).design(), made_from)
    serials = (rig.camera.left.serial, rig.camera.right.serial)
    return replace(start, made_at=made_at.astimezone(UTC).isoformat(timespec="seconds"), camera_serials=serials)


def install(rig: Rig, file: Path) -> tuple[Path, Path | None]:
    """Make a calibration in air the instrument's: where it lies, and where the one before it now does.

    Raises CalibrationError for another instrument's, StorageError.
    """
    start = load_calibration(file)
    if start.method != IN_AIR or start.rig_serial != rig.rig.serial:
        raise CalibrationError(
            f"{file} is of instrument {start.rig_serial}, method {start.method}; wanted is one in air of {rig.rig.serial}"
        )
    target = Instrument(rig).air_file
    before = None
    make_folders(LocalFileSystem(), target.parent)
    if target.is_file():
        with refused("cannot read", target):
            data = target.read_bytes()
        # Named by its content: the same file is kept once, however often it is installed.
        before = target.with_name(f"air-{hashlib.sha256(data).hexdigest()[:8]}.json")
        replace_file(LocalFileSystem(), before, data)
    replace_file(LocalFileSystem(), target, encode_calibration(start))
    return target, before


def _report(
    out: Path, air: AirCalibration, start: Calibration, seen: Coverage, rejected: Sequence[str]
) -> dict[str, Any]:
    left, right = air.rig.left, air.rig.right
    sd = dict(zip(PARAMETER_NAMES[AIR], np.sqrt(np.diag(air.covariance)), strict=True))
    baseline = np.array(right.translation_mm)
    baseline_mm = float(np.linalg.norm(baseline))
    # Error of the length along the baseline alone: √(eᵀ Σ e), with its unit vector e.
    way = baseline / baseline_mm
    shifts = slice(19, 22)
    return {
        "file": str(out),
        "pictures": [str(out.with_name(name)) for name in RESULTS],
        "views": [
            {
                "name": view.name,
                "corners": len(view.left_px),
                "residual_px": view.residual_px,
                "remarks": list(view.remarks),
            }
            for view in air.views
        ],
        "left_out": [*rejected, *air.left_out],
        "missing": list(seen.missing),
        "residual_px": air.residual_px,
        "principal_distance_px": [left.lens.f_px[0], right.lens.f_px[0]],
        "principal_distance_sd_px": [float(sd[f"{side} principal distance (px)"]) for side in SIDES],
        "principal_point_px": [list(left.lens.c_px), list(right.lens.c_px)],
        "baseline_mm": baseline_mm,
        "baseline_sd_mm": math.sqrt(float(way @ air.covariance[shifts, shifts] @ way)),
        "board_bow_mm": float(air.shapes_mm[0]),
        "hash": start.hash,
    }


def _check_size(path: Path, found_px: tuple[int, int], wanted_px: tuple[int, int]) -> None:
    if found_px != wanted_px:
        raise PicturesError(
            f"{path}: {found_px[0]}x{found_px[1]} px; the rig file has {wanted_px[0]}x{wanted_px[1]} px; "
            f"give the rig file of the instrument that took it (--rig)"
        )


def _picture(path: Path, wanted_px: tuple[int, int]) -> Image:
    """Read a picture of the wanted size, or refuse it before it is decoded: a small file may promise more pixels than there is memory."""
    longest = _LEAST_BYTES + _BYTES_PER_PIXEL * wanted_px[0] * wanted_px[1]
    try:
        data = read_bounded(path, longest)
    except OSError as error:
        raise PicturesError(
            f"{path}: {error.strerror or error}; pictures of {wanted_px[0]}x{wanted_px[1]} px are wanted; give them as recorded"
        ) from error
    stated_px = size_px(data)
    if stated_px is None:
        raise PicturesError(
            f"{path}: is no picture, or damaged ({KNOWN} is read); bring it back from a copy, or remove the pair"
        )
    _check_size(path, stated_px, wanted_px)
    # Unchanged, so that 16 bits or colours are refused by name instead of being turned into grey.
    with quiet_decoder():
        image = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
    if image is None:
        raise PicturesError(f"{path}: is no picture, or damaged; bring it back from a copy, or remove the pair")
    if image.dtype != np.uint8:
        raise PicturesError(f"{path}: {image.dtype} pixels; allowed are 8 bits; save it with 8 bits")
    if image.ndim == 3:
        channels = list(_channels(image))
        if any(not np.array_equal(channels[0], other) for other in channels[1:3]):
            raise PicturesError(f"{path}: is in colour; the cameras are grey; give the pictures as recorded")
        image = channels[0]
    return np.ascontiguousarray(image, np.uint8)


@contextmanager
def quiet_decoder() -> Iterator[None]:
    """Inside, OpenCV writes nothing of its own to stderr about a damaged file: we say it, once, with the file's name."""
    before = cv2.utils.logging.getLogLevel()
    cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)
    try:
        yield
    finally:
        cv2.utils.logging.setLogLevel(before)


def _channels(image: NDArray[Any]) -> Iterator[NDArray[Any]]:
    for k in range(image.shape[2]):
        yield image[:, :, k]
