"""Judgement whether a calibration still holds, from the ray gaps of its scans, and its memory on the disk.

A scan gives four amplitudes (``gaps.MODES``), and is judged in these steps:

    reference   the first scans of a calibration give each patch its usual gap, so that what the calibration leaves (a
                lens beyond its model) does not count. Patches that no scan has shown yet count with the uncertainty of
                that pattern. Reference and trend belong to one calibration, and come back with it.
    amplitudes  least squares over the visible patches, with standard deviations in normal operation: noise, and a share
                of the pattern that the calibration leaves, since objects show different parts of it, propagated as a
                smooth surface. So a scan of a corner of the image has large standard deviations instead of a wrong
                verdict. Where the stated water changes, the height may change with it. Errors from backscatter have
                known shapes, and are adjusted with the amplitudes.
    third gaps  once the projector is fitted (``calibrate.third_eye``), third gaps are judged in the same way beside the
                ray gaps.
    overlaps    of many scans of one object show a depth error that all share, which gaps do not show. Their score is
                kept beside the trend, and raises an alarm above ``OVERLAP_LIMIT``.
    sum         scores (amplitudes in standard deviations, as a vector) are added by Crosier's multivariate CUSUM. A
                large change alarms at once, a small one when it stays; noise does not, and an offset of one standard
                deviation hardly ever.

``docs/calibration-health.md`` lists which changes are detected.

The memory is one small checksummed file per calibration:

    <root>/calibration/health/<first 16 digits of the calibration's hash>.json

It is replaced as a whole after each scan, so that a loss of power costs the latest scan's entry at most. A file that
cannot be read is renamed: the trend begins anew, and the old file can be examined.
"""

from __future__ import annotations

import logging
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Generic, TypeVar

import numpy as np
from numpy.typing import NDArray

from appliance.base import LEFT_OUT, ContentError, SealedFile
from appliance.measure import MODES, TURNS, PatchGaps, in_words
from appliance.store import FileSystem, LocalFileSystem, StorageError

Array = NDArray[np.float64]
Four = tuple[float, float, float, float]
T = TypeVar("T")

UNMEASURED = ("design", "air")
"""Methods of calibrations whose ports are not measured, so that their ray gaps are always large."""
LEARNT_SCANS = 10
"""Scans from which each patch learns its reference."""
FEWEST_PATCHES = 8
SLACK = 2.0
"""Part of each score that is not added, so that noise alone does not add up to the limit."""
LIMIT = 6.0
"""Limit of the sum: one score of 8, two of 5, three of 4."""
TEACHES_UP_TO = 2.0
"""Largest sum with which a scan still enters the reference; a knock must not."""
LEAST_UM = 0.3
"""Standard deviation of an amplitude that remains with the best calibration."""
THIRD_MODES = ("even", "across", "down", "corners")
"""Patterns of the third gap (``calibrate.third_eye``)."""
DRIFT_UM = (27.0, 3.6, 0.0, 0.0)
"""Standard deviation of amplitudes from mounts that turn with the temperature of the case: 0.003° about x (520 mm away)
and about z (70 mm aside). Such turns change no length, and the second scan still detects a knock of 0.02°. A turn about
y changes lengths; none is allowed."""
THIRD_DRIFT_UM = (14.0, 6.0, 3.0, 4.0)
"""Standard deviation of the third gap's amplitudes: turns of a camera about y by 0.003°, or of the projector by half of
that; in the other patterns the uncertainty of a projector fitted to three scans. A knock of 0.02° about y is 93 µm."""
PATCH_UM = 0.5
"""Standard deviation of a patch that remains with the best calibration."""
SHARE_KNOWN = 0.5
"""Share of the pattern that the calibration leaves which changes with the distance of the object; the reference removes
the other part. In a patch without a reference, all of it remains."""
SMOOTH_OVER = 0.25
"""Correlation length of that pattern, as a share of the image's width."""
IMAGE_HEIGHT = 0.75
"""Height of an image in image widths."""
HEIGHT_PER_INDEX_UM = 600.0
"""Change of height per unit of the refractive index of an imperfect calibration, with the right index: 4 µm from fresh
to salt water."""
MOST_POINTS = 200
"""Number of latest scans in the trend."""
MOST_ANSWERS = 20
MOST_OBJECTS = 50
"""Number of latest objects in the trend."""
OVERLAP_LIMIT = 4.0
"""Score of an object's overlaps above which an alarm is raised; calibrated rigs of the world ``outside`` have 0.4 to
1.6 (docs/objects.md)."""
OFFSET_SHARE = 0.05
"""Relative uncertainty of an accepted change: turns and shifts of the same amplitude differ a little with distance."""
MOST_VEIL_UM = 22.0
"""RMS uncertainty of the gaps from backscatter above which a scan is not judged; a turn of 0.02° about z gives as much.
"""
MATTERS_DEG = 0.02
"""Turn of a camera that three scans should detect; otherwise the judgement states what they do detect."""
SCANS_TO_FIND = 3
LASTING = 2.5
"""Factor on the standard deviations from backscatter. Its causes last over scans, and their sum must not reach the
limit. Chosen by the rate of false alarms, because the model of the water is not exact.
"""
TAKEN_WRONGLY = 0.4
"""Relative standard deviation of the correction of an amplitude for backscatter: errors of the model of the water
beyond its causes."""
_WIDE_UM = 1e3
"""Standard deviation of an amplitude that the visible patches do not determine."""


