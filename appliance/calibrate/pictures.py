"""Pictures of a board in folders: which belong together, reading them, and filling a folder of views.

    pairs_of, read_pair            the instrument's pictures: pairs ``NAME_left.png`` and ``NAME_right.png`` (8 bit,
                                   grey; also tif, bmp, pgm), folders of scans, whose bright frames count, or
                                   ``NAME/left.png`` and ``NAME/right.png`` (``docs/air-calibration.md``)
    named_pictures, read_grey      pictures of any cameras: left and right by a word in the names of files or folders
                                   (``left``, ``R``, ``cam1``, …) or by two patterns. The rest of a name says which
                                   pictures belong together. Any picture becomes grey values.
    ViewFolder                     a folder of views of a board while it is filled: each view is there as a whole and
                                   durable, or not at all

A folder of views contains

    board.json      which board, which instrument
    01/left.png     a view; its folder gets its name when both pictures are on the disk
    01/right.png
"""

from __future__ import annotations

import re
import shutil
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from appliance.base import ContentError, SealedFile, read_bounded
from appliance.calibrate.air.board import BoardDesign
from appliance.measure import FULL_DN, SIDES
from appliance.store import KNOWN, MANIFEST_FILE, LocalFileSystem, StorageError, StoredScan, picture_head

Image = NDArray[np.uint8]

SESSION = "board.json"
LEFT, RIGHT = "left.png", "right.png"


@dataclass(frozen=True, slots=True)
class _FolderHead:
    """Content of ``board.json``."""

    rig_serial: str
    board: str


FOLDER_HEAD = SealedFile(
    _FolderHead, schema=1, max_bytes=64 * 1024, indent=1, checksum=False,
    check=lambda head: BoardDesign.parse(head.board), remedy="restore it, or remove it and give --board",
)  # fmt: skip


class ViewFolder:
    """A folder for views of one board by one instrument."""

    def __init__(self, folder: Path, rig_serial: str, design: BoardDesign | None) -> None:
        """Make the folder, or go on with an existing one.

        ``design`` ``None`` means that of the folder, else the default board. Raises ContentError for a folder of
        another board or instrument, StorageError.
        """
        self.folder = folder
        self._fs = LocalFileSystem()
        self._fs.make_folders(folder)
        begun = self.session(folder)
        if begun is None:
            self.design = design or BoardDesign()
            self._fs.replace_file(folder / SESSION, FOLDER_HEAD.encode(_FolderHead(rig_serial, str(self.design))))
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

    @staticmethod
    def session(folder: Path) -> tuple[str, BoardDesign] | None:
        """Return instrument and board of a folder that ``--live`` filled; ``None`` for any other.

        Raises ContentError.
        """
        path = folder / SESSION
        begun = FOLDER_HEAD.load(path, name=str(path))
        return None if begun is None else (begun.rig_serial, BoardDesign.parse(begun.board))

    def next_name(self) -> str:
        """Return the number of the next view; numbers only grow."""
        # The number after the largest, not the first free one: the number of a removed view must not be used again.
        numbers = [int(path.name) for path in self.folder.iterdir() if re.fullmatch(r"\d{2,6}", path.name)]
        return f"{max(numbers, default=0) + 1:02}"

    def save(self, name: str, left: Image, right: Image) -> None:
        """Write a view, durable on return. Raises StorageError, and then leaves no view ``name``."""
        # Both pictures are first written to a hidden folder, so that a numbered folder always has both.
        draft = self.folder / f".{name}"
        with StorageError.naming("cannot make", draft):
            self._fs.make_folder(draft)
        for file, image in ((LEFT, left), (RIGHT, right)):
            done, data = cv2.imencode(".png", image)
            if not done:
                raise ValueError(f"an image of shape {image.shape} cannot be encoded as PNG")
            self._fs.write_new(draft / file, [bytes(data)])
        self._fs.move_folder(draft, self.folder / name)

    def _tidy(self) -> None:
        """Remove the hidden folders of views that a loss of power interrupted."""
        for path in self.folder.iterdir():
            if re.fullmatch(r"\.\d{2,6}", path.name) and path.is_dir():
                with StorageError.naming("cannot remove the unfinished", path):
                    shutil.rmtree(path)


