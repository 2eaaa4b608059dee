"""Owns the judgement whether a calibration still holds: each scan's ray gaps against those right after it, and their
trend.

Pure values and functions. A scan gives four amplitudes (``gaps.MODES``), and is judged in three steps:

reference   the first scans of a calibration teach each patch what is usual there, so that what the calibration leaves over (a
            lens that no formula has) does not count. Patches that no scan has shown yet count with the uncertainty of that
            pattern. Reference and trend belong to a calibration: one that comes back brings its own.
amplitudes  least squares over the patches seen, with their standard deviations in normal operation: noise, and a share of the
            pattern left over, since objects show different parts of it, propagated as a smooth surface. A scan of a corner of
            the image so has wide standard deviations instead of a wrong verdict. Where the stated water changes, the height
            may change with it, as imperfect calibrations do. What backscatter may do wrongly has known shapes, and is
            adjusted along with the amplitudes.
third gaps  where the projector was learnt (``calibrate.third_eye``), its gaps are judged beside the ray gaps in the same way.
overlaps    of many scans of one object tell of a depth error that all share, which gaps do not see; their word is kept beside, and
            alarms where it is clear.
sum         scores (amplitudes in standard deviations, with their direction) are added up by Crosier's multivariate CUSUM: a
            big change alarms at once, a small one when it stays; scatter does not, and an offset of one standard deviation
            hardly ever.

``docs/calibration-health.md`` has which changes are seen so.

It also owns what is remembered on the disk about how a calibration holds: one small checksummed file per calibration.

    <root>/calibration/health/<first 16 digits of the calibration's hash>.json

Replaced as a whole after each scan, so that a loss of power costs the latest scan's entry at most. A file that cannot
be read is put aside under another name: the trend begins anew, and a person can look at what there was.
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
"""Methods of calibrations whose ports nobody measured: their rays miss each other anyway."""
LEARNT_SCANS = 10
"""Scans that teach a patch its reference."""
FEWEST_PATCHES = 8
SLACK = 2.0
"""Score that every scan is forgiven: scatter alone never adds up to the limit."""
LIMIT = 6.0
"""Limit of the sum: one score of 8, two of 5, three of 4."""
TEACHES_UP_TO = 2.0
"""A scan after which the sum is larger teaches nothing: a knock must not become the reference."""
LEAST_UM = 0.3
"""Scatter of an amplitude that remains with the best calibration."""
THIRD_MODES = ("even", "across", "down", "corners")
"""Patterns of the third gap (``calibrate.third_eye``)."""
DRIFT_UM = (27.0, 3.6, 0.0, 0.0)
"""Standard deviation of amplitudes from mounts that turn with the temperature of the case: 0.003° about x (520 mm away)
and about z (70 mm aside). Neither spoils a length, and so much leaves a knock of 0.02° to be found by the second scan.
A turn about y spoils lengths, and is forgiven nothing."""
THIRD_DRIFT_UM = (14.0, 6.0, 3.0, 4.0)
"""The same of the third gap: turns of a camera about y by 0.003°, or of the projector by half of that; of the other patterns
what three scans leave open of the projector where they did not show it. A knock of 0.02° about y is 93 µm."""
PATCH_UM = 0.5
"""Scatter of a patch that remains with the best calibration."""
SHARE_KNOWN = 0.5
"""Share of the pattern left over by the calibration that changes with the distance of the object; the reference takes
the rest away. Where a patch has no reference yet, all of it is there."""
SMOOTH_OVER = 0.25
"""Share of the image's width over which that pattern is alike."""
IMAGE_HEIGHT = 0.75
"""Height of an image in image widths."""
HEIGHT_PER_INDEX_UM = 600.0
"""Change of height per unit of the water's index that an imperfect calibration allows, with the index stated rightly: 4
µm from fresh to salt."""
MOST_POINTS = 200
"""Scans kept for looking back."""
MOST_ANSWERS = 20
MOST_OBJECTS = 50
"""Objects kept for looking back."""
OVERLAP_LIMIT = 4.0
"""Score of an object's overlaps that alarms: calibrated rigs of the world ``outside`` have 0.4 to 1.6
(docs/objects.md)."""
OFFSET_SHARE = 0.05
"""Uncertainty of an accepted change as a share of it: turns and shifts of the same amplitude differ a little with
distance."""
MOST_VEIL_UM = 22.0
"""Doubt about what backscatter does to the gaps, rms, beyond which a scan is not judged: a turn of 0.02° about z gives
no more."""
MATTERS_DEG = 0.02
"""Turn of a camera that three scans should find; where they would not, the verdict says what they do find."""
SCANS_TO_FIND = 3
LASTING = 2.5
"""Multiple of its standard deviation at which doubt about backscatter counts: its causes stay, and the sum must not add
them up. Chosen by the rate of false alarms: shapes of causes are only as good as the model of
the water."""
TAKEN_WRONGLY = 0.4
"""Standard deviation of what is taken off an amplitude for backscatter, of it: as far as the model of the water is off
beyond its causes."""
_WIDE_UM = 1e3
"""Standard deviation of an amplitude that the seen patches say nothing about."""


