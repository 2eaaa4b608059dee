"""Owns a folder of pictures of a board: which pictures belong together, and reading them.

The instrument's folder holds pairs ``NAME_left.png`` and ``NAME_right.png`` (8 bit, grey; also tif, bmp, pgm), or
folders: of scans, whose bright frames are taken, or ``NAME/left.png`` and ``NAME/right.png``. ``docs/air-calibration.md``
says how to record them.

Somebody's pictures are told apart by a word in their names or in those of their folders (``left``, ``R``, ``cam1``, …),
or by two patterns. What is left of a name without that word says which pictures belong together; any picture becomes
grey values.

It also owns a folder of views of a board while it is being filled: each view durable and whole, or not there.

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
class _Begun:
    """Content of ``board.json``."""

    rig_serial: str
    board: str


BEGUN = SealedFile(
    _Begun, schema=1, max_bytes=64 * 1024, indent=1, checksum=False, check=lambda begun: BoardDesign.parse(begun.board),
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
        self._fs.make_folders(folder)
        begun = self.session(folder)
        if begun is None:
            self.design = design or BoardDesign()
            self._fs.replace_file(folder / SESSION, BEGUN.encode(_Begun(rig_serial, str(self.design))))
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
        begun = BEGUN.load(path, name=str(path))
        return None if begun is None else (begun.rig_serial, BoardDesign.parse(begun.board))

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
        with StorageError.naming("cannot make", draft):
            self._fs.make_folder(draft)
        for file, image in ((LEFT, left), (RIGHT, right)):
            done, data = cv2.imencode(".png", image)
            if not done:
                raise ValueError(f"a picture of {image.shape} could not be encoded as PNG")
            self._fs.write_new(draft / file, [bytes(data)])
        self._fs.move_folder(draft, self.folder / name)

    def _tidy(self) -> None:
        """Take away what a loss of power left of a view that was never there."""
        for path in self.folder.iterdir():
            if re.fullmatch(r"\.\d{2,6}", path.name) and path.is_dir():
                with StorageError.naming("cannot remove the unfinished", path):
                    shutil.rmtree(path)


KINDS = (".png", ".tif", ".tiff", ".bmp", ".pgm")
_LEAST_BYTES, _BYTES_PER_PIXEL = 1_000_000, 16
"""Most bytes that a file may have: headers and notes, and four channels of 32 bits.

The cameras' pictures have one byte a pixel.
"""
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
class Pair:
    """Pictures of one board that were taken together; ``None`` where a camera has none, the same folder where it is a
    scan's."""

    name: str
    left: Path | None
    right: Path | None


@dataclass(frozen=True, slots=True)
class NamedPictures:
    """The pictures of a folder, told apart."""

    pairs: tuple[Pair, ...]
    told_by: str
    """Words or patterns that told left from right, in a phrase."""
    unnamed: tuple[str, ...]
    """Pictures of which nothing says which camera took them."""


class PicturesError(Exception):
    """A folder of pictures cannot be used; the text names the file, what is wrong and the remedy."""


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
    """Return the pictures in a folder and in the folders in it, told apart.

    ``patterns``: of the left and the right paths, with one ``*`` each, which stands for what both pictures of a pair
    share. Raises PicturesError.
    """
    if not folder.is_dir():
        raise PicturesError(f"FOLDER {folder}: no such folder; give the one that holds the pictures of the board")
    with StorageError.naming("cannot read", folder):
        found = sorted(
            p for p in (*folder.glob("*"), *folder.glob("*/*")) if p.suffix.lower() in ANY_KINDS and p.is_file()
        )
    names = {p.relative_to(folder).as_posix(): p for p in found if not p.name.startswith(".")}
    if not names:
        raise PicturesError(f"FOLDER {folder}: no pictures in it; read are {', '.join(ANY_KINDS)}")
    if patterns is not None:
        sides = _by_patterns(names, patterns)
        told = f"--sides {','.join(patterns)}"
    else:
        # The words that make most pairs: a name may have several ("l" and "left", or "cam1" of both numberings).
        sides, words = max(((_by_words(names, w), w) for w in WORDS), key=lambda one: _complete(one[0]))
        told = f"{words[0]} and {words[1]} in their names"
    if not _complete(sides):
        listed = ", ".join(list(names)[:4])
        raise PicturesError(
            f"FOLDER {folder}: no name of a picture ({listed}, …) tells a left picture from the right one of its pair; "
            "say how with "
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
            Pair(called[key], both.get("left"), both.get("right"))
            for key, both in ((key, pairs[key]) for key in sorted(pairs, key=_order))
        ),
        told,
        tuple(name for name in names if name not in sides),
    )


def common_size(pictures: Iterable[Path]) -> tuple[tuple[int, int], dict[Path, str]]:
    """Return the width and height that most pictures have, and of each other picture why it is not used: another size,
    or damage, since each is decoded once. Raises PicturesError."""
    sizes: dict[Path, tuple[int, int]] = {}
    wrong: dict[Path, str] = {}
    for path in pictures:
        data = _bytes(path)
        head = picture_head(data)
        stated = head and head[:2]
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
    """Return a picture (h, w) uint8: colours become grey, more than 8 bits become 8.

    Raises PicturesError, StorageError.
    """
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
        hits = [(side, key) for side, key in zip(SIDES, keys, strict=True) if key != stem]
        if len(hits) == 1:
            found[name] = hits[0]
    return found


def _by_patterns(names: Iterable[str], patterns: tuple[str, str]) -> _Sides:
    found: _Sides = {}
    for side, pattern in zip(SIDES, patterns, strict=True):
        if pattern.count("*") != 1:
            raise PicturesError(
                f"--sides {','.join(patterns)}: each has one *, which stands for what both pictures of a pair share"
            )
        before, after = pattern.split("*")
        for name in names:
            shared = re.fullmatch(re.escape(before) + "(.+)" + re.escape(after), name)
            if shared is not None:
                if name in found:
                    raise PicturesError(f"{name} fits both sides of --sides {','.join(patterns)}")
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


def _check_size(path: Path, found_px: tuple[int, int], wanted_px: tuple[int, int]) -> None:
    if found_px != wanted_px:
        raise PicturesError(
            f"{path}: {found_px[0]}x{found_px[1]} px; the rig file has {wanted_px[0]}x{wanted_px[1]} px; "
            f"give the rig file of the instrument that took it (--rig)"
        )


def _picture(path: Path, wanted_px: tuple[int, int]) -> Image:
    """Read a picture of the wanted size, or refuse it before it is decoded: a small file may promise more pixels than
    there is memory."""
    longest = _LEAST_BYTES + _BYTES_PER_PIXEL * wanted_px[0] * wanted_px[1]
    try:
        data = read_bounded(path, longest)
    except OSError as error:
        raise PicturesError(
            f"{path}: {error.strerror or error}; pictures of {wanted_px[0]}x{wanted_px[1]} px are wanted; give them as "
            "recorded"
        ) from error
    head = picture_head(data)
    if head is None:
        raise PicturesError(
            f"{path}: is no picture, or damaged ({KNOWN} is read); bring it back from a copy, or remove the pair"
        )
    _check_size(path, head[:2], wanted_px)
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