KINDS = (".png", ".tif", ".tiff", ".bmp", ".pgm")
_LEAST_BYTES, _BYTES_PER_PIXEL = 1_000_000, 16
"""Largest size of a file: headers and notes, and four channels of 32 bits. The cameras' own pictures have one byte a
pixel."""
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
"""Pairs of words for left and right, likely ones first; upper and lower case count as equal."""
MOST_BYTES, MOST_PIXELS = 1 << 29, 200_000_000
"""Largest file and largest picture that are read."""
LEAST_SIDE_PX, MOST_SIDE_PX = 64, 16384
WHITE_PERCENTILE = 99.9
"""Percentile that becomes white in a picture of more than 8 bits, as cameras use only a part of its range."""


@dataclass(frozen=True, slots=True)
class Pair:
    """Pictures of one board that were taken together.

    ``None`` where a camera has no picture; twice the same folder for a scan.
    """

    name: str
    left: Path | None
    right: Path | None


@dataclass(frozen=True, slots=True)
class NamedPictures:
    """The pictures of a folder, assigned to left and right."""

    pairs: tuple[Pair, ...]
    naming: str
    """Words or patterns by which left and right were assigned, as a phrase."""
    unnamed: tuple[str, ...]
    """Pictures that could not be assigned to a camera."""


class PicturesError(Exception):
    """Error of a folder of pictures; the text names the file, the fault and the remedy."""


def pairs_of(folder: Path) -> list[Pair]:
    """Return the pairs of a folder, by name. Raises PicturesError for an empty folder or an incomplete pair."""
    if not folder.is_dir():
        raise PicturesError(f"FOLDER {folder}: no such folder; give the folder with the images of the board")
    sides: dict[str, dict[str, Path]] = {}
    pairs = []
    for path in sorted(folder.iterdir()):
        stem, _, side = path.stem.rpartition("_")
        # A folder with a manifest is a scan, even if it also has pictures.
        if path.is_dir() and (path / MANIFEST_FILE).is_file():
            pairs.append(Pair(path.name, path, path))
        elif (path / LEFT).is_file() and (path / RIGHT).is_file() and not path.name.startswith("."):
            pairs.append(Pair(path.name, path / LEFT, path / RIGHT))
        elif path.suffix.lower() in KINDS and stem and side in SIDES and not path.name.startswith("."):
            # With left.png beside left.tif, it is not known which of them belongs to the right picture.
            if side in sides.setdefault(stem, {}):
                raise PicturesError(f"FOLDER {folder}: {path.name} exists with two suffixes; remove one")
            sides[stem][side] = path
    for name, files in sides.items():
        if len(files) == 1:
            (present,) = files
            absent = "right" if present == "left" else "left"
            raise PicturesError(
                f"FOLDER {folder}: {files[present].name} has no {name}_{absent}{files[present].suffix}; add "
                "it, or remove the other one"
            )
        pairs.append(Pair(name, files["left"], files["right"]))
    if not pairs:
        raise PicturesError(f"FOLDER {folder}: no stereo pairs in it; name the images NAME_left.png and NAME_right.png")
    return sorted(pairs, key=lambda pair: pair.name)


def read_pair(pair: Pair, width_px: int, height_px: int) -> tuple[Image, Image]:
    """Return both pictures (h, w) uint8. Raises PicturesError, ScanError."""
    assert pair.left is not None
    assert pair.right is not None
    if pair.left == pair.right:
        scan = StoredScan.load(pair.left)
        bright = scan.sequence.bright
        left, right = (np.array(scan.frames[side][bright]) for side in SIDES)
    else:
        left, right = (_picture(path, (width_px, height_px)) for path in (pair.left, pair.right))
    for image, path in ((left, pair.left), (right, pair.right)):
        _check_size(path, (image.shape[1], image.shape[0]), (width_px, height_px))
    return left, right