@dataclass(frozen=True, slots=True)
class TrendPoint:
    """One judged scan."""

    scan: str | None
    """Number of the scan, where it has one."""
    amplitudes_um: Four
    """Height, twist, scale, shear against the reference, RMS over the volume."""
    sigma_um: Four
    """Standard deviations of the amplitudes in normal operation."""
    rest_um: float
    """RMS of the pattern that the four leave over, without noise."""
    score: float
    """Length of the amplitudes in standard deviations; 2 is usual."""
    total: float
    """The sum after this scan; the alarm is at ``LIMIT``."""
    alarm: bool
    third_um: Four | None = field(default=None, metadata=LEFT_OUT)
    """Even, across, down, corners of the third gap; ``None``, as the next one: no projector was learnt, or too little of
    the image shows it."""
    third_sigma_um: Four | None = field(default=None, metadata=LEFT_OUT)


@dataclass(frozen=True, slots=True)
class Reference:
    """Gaps of each patch of the left image in the first normal scans; zeros where no scan has shown the patch yet."""

    gap_um: tuple[float, ...] = (0.0,) * PatchGaps.COUNT
    variance_um2: tuple[float, ...] = (0.0,) * PatchGaps.COUNT
    scans: tuple[int, ...] = (0,) * PatchGaps.COUNT
    rests_um: tuple[float, ...] = ()
    """RMS rests in µm of the scans that taught the reference."""
    water_index: float | None = None
    """Mean refractive index of the scans that taught."""
    offset_um: Four = (0.0, 0.0, 0.0, 0.0)
    """Amplitudes that a length check found harmless: they are normal, too."""
    doubts_um: tuple[float, ...] = (0.0,) * (PatchGaps.COUNT * (PatchGaps.DOUBTS + 1))
    """Standard deviations of what backscatter did to the gaps, patch after patch: mean of the scans that taught it of
    ``PatchGaps.doubts_um`` and ``PatchGaps.shape_um``. The same causes are wrong in the same way in later scans."""


@dataclass(frozen=True, slots=True)
class ThirdTrend:
    """Memory of the third gaps of one fitted projector."""

    projector: str | None = None
    """Hash of the fit; ``None``: there was none."""
    reference: Reference = Reference()
    total: Four = (0.0, 0.0, 0.0, 0.0)
    """Its share of the sum."""


@dataclass(frozen=True, slots=True)
class OverlapNews:
    """The word of one object's overlaps on the smooth depth error that all its scans share
    (``calibration.depth_error``)."""

    object: str
    scans: int
    bend_um: float
    """RMS over the view of the error found."""
    sigma_um: float
    """RMS over the view of what is left uncertain of it."""
    score: float
    """Distance from what the calibration states, in standard deviations; about 1 is usual."""

    @property
    def alarm(self) -> bool:
        """Tell whether the calibration is not what it was."""
        return self.score > OVERLAP_LIMIT


