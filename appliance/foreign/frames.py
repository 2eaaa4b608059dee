"""Owns where a single image of a foreign set lies: a file of its own, a page of a TIFF, or one of an array that NumPy wrote.

Stacks are (n, h, w), or (h, w, n) as MATLAB's programs leave them: n is the least of the three; colours are a fourth dimension, blue
first, as OpenCV has them. An array of several in an ``.npz`` is named behind ``#``: ``frames.npz#left``.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from appliance.foreign.problem import ForeignError

SUFFIXES = (".png", ".bmp", ".tif", ".tiff", ".jpg", ".jpeg", ".pgm", ".ppm", ".pnm", ".webp", ".jp2", ".exr", ".hdr")
STACKS = (".npy", ".npz")
PAGED = (".tif", ".tiff")
MOST_PAGES = 400
_ARRAY = re.compile(r"(?P<file>.+\.npz)#(?P<array>.+)", re.IGNORECASE)


@dataclass(frozen=True, slots=True)
class Frame:
    """Place of one image."""

    path: Path
    page: int | None = None
    """Number in its stack, from 0; ``None``: the file is one image."""
    array: str = ""
    """Name in an ``.npz``."""

    @property
    def name(self) -> str:
        """Name of the file, with array and page."""
        array = f"#{self.array}" if self.array else ""
        return f"{self.path.name}{array}" + ("" if self.page is None else f"[{self.page}]")


def split_name(pattern: str) -> tuple[str, str]:
    """Return the name of files and that of an array in them, empty where none is named."""
    found = _ARRAY.fullmatch(pattern)
    return (found["file"], found["array"]) if found else (pattern, "")


def frames_in(path: Path, array: str = "") -> tuple[Frame, ...]:
    """Return the images of one file, in order. Raises ForeignError for a stack that cannot be read or has too many."""
    count: int | None = None
    suffix = path.suffix.lower()
    if suffix in PAGED:
        try:
            pages = cv2.imcount(str(path))
        except cv2.error:
            pages = 1  # whoever reads it says what is wrong
        count = pages if pages > 1 else None
    elif suffix in STACKS:
        stack = _stack(path, array)
        count = None if stack.ndim == 2 else len(stack)
    if count is not None and count > MOST_PAGES:
        raise ForeignError(f"{path}: {count} images; allowed are up to {MOST_PAGES}; give one sequence a file")
    return (Frame(path, None, array),) if count is None else tuple(Frame(path, k, array) for k in range(count))


def arrays_in(path: Path) -> tuple[str, ...]:
    """Return the names of the arrays in an ``.npz`` that may be stacks of images; none where it is something else."""
    try:
        with np.load(path, allow_pickle=False) as content:
            return tuple(name for name in content.files if content[name].ndim >= 3)
    except Exception:  # whatever a damaged archive makes zipfile raise: it is no stack
        return ()


def raw_images(frames: Sequence[Frame]) -> list[NDArray[Any]]:
    """Return the images (h, w) or (h, w, channels) as their files have them. Raises ForeignError."""
    stacks: dict[tuple[Path, str], NDArray[Any]] = {}
    found = []
    for frame in frames:
        if frame.path.suffix.lower() in STACKS:
            # One at a time is mapped or unpacked once, not once for each image.
            key = frame.path, frame.array
            if key not in stacks:
                stacks = {key: _stack(*key)}
            found.append(np.asarray(stacks[key] if frame.page is None else stacks[key][frame.page]))
        else:
            found.append(_read(frame))
    return found


def _read(frame: Frame) -> NDArray[Any]:
    image = None
    try:
        if frame.page is None:
            raw = np.fromfile(frame.path, np.uint8)
            image = cv2.imdecode(raw, cv2.IMREAD_UNCHANGED) if raw.size else None
        else:
            done, pages = cv2.imreadmulti(str(frame.path), start=frame.page, count=1, flags=cv2.IMREAD_UNCHANGED)
            image = pages[0] if done and len(pages) else None
    except OSError as error:
        raise ForeignError(f"{frame.path}: {error.strerror or error}; correct the name") from error
    except cv2.error:
        image = None
    if image is None:
        raise ForeignError(
            f"{frame.path.parent / frame.name}: no image that can be read; allowed: {', '.join((*SUFFIXES[:9], *STACKS))}; convert it"
        )
    return np.asarray(image)


def _stack(path: Path, array: str) -> NDArray[Any]:
    """Return the array of a file, its images along the first dimension; one image is (h, w)."""
    try:
        content = np.load(path, mmap_mode="r", allow_pickle=False)
        names = [] if isinstance(content, np.ndarray) else list(content.files)
        if not isinstance(content, np.ndarray) and (array in names or (not array and len(names) == 1)):
            with content:
                content = np.asarray(content[array or names[0]])
    except Exception as error:  # whatever a damaged file makes NumPy and zipfile raise
        raise ForeignError(
            f"{path}: not readable as NumPy's file ({str(error)[:120]}); save it anew, without objects"
        ) from error
    if not isinstance(content, np.ndarray):
        said = f"has no array {array}" if array else f"has {len(names)} arrays"
        raise ForeignError(f"{path}: {said} ({', '.join(names[:20])[:200]}); name one of them: {path.name}#NAME")
    if content.ndim not in (2, 3, 4):
        raise ForeignError(
            f"{path}: an array of {content.ndim} dimensions; allowed: (n, h, w), or (n, h, w, 3) of colours; save it so"
        )
    if content.ndim == 3 and content.shape[2] < min(content.shape[:2]):
        return np.moveaxis(content, 2, 0)
    return np.asarray(content)
