"""The verdict ``motion``: its kind, place and speed, and whether it spoils the points.

Not every detected motion spoils a scan. The verdict fails if the noise that motion adds to the points, predicted from
the drift of the fringes (``harm``), exceeds ``MOST_ADDED``. A harmless motion is named and passes.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import Enum

import numba
import numpy as np
from numpy.typing import NDArray

from appliance.measure.decode.decoder import CameraDecoder, Mask
from appliance.measure.fault import Fault, FaultCode
from appliance.measure.light.model import StereoRig
from appliance.measure.light.noise import CameraNoise
from appliance.measure.light.patterns import Direction, PatternSequence
from appliance.measure.light.sides import SIDES, of_side
from appliance.measure.points.sigma import four_step_variance_px2
from appliance.measure.points.table import Cloud
from appliance.measure.scan_images import ScanImages
from appliance.measure.verdict import Judgement, Verdict
from appliance.measure.verdicts.motion.albedo import AlbedoShifts, albedo_shifts
from appliance.measure.verdicts.motion.course import pair_offset
from appliance.measure.verdicts.motion.drift import DriftMap, drift_map
from appliance.measure.verdicts.motion.edges import edge_shifts
from appliance.measure.verdicts.motion.harm import Harm, Place, place_of, predict, steady_offset, surface_map
from appliance.measure.verdicts.motion.scores import (
    MOVED,
    DriftTrend,
    Scores,
    drift_trend,
    edge_course,
    texture_score,
)
from appliance.measure.verdicts.motion.texture import Means, TextureChange, follow_px, means_of, texture_change

NAME = "motion"
MOST_ADDED = 0.07
"""Largest added noise, as a fraction of the noise at rest.

It is half way between an unnoticeable fraction (0.05) and an unacceptable one (0.10), as a ratio of the added
variances: predictions of these are as often too large as too small.
"""

_SHADOW, _SATURATED, _CONTRADICTION = (np.uint8(m) for m in (Mask.SHADOW, Mask.SATURATED, Mask.CONTRADICTION))

Array = NDArray[np.float64]


class MotionKind(Enum):
    """Kinds of motion; the values are for texts and manifests."""

    STILL = "still"
    AXIAL = "axial"
    """Motion towards the instrument or away from it."""
    LATERAL = "lateral"
    ROTATION = "rotation"
    LOCAL = "local"
    """Motion of another object: most of the added noise is in a small part of the image."""


@dataclass(frozen=True, slots=True)
class MotionJudgement:
    """The judgement and its evidence."""

    judgement: Judgement
    kind: MotionKind
    added: float | None
    """Added noise as a fraction of the points' noise at rest; ``None``: unknown."""
    axial_mm_s: float | None
    """Median speed at which the surface recedes along the left camera's rays; ``None``: unknown."""
    lateral_mm_s: tuple[float, float] | None
    """Speed of the texture across the left image, right and down; ``None``: it does not move, or cannot be followed."""
    shift_px: float | None
    """Motion over the complete sequence, px of the left image, by texture and fringes together."""
    place: Place | None
    """Place of most of the added noise."""
    scores: Scores
    harm: Harm
    """Maps over the cells of the pattern."""
    drift: Mapping[str, DriftMap]
    """``left`` and ``right``."""


