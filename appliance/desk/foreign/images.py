"""Images of a foreign set: the files that a description names, and their grey values.

They may have any format that OpenCV reads, pages of a TIFF and NumPy's stacks (``frames``), 8 or 16 bits, grey or
colour. Files of one name with wildcards come in natural order (2 before 10). Images are read on demand, and small sets
are kept.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from itertools import zip_longest
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from appliance.desk.foreign.description import EACH, HALVES, Description
from appliance.desk.foreign.frames import Frame, FrameReader, frame_head, frames_in, split_name
from appliance.desk.foreign.order import ShownImage, Shows, number_images, words_in
from appliance.desk.foreign.problem import ForeignError
from appliance.measure import SIDES

FULL_SCALES = (255.0, 1023.0, 4095.0, 16383.0, 65535.0)
"""Usual grey values of saturation."""
CHANNEL_NUMBER = {"blue": 0, "green": 1, "red": 2}
KEPT_BYTES = 40_000_000
"""Largest size of one camera's images that are kept after reading; others are read again."""


@dataclass(slots=True, eq=False)
class Pictures:
    """Images of files, read one by one: ``pictures[k]`` is (h, w) uint8 or uint16."""

    frames: tuple[Frame, ...]
    channel: str
    shape: tuple[int, int, int]
    dtype: np.dtype[Any]
    _reader: FrameReader = field(default_factory=FrameReader)
    _kept: dict[int, NDArray[Any]] = field(default_factory=dict)

    @classmethod
    def of(cls, frames: Sequence[Frame], channel: str) -> Pictures:
        """Return the images ``frames``, which must be alike.

        Raises ForeignError for images that differ, and for files without an image.
        """
        heads = [frame_head(frame) for frame in frames]
        first = heads[0]
        if first is None:
            first = frames[0].cut(_grey(frames[0], FrameReader().raw(frames[0]), channel))
        pictures = cls(tuple(frames), channel, (len(frames), *first.shape), first.dtype)
        for frame, head in zip(frames, heads, strict=True):
            pictures._alike(frame, first if head is None else head)
        return pictures

    def __len__(self) -> int:
        return len(self.frames)

    def __getitem__(self, number: int) -> NDArray[Any]:
        if number in self._kept:
            return self._kept[number]
        frame = self.frames[number]
        image = frame.cut(_grey(frame, self._reader.raw(frame), frame.channel or self.channel))
        self._alike(frame, image)
        # Each direction reads the bright and dark frames again, and each test reads small sets again.
        if image.nbytes * (len(self._kept) + 1) <= KEPT_BYTES:
            self._kept[number] = image
        return image

    def _alike(self, frame: Frame, image: NDArray[Any]) -> None:
        if image.shape != self.shape[1:] or image.dtype != self.dtype:
            raise ForeignError(
                f"{frame.path.parent / frame.name}: {image.shape[1]} x {image.shape[0]} px {image.dtype}, and "
                f"{self.frames[0].name} has "
                f"{self.shape[2]} x {self.shape[1]} px {self.dtype}; the images of one camera must have one size "
                "and type; name others -"
            )


@dataclass(frozen=True, slots=True, eq=False)
class ImageSet:
    """Images of one camera with their roles."""

    shown: tuple[ShownImage, ...]
    files: tuple[Frame, ...]
    images: Any
    """(n, h, w) uint8 or uint16: an array, or ``Pictures`` that are read one by one."""
    white: float
    """Grey value from which on a pixel is saturated."""

    @property
    def shape(self) -> tuple[int, int]:
        """(h, w)."""
        return int(self.images.shape[1]), int(self.images.shape[2])

    def image(self, shows: Shows, axis: str = "", index: int = 0) -> NDArray[Any] | None:
        """Return an image (h, w) of the first period; ``None`` where there is none."""
        role = ShownImage(shows, axis, index)
        return self.images[self.shown.index(role)] if role in self.shown else None

    def all_of(self, shows: Shows, axis: str, period: int = 0) -> NDArray[Any]:
        """Return all images (n, h, w) of a kind, in their order."""
        indices = [
            k for k, role in enumerate(self.shown) if (role.shows, role.axis, role.period) == (shows, axis, period)
        ]
        # One allocation, which can be freed as a whole.
        images = np.empty((len(indices), *self.shape), self.images.dtype)
        for slot, k in enumerate(indices):
            images[slot] = self.images[k]
        return images


def natural_key(text: str) -> list[tuple[int, int, str]]:
    """Return the sort key of a name in natural order: ``a2`` before ``a10``."""
    parts = re.split(r"(\d+)", text)
    return [(0, int(part), "") if part.isdigit() else (1, 0, part.lower()) for part in parts if part]


def read_side(description: Description, side: str) -> ImageSet:
    """Return the images of one camera; those of 16 bits are read for their saturation.

    Raises ForeignError for files that are missing, of different sizes, or no images.
    """
    images = first_of_side(description, side)
    return replace(images, white=description.white or _white(images.images))