@dataclass(frozen=True, slots=True)
class TrendPoint:
    """One judged scan in the trend."""

    scan: str | None
    """Number of the scan, where it has one."""
    amplitudes_um: Four
    """Height, twist, scale and shear against the reference, RMS over the volume."""
    sigma_um: Four
    """Standard deviations of the amplitudes in normal operation."""
    rest_um: float
    """RMS of the gaps beyond the four patterns, without noise."""
    score: float
    """Length of the vector of amplitudes in standard deviations; 2 is usual."""
    total: float
    """Length of the sum after this scan; the alarm is at ``LIMIT``."""
    alarm: bool
    third_um: Four | None = field(default=None, metadata=LEFT_OUT)
    """Even, across, down and corners of the third gap. ``None``, like the next field, without a fitted projector, or if
    too few patches show it."""
    third_sigma_um: Four | None = field(default=None, metadata=LEFT_OUT)


@dataclass(frozen=True, slots=True)
class Reference:
    """Gaps of each patch of the left image in the first normal scans; zeros in patches without a scan."""

    gap_um: tuple[float, ...] = (0.0,) * PatchGaps.COUNT
    variance_um2: tuple[float, ...] = (0.0,) * PatchGaps.COUNT
    scans: tuple[int, ...] = (0,) * PatchGaps.COUNT
    rests_um: tuple[float, ...] = ()
    """RMS in µm of the gaps beyond the four patterns, in each scan of the reference."""
    water_index: float | None = None
    """Mean refractive index of the scans of the reference."""
    offset_um: Four = (0.0, 0.0, 0.0, 0.0)
    """Amplitudes that a length check found harmless, so that they count as normal."""
    doubts_um: tuple[float, ...] = (0.0,) * (PatchGaps.COUNT * (PatchGaps.DOUBTS + 1))
    """Standard deviations of the gaps from backscatter, patch after patch: mean of ``PatchGaps.doubts_um`` and
    ``PatchGaps.shape_um`` over the scans of the reference. The same causes have the same effect in later scans."""


@dataclass(frozen=True, slots=True)
class ThirdTrend:
    """Trend of the third gaps of one fitted projector."""

    projector: str | None = None
    """Hash of the fit; ``None`` without one."""
    reference: Reference = Reference()
    total: Four = (0.0, 0.0, 0.0, 0.0)
    """Its part of the sum."""


@dataclass(frozen=True, slots=True)
class OverlapNews:
    """Smooth depth error that the overlaps of one object show for all its scans (``calibration.depth_error``)."""

    object: str
    scans: int
    bend_um: float
    """RMS of the depth error over the image."""
    sigma_um: float
    """RMS of its standard deviation over the image."""
    score: float
    """Difference from the calibration's depth error, in standard deviations; about 1 is usual."""

    @property
    def alarm(self) -> bool:
        """True if the depth error has changed since the calibration."""
        return self.score > OVERLAP_LIMIT