def judge_motion(
    images: ScanImages,
    cloud: Cloud,
    rig: StereoRig,
    water_index: float,
    means: Mapping[str, Means] | None = None,
) -> MotionJudgement:
    """Judge a complete sequence with its coarse ``cloud``; ``rig`` and ``water_index`` convert px to mm.

    ``means``: those of both sides, if they were taken while the frames arrived.
    """
    sequence = images.sequence
    noise = {side: of_side(images.noise, side) for side in SIDES}
    drift: dict[str, DriftMap] = {}
    means = means or {side: means_of(images.frames[side], sequence) for side in SIDES}
    changes: dict[str, TextureChange | None] = {}
    for side in SIDES:
        frames, decoded, variance = images.frames[side], images.decoded[side], _variance(noise[side])
        drift[side] = drift_map(frames, decoded, sequence, variance)
        changes[side] = texture_change(frames, decoded, sequence, variance, means[side])
    lost = float(np.mean([_lost_share(images.decoded[side]) for side in SIDES]))
    left = images.decoded["left"]
    light_dn = np.float32(left.offset_per_threshold) * left.gray_threshold.ravel()[cloud.pixel]
    variance_px2 = four_step_variance_px2(cloud.modulation_dn, light_dn, noise["left"], sequence.period_px)
    surface = surface_map(cloud, left.p_px, left.q_px, variance_px2, drift["left"].drift_px.shape)
    texture = texture_score(changes)
    # Backscatter changes with the stripes, and looks like a displacement of the illuminated surface: use displacements
    # only if the texture has changed.
    slides = (texture or 0.0) >= MOVED
    pair_way2 = _pair_way2(images, noise) if slides else None
    harm = predict(drift, surface, pair_way2, rig, water_index, sequence, images.frame_s)
    if steady_offset(sequence).of_drift2 == 0.0:
        edge_shifts_px = {side: edge_shifts(images.frames[side], images.decoded[side], sequence) for side in SIDES}
        course = edge_course(edge_shifts_px["left"], edge_shifts_px["right"], harm)
        offset = pair_offset(*course, drift["left"], drift["right"], harm, sequence, images.frame_s)
        harm = predict(drift, surface, pair_way2, rig, water_index, sequence, images.frame_s, offset)
    trend = drift_trend(harm)
    scores = Scores(None if trend is None else trend.score, texture)
    axial = _axial(harm)
    x, y = (sequence.axis(direction).sine for direction in (Direction.X, Direction.Y))
    followed = follow_px(left, means["left"]) if slides else None
    displacement_px = None if followed is None else np.array(followed) / (np.mean(y) - np.mean(x))
    lateral = None if displacement_px is None else _lateral(displacement_px, rig, water_index, images.frame_s)
    kind = _kind(scores, trend, harm, axial, lateral)
    place = place_of(harm, (rig.left.width_px, rig.left.height_px))
    shift = _shift(drift["left"], harm, displacement_px, len(sequence))
    judgement = _judgement(kind, harm, axial, lateral, shift, place, scores, lost)
    return MotionJudgement(
        judgement,
        kind,
        harm.added,
        axial,
        lateral,
        shift,
        place,
        scores,
        harm,
        drift,
    )


def _pair_way2(images: ScanImages, noise: Mapping[str, CameraNoise]) -> float | None:
    """Return the mean square displacement of the albedo within a pair of steps, px²; ``None``: unknown.

    It is the mean over both cameras, or that of one of them if the other's is unknown.
    """
    sequence = images.sequence
    albedo = [
        albedo_shifts(images.frames[side], images.decoded[side], sequence, _variance(noise[side])) for side in SIDES
    ]
    return mean_pair_way2(albedo, sequence)


def mean_pair_way2(albedo: Sequence[AlbedoShifts], sequence: PatternSequence) -> float | None:
    """Return the mean square displacement within a pair of steps, px², by both cameras' ``albedo``."""
    squares = (shifts.mean_way2(frames) for shifts in albedo for frames in sequence.axis(Direction.X).pair_frames)
    known_squares = [way2 for way2 in squares if way2 is not None]
    return float(np.mean(known_squares)) if known_squares else None


def _variance(noise: CameraNoise) -> tuple[float, float]:
    """Return the noise's variance in DN² as (at grey value 0, per grey value)."""
    return noise.dark_variance_dn2, noise.dn_per_e


def _lost_share(decoded: CameraDecoder) -> float:
    """Return the share of the illuminated pixels that are masked for a contradiction or as an edge.

    Saturated pixels do not count, since they have no phase; nor do those that backscatter hides, also at rest.
    """
    illuminated, lost = (int(pixels) - decoded.backscatter_pixels for pixels in _count(decoded.mask))
    return lost / illuminated if illuminated > 0 else 0.0


