"""Owns the images of a foreign set: which files a description means, and their grey values.

Any format that OpenCV reads, pages of a TIFF and NumPy's stacks (``frames``), 8 or 16 bits, grey or colour; files of
one name with wildcards come in natural order (2 before 10). Pictures are read when they are asked for, and what is
small is kept.
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
"""Grey values of saturation that sensors have."""
CHANNEL_NUMBER = {"blue": 0, "green": 1, "red": 2}
KEPT_BYTES = 40_000_000
"""Images of one camera that are kept once they were read; others are read again."""


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

        Raises ForeignError for others, and for files that are none.
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
        # Bright and dark are asked for by each direction, and small sets by every test.
        if image.nbytes * (len(self._kept) + 1) <= KEPT_BYTES:
            self._kept[number] = image
        return image

    def _alike(self, frame: Frame, image: NDArray[Any]) -> None:
        if image.shape != self.shape[1:] or image.dtype != self.dtype:
            raise ForeignError(
                f"{frame.path.parent / frame.name}: {image.shape[1]} x {image.shape[0]} px {image.dtype}, and "
                f"{self.frames[0].name} has "
                f"{self.shape[2]} x {self.shape[1]} px {self.dtype}; images of one camera must be alike: name others "
                "with -"
            )


@dataclass(frozen=True, slots=True, eq=False)
class ImageSet:
    """One camera's images."""

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
        wanted = ShownImage(shows, axis, index)
        return self.images[self.shown.index(wanted)] if wanted in self.shown else None

    def all_of(self, shows: Shows, axis: str, period: int = 0) -> NDArray[Any]:
        """Return all images (n, h, w) of a kind, in their order."""
        wanted = [k for k, one in enumerate(self.shown) if (one.shows, one.axis, one.period) == (shows, axis, period)]
        # In one piece, which is given back as such.
        found = np.empty((len(wanted), *self.shape), self.images.dtype)
        for place, k in enumerate(wanted):
            found[place] = self.images[k]
        return found


def natural_key(text: str) -> list[tuple[int, int, str]]:
    """Return what sorts names as people do: ``a2`` before ``a10``."""
    parts = re.split(r"(\d+)", text)
    return [(0, int(part), "") if part.isdigit() else (1, 0, part.lower()) for part in parts if part]


def read_side(description: Description, side: str) -> ImageSet:
    """Return the images of one camera, of which those of 16 bits are read.

    Raises ForeignError for files that are missing, of different sizes, or no images.
    """
    found = first_of_side(description, side)
    return replace(found, white=description.white or _white(found.images))


def first_of_side(description: Description, side: str) -> ImageSet:
    """Return the images of one camera by the headers of their files, none of which is decoded.

    Raises ForeignError for files that are missing, of different sizes, or no images.
    """
    kept = [
        (file, one) for file, one in zip(*named_files(description, side), strict=True) if one.shows is not Shows.OTHER
    ]
    if not kept:
        raise ForeignError("all images are named -; name what they show")
    files, shown = zip(*kept, strict=True)
    return ImageSet(shown, files, Pictures.of(files, description.channel), description.white or FULL_SCALES[0])


def _white(images: Pictures) -> float:
    """Return the least grey value of saturation that no pixel exceeds.

    Sensors of fewer bits may lie at the upper end of 16, where each value is a multiple of their last one.
    """
    if images.dtype == np.uint8:
        return FULL_SCALES[0]
    brightest, bits = 0, 0
    for k in range(len(images)):
        brightest = max(brightest, int(images[k].max()))
        bits |= int(np.bitwise_or.reduce(images[k], axis=None))
    scale = next(one for one in FULL_SCALES if brightest <= one)
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


def named_files(description: Description, side: str) -> tuple[list[Frame], tuple[ShownImage, ...]]:
    """Return the files of one camera and what they show.

    Raises ForeignError for files that are missing, too few or too many.
    """
    wanted = description.files[side]
    key = f"images.{'both' if wanted.sides else side}"
    named = [
        (frame, word)
        for pattern, word in zip_longest(wanted.patterns, wanted.kinds, fillvalue="")
        for frame in matching(description.folder, pattern, f"{key}.{word}" if word else key)
    ]
    found = of_channel(of_side([frame for frame, _ in named], wanted.sides, side), description.channel)
    if description.order is None:
        # Each kind's own images, and three times as many where every channel is one.
        return found, number_images([word for _, word in named for _ in range(len(found) // len(named))], key)
    if len(found) != len(description.order):
        raise ForeignError(
            f"{key}: {len(found)} images ({found[0].name} to {found[-1].name}), and images.order names "
            f"{len(description.order)} images; "
            "name as many, with - for what shows something else"
        )
    return found, description.order


def of_channel(frames: Sequence[Frame], channel: str) -> list[Frame]:
    """Return the images of pictures: three of each where every channel is one."""
    channels = ("red", "green", "blue") if channel == EACH else ("",)
    return [replace(frame, channel=one) for frame in frames for one in channels]


def of_side(frames: Sequence[Frame], sides: str, side: str) -> list[Frame]:
    """Return one camera's images of those that both share, ``sides`` saying how; all where it is empty.

    Raises ForeignError.
    """
    if sides in HALVES:
        return [replace(frame, half=HALVES[sides][SIDES.index(side)]) for frame in frames]
    turns = words_in(sides, "images.sides") or [side]
    if len(frames) % len(turns):
        raise ForeignError(
            f"images.both: {len(frames)} images, which are no whole number of turns of {len(turns)}; correct "
            "images.sides, or name the images "
            "that belong to it"
        )
    return [frame for k, frame in enumerate(frames) if turns[k % len(turns)] == side]


def matching(folder: Path, named: str, key: str) -> list[Frame]:
    """Return the images of the files that a name with wildcards means, in natural order.

    Raises ForeignError where there is none.
    """
    pattern, array = split_name(named)
    place = Path(pattern)
    try:
        if place.is_absolute():
            found = list(Path(place.anchor).glob(str(place.relative_to(place.anchor))))
        else:
            found = list(folder.glob(pattern))
    except (ValueError, NotImplementedError, OSError) as error:
        raise ForeignError(f"{key}: {pattern!r:.80} is no name of files ({error}); correct it") from error
    files = sorted((path for path in found if path.is_file()), key=lambda path: natural_key(str(path)))
    if not files:
        raise ForeignError(f"{key}: no file is called {pattern!r:.80} in {folder.absolute()}; correct the name")
    return [frame for path in files for frame in frames_in(path, array)]