@dataclass(frozen=True, slots=True)
class HealthTrend:
    """Everything remembered about one calibration."""

    reference: Reference = Reference()
    total: Four = (0.0, 0.0, 0.0, 0.0)
    """The sum of scores, with its direction."""
    judged: int = 0
    points: tuple[TrendPoint, ...] = ()
    """The latest scans, oldest first."""
    alarm: str | None = None
    """Finding in words, until somebody answered it."""
    answers: tuple[str, ...] = ()
    """Length checks after which an alarm was taken back."""
    overlaps: tuple[OverlapNews, ...] = ()
    """Words of objects' overlaps, the latest of each object, oldest first."""
    third: ThirdTrend = field(default=ThirdTrend(), metadata=LEFT_OUT)

    def named(self, scan: str) -> HealthTrend:
        """Return the trend with the number that the latest scan gets on the disk."""
        return replace(self, points=(*self.points[:-1], replace(self.points[-1], scan=scan)))


@dataclass(frozen=True, slots=True)
class HealthJudgement:
    """Findings of one scan about the calibration."""

    point: TrendPoint | None
    """Point of the trend; ``None``: not judged."""
    alarm: bool
    text: str
    numbers: Mapping[str, float | None]
    normal: bool = False
    """The scan is beyond doubt: what is learnt may be learnt from it."""


def judge_health(
    trend: HealthTrend, gaps: PatchGaps, scan: str | None = None, third: PatchGaps | None = None
) -> tuple[HealthTrend, HealthJudgement]:
    """Return the trend after one more scan (its number, where it has one already), and what is to be said about it.

    ``third``: its third gaps, where a projector was learnt.
    """
    if len(gaps.patch) < FEWEST_PATCHES:
        text = f"not judged: {len(gaps.patch)} of {PatchGaps.COUNT} patches seen, {FEWEST_PATCHES} are needed"
        return trend, HealthJudgement(None, trend.alarm is not None, text, _counts(gaps))
    if not _are_numbers(gaps):
        return trend, HealthJudgement(None, trend.alarm is not None, "not judged: a gap is not a number", _counts(gaps))
    veil_um = _veil_doubt_um(gaps)
    if veil_um > MOST_VEIL_UM:
        text = f"not judged: backscatter may move the gaps by {veil_um:.0f} µm, allowed are {MOST_VEIL_UM:.0f}; scan in clearer water"
        return trend, HealthJudgement(None, trend.alarm is not None, text, _counts(gaps))
    # The three steps of the module's head, for the ray gap and for the third: their scores add up side by side.
    found = [_found(trend.reference, gaps, DRIFT_UM, HEIGHT_PER_INDEX_UM)]
    if third is not None and len(third.patch) >= FEWEST_PATCHES and _are_numbers(third):
        found.append(_found(trend.third.reference, third, THIRD_DRIFT_UM, 0.0))
    z = np.concatenate([_whitened(one.amplitudes_um, one.covariance) for one in found])
    before = np.array([*trend.total, *trend.third.total])
    total = _summed(before, np.pad(z, (0, len(before) - len(z))))
    size = float(np.linalg.norm(total))
    least_deg = _found_from_deg(found)
    # An alarm stays until somebody answers it: it is not raised twice, and the sum that caused it is kept.
    raised = trend.alarm is None and size > LIMIT
    amplitudes, sigmas = zip(*[(_four(one.amplitudes_um), _four(one.sigma_um)) for one in found], strict=True)
    point = TrendPoint(
        scan, amplitudes[0], sigmas[0], found[0].rest_um, float(np.linalg.norm(z)), size, raised or trend.alarm is not None,
        *((amplitudes[1], sigmas[1]) if len(found) > 1 else ()),
    )  # fmt: skip
    # The reference learns from scans that are beyond doubt; else a slow drift would teach itself to be normal.
    normal = not point.alarm and size <= TEACHES_UP_TO
    references = [trend.reference, trend.third.reference]
    if normal:
        for k, one in enumerate(found):
            references[k] = _taught(references[k], one.gaps, one.rest_um)
    text = _said(point, references[0]) + (_explained(found) if point.alarm else "")
    if least_deg is not None and max(least_deg) > MATTERS_DEG and not point.alarm:
        text += f"; {_blind_to(least_deg)}{_veiled(gaps)}"
    after = replace(
        trend,
        reference=references[0],
        total=_four(total[: len(MODES)]),
        judged=trend.judged + 1,
        points=(*trend.points, point)[-MOST_POINTS:],
        alarm=trend.alarm or (text if raised else None),
        third=replace(trend.third, reference=references[1], total=_four(total[len(MODES) :])),
    )
    return after, HealthJudgement(point, point.alarm, text, _numbers(point, found) | _turns(least_deg), normal)