@dataclass(frozen=True, slots=True)
class HealthTrend:
    """Reference, sum and latest scans of one calibration."""

    reference: Reference = Reference()
    total: Four = (0.0, 0.0, 0.0, 0.0)
    """Sum of scores, as a vector."""
    judged: int = 0
    points: tuple[TrendPoint, ...] = ()
    """The latest scans, oldest first."""
    alarm: str | None = None
    """Alarm in words, until a length check answers it."""
    answers: tuple[str, ...] = ()
    """Length checks that ended an alarm, in words."""
    overlaps: tuple[OverlapNews, ...] = ()
    """Latest result of each object's overlaps, oldest first."""
    third: ThirdTrend = field(default=ThirdTrend(), metadata=LEFT_OUT)

    def named(self, scan: str) -> HealthTrend:
        """Return the trend with ``scan`` as the number of the latest scan, known once it is stored."""
        return replace(self, points=(*self.points[:-1], replace(self.points[-1], scan=scan)))


@dataclass(frozen=True, slots=True)
class HealthJudgement:
    """Judgement of a calibration by one scan."""

    point: TrendPoint | None
    """Point of the trend; ``None`` if not judged."""
    alarm: bool
    text: str
    numbers: Mapping[str, float | None]
    normal: bool = False
    """The scan is normal, and may enter the reference and the fit of the projector."""


def judge_health(
    trend: HealthTrend, gaps: PatchGaps, scan: str | None = None, third: PatchGaps | None = None
) -> tuple[HealthTrend, HealthJudgement]:
    """Return trend and judgement after one more scan (``scan``: its number, where it has one already).

    ``third``: its third gaps, where the projector is fitted.
    """
    if len(gaps.patch) < FEWEST_PATCHES:
        text = f"not judged: {len(gaps.patch)} of {PatchGaps.COUNT} patches have points, {FEWEST_PATCHES} are needed"
        return trend, HealthJudgement(None, trend.alarm is not None, text, _counts(gaps))
    if not _are_numbers(gaps):
        return trend, HealthJudgement(None, trend.alarm is not None, "not judged: a gap is not a number", _counts(gaps))
    backscatter_um = _backscatter_rms_um(gaps)
    if backscatter_um > MOST_VEIL_UM:
        text = (
            f"not judged: backscatter may move the gaps by {backscatter_um:.0f} µm, allowed are {MOST_VEIL_UM:.0f}; "
            "scan in clearer water"
        )
        return trend, HealthJudgement(None, trend.alarm is not None, text, _counts(gaps))
    # Reference, amplitudes and sum as in the module's head, for the ray gaps and the third gaps beside them.
    fits = [_fit_gaps(trend.reference, gaps, DRIFT_UM, HEIGHT_PER_INDEX_UM)]
    if third is not None and len(third.patch) >= FEWEST_PATCHES and _are_numbers(third):
        fits.append(_fit_gaps(trend.third.reference, third, THIRD_DRIFT_UM, 0.0))
    z = np.concatenate([_whiten(fit.amplitudes_um, fit.covariance) for fit in fits])
    old_sum = np.array([*trend.total, *trend.third.total])
    new_sum = _next_sum(old_sum, np.pad(z, (0, len(old_sum) - len(z))))
    length = float(np.linalg.norm(new_sum))
    detectable_deg = _detectable_turns_deg(fits)
    # An alarm lasts until it is answered: it is not raised twice, and the sum that caused it is kept.
    is_new_alarm = trend.alarm is None and length > LIMIT
    amplitudes, sigmas = zip(*[(_four(fit.amplitudes_um), _four(fit.sigma_um)) for fit in fits], strict=True)
    point = TrendPoint(
        scan, amplitudes[0], sigmas[0], fits[0].rest_um, float(np.linalg.norm(z)), length,
        is_new_alarm or trend.alarm is not None,
        *((amplitudes[1], sigmas[1]) if len(fits) > 1 else ()),
    )  # fmt: skip
    # Only normal scans enter the reference, because a slow drift would otherwise become part of it.
    is_normal = not point.alarm and length <= TEACHES_UP_TO
    references = [trend.reference, trend.third.reference]
    if is_normal:
        for k, fit in enumerate(fits):
            references[k] = _teach(references[k], fit.gaps, fit.rest_um)
    text = _describe(point, references[0]) + (_likeliest_turn(fits) if point.alarm else "")
    if detectable_deg is not None and max(detectable_deg) > MATTERS_DEG and not point.alarm:
        text += f"; {_undetected_turns(detectable_deg)}{_backscatter_note(gaps)}"
    new_trend = replace(
        trend,
        reference=references[0],
        total=_four(new_sum[: len(MODES)]),
        judged=trend.judged + 1,
        points=(*trend.points, point)[-MOST_POINTS:],
        alarm=trend.alarm or (text if is_new_alarm else None),
        third=replace(trend.third, reference=references[1], total=_four(new_sum[len(MODES) :])),
    )
    return new_trend, HealthJudgement(
        point, point.alarm, text, _numbers(point, fits) | _turns(detectable_deg), is_normal
    )


