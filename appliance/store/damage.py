"""Finding the damaged frames of a scan by their checksums, and salvaging the scan.

Salvaging computes lost frames from the others, and the cloud says so. In each camera and sequence one frame of each of
these kinds may be lost:

    one of the four sine images of a direction   I(k) = I(k+1) + I(k-1) - I(k+2): the sum of opposite steps of 90° is the same
                                                 for both pairs. It is the three-step phase of the other images; its variance
                                                 is up to three times that of four steps, and so counted; the harmonics that
                                                 the projector then leaves in it are measured as ripple, as ever.
    the bright or the dark image                 the mean of those Gray images in which the pixel is lit, or is not

A lost Gray image cannot be salvaged: it alone tells which of several fringes a pixel sees, and the point would be wrong
by whole fringes. Of two exposures, one that is undamaged is a scan by itself. A salvaged cloud is for looking at only;
it never calibrates and is never evaluated, since movement and flickering light show in the computed frames.
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
"""Position between a pixel's darkest (0) and brightest (1) Gray image: above it, the pixel is lit in that image and not
at the border of a stripe; below one minus it, it is dark.
"""
THREE_STEP_VARIANCE = 3.0
"""Largest variance of a phase from three of four steps, relative to that from four: the difference with the lost step
has 6 σ² instead of 2 σ²."""
MOST_NAMED = 6
"""Largest number of frames that are named in one line."""


@dataclass(frozen=True, slots=True)
class DamagedFrames:
    """One file of frames with damage."""

    file: str
    problem: str
    """Kind of the damage in words: missing, too short, damaged."""
    frames: tuple[int, ...]
    """Numbers of the damaged frames."""
    names: tuple[str, ...]
    """Names of the damaged frames' patterns."""

    def __str__(self) -> str:
        which = "" if not self.frames else f" in {', '.join(self.names)}"
        if len(self.frames) > MOST_NAMED:
            which = f" in {len(self.frames)} frames"
        return f"{self.file}: {self.problem}{which}"


def damaged_frames(folder: Path, manifest: Manifest) -> tuple[DamagedFrames, ...]:
    """Compare all files of frames with their checksums, and return the damaged ones."""
    wrong = stored.wrong_files(folder, manifest, checksums=True)
    names = manifest.record.sequence.patterns
    damages = []
    for file in FRAME_FILES:
        if file in wrong:
            frames = _which(folder, manifest, file)
            damages.append(DamagedFrames(file, wrong[file], frames, tuple(names[k] for k in frames)))
    return tuple(damages)


def frames_as_they_are(folder: Path, manifest: Manifest, file: str) -> NDArray[np.uint8]:
    """Return the frames of a damaged ``file``, (n, h, w) uint8, 0 at a missing end. Raises ScanError.

    A damaged header is replaced by that of another file of frames: all cameras have the same size.
    """
    count = len(manifest.record.sequence.patterns)
    shape = _shape(folder, manifest, count)
    if shape is None:
        raise ScanError(f"{folder / file}: the size of its frames is lost; restore it from a copy")
    if stored.is_packed(folder, file):
        return _unpacked(packed_path(folder / file), (count, *shape))
    pixels = count * shape[0] * shape[1]
    frames = np.zeros(pixels, np.uint8)
    try:
        # The header has a fixed length, so that pixels are found behind a damaged one, too.
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
        # Each frame is a stream of its own: damage in one does not affect the others.
        with suppress(PackedError, OSError):
            frames[k] = index.frame(k)
    return frames


def _which(folder: Path, manifest: Manifest, file: str) -> tuple[int, ...]:
    count = len(manifest.record.sequence.patterns)
    recorded = manifest.frame_crc32.get(file, ())
    if len(recorded) != count or _shape(folder, manifest, count) is None:
        return tuple(range(count))
    computed = frame_checks(frames_as_they_are(folder, manifest, file))
    return tuple(k for k in range(count) if computed[k] != recorded[k])