def answered(trend: HealthTrend, answer: str) -> HealthTrend:
    """Return the trend after an accepted length check: the latest scan's state is normal from now on. ``answer`` says
    what was found."""
    nothing: Four = (0.0, 0.0, 0.0, 0.0)
    point = trend.points[-1] if trend.points else None
    third_um = next((one.third_um for one in reversed(trend.points) if one.third_um is not None), nothing)
    return replace(
        trend,
        reference=_moved(trend.reference, nothing if point is None else point.amplitudes_um),
        total=nothing,
        alarm=None,
        answers=(*trend.answers, answer)[-MOST_ANSWERS:],
        third=replace(trend.third, reference=_moved(trend.third.reference, third_um), total=nothing),
    )


def _moved(reference: Reference, latest_um: Four) -> Reference:
    # The offset moves the expectation by whole patterns instead of patch by patch, and every patch keeps the weight of
    # one scan at most, so that it follows what the next scans show.
    return replace(
        reference,
        offset_um=_four(np.array(reference.offset_um) + np.array(latest_um)),
        scans=tuple(min(n, 1) for n in reference.scans),
    )


def told_by_overlaps(trend: HealthTrend, news: OverlapNews) -> HealthTrend:
    """Return the trend after an object was solved; what the same object told before is replaced."""
    others = tuple(one for one in trend.overlaps if one.object != news.object)
    alarm = trend.alarm
    if alarm is None and news.alarm:
        alarm = (
            f"scans of object {news.object} overlap as if all were bent by {news.bend_um:.0f} ± {news.sigma_um:.0f} "
            "µm: "
            f"{news.score:.1f} times what the calibration states"
        )
    return replace(trend, alarm=alarm, overlaps=(*others, news)[-MOST_OBJECTS:])


@dataclass(frozen=True, slots=True)
class _Found:
    """One kind of gap of one scan against its reference."""

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


def _found(reference: Reference, gaps: PatchGaps, drift_um: Four, per_index_um: float) -> _Found:
    # The median with the taught scans keeps one odd scan from widening its own limits.
    rest_um = _rest(gaps)
    usual_um = float(np.median([*reference.rests_um, rest_um]))
    return _Found(gaps, *_compared(reference, gaps, usual_um, drift_um, per_index_um), rest_um)


def _found_from_deg(found: Sequence[_Found]) -> tuple[float, float, float] | None:
    """Return the smallest turns of the right camera about x, y, z that ``SCANS_TO_FIND`` scans like this one alarm at,
    in degrees; ``None``: how the amplitudes answer to turns was not asked."""
    # As many equal scores reach the limit when each exceeds the slack by its share of the limit.
    score = SLACK + LIMIT / SCANS_TO_FIND
    per_deg = np.zeros(3)
    for one in found:
        if one.gaps.turns_um is None:
            return None
        per_deg += [float(np.linalg.norm(_whitened(turn, one.covariance))) ** 2 for turn in one.gaps.turns_um]
    x, y, z = (score / max(one, 1e-9) for one in np.sqrt(per_deg))
    return x, y, z


