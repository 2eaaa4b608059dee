"""Owns the images of a foreign set: which files a description means, and their grey values.

Any format that OpenCV reads, pages of a TIFF and NumPy's stacks (``frames``), 8 or 16 bits, grey or colour; files of one name with
wildcards come in natural order (2 before 10).
"""

from __future__ import annotations

import re
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from appliance.foreign.description import Description, ImageFiles
from appliance.foreign.frames import Frame, frames_in, raw_images, split_name
from appliance.foreign.order import ShownImage, Shows, numbered
from appliance.foreign.problem import ForeignError

FULL_SCALES = (255.0, 1023.0, 4095.0, 16383.0, 65535.0)
"""Grey values of saturation that sensors have."""
CHANNEL_NUMBER = {"blue": 0, "green": 1, "red": 2}
LOSSY = (".jpg", ".jpeg", ".webp")


@dataclass(frozen=True, slots=True, eq=False)
class ImageSet:
    """One camera's images."""

    shown: tuple[ShownImage, ...]
    files: tuple[Frame, ...]
    images: NDArray[Any]
    """(n, h, w) uint8 or uint16."""
    white: float
    """Grey value from which on a pixel is saturated."""

    @property
    def shape(self) -> tuple[int, int]:
        """(h, w)."""
        return int(self.images.shape[1]), int(self.images.shape[2])

    def find(self, shows: Shows, axis: str = "", index: int = 0, period: int = 0) -> int | None:
        """Return the number of an image; ``None`` where there is none."""
        wanted = ShownImage(shows, axis, index, period)
        return self.shown.index(wanted) if wanted in self.shown else None

    def image(self, shows: Shows, axis: str = "", index: int = 0, period: int = 0) -> NDArray[Any] | None:
        """Return an image (h, w); ``None`` where there is none."""
        number = self.find(shows, axis, index, period)
        return None if number is None else self.images[number]


def natural_key(text: str) -> list[tuple[int, int, str]]:
    """Return what sorts names as people do: ``a2`` before ``a10``."""
    parts = re.split(r"(\d+)", text)
    return [(0, int(part), "") if part.isdigit() else (1, 0, part.lower()) for part in parts if part]


def read_side(description: Description, side: str) -> ImageSet:
    """Read the images of one camera. Raises ForeignError for files that are missing, of different sizes, or no images."""
    files, shown = named_files(description, side)
    return read_images(files, shown, description.channel, description.white)


def first_of_side(description: Description, side: str) -> ImageSet:
    """Return what all images of one camera show, with the first one of them alone: its size and kind are those of all. Raises
    ForeignError for files that are missing, or a first one that is no image."""
    files, shown = named_files(description, side)
    kept = [k for k, one in enumerate(shown) if one.shows is not Shows.OTHER]
    first = read_images(files[: kept[0] + 1], shown[: kept[0] + 1], description.channel, description.white)
    return replace(first, shown=tuple(shown[k] for k in kept), files=tuple(files[k] for k in kept))


def read_images(
    files: tuple[Frame, ...], shown: tuple[ShownImage, ...], channel: str, white: float | None = None
) -> ImageSet:  # fmt: skip
    """Read ``files``, of which ``shown`` says what each shows; images that show something else are left out. Raises ForeignError."""
    kept = [k for k, one in enumerate(shown) if one.shows is not Shows.OTHER]
    images: NDArray[Any] | None = None
    raw = raw_images([files[k] for k in kept])
    for n, k in enumerate(kept):
        image = _grey(files[k], raw[n], channel)
        if images is None:
            images = np.empty((len(kept), *image.shape), image.dtype)
        if image.shape != images.shape[1:] or image.dtype != images.dtype:
            raise ForeignError(
                f"{files[k].path.parent / files[k].name}: {image.shape[1]} x {image.shape[0]} px {image.dtype}, and {files[kept[0]].name} has {images.shape[2]} x "
                f"{images.shape[1]} px {images.dtype}; images of one camera must be alike: name others with -"
            )
        images[n] = image
    if images is None:
        raise ForeignError("all images are named -; name what they show")
    brightest = float(images.max())
    scale = white or next(one for one in FULL_SCALES if brightest <= one)
    return ImageSet(tuple(shown[k] for k in kept), tuple(files[k] for k in kept), images, scale)


def read_image(frame: Frame, channel: str) -> NDArray[Any]:
    """Return one image (h, w) uint8 or uint16. Raises ForeignError."""
    return _grey(frame, raw_images([frame])[0], channel)


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


def named_files(description: Description, side: str) -> tuple[tuple[Frame, ...], tuple[ShownImage, ...]]:
    """Return the files of one camera and what they show. Raises ForeignError for files that are missing, too few or too many."""
    wanted = description.files[side]
    if description.order is None:
        return _by_word(description, side, wanted)
    key = f"images.{'both' if wanted.turns else side}"
    found = [frame for pattern in wanted.patterns for frame in matching(description.folder, pattern, key)]
    if wanted.turns:
        if len(found) % len(wanted.turns):
            raise ForeignError(
                f"{key}: {len(found)} images, which are no whole number of turns of {len(wanted.turns)}; correct images.sides, or name the "
                "images that belong to it"
            )
        found = [frame for k, frame in enumerate(found) if wanted.turns[k % len(wanted.turns)] == side]
    if len(found) != len(description.order):
        raise ForeignError(
            f"{key}: {len(found)} {'images' if wanted.turns else 'files'} ({found[0].name} to {found[-1].name}), and images.order names {len(description.order)} images; "
            "name as many, with - for what shows something else"
        )
    return tuple(found), description.order


def _by_word(
    description: Description, side: str, wanted: ImageFiles
) -> tuple[tuple[Frame, ...], tuple[ShownImage, ...]]:
    files: list[Frame] = []
    words: list[str] = []
    for word, patterns in wanted.by_word:
        key = f"images.{side}.{word}"
        found = [path for pattern in patterns for path in matching(description.folder, pattern, key)]
        files += found
        words += [word] * len(found)
    return tuple(files), numbered(words, f"images.{side}")


def matching(folder: Path, named: str, key: str) -> list[Frame]:
    """Return the images of the files that a name with wildcards means, in natural order. Raises ForeignError where there is none."""
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