def _shape(folder: Path, manifest: Manifest, count: int) -> tuple[int, int] | None:
    """Return the height and width of the frames.

    They are from the first header that can be read and fits its file's recorded length.
    """
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
class SalvagedScan:
    """A scan whose lost frames were computed from the others."""

    scan: StoredScan
    notes: tuple[str, ...]
    """Sentences that name the lost frames and their substitutes; empty: no frame was damaged."""
    variance: Mapping[str, float]
    """Largest factor, by side, by which the variance of grey values grows."""

    def noise(self, noise: StereoNoise) -> StereoNoise:
        """Return the expected noise of this scan's points, from the ``noise`` of an undamaged scan."""
        return StereoNoise(*(_times(of_side(noise, side), self.variance[side]) for side in SIDES))

    @classmethod
    def of(cls, folder: Path) -> SalvagedScan:
        """Open a scan and compute its lost frames from the others.

        Raises ScanError where these do not suffice.
        """
        manifest = StoredScan.manifest_of(folder)
        damaged = damaged_frames(folder, manifest)
        if not damaged:
            return cls(StoredScan.load(folder, only_raw=True), (), dict.fromkeys(SIDES, 1.0))
        second = manifest.record.second
        of_second = [damage for damage in damaged if damage.file in SECOND_FILES]
        of_first = [damage for damage in damaged if damage.file not in SECOND_FILES]
        notes = [f"damaged: {damage}" for damage in damaged]
        if second is not None and of_first and not of_second:
            alone = replace(manifest.record, exposure=second.exposure, second=None)
            frames = {side: frames_as_they_are(folder, manifest, second_frames_file(side)) for side in SIDES}
            notes.append("only the second exposure is used")
            return cls(
                StoredScan(folder, replace(manifest, record=alone), frames), tuple(notes), dict.fromkeys(SIDES, 1.0)
            )
        if second is not None:
            manifest = replace(manifest, record=replace(manifest.record, second=None))
            notes.append("only the first exposure is used")
        sequence = StoredScan(folder, manifest, {}).sequence
        frames, variance = {}, dict.fromkeys(SIDES, 1.0)
        for side in SIDES:
            frames[side] = frames_as_they_are(folder, manifest, frames_file(side))
            loss = next((damage for damage in of_first if damage.file == frames_file(side)), None)
            if loss is not None:
                variance[side] = _make_up(frames[side], sequence, loss.frames, f"{folder}: {loss}", notes)
        return cls(StoredScan(folder, manifest, frames), tuple(notes), variance)


def _make_up(frames: Frames, sequence: PatternSequence, lost: Sequence[int], what: str, notes: list[str]) -> float:
    """Compute the ``lost`` frames of one camera in place, and return the factor of variance."""
    gray = [k for direction in Direction for k in sequence.axis(direction).gray]
    variance = 1.0
    for k in lost:
        pattern = sequence.patterns[k]
        if pattern.kind is Kind.GRAY:
            raise ScanError(
                f"{what}: {pattern.name} is lost, and no other frame gives the fringe order; restore the "
                "folder from a copy"
            )
        if pattern.kind is Kind.SINE:
            steps = sequence.axis(pattern.direction).sine
            if any(step in lost for step in steps if step != k):
                raise ScanError(
                    f"{what}: two of the four sine frames of a direction are lost; restore the folder from a copy"
                )
            # The steps after, opposite and before: I(k) = I(k+1) + I(k−1) − I(k+2), indices modulo 4.
            frames[k] = _sine(*(frames[steps[(pattern.index + offset) % PHASE_STEPS]] for offset in (1, 2, 3)))
            variance = THREE_STEP_VARIANCE
            notes.append(f"{pattern.name} is computed from the other three phase steps")
    if sequence.bright in lost and sequence.dark in lost:
        raise ScanError(f"{what}: bright and dark frame are both lost; restore the folder from a copy")
    for k, is_bright in ((sequence.bright, True), (sequence.dark, False)):
        if k in lost:
            frames[k] = _reference(frames[gray], is_bright=is_bright)
            notes.append(f"{sequence.patterns[k].name} is computed from the Gray code frames")
    return variance


def _sine(after: Frames, opposite: Frames, before: Frames) -> Frames:
    """Return the lost sine step, computed from the other three.

    It is ``SATURATED``, which makes no point, where it is out of range or one of the three is saturated.
    """
    # Signed and wider than a byte: the result lies between −255 and 510.
    frame: NDArray[np.int16] = after.astype(np.int16) + before - opposite
    invalid = (frame < 0) | (frame > SATURATED) | (np.maximum(np.maximum(after, before), opposite) == SATURATED)
    frame[invalid] = SATURATED
    return frame.astype(np.uint8)


def _reference(gray: Frames, *, is_bright: bool) -> Frames:
    """Return the bright or the dark image, computed from the Gray images (n, h, w).

    Each pixel must be bright in one of them at least.
    """
    low, high = gray.min(axis=0).astype(np.float32), gray.max(axis=0).astype(np.float32)
    share = CLEARLY if is_bright else 1.0 - CLEARLY
    border = low + np.float32(share) * (high - low)
    # Images in which a stripe's border crosses the pixel are neither bright nor dark.
    used = gray >= border if is_bright else gray <= border
    total = np.where(used, gray, 0).sum(axis=0, dtype=np.float32)
    mean: NDArray[np.float32] = np.rint(total / used.sum(axis=0))
    return mean.astype(np.uint8)


def _times(noise: CameraNoise, variance: float) -> CameraNoise:
    # Variance = read² + dn_per_e · light: both terms grow by the same factor.
    return CameraNoise(noise.read_dn * math.sqrt(variance), noise.dn_per_e * variance, noise.black_dn)