def named_pictures(folder: Path, patterns: tuple[str, str] | None) -> NamedPictures:
    """Return the pictures in a folder and its subfolders, assigned to left and right.

    ``patterns`` are those of the left and of the right paths, each with one ``*`` for the part that both pictures of a
    pair share. Raises PicturesError.
    """
    if not folder.is_dir():
        raise PicturesError(f"FOLDER {folder}: no such folder; give the folder with the images of the board")
    with StorageError.naming("cannot read", folder):
        paths = sorted(
            p for p in (*folder.glob("*"), *folder.glob("*/*")) if p.suffix.lower() in ANY_KINDS and p.is_file()
        )
    names = {p.relative_to(folder).as_posix(): p for p in paths if not p.name.startswith(".")}
    if not names:
        raise PicturesError(f"FOLDER {folder}: no images in it; allowed are {', '.join(ANY_KINDS)}")
    if patterns is not None:
        sides = _by_patterns(names, patterns)
        naming = f"--sides {','.join(patterns)}"
    else:
        # The words that give most pairs: a name may contain several ("l" and "left", or "cam1" of both numberings).
        sides, side_words = max(((_by_words(names, w), w) for w in WORDS), key=lambda hit: _count_pairs(hit[0]))
        naming = f"{side_words[0]} and {side_words[1]} in their names"
    if not _count_pairs(sides):
        listed = ", ".join(list(names)[:4])
        raise PicturesError(
            f"FOLDER {folder}: the names of the images ({listed}, …) do not show left and right; give "
            "patterns with --sides LEFT,RIGHT, for example --sides 'a/*.png,b/*.png'"
        )
    pairs: dict[str, dict[str, Path]] = {}
    for name, (side, key) in sides.items():
        pair = pairs.setdefault(key, {})
        if side in pair:
            raise PicturesError(
                f"FOLDER {folder}: {pair[side].name} and {names[name].name} are both the {side} image of "
                f"{key}; remove one"
            )
        pair[side] = names[name]
    called = _short_names(pairs)
    return NamedPictures(
        tuple(
            Pair(called[key], pair.get("left"), pair.get("right"))
            for key, pair in ((key, pairs[key]) for key in sorted(pairs, key=_natural_order))
        ),
        naming,
        tuple(name for name in names if name not in sides),
    )


def common_size(pictures: Iterable[Path]) -> tuple[tuple[int, int], dict[Path, str]]:
    """Return the width and height that most pictures have, and why each other picture is not used.

    The reason is another size or damage; each picture is decoded once. Raises PicturesError.
    """
    sizes: dict[Path, tuple[int, int]] = {}
    wrong: dict[Path, str] = {}
    for path in pictures:
        data = _bytes(path)
        header = picture_head(data)
        stated = header and header[:2]
        if stated is None:
            wrong[path] = f"{path}: is no image, or damaged (allowed: {KNOWN}); restore it from a copy"
        elif not (
            min(stated) >= LEAST_SIDE_PX and max(stated) <= MOST_SIDE_PX and stated[0] * stated[1] <= MOST_PIXELS
        ):
            wrong[path] = (
                f"{path.name}: {stated[0]}x{stated[1]} px; {LEAST_SIDE_PX} to {MOST_SIDE_PX} px a side are allowed"
            )
        elif _decode(data) is None:
            wrong[path] = f"{path}: is damaged and cannot be decoded; restore it from a copy"
        else:
            sizes[path] = stated
    if not sizes:
        raise PicturesError(next(iter(wrong.values())))
    usual = Counter(sizes.values()).most_common(1)[0][0]
    for path, size in sizes.items():
        if size != usual:
            wrong[path] = f"{path.name}: {size[0]}x{size[1]} px, the other images have {usual[0]}x{usual[1]} px"
    return usual, wrong


def read_grey(path: Path) -> Image:
    """Return a picture as (h, w) uint8: colours are converted to grey, more than 8 bits to 8.

    Raises PicturesError, StorageError.
    """
    image = _decode(_bytes(path))
    if image is None:
        raise PicturesError(f"{path}: is no image, or damaged; restore it from a copy")
    if image.ndim == 3:
        image = cv2.cvtColor(image, cv2.COLOR_BGRA2GRAY if image.shape[2] == 4 else cv2.COLOR_BGR2GRAY)
    if image.dtype != np.uint8:
        white = float(np.percentile(image, WHITE_PERCENTILE))
        image = np.clip(image * (FULL_DN / max(white, 1e-9)), 0, FULL_DN)
    return np.ascontiguousarray(np.rint(image), np.uint8)


def _decode(data: bytes) -> NDArray[Any] | None:
    """Return the picture in a file's bytes as it is stored; ``None`` where it cannot be decoded."""
    with quiet_decoder():
        try:
            return cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
        except cv2.error:
            return None


def _bytes(path: Path) -> bytes:
    try:
        return read_bounded(path, MOST_BYTES)
    except OSError as error:
        raise PicturesError(f"{path}: {error.strerror or error}; give the images as recorded") from error


# ------------------------------------------------------------------------------------------ names

_Sides = dict[str, tuple[str, str]]
"""Map from a path to its side, and to the key that both pictures of a pair share."""