@numba.njit(nogil=True, cache=True, error_model="numpy")
def _count(mask: NDArray[np.uint8]) -> tuple[np.int64, np.int64]:
    """Return the numbers of illuminated, unsaturated and of lost pixels of ``mask`` (h, w)."""
    illuminated = lost = np.int64(0)
    for v in range(mask.shape[0]):
        in_light, lost_pixels = _count_row(mask[v])
        illuminated += np.int64(in_light)
        lost += np.int64(lost_pixels)
    return illuminated, lost


@numba.njit(nogil=True, cache=True, error_model="numpy")
def _count_row(row: NDArray[np.uint8]) -> tuple[np.uint16, np.uint16]:
    """Return the same for one ``row`` (w,) of less than 65,536 pixels, in 16 bits, which vectorise better."""
    in_light = lost = np.uint16(0)
    for u in range(row.size):
        in_light = np.uint16(in_light + np.uint16((row[u] != _SHADOW) & (row[u] != _SATURATED)))
        lost = np.uint16(lost + np.uint16(row[u] >= _CONTRADICTION))
    return in_light, lost


def _axial(harm: Harm) -> float | None:
    is_known = (harm.weight > 0.0) & np.isfinite(harm.depth_rate_mm_s)
    return float(np.median(harm.depth_rate_mm_s[is_known])) if is_known.any() else None


def _turning_mm_s(harm: Harm) -> float:
    """Return the RMS speed over the cells, since the median of a rotation is near 0."""
    is_known = (harm.weight > 0.0) & np.isfinite(harm.depth_rate_mm_s)
    return float(np.sqrt(np.mean(harm.depth_rate_mm_s[is_known] ** 2)))


def _lateral(displacement_px: Array, rig: StereoRig, water_index: float, frame_s: float) -> tuple[float, float]:
    """Return the texture's speed right and down, in mm/s at the distance of the volume's middle."""
    camera = rig.left
    middle = np.array([(camera.width_px - 1) / 2.0, (camera.height_px - 1) / 2.0])
    # Rays begin at the port, not at the projection centre.
    origin, along = camera.rays(np.stack([middle, middle + np.array([1.0, 0.0])]), water_index)
    centre_mm, beside_mm = origin + along * ((rig.volume_centre_mm(water_index) - origin[0]) @ along[0])
    # mm across the middle of the volume per px of the image, per second.
    right, down = displacement_px * (float(np.linalg.norm(beside_mm - centre_mm)) / frame_s)
    return float(right), float(down)


def _shift(left: DriftMap, harm: Harm, displacement_px: Array | None, frames: int) -> float | None:
    """Return the motion over so many ``frames``, px of the left image.

    It is that of the fringes and of the texture, ``displacement_px`` per frame, together.
    """
    is_known = (harm.weight > 0.0) & np.isfinite(left.slope_per_px)
    if not is_known.any():
        return None
    fringes = float(np.median(np.abs(left.drift_px[is_known] / left.slope_per_px[is_known])))
    return frames * float(np.hypot(fringes, 0.0 if displacement_px is None else np.hypot(*displacement_px)))


LOCAL_CELLS, LOCAL_SHARE, LOCAL_REACH_CELLS = 0.2, 0.7, 4.0
"""Criteria of a local motion: share of the cells, their least share of the added noise (squared), and their largest
distance."""


def _kind(
    scores: Scores,
    trend: DriftTrend | None,
    harm: Harm,
    axial_mm_s: float | None,
    lateral_mm_s: tuple[float, float] | None,
) -> MotionKind:
    """Return the first kind that fits."""
    if lateral_mm_s is None and _is_local(harm):
        return MotionKind.LOCAL
    largest = scores.largest
    if largest is None or largest < MOVED:
        return MotionKind.STILL
    sideways = 0.0 if lateral_mm_s is None else float(np.hypot(*lateral_mm_s))
    if sideways > 1.5 * abs(axial_mm_s or 0.0) and not _turns(trend, factor=1.5):
        return MotionKind.LATERAL
    if _turns(trend, factor=0.7):
        return MotionKind.ROTATION
    if scores.drift is not None and scores.drift >= MOVED:
        return MotionKind.AXIAL
    return MotionKind.LATERAL


