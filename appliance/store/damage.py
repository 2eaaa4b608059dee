"""Owns which of a scan's frames are damaged, found by their own checksums.

It also owns what can still be made of a scan with damaged frames: the others say what the lost one was, and the cloud
says so.

Per camera and sequence, one of each of these can be missed:

    one of the four sine images of a direction   I(k) = I(k+1) + I(k-1) - I(k+2): the sum of opposite steps of 90° is the same
                                                 for both pairs. It is the three-step phase of the other images; its variance
                                                 is up to three times that of four steps, and so counted; what harmonics of
                                                 the projector then leave in it is measured as ripple, as ever.
    the bright or the dark image                 the mean of those Gray images in which the pixel is lit, or is not

A Gray image cannot be missed: it alone tells which of several fringes a pixel sees, and the point would be wrong by
whole fringes. Of two exposures, one that is whole is a scan by itself. What a salvaged cloud shows may be looked at; it
never calibrates and is never evaluated, since movement and flickering light show in what is made up here.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from appliance.measure import (
    PHASE_STEPS,
    SIDES,
    CameraNoise,
    Direction,
    Kind,
    PatternSequence,
    StereoNoise,
    of_side,
)
from appliance.store import scan as stored
from appliance.store.manifest import Manifest
from appliance.store.packed import PackedError, packed_path, read_index
from appliance.store.scan import (
    FRAME_FILES,
    SECOND_FILES,
    ScanError,
    StoredScan,
    frame_checks,
    frames_file,
    second_frames_file,
)

HEADER_BYTES = 128
"""Length of the header of every file of frames: NumPy's format 1.0 pads so short a header to this."""
Frames = NDArray[np.uint8]
SATURATED = 255
CLEARLY = 0.9
"""Share of the way from a pixel's darkest to its brightest Gray image: beyond, it is lit in that image, and is not at
the border of a stripe; likewise from the other end."""
THREE_STEP_VARIANCE = 3.0
"""Variance of a phase from three of four steps, at most, over that of four: 6 σ² in the difference that the lost step
is in, not 2 σ²."""
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
    for file in FRAME_FILES:
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
    for file in FRAME_FILES:
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


@dataclass(frozen=True, slots=True, eq=False)
class Salvaged:
    """A scan whose lost frames were made up from the others."""

    scan: StoredScan
    notes: tuple[str, ...]
    """The words for what was lost and what stands in its place; empty: nothing was damaged."""
    variance: Mapping[str, float]
    """Factor by side with which the variance of grey values is to be multiplied, at most."""

    def noise(self, noise: StereoNoise) -> StereoNoise:
        """Return the noise that points of this scan are to be expected to have, from that of a whole one."""
        return StereoNoise(*(_times(of_side(noise, side), self.variance[side]) for side in SIDES))

    @classmethod
    def of(cls, folder: Path) -> Salvaged:
        """Open a scan, damaged or not. Raises ScanError that names what cannot be done without."""
        manifest = StoredScan.manifest_of(folder)
        damaged = damaged_frames(folder, manifest)
        if not damaged:
            return cls(StoredScan.load(folder, only_raw=True), (), dict.fromkeys(SIDES, 1.0))
        second = manifest.record.second
        of_second = [one for one in damaged if one.file in SECOND_FILES]
        of_first = [one for one in damaged if one.file not in SECOND_FILES]
        notes = [f"damaged: {one}" for one in damaged]
        if second is not None and of_first and not of_second:
            alone = replace(manifest.record, exposure=second.exposure, second=None)
            frames = {side: frames_as_they_are(folder, manifest, second_frames_file(side)) for side in SIDES}
            notes.append("only the second exposure was used")
            return cls(
                StoredScan(folder, replace(manifest, record=alone), frames), tuple(notes), dict.fromkeys(SIDES, 1.0)
            )
        if second is not None:
            manifest = replace(manifest, record=replace(manifest.record, second=None))
            notes.append("only the first exposure was used")
        sequence = StoredScan(folder, manifest, {}).sequence
        frames, variance = {}, dict.fromkeys(SIDES, 1.0)
        for side in SIDES:
            frames[side] = frames_as_they_are(folder, manifest, frames_file(side))
            lost = next((one for one in of_first if one.file == frames_file(side)), None)
            if lost is not None:
                variance[side] = _make_up(frames[side], sequence, lost.frames, f"{folder}: {lost}", notes)
        return cls(StoredScan(folder, manifest, frames), tuple(notes), variance)


def _make_up(frames: Frames, sequence: PatternSequence, lost: Sequence[int], what: str, notes: list[str]) -> float:
    """Fill in the ``lost`` of one camera's frames, in place; the factor of variance that this costs."""
    gray = [k for direction in Direction for k in sequence.axis(direction).gray]
    variance = 1.0
    for k in lost:
        pattern = sequence.patterns[k]
        if pattern.kind is Kind.GRAY:
            raise ScanError(
                f"{what}: {pattern.name} cannot be missed, since nothing else tells which fringe a pixel sees; bring "
                "the folder "
                "back from a copy"
            )
        if pattern.kind is Kind.SINE:
            steps = sequence.axis(pattern.direction).sine
            if any(other in lost for other in steps if other != k):
                raise ScanError(
                    f"{what}: two of the four sine images of a direction are lost; bring the folder back from a copy"
                )
            # In the order after, opposite, before: I(k) = I(k+1) + I(k−1) − I(k+2), indices modulo 4.
            frames[k] = _sine(*(frames[steps[(pattern.index + by) % PHASE_STEPS]] for by in (1, 2, 3)))
            variance = THREE_STEP_VARIANCE
            notes.append(f"{pattern.name} was made up from the other three steps")
    if sequence.bright in lost and sequence.dark in lost:
        raise ScanError(f"{what}: bright and dark image are both lost; bring the folder back from a copy")
    for k, lit in ((sequence.bright, True), (sequence.dark, False)):
        if k in lost:
            frames[k] = _reference(frames[gray], lit=lit)
            notes.append(f"{sequence.patterns[k].name} was made up from the Gray images")
    return variance


def _sine(after: Frames, opposite: Frames, before: Frames) -> Frames:
    """Return the lost step, from the other three; ``SATURATED``, which makes no point, where it is out of range or
    they are."""
    # Signed and wider: the sum of two bytes less a third lies between −255 and 510.
    made: NDArray[np.int16] = after.astype(np.int16) + before - opposite
    useless = (made < 0) | (made > SATURATED) | (np.maximum(np.maximum(after, before), opposite) == SATURATED)
    made[useless] = SATURATED
    return made.astype(np.uint8)


def _reference(gray: Frames, *, lit: bool) -> Frames:
    """Return the bright (``lit``) or the dark image, from the Gray images (n, h, w), each pixel of which is lit in
    some."""
    low, high = gray.min(axis=0).astype(np.float32), gray.max(axis=0).astype(np.float32)
    share = CLEARLY if lit else 1.0 - CLEARLY
    border = low + np.float32(share) * (high - low)
    # Images in which a stripe's border crosses the pixel are neither bright nor dark.
    used = gray >= border if lit else gray <= border
    total = np.where(used, gray, 0).sum(axis=0, dtype=np.float32)
    mean: NDArray[np.float32] = np.rint(total / used.sum(axis=0))
    return mean.astype(np.uint8)


def _times(noise: CameraNoise, variance: float) -> CameraNoise:
    # Variance = read² + dn_per_e · light: both terms grow by the same factor.
    return CameraNoise(noise.read_dn * math.sqrt(variance), noise.dn_per_e * variance, noise.black_dn)