def _by_words(names: Iterable[str], side_words: tuple[str, str]) -> _Sides:
    sides: _Sides = {}
    for name in names:
        stem = str(Path(name).with_suffix("")).lower()
        # A word ends where its kind of character ends: L in 01L and left in left01 count, l in label01 and cam1 in
        # cam10 do not.
        end = "[0-9]" if side_words[0][-1].isdigit() else "[a-z]"
        keys = [re.sub(rf"(?<![a-z]){word}(?!{end})", "*", stem) for word in side_words]
        hits = [(side, key) for side, key in zip(SIDES, keys, strict=True) if key != stem]
        if len(hits) == 1:
            sides[name] = hits[0]
    return sides


def _by_patterns(names: Iterable[str], patterns: tuple[str, str]) -> _Sides:
    sides: _Sides = {}
    for side, pattern in zip(SIDES, patterns, strict=True):
        if pattern.count("*") != 1:
            raise PicturesError(
                f"--sides {','.join(patterns)}: each needs one *, for the part of the name that both images "
                "of a stereo pair share"
            )
        before, after = pattern.split("*")
        for name in names:
            shared = re.fullmatch(re.escape(before) + "(.+)" + re.escape(after), name)
            if shared is not None:
                if name in sides:
                    raise PicturesError(f"{name} fits both sides of --sides {','.join(patterns)}")
                sides[name] = (side, shared[1])
    return sides


def _count_pairs(sides: _Sides) -> int:
    counts = Counter(key for _, key in set(sides.values()))
    return sum(count == 2 for count in counts.values())


def _short_names(keys: Iterable[str]) -> Mapping[str, str]:
    """Return a short name for each key; the key itself where short names would be equal."""
    short = {key: re.sub(r"^[\W_]+|[\W_]+$", "", key.replace("*", "")) or key for key in keys}
    ambiguous = {name for name, count in Counter(short.values()).items() if count > 1}
    return {key: key if name in ambiguous else name for key, name in short.items()}


def _natural_order(key: str) -> list[tuple[int, str]]:
    """Return a sort key that orders numbers in names by value: v2 before v12."""
    return [(int(part), "") if part.isdigit() else (-1, part) for part in re.split(r"(\d+)", key)]


def _check_size(path: Path, size_px: tuple[int, int], rig_size_px: tuple[int, int]) -> None:
    if size_px != rig_size_px:
        raise PicturesError(
            f"{path}: {size_px[0]}x{size_px[1]} px; the rig file has {rig_size_px[0]}x{rig_size_px[1]} px; "
            "give the rig file of the instrument that recorded it (--rig)"
        )


def _picture(path: Path, rig_size_px: tuple[int, int]) -> Image:
    """Read a picture of the size in the rig file.

    Another size is rejected before the picture is decoded, because a small file may promise more pixels than fit the
    memory.
    """
    max_bytes = _LEAST_BYTES + _BYTES_PER_PIXEL * rig_size_px[0] * rig_size_px[1]
    try:
        data = read_bounded(path, max_bytes)
    except OSError as error:
        raise PicturesError(
            f"{path}: {error.strerror or error}; allowed are images of {rig_size_px[0]}x{rig_size_px[1]} "
            "px; give them as recorded"
        ) from error
    header = picture_head(data)
    if header is None:
        raise PicturesError(
            f"{path}: is no image, or damaged (allowed: {KNOWN}); restore it from a copy, or remove the pair"
        )
    _check_size(path, header[:2], rig_size_px)
    # Read unchanged, so that 16 bits or colours are rejected instead of converted to grey.
    with quiet_decoder():
        image = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
    if image is None:
        raise PicturesError(f"{path}: is no image, or damaged; restore it from a copy, or remove the pair")
    if image.dtype != np.uint8:
        raise PicturesError(f"{path}: {image.dtype} pixels; allowed are 8 bits; save it with 8 bits")
    if image.ndim == 3:
        channels = list(_channels(image))
        if any(not np.array_equal(channels[0], channel) for channel in channels[1:3]):
            raise PicturesError(f"{path}: is in colour; allowed are grey values; give the images as recorded")
        image = channels[0]
    return np.ascontiguousarray(image, np.uint8)


@contextmanager
def quiet_decoder() -> Iterator[None]:
    """Suppress OpenCV's own lines on stderr about a damaged file inside the block; our error names the file."""
    before = cv2.utils.logging.getLogLevel()
    cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)
    try:
        yield
    finally:
        cv2.utils.logging.setLogLevel(before)


def _channels(image: NDArray[Any]) -> Iterator[NDArray[Any]]:
    for k in range(image.shape[2]):
        yield image[:, :, k]