def _turns(trend: DriftTrend | None, factor: float) -> bool:
    """Return True if the drift's slope across the pattern exceeds its mean ``factor`` times, and is certain."""
    if trend is None:
        return False
    slope = float(np.hypot(trend.across, trend.down))
    return slope > factor * abs(trend.mean) and slope > MOVED * float(np.hypot(trend.sd[1], trend.sd[2]))


def _is_local(harm: Harm) -> bool:
    """Return True if most of the added noise is in few cells close to each other."""
    is_known = (harm.weight > 0.0) & (harm.noise_mm > 0.0)
    if np.count_nonzero(is_known) < 20:
        return False
    # Uncertain cells have large ripples by chance.
    certain = is_known & (np.abs(harm.drift_px) > 6.0 * harm.sd_px)
    squared = np.where(certain, np.nan_to_num(harm.ripple_mm / harm.noise_mm) ** 2 * harm.weight, 0.0)
    if squared.sum() <= 0.01 * harm.weight.sum():
        return False
    few = int(LOCAL_CELLS * np.count_nonzero(is_known))
    row, column = np.unravel_index(np.argsort(squared, axis=None)[::-1][:few], squared.shape)
    near = np.hypot(row - row[0], column - column[0]) <= LOCAL_REACH_CELLS
    return bool(squared[row, column][near].sum() > LOCAL_SHARE * squared.sum())


def _judgement(
    kind: MotionKind,
    harm: Harm,
    axial_mm_s: float | None,
    lateral_mm_s: tuple[float, float] | None,
    shift_px: float | None,
    place: Place | None,
    scores: Scores,
    lost: float,
) -> Judgement:
    moved = kind is not MotionKind.STILL
    speeds = []
    if axial_mm_s is not None and (scores.drift or 0.0) >= MOVED:
        speeds.append(_turning_mm_s(harm) if kind is MotionKind.ROTATION else axial_mm_s)
    if lateral_mm_s is not None:
        speeds += lateral_mm_s
    speed = float(np.linalg.norm(speeds)) if speeds else None
    added = harm.added
    numbers: dict[str, float | None] = {
        "added_noise_percent": None if added is None else 100.0 * added,
        "limit_percent": 100.0 * MOST_ADDED,
        "lost_percent": 100.0 * lost,
        "ripple_mm": harm.ripple_rms_mm,
        "noise_mm": harm.noise_rms_mm,
        "shift_px": shift_px,
        "speed_mm_s": speed,
        "axial_mm_s": axial_mm_s,
        "right_mm_s": None if lateral_mm_s is None else lateral_mm_s[0],
        "down_mm_s": None if lateral_mm_s is None else lateral_mm_s[1],
        "drift_over_noise": harm.drift_over_noise,
        "score": scores.largest,
        "score_limit": MOVED,
        "score_drift": scores.drift,
        "score_texture": scores.texture,
        "place_u_px": None if place is None or not moved else place.u_px,
        "place_v_px": None if place is None or not moved else place.v_px,
    }
    if added is None:
        return Judgement(Verdict(NAME, None, numbers, "not judged: too few points"))
    text = kind.value
    if moved:
        where = "" if place is None else f", {place.word}"
        text = f"{kind.value}{'' if speed is None else f' {speed:.1f} mm/s'}{where}; adds {100.0 * added:.0f} % noise"
    # Without evidence of motion, the cause is another one: specks between two images look like moving albedo.
    passed = added <= MOST_ADDED or not moved
    fault = None
    if not passed:
        fault_numbers = {"shift_px": shift_px, "added_noise_percent": 100.0 * added, "speed_mm_s": speed}
        evidence = {name: value for name, value in fault_numbers.items() if value is not None}
        fault = Fault(FaultCode.MOVED, text, evidence)
    return Judgement(Verdict(NAME, passed, numbers, text), fault)