def likeliest(amplitudes_um: Array, answers: Mapping[str, Array]) -> tuple[str, float, float]:
    """Return the one change that explains amplitudes (n,) best: its name, its size, and the share (0..1) that it
    explains.

    ``answers`` are the amplitudes (n,) per unit of each change in question.
    """
    best = ("", 0.0, 0.0)
    for name, one in answers.items():
        size = float(one @ amplitudes_um / (one @ one))
        left = float(np.sum((amplitudes_um - size * one) ** 2))
        share = 1.0 - left / max(float(amplitudes_um @ amplitudes_um), 1e-12)
        if share > best[2]:
            best = (name, size, share)
    return best


def _explained(found: Sequence[_Found]) -> str:
    """Return which single turn of the right camera would look most like it; it is one of many, so only in words for a
    technician."""
    per_rad = [None if one.gaps.turns_um is None else np.degrees(one.gaps.turns_um) for one in found]
    known = [turns_um for turns_um in per_rad if turns_um is not None]
    if len(known) < len(found):
        return ""
    answers = dict(zip(TURNS, np.concatenate(known, axis=1), strict=True))
    name, size, share = likeliest(np.concatenate([one.amplitudes_um for one in found]), answers)
    return f"; most like {in_words(name, -size)} ({100.0 * share:.0f} %)" if name else ""


def _rest(gaps: PatchGaps) -> float:
    """Return the RMS of what the four patterns leave over, less what noise alone leaves."""
    amplitudes = _solver(gaps.modes, np.diag(1.0 / (gaps.noise_um**2 + PATCH_UM**2))) @ gaps.gap_um
    # Unbiased variance of the rest: squares over the degrees of freedom, less the mean variance of the noise.
    left = gaps.gap_um - gaps.modes @ amplitudes
    freedom = max(len(left) - len(MODES), 1)
    return math.sqrt(max(float(np.sum(left**2)) / freedom - float(np.mean(gaps.noise_um**2)), 0.0))


def _compared(
    reference: Reference, gaps: PatchGaps, usual_um: float, drift_um: Four, per_index_um: float
) -> tuple[Array, Array]:
    """Return amplitudes (4,) against the reference and their covariance in normal operation; ``per_index_um``: what the
    first may change by per unit of the water's index."""
    offset = np.array(reference.offset_um)
    # Model: gap = expected + modes · a + smooth rest + white noise. A patch without a reference has all of the rest,
    # one with a reference the share that changes with distance.
    expected = np.array(reference.gap_um)[gaps.patch] + gaps.modes @ offset
    known = np.array(reference.scans)[gaps.patch] > 0
    left_over = usual_um * np.where(known, SHARE_KNOWN, 1.0)
    white = gaps.noise_um**2 + PATCH_UM**2 + np.array(reference.variance_um2)[gaps.patch]
    # What backscatter may do wrongly it does to the reference, too: only the difference counts.
    causes, shape = _doubts(gaps)
    known_causes = np.array(reference.doubts_um).reshape(PatchGaps.COUNT, PatchGaps.DOUBTS + 1)[gaps.patch]
    doubted_um = _size(causes)
    causes, shape = causes - known_causes[:, : PatchGaps.DOUBTS], shape - known_causes[:, PatchGaps.DOUBTS]
    share_new = min(_size(causes) / max(doubted_um, 1e-9), 1.0)
    # Generalised least squares: a cause moves all patches together, so that its pattern is told from that of a knock by
    # the scan itself. What is left over counts as if patches were independent, and its covariance as they are: it is
    # smooth, but how smooth is known too roughly to make use of it.
    weight = np.linalg.inv(np.diag(white + left_over**2 + shape**2) + causes @ causes.T)
    solve = _solver(gaps.modes, weight)
    amplitudes = solve @ (gaps.gap_um - expected)
    # Propagation of the true covariance S through the estimator K: K S Kᵀ. What the patches do not determine, (I − K
    # M), is as uncertain as before.
    smooth = np.outer(left_over, left_over) + np.outer(shape, shape)
    scatter = np.diag(white) + smooth * _alike(gaps.patch) + causes @ causes.T
    unseen = np.eye(len(MODES)) - solve @ gaps.modes
    covariance = (
        _misfit(gaps, expected, amplitudes, weight) * (solve @ scatter @ solve.T) + unseen @ unseen.T * _WIDE_UM**2
    )
    # Floors that no number of patches takes away: the best calibration's scatter, mounts that follow the temperature,
    # the part of an accepted change that varies with distance, for height the index times the change of the stated
    # water, and of what backscatter did a share, as far as it did something else to the reference.
    least = np.full(len(MODES), LEAST_UM**2) + np.square(drift_um) + (OFFSET_SHARE * offset) ** 2
    if reference.water_index is not None:
        least[0] += (per_index_um * (gaps.water_index - reference.water_index)) ** 2
    if gaps.veil_um is not None:
        independent = _solver(gaps.modes, np.diag(1.0 / (white + left_over**2 + shape**2)))
        least += (TAKEN_WRONGLY * share_new * (independent @ gaps.veil_um)) ** 2
    return amplitudes, covariance + np.diag(least)


