"""Places and arrays of single foreign images.

* ``Frame``: one image: a file of its own, a page of a TIFF, or one of an array of NumPy.
* ``array_heads``, ``load_array``: the arrays in NumPy's files, by their headers alone, and their numbers once their size
  is allowed.

Stacks are (n, h, w), or (h, w, n) as MATLAB's programs leave them: n is the least of the three; colours are a fourth
dimension, blue first, as OpenCV has them. An array of several in an ``.npz`` is named behind ``#``:
``frames.npz#left``. Five megabytes of an ``.npz`` may unpack to as many gigabytes: shapes are read without unpacking.
Format: NEP 1, versions 1 to 3.
"""

from __future__ import annotations

import io
import mmap
import re
import zipfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any

import cv2
import numpy as np
from numpy.typing import NDArray

from appliance.base import read_bounded, refuse_irregular
from appliance.desk.foreign.problem import ForeignError
from appliance.store import picture_head

HEADER_BYTES = 16 * 1024
"""Number of bytes that are read for a header; those of arrays of numbers have some hundred."""
MOST_ARRAYS = 1000
ZIPPED = ".npz"
_SUFFIX = ".npy"


def array_heads(path: Path) -> dict[str, NDArray[Any]]:
    """Return the arrays of an ``.npz`` by name, or the one of an ``.npy``, whose name is empty.

    Raises ValueError. They have shape and type, but no numbers and no memory of their own.
    """
    with _as_value_error(path):
        if path.suffix.lower() != ZIPPED:
            with path.open("rb") as file:
                return {"": _head(file)}
        with zipfile.ZipFile(path) as archive:
            names = [name for name in archive.namelist() if name.endswith(_SUFFIX)]
            heads = {}
            for name in names[: MOST_ARRAYS + 1]:
                with archive.open(name) as member:
                    heads[name.removesuffix(_SUFFIX)] = _head(member)
    if len(names) > MOST_ARRAYS:
        raise ValueError(f"{len(names)} arrays; allowed are up to {MOST_ARRAYS}")
    return heads


def load_array(path: Path, name: str, max_bytes: int) -> NDArray[Any]:
    """Return an array by its name in ``array_heads``; an ``.npy`` is mapped, not read.

    Raises ValueError for an array of more than ``max_bytes``.
    """
    if path.suffix.lower() == ZIPPED:
        head = array_heads(path)[name]
        size_bytes = head.size * head.itemsize
        if size_bytes > max_bytes:
            raise ValueError(
                f"array {name} unpacks to {size_bytes / 1e9:.3g} GB; allowed are {max_bytes / 1e9:.3g} GB; save it as "
                ".npy, which is read in parts"
            )
    with _as_value_error(path):
        if path.suffix.lower() != ZIPPED:
            return np.asarray(np.load(path, mmap_mode="r", allow_pickle=False))
        with np.load(path, allow_pickle=False) as content:
            return np.asarray(content[name])


def _head(file: IO[bytes]) -> NDArray[Any]:
    # A header may state any length in four bytes: unpack no more than this for it.
    few = io.BytesIO(file.read(HEADER_BYTES))
    version = np.lib.format.read_magic(few)
    read = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
    shape, _, dtype = read(few)
    return np.broadcast_to(np.empty((), dtype), shape)


@contextmanager
def _as_value_error(path: Path) -> Iterator[None]:
    """Raise ValueError in place of the errors that NumPy and zipfile raise for a damaged file."""
    try:
        refuse_irregular(path)
        yield
    except Exception as error:
        raise ValueError(f"not readable as NumPy's file ({str(error)[:120]})") from error


SUFFIXES = (".png", ".bmp", ".tif", ".tiff", ".jpg", ".jpeg", ".pgm", ".ppm", ".pnm", ".webp", ".jp2", ".exr", ".hdr")
STACKS = (".npy", ".npz")
PAGED = (".tif", ".tiff")
MOST_PAGES = 400
MOST_FILE_BYTES, MOST_STACK_BYTES, MOST_PIXELS = 1 << 29, 1 << 31, 200_000_000
"""Largest file of one image, largest array once it is unpacked, and largest image."""
_ARRAY = re.compile(r"(?P<file>.+\.npz)#(?P<array>.+)", re.IGNORECASE)


