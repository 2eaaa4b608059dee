"""Owns which of somebody's pictures are the left camera's and which the right one's, and how any picture becomes grey values.

Files are told apart by a word in their names or in those of their folders (``left``, ``R``, ``cam1``, …), or by two patterns. What is
left of a name without that word says which pictures belong together.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from appliance.base import read_bounded
from appliance.calibrate.in_air import KINDS, PicturesError, quiet_decoder
from appliance.measure import FULL_DN
from appliance.store import KNOWN, refused, size_px

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