def first_of_side(description: Description, side: str) -> ImageSet:
    """Return the images of one camera by the headers of their files, none of which is decoded.

    Raises ForeignError for files that are missing, of different sizes, or no images.
    """
    used = [
        (file, role)
        for file, role in zip(*files_of_side(description, side), strict=True)
        if role.shows is not Shows.OTHER
    ]
    if not used:
        raise ForeignError("all images are named -; name the image role of each")
    files, shown = zip(*used, strict=True)
    return ImageSet(shown, files, Pictures.of(files, description.channel), description.white or FULL_SCALES[0])


def _white(images: Pictures) -> float:
    """Return the least grey value of saturation that no pixel exceeds.

    Values of sensors with fewer bits may be shifted to the upper end of 16, as multiples of their last bit.
    """
    if images.dtype == np.uint8:
        return FULL_SCALES[0]
    brightest, bits = 0, 0
    for k in range(len(images)):
        brightest = max(brightest, int(images[k].max()))
        bits |= int(np.bitwise_or.reduce(images[k], axis=None))
    scale = next(full_scale for full_scale in FULL_SCALES if brightest <= full_scale)
    return scale - (bits & -bits) + 1.0 if scale == FULL_SCALES[-1] else scale


def _grey(frame: Frame, image: NDArray[Any], channel: str) -> NDArray[Any]:
    if image.dtype not in (np.uint8, np.uint16):
        raise ForeignError(f"{frame.path}: grey values are {image.dtype}; allowed: 8 or 16 bits; convert it")
    if image.ndim == 2:
        return np.asarray(image)
    if image.shape[2] < 3:
        # Grey with transparency, or one channel.
        return np.ascontiguousarray(image[..., 0])
    if channel == "grey":
        # A grey picture that was saved in colour has three equal channels.
        return np.asarray(cv2.cvtColor(np.ascontiguousarray(image[..., :3]), cv2.COLOR_BGR2GRAY))
    return np.ascontiguousarray(image[..., CHANNEL_NUMBER[channel]])


def files_of_side(description: Description, side: str) -> tuple[list[Frame], tuple[ShownImage, ...]]:
    """Return the files of one camera and their roles.

    Raises ForeignError for files that are missing, too few or too many.
    """
    files = description.files[side]
    key = f"images.{'both' if files.sides else side}"
    frame_words = [
        (frame, word)
        for pattern, word in zip_longest(files.patterns, files.kinds, fillvalue="")
        for frame in matching_frames(description.folder, pattern, f"{key}.{word}" if word else key)
    ]
    frames = of_channel(of_side([frame for frame, _ in frame_words], files.sides, side), description.channel)
    if description.order is None:
        # Three images of each file where every channel is an image.
        return frames, number_images(
            [word for _, word in frame_words for _ in range(len(frames) // len(frame_words))], key
        )
    if len(frames) != len(description.order):
        raise ForeignError(
            f"{key}: {len(frames)} images ({frames[0].name} to {frames[-1].name}), and images.order names "
            f"{len(description.order)} images; name as many, with - for other images"
        )
    return frames, description.order


def of_channel(frames: Sequence[Frame], channel: str) -> list[Frame]:
    """Return the images of pictures: three of each where every channel is one."""
    channels = ("red", "green", "blue") if channel == EACH else ("",)
    return [replace(frame, channel=name) for frame in frames for name in channels]


def of_side(frames: Sequence[Frame], sides: str, side: str) -> list[Frame]:
    """Return the images of one camera among those of both, by the words ``sides``; all if that is empty.

    Raises ForeignError.
    """
    if sides in HALVES:
        return [replace(frame, half=HALVES[sides][SIDES.index(side)]) for frame in frames]
    order_of_sides = words_in(sides, "images.sides") or [side]
    if len(frames) % len(order_of_sides):
        raise ForeignError(
            f"images.both: {len(frames)} images, no multiple of {len(order_of_sides)}; correct images.sides, or "
            "name only images of the set"
        )
    return [frame for k, frame in enumerate(frames) if order_of_sides[k % len(order_of_sides)] == side]


def matching_frames(folder: Path, name: str, key: str) -> list[Frame]:
    """Return the images of the files that match a name with wildcards, in natural order.

    Raises ForeignError if there are none.
    """
    pattern, array = split_name(name)
    absolute = Path(pattern)
    try:
        if absolute.is_absolute():
            paths = list(Path(absolute.anchor).glob(str(absolute.relative_to(absolute.anchor))))
        else:
            paths = list(folder.glob(pattern))
    except (ValueError, NotImplementedError, OSError) as error:
        raise ForeignError(f"{key}: {pattern!r:.80} is no file name pattern ({error}); correct it") from error
    files = sorted((path for path in paths if path.is_file()), key=lambda path: natural_key(str(path)))
    if not files:
        raise ForeignError(f"{key}: no file is called {pattern!r:.80} in {folder.absolute()}; correct the name")
    return [frame for path in files for frame in frames_in(path, array)]