@dataclass(frozen=True, slots=True)
class Frame:
    """Place of one image."""

    path: Path
    page: int | None = None
    """Number in its stack, from 0; ``None``: the file is one image."""
    array: str = ""
    """Name in an ``.npz``."""
    channel: str = ""
    """Colour of the picture that is this image; empty: the channel that the description gives for all."""
    half: str = ""
    """Half of the picture that is this image; empty: all of it."""

    @property
    def name(self) -> str:
        """Name of the file, with array and page."""
        array = f"#{self.array}" if self.array else ""
        page = "" if self.page is None else f"[{self.page}]"
        return " ".join(part for part in (f"{self.path.name}{array}{page}", self.channel, self.half) if part)

    def cut(self, image: NDArray[Any]) -> NDArray[Any]:
        """Return the part of a picture (h, w) that is this image."""
        rows, columns = (size // 2 for size in image.shape[:2])
        parts = {
            "left half": (slice(None), slice(columns)),
            "right half": (slice(None), slice(columns, None)),
            "upper half": (slice(rows),),
            "lower half": (slice(rows, None),),
        }
        return image[parts.get(self.half, ())]


def split_name(pattern: str) -> tuple[str, str]:
    """Return the name of files and that of an array in them; the latter is empty if none is named."""
    match = _ARRAY.fullmatch(pattern)
    return (match["file"], match["array"]) if match else (pattern, "")


def frames_in(path: Path, array: str = "") -> tuple[Frame, ...]:
    """Return the images of one file, in order.

    Raises ForeignError for a stack that cannot be read or has too many.
    """
    count: int | None = None
    suffix = path.suffix.lower()
    if suffix in PAGED:
        _refuse_other_files(path)
        with suppress(cv2.error):  # the reader raises the error
            count = cv2.imcount(str(path))
        count = None if count == 1 else count
    elif suffix in STACKS:
        head = _stack(path, array, head=True)
        count = len(head) if head.ndim > 2 else None
    if count is not None and count > MOST_PAGES:
        raise ForeignError(f"{path}: {count} images; allowed are up to {MOST_PAGES}; write one file a sequence")
    return (Frame(path, None, array),) if not count else tuple(Frame(path, k, array) for k in range(count))


def arrays_in(path: Path) -> tuple[str, ...]:
    """Return the names of the arrays in an ``.npz`` that may be stacks of images; none for another file."""
    try:
        return tuple(name for name, head in array_heads(path).items() if head.ndim >= 3)
    except ValueError:
        return ()


class FrameReader:
    """Reader of images in order; a stack, or a picture that holds several images, is opened once."""

    def __init__(self) -> None:
        self._last: tuple[Frame, NDArray[Any]] | None = None

    def raw(self, frame: Frame) -> NDArray[Any]:
        """Return the picture (h, w) or (h, w, channels) that an image lies in. Raises ForeignError."""
        stacked = frame.path.suffix.lower() in STACKS
        key = Frame(frame.path, None if stacked else frame.page, frame.array)
        if self._last is None or self._last[0] != key:
            self._last = None  # not both at once
            self._last = key, _stack(frame.path, frame.array) if stacked else _read(key)
        content = self._last[1]
        return content if not stacked or frame.page is None else content[frame.page]


def frame_head(frame: Frame) -> NDArray[Any] | None:
    """Return an image (h, w) with size and type by the file's header; ``None`` if only reading gives them."""
    if frame.path.suffix.lower() in STACKS:
        head = _stack(frame.path, frame.array, head=True)
        head = head if frame.page is None else head[frame.page]
        return frame.cut(head if head.ndim == 2 else head[..., 0])
    _refuse_other_files(frame.path)
    with frame.path.open("rb") as file:
        if not file.seek(0, 2):
            return None
        with mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as data:
            stated = picture_head(data)
    if stated is None or stated[2] > 16 or not 0 <= stated[0] * stated[1] <= MOST_PIXELS:
        return None
    return frame.cut(np.broadcast_to(np.empty((), np.uint8 if stated[2] <= 8 else np.uint16), stated[1::-1]))


def _read(frame: Frame) -> NDArray[Any]:
    image = None
    try:
        if frame.page is None:
            raw = read_bounded(frame.path, MOST_FILE_BYTES)
            stated = picture_head(raw)
            # A decoder allocates as many pixels as the header states.
            if stated is not None and stated[0] * stated[1] > MOST_PIXELS:
                raise ForeignError(
                    f"{frame.path}: {stated[0]} x {stated[1]} px; allowed are up to {MOST_PIXELS} pixels; crop it"
                )
            image = cv2.imdecode(np.frombuffer(raw, np.uint8), cv2.IMREAD_UNCHANGED) if raw else None
        else:
            done, pages = cv2.imreadmulti(str(frame.path), start=frame.page, count=1, flags=cv2.IMREAD_UNCHANGED)
            image = pages[0] if done and len(pages) else None
    except OSError as error:
        raise ForeignError(f"{frame.path}: {error.strerror or error}; correct the name") from error
    except cv2.error:
        image = None
    if image is None:
        raise ForeignError(
            f"{frame.path.parent / frame.name}: no readable image; allowed: "
            f"{', '.join((*SUFFIXES[:9], *STACKS))}; convert it"
        )
    return np.asarray(image)


def _refuse_other_files(path: Path) -> None:
    try:
        refuse_irregular(path)
    except OSError as error:
        raise ForeignError(f"{path}: {error.strerror or error}; correct the name") from error


def _stack(path: Path, array: str, head: bool = False) -> NDArray[Any]:
    """Return the array of a file, its images along the first dimension, or its ``head`` alone.

    One image is (h, w). Raises ForeignError.
    """
    try:
        heads = array_heads(path)
        name = array or (next(iter(heads)) if len(heads) == 1 else "")
        if name not in heads:
            reason = f"has no array {array}" if array else f"has {len(heads)} arrays"
            raise ForeignError(
                f"{path}: {reason} ({', '.join(list(heads)[:20])[:200]}); name one of them: {path.name}#NAME"
            )
        content = heads[name] if head else load_array(path, name, MOST_STACK_BYTES)
    except ValueError as error:
        raise ForeignError(f"{path}: {error}; save it anew, without objects") from error
    if content.ndim not in (2, 3, 4) or 0 in content.shape:
        raise ForeignError(
            f"{path}: an array of shape {content.shape!s:.60}; allowed: (n, h, w), or (n, h, w, 3) of colours; save it "
            "so"
        )
    images_last = content.ndim == 3 and content.shape[2] < min(content.shape[:2])
    return np.moveaxis(content, 2, 0) if images_last else content