def accept_change(trend: HealthTrend, answer: str) -> HealthTrend:
    """Return the trend after an accepted length check, with the state of the latest scan as normal.

    ``answer`` is the result of the check in words.
    """
    zeros: Four = (0.0, 0.0, 0.0, 0.0)
    point = trend.points[-1] if trend.points else None
    third_um = next((earlier.third_um for earlier in reversed(trend.points) if earlier.third_um is not None), zeros)
    return replace(
        trend,
        reference=_shift_reference(trend.reference, zeros if point is None else point.amplitudes_um),
        total=zeros,
        alarm=None,
        answers=(*trend.answers, answer)[-MOST_ANSWERS:],
        third=replace(trend.third, reference=_shift_reference(trend.third.reference, third_um), total=zeros),
    )


def _shift_reference(reference: Reference, latest_um: Four) -> Reference:
    # The offset changes the expected gaps by entire patterns instead of patch by patch. Every patch keeps the weight of
    # one scan at most, so that it follows the next scans.
    return replace(
        reference,
        offset_um=_four(np.array(reference.offset_um) + np.array(latest_um)),
        scans=tuple(min(n, 1) for n in reference.scans),
    )


def add_overlap_news(trend: HealthTrend, news: OverlapNews) -> HealthTrend:
    """Return the trend after an object was solved, with ``news`` in place of that of the same object."""
    overlaps = tuple(item for item in trend.overlaps if item.object != news.object)
    alarm = trend.alarm
    if alarm is None and news.alarm:
        alarm = (
            f"scans of object {news.object} overlap as with a common depth error of {news.bend_um:.0f} ± "
            f"{news.sigma_um:.0f} "
            "µm: "
            f"{news.score:.1f} times what the calibration states"
        )
    return replace(trend, alarm=alarm, overlaps=(*overlaps, news)[-MOST_OBJECTS:])


@dataclass(frozen=True, slots=True)
class _GapFit:
    """Amplitudes of one kind of gap of one scan against its reference."""

    gaps: PatchGaps
    amplitudes_um: Array
    """(4,)."""
    covariance: Array
    """(4, 4) in normal operation, µm²."""
    rest_um: float

    @property
    def sigma_um(self) -> Array:
        return np.asarray(np.sqrt(np.diag(self.covariance)))


def _are_numbers(gaps: PatchGaps) -> bool:
    return all(np.isfinite(values).all() for values in (gaps.gap_um, gaps.noise_um, gaps.modes))


def _fit_gaps(reference: Reference, gaps: PatchGaps, drift_um: Four, per_index_um: float) -> _GapFit:
    # Median with the scans of the reference, so that an unusual scan does not widen its own limits.
    rest_um = _unexplained_um(gaps)
    usual_um = float(np.median([*reference.rests_um, rest_um]))
    return _GapFit(gaps, *_amplitudes(reference, gaps, usual_um, drift_um, per_index_um), rest_um)


def _detectable_turns_deg(fits: Sequence[_GapFit]) -> tuple[float, float, float] | None:
    """Return the smallest turns of the right camera about x, y and z that are detected, in °.

    ``SCANS_TO_FIND`` scans like this one raise an alarm then. ``None`` where the change of the amplitudes with turns
    was not computed.
    """
    # So many equal scores reach the limit if each exceeds the slack by its share of the limit.
    score = SLACK + LIMIT / SCANS_TO_FIND
    per_deg = np.zeros(3)
    for fit in fits:
        if fit.gaps.turns_um is None:
            return None
        per_deg += [float(np.linalg.norm(_whiten(turn_um, fit.covariance))) ** 2 for turn_um in fit.gaps.turns_um]
    x, y, z = (score / max(value, 1e-9) for value in np.sqrt(per_deg))
    return x, y, z


