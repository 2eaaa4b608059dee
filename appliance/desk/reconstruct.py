"""Owns the cloud of a stored scan made again from its raw frames: the file, and the report of what it says.

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

import hashlib
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from appliance.base import Progress
from appliance.measure import (
    PHASE_STEPS,
    SIDES,
    Calibration,
    CameraNoise,
    Direction,
    Kind,
    PatternSequence,
    StereoNoise,
    build_sequence,
    of_side,
)
from appliance.store import (
    CLOUD_FILE,
    SECOND_FILES,
    Bytes,
    Chosen,
    Instrument,
    LocalFileSystem,
    ReprocessedScan,
    Rig,
    ScanError,
    SourceScan,
    StoredScan,
    damaged_frames,
    encode_ply,
    frames_as_they_are,
    frames_file,
    load_scan,
    lost,
    manifest_of,
    refuse_empty,
    reprocess_bracket,
    reprocess_scan,
    second_frames_file,
)

Frames = NDArray[np.uint8]
SATURATED = 255
CLEARLY = 0.9
"""Share of the way from a pixel's darkest to its brightest Gray image: beyond, it is lit in that image, and is not at
the border of a stripe; likewise from the other end."""
THREE_STEP_VARIANCE = 3.0
"""Variance of a phase from three of four steps, at most, over that of four: 6 σ² in the difference that the lost step
is in, not 2 σ²."""


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


def salvage(folder: Path) -> Salvaged:
    """Open a scan, damaged or not. Raises ScanError that names what cannot be done without."""
    manifest = manifest_of(folder)
    damaged = damaged_frames(folder, manifest)
    if not damaged:
        return Salvaged(load_scan(folder, only_raw=True), (), dict.fromkeys(SIDES, 1.0))
    second = manifest.record.second
    of_second = [one for one in damaged if one.file in SECOND_FILES]
    of_first = [one for one in damaged if one.file not in SECOND_FILES]
    notes = [f"damaged: {one}" for one in damaged]
    if second is not None and of_first and not of_second:
        alone = replace(manifest.record, exposure=second.exposure, second=None)
        frames = {side: frames_as_they_are(folder, manifest, second_frames_file(side)) for side in SIDES}
        notes.append("only the second exposure was used")
        return Salvaged(
            StoredScan(folder, replace(manifest, record=alone), frames), tuple(notes), dict.fromkeys(SIDES, 1.0)
        )
    if second is not None:
        manifest = replace(manifest, record=replace(manifest.record, second=None))
        notes.append("only the first exposure was used")
    made = manifest.record.sequence
    sequence = build_sequence(made.period_px, made.width_px, made.height_px)
    frames, variance = {}, dict.fromkeys(SIDES, 1.0)
    for side in SIDES:
        frames[side] = frames_as_they_are(folder, manifest, frames_file(side))
        lost = next((one for one in of_first if one.file == frames_file(side)), None)
        if lost is not None:
            variance[side] = _make_up(frames[side], sequence, lost.frames, f"{folder}: {lost}", notes)
    return Salvaged(StoredScan(folder, manifest, frames), tuple(notes), variance)


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


def reconstruct_scan(
    source: SourceScan,
    chosen: Chosen,
    out: Path,
    progress: Progress,
    salvaged: Salvaged | None = None,
) -> dict[str, Any]:
    """Make the cloud of a stored scan from its raw frames, written as PLY to ``out``.

    The same frames, calibration and version give the same points as on the instrument; ``stored_cloud`` says what
    became of those that the instrument stored. Of a ``salvaged`` scan, which ``source`` is then of, file and report say
    what was lost. Raises ScanError, also where no points are left; CalibrationError, OSError.
    """
    scan, rig, calibration = source.scan, source.rig, chosen.calibration
    record = scan.manifest.record
    notes = salvaged.notes if salvaged is not None else ()
    worked = work_through(scan, rig, calibration, progress, salvaged)
    progress("writing")
    header, body = encode_ply(worked.cloud, "; ".join(notes) or None)
    before = _stored_cloud(scan, header, body)  # compared before it may be written over
    LocalFileSystem().replace_file(out, header, body)
    s = worked.cloud.summary
    return {
        "scan": scan.manifest.scan_id,
        "file": str(out),
        "points": s.points,
        "coverage_percent": s.coverage_percent,
        "distance_mm": s.distance_mm,
        "noise_mm": s.noise_mm,
        "gap_mm": s.gap_mm,
        "exposure": Instrument(rig).exposures_label(record),
        "period_px": record.sequence.period_px,
        "stored_cloud": before,
        "salvaged": list(notes) or None,
        "calibration": calibration.hash,
        "calibration_from": chosen.whose,
        "calibration_method": calibration.method,
        "same_calibration": calibration.hash == record.calibration_hash,
        "water_index": worked.water.index,
        "warnings": [f"{fault.code.value}: {fault.detail}" for fault in worked.faults],
    }


def _stored_cloud(scan: StoredScan, *parts: Bytes) -> str:
    """Return what became of the cloud that the instrument stored, beside the new one in ``parts``."""
    stamp = scan.manifest.files.get(CLOUD_FILE)
    if stamp is None:
        return "none was stored"
    digest = hashlib.sha256()
    for part in parts:
        digest.update(part)
    # By its checksum in the manifest, so that it can be said also where the stored cloud itself is damaged or gone.
    same = digest.hexdigest() == stamp.sha256
    problem = lost(scan.folder, scan.manifest, CLOUD_FILE)
    if problem is None:
        return "the same, byte for byte" if same else "other points"
    return f"{CLOUD_FILE}: {problem}; {'made again, byte for byte' if same else 'these are not the points it had'}"


def work_through(
    scan: StoredScan,
    rig: Rig,
    calibration: Calibration,
    progress: Progress,
    salvaged: Salvaged | None = None,
) -> ReprocessedScan:
    """Reconstruct and judge a scan, one sequence or both. Raises ScanError, also where no points are left."""
    record = scan.manifest.record
    settings = Instrument(rig).settings_of_scan(record)
    if salvaged is not None:
        # A made-up frame is noisier than a recorded one, and the points' sigmas must say so.
        settings = replace(settings, noise=salvaged.noise(settings.noise))
    if scan.second is None or record.second is None:
        worked = reprocess_scan(scan, calibration, settings, progress)
    else:
        both = (settings, Instrument(rig).settings(record.second.exposure))
        worked = reprocess_bracket(scan, scan.second, both, calibration, progress)
    # No file for a cloud without points: it would look like a result.
    refuse_empty(scan.folder, worked.empty)
    return worked
