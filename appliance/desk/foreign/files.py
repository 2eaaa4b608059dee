"""Assignment of the image files of a folder to cameras: by folders, or by names."""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path

from appliance.desk.foreign.description import ImageFiles
from appliance.desk.foreign.frames import PAGED, STACKS, SUFFIXES, Frame, arrays_in, frame_head, frames_in
from appliance.desk.foreign.images import natural_key, of_side
from appliance.desk.foreign.problem import ForeignError
from appliance.measure import SIDES

LEAST_IMAGES, MOST_FILES = 3, 2000
WIDE, HIGH = 2.0, 1.2
"""Least width over height, and least height over width, of a picture that may show both cameras."""
_RIGHT = re.compile(r"(^|[^a-z])(right|r|slave)([^a-z]|$)|right", re.IGNORECASE)
_LEFT = re.compile(r"(^|[^a-z])(left|l|master)([^a-z]|$)|left", re.IGNORECASE)
_SIDE = re.compile(
    r"left|right|master|slave|(?:cam(?:era)?|view|sensor)[_-]?\d+|(?<![a-z])[lrc]\d?(?![a-z0-9])", re.IGNORECASE
)
_ASIDE = re.compile(r"calib|chess|board|checker|charuco|result|output|depth|mask", re.IGNORECASE)
"""Names of folders and files that are no part of a sequence, ignored where other names remain."""


def camera_files(folder: Path) -> dict[str, ImageFiles]:
    """Return the images of the one or two cameras below ``folder``, the left one first.

    Raises ForeignError.
    """
    if not folder.is_dir():
        raise ForeignError(f"{folder}: is no folder; give the folder of the images")
    stacks = _stacks(folder)
    if stacks is not None:
        return stacks
    paths = [path for path in folder.rglob("*") if path.suffix.lower() in SUFFIXES and path.is_file()]
    if not LEAST_IMAGES <= len(paths) <= MOST_FILES:
        raise ForeignError(
            f"{folder}: {len(paths)} images; allowed are {LEAST_IMAGES} to {MOST_FILES}; give the folder of one set"
        )
    names = [str(path.relative_to(folder)) for path in paths]
    # Ignore files beside a sequence; if all files are called so, they are the sequence.
    best = _best([name for name in names if not _ASIDE.search(name)]) or _best(names)
    if best is None:
        raise ForeignError(
            f"{folder}: the names of its {len(names)} images do not show the camera; put the images of each camera "
            "into a folder, left and right"
        )
    frames = {
        pattern: tuple(Frame(folder / name) for name in sorted(names, key=natural_key))
        for pattern, names in best.items()
    }
    return _by_side(frames)


def _by_side(frames: Mapping[str, tuple[Frame, ...]]) -> dict[str, ImageFiles]:
    """Return the images of one or two cameras by side, from the images by file name."""
    ordered = sorted(frames, key=natural_key)
    if len(ordered) == 2 and (_RIGHT.search(ordered[0]) or _LEFT.search(ordered[1])) and not _LEFT.search(ordered[0]):
        ordered.reverse()
    return {side: ImageFiles((name,), frames=frames[name]) for side, name in zip(SIDES, ordered, strict=False)}


def _stacks(folder: Path) -> dict[str, ImageFiles] | None:
    """Return the one or two stacks of images below ``folder``; ``None`` for any other number."""
    frames_by_name: dict[str, tuple[Frame, ...]] = {}
    for path in sorted(folder.rglob("*")):
        if path.suffix.lower() not in (*STACKS, *PAGED) or not path.is_file():
            continue
        name = str(path.relative_to(folder))
        for array in arrays_in(path) if path.suffix.lower() == ".npz" else ("",):
            try:
                frames = frames_in(path, array)
            except ForeignError:
                continue  # no stack of images
            if len(frames) >= LEAST_IMAGES:
                frames_by_name[f"{name}#{array}" if array else name] = frames
    if not 1 <= len(frames_by_name) <= 2 or len({len(frames) for frames in frames_by_name.values()}) != 1:
        return None
    return _by_side(frames_by_name)


def in_halves(camera: ImageFiles) -> Iterator[dict[str, ImageFiles]]:
    """Yield two cameras as halves of each picture, side by side or one above the other, if its shape fits."""
    head = frame_head(camera.frames[0])
    if head is not None:
        height_px, width_px = head.shape
        if width_px >= WIDE * height_px:
            yield _share(camera, "left beside right")
        elif height_px > HIGH * width_px:
            yield _share(camera, "left above right")


def in_turns(camera: ImageFiles) -> Iterator[dict[str, ImageFiles]]:
    """Yield the ways in which two cameras may share one sequence: in turns, or one after the other."""
    count = len(camera.frames)
    if count % 2 == 0 and count >= 2 * LEAST_IMAGES:
        yield _share(camera, "left right")
        yield _share(camera, f"left*{count // 2} right*{count // 2}")


def _share(camera: ImageFiles, sides: str) -> dict[str, ImageFiles]:
    return {side: replace(camera, sides=sides, frames=tuple(of_side(camera.frames, sides, side))) for side in SIDES}


def exchange_sides(cameras: Mapping[str, ImageFiles]) -> dict[str, ImageFiles]:
    """Return two cameras with left and right exchanged."""
    sides = re.sub("left|right", lambda match: SIDES[match[0] == "left"], cameras["left"].sides)
    return {side: replace(cameras[source], sides=sides) for side, source in zip(SIDES, SIDES[::-1], strict=True)}


def _best(names: list[str]) -> dict[str, list[str]] | None:
    """Return the images of one or two cameras by the pattern of their names; ``None`` if no pattern fits."""
    best: dict[str, list[str]] | None = None
    for patterns in zip(*(_patterns(name) for name in names), strict=True):
        groups: dict[str, list[str]] = defaultdict(list)
        for pattern, name in zip(patterns, names, strict=True):
            groups[pattern].append(name)
        sizes = {len(group) for group in groups.values()}
        if "" not in groups and len(groups) <= 2 and len(sizes) == 1 and sizes.pop() >= LEAST_IMAGES:
            # Two cameras are likelier than one with two kinds of names.
            if len(groups) == 2:
                return groups
            best = best or groups
    return best


def _patterns(name: str) -> Iterator[str]:
    """Yield the patterns that a name may share with others of its camera, the likeliest first.

    A pattern is empty where the name has no such part.
    """
    path = Path(name)
    yield str(path.with_name(f"*{path.suffix}"))
    # One of the numbers in a name counts the images: the last, or the one before it, …
    numbers = list(re.finditer(r"\d+", name))[::-1]
    for place in range(4):
        yield f"{name[: numbers[place].start()]}*{name[numbers[place].end() :]}" if place < len(numbers) else ""
    # Replace all but a word for one of two cameras: 00_left.png, bright_R.png, cam0_gray_03.png.
    *_, side = [None, *_SIDE.finditer(path.name)]
    # A wildcard does not match a part of a folder's name.
    yield str(path.with_name(f"{'*' if side.start() else ''}{side[0]}*{path.suffix}")) if side else ""