def likeliest(amplitudes_um: Array, answers: Mapping[str, Array]) -> tuple[str, float, float]:
    """Return the single change that explains amplitudes (n,) best: name, size, and the explained share (0..1).

    ``answers`` are the amplitudes (n,) per unit of each possible change.
    """
    best = ("", 0.0, 0.0)
    for name, answer_um in answers.items():
        size = float(answer_um @ amplitudes_um / (answer_um @ answer_um))
        unexplained = float(np.sum((amplitudes_um - size * answer_um) ** 2))
        share = 1.0 - unexplained / max(float(amplitudes_um @ amplitudes_um), 1e-12)
        if share > best[2]:
            best = (name, size, share)
    return best


def _likeliest_turn(fits: Sequence[_GapFit]) -> str:
    """Return the single turn of the right camera that explains an alarm best, in words for a technician."""
    per_rad = [None if fit.gaps.turns_um is None else np.degrees(fit.gaps.turns_um) for fit in fits]
    known_turns = [turns_um for turns_um in per_rad if turns_um is not None]
    if len(known_turns) < len(fits):
        return ""
    answers = dict(zip(TURNS, np.concatenate(known_turns, axis=1), strict=True))
    name, size, share = likeliest(np.concatenate([fit.amplitudes_um for fit in fits]), answers)
    return f"; most like {in_words(name, -size)} ({100.0 * share:.0f} %)" if name else ""


def _unexplained_um(gaps: PatchGaps) -> float:
    """Return the RMS of the gaps beyond the four patterns, without that of noise."""
    amplitudes = _solver(gaps.modes, np.diag(1.0 / (gaps.noise_um**2 + PATCH_UM**2))) @ gaps.gap_um
    # Unbiased variance of the residuals: squares over the degrees of freedom, less the mean variance of the noise.
    residual_um = gaps.gap_um - gaps.modes @ amplitudes
    freedom = max(len(residual_um) - len(MODES), 1)
    return math.sqrt(max(float(np.sum(residual_um**2)) / freedom - float(np.mean(gaps.noise_um**2)), 0.0))


def _amplitudes(
    reference: Reference, gaps: PatchGaps, usual_um: float, drift_um: Four, per_index_um: float
) -> tuple[Array, Array]:
    """Return the amplitudes (4,) against the reference and their covariance in normal operation.

    ``per_index_um`` is the allowed change of the first per unit of the refractive index.
    """
    offset = np.array(reference.offset_um)
    # Model: gap = expected + modes · a + smooth pattern + white noise. A patch without a reference has all of the
    # pattern, one with a reference only the share that changes with distance.
    expected = np.array(reference.gap_um)[gaps.patch] + gaps.modes @ offset
    has_reference = np.array(reference.scans)[gaps.patch] > 0
    pattern_um = usual_um * np.where(has_reference, SHARE_KNOWN, 1.0)
    noise_um2 = gaps.noise_um**2 + PATCH_UM**2 + np.array(reference.variance_um2)[gaps.patch]
    # Errors from backscatter are in the reference, too: only the difference counts.
    causes, shape = _backscatter_sd_um(gaps)
    reference_causes = np.array(reference.doubts_um).reshape(PatchGaps.COUNT, PatchGaps.DOUBTS + 1)[gaps.patch]
    backscatter_um = _rms_um(causes)
    causes, shape = causes - reference_causes[:, : PatchGaps.DOUBTS], shape - reference_causes[:, PatchGaps.DOUBTS]
    new_share = min(_rms_um(causes) / max(backscatter_um, 1e-9), 1.0)
    # Generalised least squares. A cause changes all patches together, so that the scan itself separates its pattern
    # from that of a knock. The smooth pattern enters the weights as if patches were independent, because its smoothness
    # is not known well enough to use it; the covariance below has its correlation.
    weight = np.linalg.inv(np.diag(noise_um2 + pattern_um**2 + shape**2) + causes @ causes.T)
    solve = _solver(gaps.modes, weight)
    amplitudes = solve @ (gaps.gap_um - expected)
    # Propagation of the true covariance S through the estimator K: K S Kᵀ. The part that the patches do not determine,
    # (I − K M), keeps its prior uncertainty.
    smooth = np.outer(pattern_um, pattern_um) + np.outer(shape, shape)
    noise_covariance = np.diag(noise_um2) + smooth * _patch_correlation(gaps.patch) + causes @ causes.T
    unobserved = np.eye(len(MODES)) - solve @ gaps.modes
    covariance = (
        _variance_ratio(gaps, expected, amplitudes, weight) * (solve @ noise_covariance @ solve.T)
        + unobserved @ unobserved.T * _WIDE_UM**2
    )
    # Variances that no number of patches reduces: of the best calibration, of mounts that follow the temperature, of
    # the part of an accepted change that varies with distance, for the height of a change of the stated index, and a
    # share of the correction for backscatter as far as it differs from that of the reference.
    floor_um2 = np.full(len(MODES), LEAST_UM**2) + np.square(drift_um) + (OFFSET_SHARE * offset) ** 2
    if reference.water_index is not None:
        floor_um2[0] += (per_index_um * (gaps.water_index - reference.water_index)) ** 2
    if gaps.veil_um is not None:
        independent = _solver(gaps.modes, np.diag(1.0 / (noise_um2 + pattern_um**2 + shape**2)))
        floor_um2 += (TAKEN_WRONGLY * new_share * (independent @ gaps.veil_um)) ** 2
    return amplitudes, covariance + np.diag(floor_um2)


