"""Owns which of a scan's frames are damaged, found by their own checksums."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from appliance.store import scan as stored
from appliance.store.manifest import Manifest
from appliance.store.packed import PackedError, packed_path, read_index
from appliance.store.scan import RAW_FILES, SECOND_FILES, ScanError, frame_checks

HEADER_BYTES = 128
"""Length of the header of every file of frames: NumPy's format 1.0 pads so short a header to this."""
MOST_NAMED = 6
"""Frames, in one line."""


@dataclass(frozen=True, slots=True)
class DamagedFrames:
    """One file of frames that is not what was recorded."""

    file: str
    problem: str
    """Kind of the damage in words: missing, too short, damaged."""
    frames: tuple[int, ...]
    """Numbers of the damaged ones; all others are whole."""
    names: tuple[str, ...]
    """Names of the damaged frames' patterns."""

    def __str__(self) -> str:
        which = "" if not self.frames else f" in {', '.join(self.names)}"
        if len(self.frames) > MOST_NAMED:
            which = f" in {len(self.frames)} frames"
        return f"{self.file}: {self.problem}{which}"


def damaged_frames(folder: Path, manifest: Manifest) -> tuple[DamagedFrames, ...]:
    """Compare every byte of the frames with its checksum; empty where all are whole."""
    wrong = stored.wrong_files(folder, manifest, checksums=True)
    names = manifest.record.sequence.patterns
    found = []
    for file in (*RAW_FILES, *SECOND_FILES):
        if file in wrong:
            frames = _which(folder, manifest, file)
            found.append(DamagedFrames(file, wrong[file], frames, tuple(names[k] for k in frames)))
    return tuple(found)


def frames_as_they_are(folder: Path, manifest: Manifest, file: str) -> NDArray[np.uint8]:
    """Return the frames of a damaged ``file``, (n, h, w) uint8; what is missing at its end is 0. Raises ScanError.

    A header that is damaged is made up from that of the other files of frames: all cameras have the same size.
    """
    count = len(manifest.record.sequence.patterns)
    shape = _shape(folder, manifest, count)
    if shape is None:
        raise ScanError(
            f"{folder / file}: nothing is left that says how large its frames are; bring it back from a copy"
        )
    if stored.is_packed(folder, file):
        return _unpacked(packed_path(folder / file), (count, *shape))
    pixels = count * shape[0] * shape[1]
    frames = np.zeros(pixels, np.uint8)
    try:
        # The header has a fixed length, so that pixels can be found also behind a damaged one.
        raw = np.frombuffer((folder / file).read_bytes(), np.uint8)[HEADER_BYTES:]
    except FileNotFoundError:
        raw = frames[:0]
    except OSError as error:
        raise ScanError(f"{folder / file}: {error.strerror or error}") from error
    frames[: min(pixels, raw.size)] = raw[:pixels]
    return frames.reshape(count, *shape)


def _unpacked(path: Path, shape: tuple[int, int, int]) -> NDArray[np.uint8]:
    """Return the frames of a packed file that can be decoded; the others are 0."""
    frames = np.zeros(shape, np.uint8)
    try:
        index = read_index(path)
    except (PackedError, OSError):
        return frames
    if (index.count, index.height_px, index.width_px) != shape:
        return frames
    for k in range(shape[0]):
        # Each frame is a stream of its own: a damaged one takes no other with it.
        with suppress(PackedError, OSError):
            frames[k] = index.frame(k)
    return frames


def _which(folder: Path, manifest: Manifest, file: str) -> tuple[int, ...]:
    count = len(manifest.record.sequence.patterns)
    known = manifest.frame_crc32.get(file, ())
    if len(known) != count or _shape(folder, manifest, count) is None:
        return tuple(range(count))
    found = frame_checks(frames_as_they_are(folder, manifest, file))
    return tuple(k for k in range(count) if found[k] != known[k])


def _shape(folder: Path, manifest: Manifest, count: int) -> tuple[int, int] | None:
    """Return the height and width of the frames, as the first header says that can be read and fits its file's recorded
    length."""
    for file in (*RAW_FILES, *SECOND_FILES):
        if file not in manifest.files:
            continue
        if stored.is_packed(folder, file):
            with suppress(PackedError, OSError):
                index = read_index(packed_path(folder / file))
                if index.count == count and index.stamp == manifest.files[file]:
                    return index.height_px, index.width_px
            continue
        try:
            with (folder / file).open("rb") as opened:
                header = stored.read_header(opened.read(2 * HEADER_BYTES))
        except OSError:
            continue
        if header is not None and header[1][0] == count:
            header_bytes, (_, height, width) = header
            if header_bytes == HEADER_BYTES and count * height * width == manifest.files[file].length - HEADER_BYTES:
                return height, width
    return None


def refuse_damaged_frames(folder: Path) -> None:
    """Compare every byte of a scan's frames with its checksum.

    Raises ScanError that names every damaged file, and the frame where that is known.
    """
    manifest = stored.manifest_of(folder)
    damaged = damaged_frames(folder, manifest)
    if damaged:
        told = "; ".join(str(one) for one in damaged)
        raise ScanError(
            f"{folder}: {told}; bring the scan's folder back from a copy, or see what `kingfisher cloud` makes without "
            "(.ply)"
        )