def _misfit(gaps: PatchGaps, expected: Array, amplitudes: Array, weight: Array) -> float:
    """Return how much larger the variance of what is left of the gaps is than expected, at least 1; 1 where backscatter
    moves nothing."""
    # Shapes of causes are only as good as the model of the water. Where amplitudes and causes leave more than they may,
    # all is as much less certain; a knock leaves next to nothing. What a calibration leaves over is counted by itself
    # (``rest_um``).
    if gaps.doubts_um is None:
        return 1.0
    left = gaps.gap_um - expected - gaps.modes @ amplitudes
    return max(1.0, float(left @ weight @ left) / (len(left) - len(MODES)))


def _doubts(gaps: PatchGaps) -> tuple[Array, Array]:
    """Return the standard deviations of what backscatter does wrongly: of each cause (k, DOUBTS), and smooth ones (k,)."""
    if gaps.doubts_um is None or gaps.shape_um is None:
        return np.zeros((len(gaps.patch), PatchGaps.DOUBTS)), np.zeros(len(gaps.patch))
    return LASTING * gaps.doubts_um, LASTING * gaps.shape_um


def _veil_doubt_um(gaps: PatchGaps) -> float:
    """Return the standard deviation of what backscatter does wrongly, rms over the patches."""
    if gaps.doubts_um is None or gaps.shape_um is None:
        return 0.0
    return float(np.sqrt(np.mean(np.sum(gaps.doubts_um**2, axis=1) + gaps.shape_um**2)))


def _size(causes: Array) -> float:
    return float(np.sqrt(np.mean(np.sum(causes**2, axis=1))))