def _variance_ratio(gaps: PatchGaps, expected: Array, amplitudes: Array, weight: Array) -> float:
    """Return the variance of the residual gaps over the expected one, at least 1; 1 without backscatter."""
    # The shapes of causes are only as good as the model of the water. Where amplitudes and causes leave larger
    # residuals than expected, the covariance grows in proportion; a knock leaves next to none. The pattern that a
    # calibration leaves is counted separately (``rest_um``).
    if gaps.doubts_um is None:
        return 1.0
    residual_um = gaps.gap_um - expected - gaps.modes @ amplitudes
    return max(1.0, float(residual_um @ weight @ residual_um) / (len(residual_um) - len(MODES)))


def _backscatter_sd_um(gaps: PatchGaps) -> tuple[Array, Array]:
    """Return standard deviations of the gaps from backscatter: of each cause (k, DOUBTS), and of smooth ones (k,)."""
    if gaps.doubts_um is None or gaps.shape_um is None:
        return np.zeros((len(gaps.patch), PatchGaps.DOUBTS)), np.zeros(len(gaps.patch))
    return LASTING * gaps.doubts_um, LASTING * gaps.shape_um


def _backscatter_rms_um(gaps: PatchGaps) -> float:
    """Return the standard deviation of the gaps from backscatter, RMS over the patches."""
    if gaps.doubts_um is None or gaps.shape_um is None:
        return 0.0
    return float(np.sqrt(np.mean(np.sum(gaps.doubts_um**2, axis=1) + gaps.shape_um**2)))


def _rms_um(causes: Array) -> float:
    return float(np.sqrt(np.mean(np.sum(causes**2, axis=1))))


def _patch_correlation(patch: NDArray[np.intp]) -> Array:
    """Return the correlation (k, k) of the smooth pattern between patches."""
    columns, rows = PatchGaps.GRID
    across, down = (patch % columns) / columns, (patch // columns) / rows * IMAGE_HEIGHT
    far2 = np.subtract.outer(across, across) ** 2 + np.subtract.outer(down, down) ** 2
    return np.asarray(np.exp(-0.5 * far2 / SMOOTH_OVER**2))


def _solver(modes: Array, weight: Array) -> Array:
    """Return the matrix (4, k) from gaps to amplitudes, for the inverse covariance ``weight`` (k, k) of the gaps."""
    # Least squares with a weak prior of _WIDE_UM, so that patterns that no patch shows stay near zero.
    weighted = modes.T @ weight
    return np.asarray(np.linalg.solve(weighted @ modes + np.eye(len(MODES)) / _WIDE_UM**2, weighted))


def _whiten(amplitudes: Array, covariance: Array) -> Array:
    # C^(-1/2) a by the eigenvectors: symmetric, so that every score keeps the direction of its pattern and the sums of
    # scans with different covariances can be added.
    values, vectors = np.linalg.eigh(covariance)
    return np.asarray(vectors @ ((vectors.T @ amplitudes) / np.sqrt(values)))


def _next_sum(total: Array, z: Array) -> Array:
    """Return the next sum after Crosier 1988: add, then shrink by the slack."""
    # Crosier's multivariate CUSUM: s ← (s + z)(1 − k / |s + z|), and 0 where |s + z| ≤ k. It keeps the direction, so
    # that noise cancels and a constant shift adds up.
    shifted = total + z
    length = float(np.linalg.norm(shifted))
    return np.zeros_like(total) if length <= SLACK else np.asarray(shifted * (1.0 - SLACK / length))


def _teach(reference: Reference, gaps: PatchGaps, rest_um: float) -> Reference:
    mean, variance, scans = (
        np.array(values, float) for values in (reference.gap_um, reference.variance_um2, reference.scans)
    )
    learning = gaps.patch[scans[gaps.patch] < LEARNT_SCANS]
    if not len(learning):
        return reference
    is_learning = np.isin(gaps.patch, learning)
    n = scans[learning]
    gap_um = gaps.gap_um[is_learning] - gaps.modes[is_learning] @ np.array(reference.offset_um)
    # Running mean of n + 1 scans, and the variance of that mean: (n² v + σ²) / (n + 1)².
    mean[learning] = (n * mean[learning] + gap_um) / (n + 1.0)
    variance[learning] = (n**2 * variance[learning] + gaps.noise_um[is_learning] ** 2) / (n + 1.0) ** 2
    doubts = np.array(reference.doubts_um).reshape(PatchGaps.COUNT, PatchGaps.DOUBTS + 1)
    causes, shape = _backscatter_sd_um(gaps)
    doubts[learning] = (n[:, None] * doubts[learning] + np.column_stack([causes, shape])[is_learning]) / (
        n[:, None] + 1.0
    )
    scans[learning] += 1.0
    rests_um, index = reference.rests_um, reference.water_index
    if len(rests_um) < LEARNT_SCANS:
        index = gaps.water_index if index is None else (len(rests_um) * index + gaps.water_index) / (len(rests_um) + 1)
        rests_um = (*rests_um, rest_um)
    return replace(
        reference,
        gap_um=tuple(float(v) for v in mean),
        variance_um2=tuple(float(v) for v in variance),
        scans=tuple(int(n) for n in scans),
        doubts_um=tuple(float(v) for v in doubts.ravel()),
        rests_um=rests_um,
        water_index=index,
    )


def _describe(point: TrendPoint, reference: Reference) -> str:
    amplitudes_um = [*zip(MODES, point.amplitudes_um, strict=True)]
    if point.third_um is not None:
        amplitudes_um += zip(THIRD_MODES, point.third_um, strict=True)
    parts = ", ".join(f"{name} {value:+.1f} µm" for name, value in amplitudes_um)
    if point.alarm:
        return f"the ray gaps have changed since the calibration: {parts}; {point.score:.1f} standard deviations"
    scans = len(reference.rests_um)
    learning = f"; {scans} of {LEARNT_SCANS} scans of the reference" if scans < LEARNT_SCANS else ""
    return f"unchanged since the calibration: {parts}{learning}"


def _undetected_turns(detectable_deg: tuple[float, float, float]) -> str:
    """Return in words which turns such scans detect late."""
    limits = [f"{axis} below {deg:.2g}°" for axis, deg in zip("xyz", detectable_deg, strict=True) if deg > MATTERS_DEG]
    return f"{SCANS_TO_FIND} such scans do not show rotations of a camera about {', '.join(limits)}"


def _backscatter_note(gaps: PatchGaps) -> str:
    doubt_um = _backscatter_rms_um(gaps)
    return f" (backscatter may move the gaps by {doubt_um:.0f} µm)" if doubt_um >= 1.0 else ""


def _turns(detectable_deg: tuple[float, float, float] | None) -> dict[str, float | None]:
    return (
        {}
        if detectable_deg is None
        else {f"found_{axis}_deg": deg for axis, deg in zip("xyz", detectable_deg, strict=True)}
    )


def _numbers(point: TrendPoint, fits: Sequence[_GapFit]) -> dict[str, float | None]:
    numbers: dict[str, float | None] = {}
    for names, fit in zip((MODES, THIRD_MODES), fits, strict=False):
        for name, value, sigma in zip(names, fit.amplitudes_um, fit.sigma_um, strict=True):
            numbers |= {f"{name}_um": float(value), f"{name}_sigma_um": float(sigma)}
    if len(fits) > 1:
        numbers |= {"third_um": float(np.sqrt(np.mean(fits[1].gaps.gap_um ** 2))), "third_rest_um": fits[1].rest_um}
    gaps = fits[0].gaps
    if gaps.veil_um is not None:
        numbers |= {"veil_um": float(np.sqrt(np.mean(gaps.veil_um**2))), "veil_doubt_um": _backscatter_rms_um(gaps)}
    numbers |= {"rest_um": point.rest_um, "score": point.score, "sum": point.total, "limit": LIMIT}
    return numbers | _counts(gaps)


def _counts(gaps: PatchGaps) -> dict[str, float | None]:
    return {"patches": float(len(gaps.patch)), "samples": float(gaps.samples)}


def _four(values: Array) -> Four:
    a, b, c, d = (float(v) for v in values)
    return a, b, c, d


log = logging.getLogger("kingfisher")

FOLDER = Path("calibration", "health")


@dataclass(frozen=True, slots=True)
class _StoredHealth:
    """Content of the file of one calibration."""

    trend: HealthTrend


def _refuse_impossible(stored: _StoredHealth) -> None:
    """Raise ValueError for numbers that no trend can have."""
    if stored.trend.judged < 0:
        raise ValueError(f"trend.judged is {stored.trend.judged}; allowed: whole numbers from 0")
    for reference in (stored.trend.reference, stored.trend.third.reference):
        if any(
            len(values) != PatchGaps.COUNT for values in (reference.gap_um, reference.variance_um2, reference.scans)
        ):
            raise ValueError(f"its reference has not {PatchGaps.COUNT} patches")
        if len(reference.doubts_um) != PatchGaps.COUNT * (PatchGaps.DOUBTS + 1):
            raise ValueError(f"its reference has not {PatchGaps.DOUBTS + 1} uncertainties of {PatchGaps.COUNT} patches")


HEALTH = SealedFile(_StoredHealth, schema=1, max_bytes=1_000_000, indent=None, check=_refuse_impossible)


class MemoryFile(Generic[T]):
    """File of the learnt state of one calibration. One process writes, any number may read."""

    def __init__(
        self, form: SealedFile[T], empty: T, path: Path, calibration_hash: str, fs: FileSystem | None = None
    ) -> None:
        self._form, self._empty = form, empty
        self._fs: FileSystem = fs or LocalFileSystem()
        self._of: Mapping[str, str] = {"calibration": calibration_hash}
        self.path = path

    def read(self) -> T:
        """Return the stored state; the empty one where there is no file or it cannot be read."""
        try:
            state = self._form.load(self.path, self._of, name=str(self.path))
        except ContentError as error:
            log.warning("%s; the trend starts again", error)
            state = None
        return self._empty if state is None else state

    def write(self, state: T) -> None:
        """Write the state; durable on return. Raises StorageError."""
        self._fs.make_folders(self.path.parent)
        self._set_aside()
        self._fs.replace_file(self.path, self._form.encode(state, self._of))

    def _set_aside(self) -> None:
        """Rename a file that cannot be read, so that it is not overwritten."""
        if not self.path.exists():
            return
        try:
            self._form.decode(self.path.read_bytes(), str(self.path), self._of)
        except OSError as error:
            raise StorageError.of("cannot read", self.path, error) from error
        except ContentError:
            with StorageError.naming("cannot rename", self.path):
                self._fs.rename(self.path, self.path.with_suffix(".damaged"))


class HealthFile:
    """File of one calibration's trend. One process writes, any number may read."""

    def __init__(self, root: Path, calibration_hash: str, fs: FileSystem | None = None) -> None:
        self.path = root / FOLDER / f"{calibration_hash[:16]}.json"
        self._file = MemoryFile(HEALTH, _StoredHealth(HealthTrend()), self.path, calibration_hash, fs)

    def read(self) -> HealthTrend:
        """Return the stored trend; an empty one where there is no file or it cannot be read."""
        return self._file.read().trend

    def write(self, trend: HealthTrend) -> None:
        """Write the trend; durable on return. Raises StorageError."""
        self._file.write(_StoredHealth(trend))