def _alike(patch: NDArray[np.intp]) -> Array:
    """Compute the correlation (k, k) between the rests of patches: lenses are smooth."""
    columns, rows = PatchGaps.GRID
    across, down = (patch % columns) / columns, (patch // columns) / rows * IMAGE_HEIGHT
    far2 = np.subtract.outer(across, across) ** 2 + np.subtract.outer(down, down) ** 2
    return np.asarray(np.exp(-0.5 * far2 / SMOOTH_OVER**2))


def _solver(modes: Array, weight: Array) -> Array:
    """Return the matrix (4, k) that makes amplitudes of gaps whose inverse covariance is ``weight`` (k, k); small where
    the patches say nothing."""
    # Least squares with a weak prior of _WIDE_UM: patterns that no patch shows stay near zero instead of exploding.
    weighted = modes.T @ weight
    return np.asarray(np.linalg.solve(weighted @ modes + np.eye(len(MODES)) / _WIDE_UM**2, weighted))


def _whitened(amplitudes: Array, covariance: Array) -> Array:
    # C^(-1/2) a by the eigenvectors: symmetric, so that every score keeps the direction of its pattern and the sums of
    # scans with different covariances can be added.
    values, vectors = np.linalg.eigh(covariance)
    return np.asarray(vectors @ ((vectors.T @ amplitudes) / np.sqrt(values)))


def _summed(total: Array, z: Array) -> Array:
    """Return the next sum after Crosier 1988: add, then shrink by the slack."""
    # Crosier's multivariate CUSUM: s ← (s + z)(1 − k / |s + z|), and 0 where |s + z| ≤ k. It keeps the direction, so
    # that scatter cancels and a constant shift adds up.
    together = total + z
    length = float(np.linalg.norm(together))
    return np.zeros_like(total) if length <= SLACK else np.asarray(together * (1.0 - SLACK / length))


def _taught(reference: Reference, gaps: PatchGaps, rest_um: float) -> Reference:
    mean, variance, scans = (
        np.array(values, float) for values in (reference.gap_um, reference.variance_um2, reference.scans)
    )
    learning = gaps.patch[scans[gaps.patch] < LEARNT_SCANS]
    if not len(learning):
        return reference
    at = np.isin(gaps.patch, learning)
    n = scans[learning]
    seen = gaps.gap_um[at] - gaps.modes[at] @ np.array(reference.offset_um)
    # Running mean of n + 1 scans, and the variance of that mean: (n² v + σ²) / (n + 1)².
    mean[learning] = (n * mean[learning] + seen) / (n + 1.0)
    variance[learning] = (n**2 * variance[learning] + gaps.noise_um[at] ** 2) / (n + 1.0) ** 2
    doubts = np.array(reference.doubts_um).reshape(PatchGaps.COUNT, PatchGaps.DOUBTS + 1)
    causes, shape = _doubts(gaps)
    doubts[learning] = (n[:, None] * doubts[learning] + np.column_stack([causes, shape])[at]) / (n[:, None] + 1.0)
    scans[learning] += 1.0
    rests, index = reference.rests_um, reference.water_index
    if len(rests) < LEARNT_SCANS:
        index = gaps.water_index if index is None else (len(rests) * index + gaps.water_index) / (len(rests) + 1)
        rests = (*rests, rest_um)
    return replace(
        reference,
        gap_um=tuple(float(v) for v in mean),
        variance_um2=tuple(float(v) for v in variance),
        scans=tuple(int(n) for n in scans),
        doubts_um=tuple(float(v) for v in doubts.ravel()),
        rests_um=rests,
        water_index=index,
    )


def _said(point: TrendPoint, reference: Reference) -> str:
    named = [*zip(MODES, point.amplitudes_um, strict=True)]
    if point.third_um is not None:
        named += zip(THIRD_MODES, point.third_um, strict=True)
    parts = ", ".join(f"{name} {value:+.1f} µm" for name, value in named)
    if point.alarm:
        return f"the ray gaps have changed since the calibration: {parts}; {point.score:.1f} standard deviations"
    taught = len(reference.rests_um)
    learning = f"; {taught} of {LEARNT_SCANS} scans of the reference" if taught < LEARNT_SCANS else ""
    return f"as since the calibration: {parts}{learning}"


def _blind_to(least_deg: tuple[float, float, float]) -> str:
    """Return which turns are found late, in words."""
    late = [f"{axis} below {least:.2g}°" for axis, least in zip("xyz", least_deg, strict=True) if least > MATTERS_DEG]
    return f"{SCANS_TO_FIND} such scans do not find turns of a camera about {', '.join(late)}"


def _veiled(gaps: PatchGaps) -> str:
    doubt_um = _veil_doubt_um(gaps)
    return f" (backscatter may move the gaps by {doubt_um:.0f} µm)" if doubt_um >= 1.0 else ""


def _turns(least_deg: tuple[float, float, float] | None) -> dict[str, float | None]:
    return (
        {} if least_deg is None else {f"found_{axis}_deg": least for axis, least in zip("xyz", least_deg, strict=True)}
    )


def _numbers(point: TrendPoint, found: Sequence[_Found]) -> dict[str, float | None]:
    numbers: dict[str, float | None] = {}
    for names, one in zip((MODES, THIRD_MODES), found, strict=False):
        for name, value, sigma in zip(names, one.amplitudes_um, one.sigma_um, strict=True):
            numbers |= {f"{name}_um": float(value), f"{name}_sigma_um": float(sigma)}
    if len(found) > 1:
        numbers |= {"third_um": float(np.sqrt(np.mean(found[1].gaps.gap_um ** 2))), "third_rest_um": found[1].rest_um}
    gaps = found[0].gaps
    if gaps.veil_um is not None:
        numbers |= {"veil_um": float(np.sqrt(np.mean(gaps.veil_um**2))), "veil_doubt_um": _veil_doubt_um(gaps)}
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
    """Content of the file."""

    trend: HealthTrend


def _refuse_impossible(stored: _StoredHealth) -> None:
    """Raises ValueError."""
    if stored.trend.judged < 0:
        raise ValueError(f"trend.judged is {stored.trend.judged}; allowed: whole numbers from 0")
    for reference in (stored.trend.reference, stored.trend.third.reference):
        if any(len(of) != PatchGaps.COUNT for of in (reference.gap_um, reference.variance_um2, reference.scans)):
            raise ValueError(f"its reference has not {PatchGaps.COUNT} patches")
        if len(reference.doubts_um) != PatchGaps.COUNT * (PatchGaps.DOUBTS + 1):
            raise ValueError(f"its reference has not {PatchGaps.DOUBTS + 1} doubts of {PatchGaps.COUNT} patches")


HEALTH = SealedFile(_StoredHealth, schema=1, max_bytes=1_000_000, indent=None, check=_refuse_impossible)


class LearntFile(Generic[T]):
    """One thing learnt about one calibration, in a file of its own. One process writes, any number may read."""

    def __init__(
        self, form: SealedFile[T], nothing: T, path: Path, calibration_hash: str, fs: FileSystem | None = None
    ) -> None:
        self._form, self._nothing = form, nothing
        self._fs: FileSystem = fs or LocalFileSystem()
        self._of: Mapping[str, str] = {"calibration": calibration_hash}
        self.path = path

    def read(self) -> T:
        """Read what is remembered; what nothing is known by where there is no file, or none that can be read."""
        try:
            found = self._form.load(self.path, self._of, name=str(self.path))
        except ContentError as error:
            log.warning("%s; it begins anew", error)
            found = None
        return self._nothing if found is None else found

    def write(self, learnt: T) -> None:
        """Write it all down; it is durable on return. Raises StorageError."""
        self._fs.make_folders(self.path.parent)
        self._set_aside()
        self._fs.replace_file(self.path, self._form.encode(learnt, self._of))

    def _set_aside(self) -> None:
        """Move a file that cannot be read aside, so that it is not overwritten."""
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
    """The memory of one calibration's trend."""

    def __init__(self, root: Path, calibration_hash: str, fs: FileSystem | None = None) -> None:
        self.path = root / FOLDER / f"{calibration_hash[:16]}.json"
        self._file = LearntFile(HEALTH, _StoredHealth(HealthTrend()), self.path, calibration_hash, fs)

    def read(self) -> HealthTrend:
        """Read the remembered trend; an empty one where there is none, or none that can be read."""
        return self._file.read().trend

    def write(self, trend: HealthTrend) -> None:
        """Write it all down; it is durable on return. Raises StorageError."""
        self._file.write(_StoredHealth(trend))
