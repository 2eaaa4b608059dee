"""Owns whether two scans lie to each other as found: accepted with a covariance, or refused in words.

The residual does not tell: a pair that slides fits as well as one that holds. What is asked instead: does something
hold every direction (``Fit.held``), do surfaces contradict each other, is the paint alike, and does no other pose fit
as well.

It also owns whether paint repeats itself: a printed grid fits as well one square farther, and no residual tells.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

import numpy as np
from numpy.typing import NDArray

from appliance.base import one_line
from appliance.measure.light.model import HousedCamera
from appliance.measure.light.volume import STANDARD, WorkingVolume
from appliance.measure.overlap.albedo import Paint, paint_of, patch_pitch_mm
from appliance.measure.overlap.coarse import Guess, guess_by_features, guess_by_shape, in_common, same
from appliance.measure.overlap.equations import Resistance
from appliance.measure.overlap.features import Features, features_of
from appliance.measure.overlap.fine import Fit, Prepared, own_resistance, refine
from appliance.measure.overlap.patches import Array, Patches, Projection, coarser, patches_of, projection_of
from appliance.measure.overlap.rigid import Rigid
from appliance.measure.points.organised import OrganisedCloud

ALIKE = 0.55
"""Correlation of the paint with itself, moved, from which on it repeats."""
NEAR_MM = 4.0
"""Paint always resembles itself this close by."""
MOST = 6
"""Number of shifts that are returned."""
LEAST_COMMON = 0.3
"""Least share of the patches that are compared at a shift."""


def repeats_of(patches: Patches, paint: Paint) -> list[Array]:
    """Return shifts (3,), mm in the scan's frame, by which the paint looks like itself; the most alike first.

    From the masked autocorrelation over the grid of patches (D. Padfield 2012), which on the usual distances of a dive
    is nearly metric.
    """
    value = paint.value
    known = np.isfinite(value)
    if np.count_nonzero(known) < 200:
        return []
    correlation, common = _autocorrelation(np.where(known, value, 0.0), known)
    h, w = value.shape
    pitch = patch_pitch_mm(patches)
    dv, du = np.mgrid[-h + 1 : h, -w + 1 : w]
    far = np.hypot(dv, du) * pitch > NEAR_MM
    # Each shift and its opposite are the same news.
    half = (dv > 0) | ((dv == 0) & (du > 0))
    candidate = far & half & (common > LEAST_COMMON * np.count_nonzero(known)) & (correlation > ALIKE)
    candidate &= _is_peak(correlation)
    at = np.argwhere(candidate)
    order = np.argsort(-correlation[candidate])[:MOST]
    shifts = []
    for v, u in at[order]:
        shift = _shift_mm(patches.centre_mm, int(dv[v, u]), int(du[v, u]))
        if shift is not None:
            shifts += [shift, -shift]
    return shifts


def _autocorrelation(value: Array, known: NDArray[np.bool_]) -> tuple[Array, Array]:
    """Return Pearson's correlation of the known values with themselves at each shift, zero shift in the middle, and how
    many are in common."""
    h, w = value.shape
    size = (2 * h - 1, 2 * w - 1)

    def correlate(a: Array, b: Array) -> Array:
        spectrum = np.fft.rfft2(a, size) * np.conj(np.fft.rfft2(b, size))
        full = np.fft.irfft2(spectrum, size)
        return np.roll(full, (h - 1, w - 1), axis=(0, 1))

    one = known.astype(np.float64)
    n = np.maximum(np.round(correlate(one, one)), 1.0)
    first, second = correlate(value, one), correlate(one, value)
    square = value * value
    product = correlate(value, value) - first * second / n
    spread = (correlate(square, one) - first**2 / n) * (correlate(one, square) - second**2 / n)
    return np.asarray(product / np.sqrt(np.maximum(spread, 1e-12))), n


def _is_peak(correlation: Array) -> NDArray[np.bool_]:
    inner = correlation[1:-1, 1:-1]
    peak = np.ones(inner.shape, bool)
    for dv in (-1, 0, 1):
        for du in (-1, 0, 1):
            if (dv, du) != (0, 0):
                peak &= (
                    inner >= correlation[1 + dv : correlation.shape[0] - 1 + dv, 1 + du : correlation.shape[1] - 1 + du]
                )
    return np.pad(peak, 1)


def _shift_mm(centre: Array, dv: int, du: int) -> Array | None:
    """Return the median displacement (3,) between patches ``dv`` rows and ``du`` columns apart."""
    h, w = centre.shape[:2]
    to = centre[max(dv, 0) : h + min(dv, 0), max(du, 0) : w + min(du, 0)]
    here = centre[max(-dv, 0) : h + min(-dv, 0), max(-du, 0) : w + min(-du, 0)]
    step = (to - here).reshape(-1, 3)
    step = step[np.isfinite(step[:, 0])]
    return np.median(step, axis=0) if len(step) else None


HELD = 5.0
"""Least stiffness of the softest direction, in standard deviations of what noise alone would make of it."""
MAX_SIGMA_MM = 0.4
"""Largest stated RMS displacement of a pose that is used."""
LEAST_OVERLAP = 0.08
MAX_OUTLIERS, MAX_FRONT = 0.05, 0.02
"""Largest shares of patches that miss the other surface, and that hover before it."""
LEAST_ALIKE = 0.6
"""Least correlation of paint where paint holds the pose; half of it where shape does."""
LEAST_ALIKE_REPEATING = 0.82
"""The same where paint that repeats holds the pose: some squares farther it is still alike by up to 0.78 (a board of
markers)."""
AS_GOOD, AS_ALIKE = 0.04, 0.06
"""A pose whose share of contradictions is larger, and whose paint is less alike, by less than these is as good as the
best one."""
SLIDES_ROUGHLY = 3.0
"""Poses that the search by shape found and that planes hold less than this slide: others like them stand for one
family, and for few."""
MOST_SLIDING = 4
"""Sliding poses that are tried: a bar may lie either way round, and each way slides about its axis."""
TURNS = 0.4
"""Share of a loose direction, of length 1, that must be turn for it to be called one: a pipe of 0.2 m radius about its
axis has that."""
INSIDE = 0.15
"""An axis that lies so deep behind the surface, in levers, is the thing's own."""
LEVEL_DEG = 22.5
UNEVEN = "have something uneven in both views (a flange, a weld, an edge), or stick on marks"
COARSE = 3
"""Patches a side that the search by shape joins."""


class PairRefusal(Enum):
    """Reason why two scans are not placed relative to each other."""

    NOTHING_IN_COMMON = "nothing in common"
    TOO_LITTLE = "too little in common"
    SLIDES = "slides"
    CONTRADICTS = "surfaces contradict each other"
    AMBIGUOUS = "more than one pose fits"
    UNCERTAIN = "too uncertain"


@dataclass(frozen=True, slots=True, eq=False)
class ReadyScan:
    """A scan as registration wants it; made once per scan."""

    fine: Prepared
    coarse: Prepared
    features: Features
    repeats: tuple[Array, ...]
    own: Resistance
    """Resistance of the scan's own shape, all of it, to a displacement."""

    @property
    def holds(self) -> bool:
        """Its shape alone holds every direction; where it does not, no pair with it can be told by shape."""
        return bool(self.own.held.min() >= HELD)

    def marks_in_common(self, other: ReadyScan, pose: Rigid) -> int:
        """Return the number of features that both show, where ``pose`` lays those of ``other`` on its own."""
        return len(in_common(self.features, other.features, pose))

    __repr__ = one_line


@dataclass(frozen=True, slots=True, eq=False)
class RegisteredPair:
    """Two scans that were compared, and what came of it."""

    fit: Fit | None
    """The best pose; of a refused pair nothing of it is known, its overlap neither. ``None``: there is none."""
    refusal: PairRefusal | None
    text: str
    """Finding in words: how closely they are placed, or why not and what would help."""

    __repr__ = one_line

    @property
    def accepted(self) -> bool:
        """The pose may be used."""
        return self.refusal is None


def ready(
    cloud: OrganisedCloud,
    camera: HousedCamera,
    water_index: float,
    light_mm: Array,
    volume: WorkingVolume = STANDARD,
) -> ReadyScan:
    """Prepare a scan for registration.

    ``light_mm``: where the projector's light comes from, in the left camera's frame.
    """
    return ready_with(cloud, projection_of(camera, water_index, volume), light_mm)


def ready_with(cloud: OrganisedCloud, projection: Projection, light_mm: Array) -> ReadyScan:
    """Prepare a scan with a projection that was fitted before."""
    patches = patches_of(cloud, projection)
    fine = Prepared(patches, paint_of(patches, light_mm))
    joined = coarser(patches, COARSE)
    nothing = np.full(joined.sigma_mm.shape, np.nan)
    coarse = Prepared(joined, Paint(nothing, np.full((*nothing.shape, 3), np.nan), nothing))
    return ReadyScan(fine, coarse, features_of(cloud), tuple(repeats_of(patches, fine.paint)), own_resistance(fine))


def register(a: ReadyScan, b: ReadyScan, near: Rigid | None = None) -> RegisteredPair:
    """Find the pose of B in A's frame. ``near``: where it is thought to be, for instance by a graph of other pairs."""
    fits = [] if near is None else _fits(a, b, [Guess(near, 0.0, False)])
    if not any(_plausible(fit) for fit in fits):
        fits += _fits(a, b, guess_by_features(a.features, b.features))
    # Paint that repeats has features that repeat: they may have led to one place of several, all of which the shape
    # knows.
    repeats = bool(a.repeats or b.repeats)
    by_shape = []
    # What slides by its own shape the search would lay anywhere along the slide, each place as good as any other.
    if repeats if any(_plausible(fit) for fit in fits) else a.holds and b.holds:
        by_shape = _fits_by_shape(a, b)
    fits += by_shape
    if not fits:
        sliding = PairRefusal.AMBIGUOUS if repeats else PairRefusal.SLIDES
        why = PairRefusal.NOTHING_IN_COMMON if a.holds and b.holds else sliding
        return RegisteredPair(None, why, _words(why, None, a, b))
    # Of those that may be believed the one that least contradicts; where there is none, the reason of the best of the
    # others.
    fits = sorted(fits, key=lambda fit: (not _plausible(fit), _contradiction(fit)))
    best = fits[0]
    refusal = refusal_of(best)
    if refusal is None:
        others = fits[1:] + _repeated(a, b, best)
        # A thing too small to be searched by shape (a ball bar) is the same turned half about, and so is a grid on it.
        unlike = (best.alike or 0.0) < LEAST_ALIKE_REPEATING
        doubtful = repeats and best.paint_share > 0.5 and (unlike or not by_shape)
        if doubtful or any(_as_good(other, best, repeats=repeats and best.paint_share > 0.5) for other in others):
            refusal = PairRefusal.AMBIGUOUS
    return RegisteredPair(best, refusal, _words(refusal, best, a, b))


def _fits(a: ReadyScan, b: ReadyScan, guesses: list[Guess]) -> list[Fit]:
    """Refine guesses; distinct ones remain."""
    fits: list[Fit] = []
    for guess in guesses:
        fit = refine(a.fine, b.fine, guess.pose, gate_mm=2.0)
        if fit is not None and all(not same(fit.pose, one.pose, 1.0) for one in fits):
            fits.append(fit)
    return fits


def _fits_by_shape(a: ReadyScan, b: ReadyScan) -> list[Fit]:
    """Search by shape and refine what was found."""
    chosen: list[Guess] = []
    sliding = 0
    for guess in guess_by_shape(a.coarse, b.coarse):
        # From four millimetres down to one: planes alone first, since paint leads only from near by.
        rough = refine(a.coarse, b.coarse, guess.pose, gate_mm=4.0, with_paint=False)
        if rough is None or rough.outliers > 0.3:
            continue
        if rough.held.min() < SLIDES_ROUGHLY:
            if sliding == MOST_SLIDING:
                continue
            sliding += 1
        chosen.append(Guess(rough.pose, guess.support, False))
    return _fits(a, b, chosen)


def _contradiction(fit: Fit) -> float:
    """Return what speaks against a fit: shares of patches that miss, hover or find nothing, and paint that differs."""
    unlike = 0.0 if fit.alike is None else 0.3 * (1.0 - fit.alike)
    return fit.outliers + 2.0 * fit.front + fit.unmet + unlike - 0.1 * min(fit.overlap, 1.0)


def _as_good(other: Fit, best: Fit, *, repeats: bool) -> bool:
    # Where there is no paint to decide, or paint that repeats, a place that slides explains what is seen as well as one
    # that is held.
    slides = (best.alike is None or repeats) and refusal_of(other) is PairRefusal.SLIDES
    if not (_plausible(other) or slides) or other.overlap < 0.5 * best.overlap:
        return False
    if same(other.pose, best.pose, 1.0 + 5.0 * best.sigma_mm):
        return False
    less_alike = best.alike is not None and other.alike is not None and other.alike < best.alike - AS_ALIKE
    # Paint that repeats is very alike in wrong places, too: against a place that slides it does not decide.
    if less_alike and not slides:
        return False
    return other.outliers + other.front + other.unmet < best.outliers + best.front + best.unmet + AS_GOOD


def _repeated(a: ReadyScan, b: ReadyScan, best: Fit) -> list[Fit]:
    """Return fits one repeat of the paint away from the best one; none where shape holds it, which would contradict
    them."""
    if best.paint_share < 0.5:
        return []
    guesses = [Guess(Rigid(best.pose.rotation, best.pose.translation_mm + shift), 0.0, False) for shift in a.repeats]
    return [fit for fit in _fits(a, b, guesses) if not same(fit.pose, best.pose, 1.0)]


def _plausible(fit: Fit) -> bool:
    return refusal_of(fit) is None


def refusal_of(fit: Fit) -> PairRefusal | None:
    """Return what speaks against a fit, whatever other poses there are; ``None``: nothing."""
    if fit.overlap < LEAST_OVERLAP:
        return PairRefusal.TOO_LITTLE
    if fit.outliers > MAX_OUTLIERS:
        return PairRefusal.CONTRADICTS
    by_paint = fit.paint_share > 0.5
    # Before all that another place along the slide could mend.
    if fit.held.min() < HELD:
        return PairRefusal.SLIDES
    if fit.front > MAX_FRONT:
        return PairRefusal.CONTRADICTS
    if fit.alike is None:
        if by_paint:
            return PairRefusal.SLIDES
    elif fit.alike < (LEAST_ALIKE if by_paint else 0.5 * LEAST_ALIKE):
        return PairRefusal.CONTRADICTS
    return PairRefusal.UNCERTAIN if fit.sigma_mm > MAX_SIGMA_MM else None


def _words(refusal: PairRefusal | None, fit: Fit | None, a: ReadyScan, b: ReadyScan) -> str:
    if refusal is PairRefusal.NOTHING_IN_COMMON:
        return "no pose was found: nothing in common; scan in between, or with more overlap"
    if refusal is PairRefusal.AMBIGUOUS:
        return (
            "it fits as well elsewhere, since shape or paint repeats: have something that is there once in both views"
        )
    if fit is None:
        slides = b if a.holds else a
        loose = freedom(slides.own.directions, slides.own.held)
        return f"no marks in common, and by shape alone the {'second' if a.holds else 'first'} can {loose}: scan in between, {UNEVEN}"
    if refusal is None:
        return f"{100.0 * fit.overlap:.0f} % in common; placed within {1000.0 * fit.sigma_mm:.0f} µm"
    if refusal is PairRefusal.SLIDES or refusal is PairRefusal.UNCERTAIN:
        if fit.alike is not None and fit.alike >= LEAST_ALIKE:
            remedy = (
                "both show the same marks, but too few to hold it: scan again with more in common, or stick on marks"
            )
        elif a.holds and b.holds:
            remedy = "what holds each of them is not in both views: scan in between"
        else:
            remedy = UNEVEN
        return f"the second can {freedom(fit.directions, fit.held)} on the first: {remedy}"
    if refusal is PairRefusal.TOO_LITTLE:
        return "too little in common: scan again with half of the view in common"
    return "surfaces contradict each other: one of the scans may have moved, or they show different places"


def freedom(directions: Array, held: Array) -> str:
    """Return in words how a scan can move, as seen by the camera whose frame ``directions`` (6, 6) are in: along those
    that ``held`` (6,) says are not held; along the least held where all are."""
    loose = held < HELD if (held < HELD).any() else held == held.min()
    soft = directions[:, loose]
    # Of what is loose any mixture is: mixed so that those that turn least come last.
    _, turning, mixing = np.linalg.svd(soft[:3])
    motions = mixing @ soft.T
    turns = np.count_nonzero(turning > TURNS)
    said = [f"turn about {_axis(motion)}" for motion in motions[:turns]]
    slides = [f"slide {_way(motion[3:], 'to and from the instrument')}" for motion in motions[turns:]]
    if len(said) == 3:
        said = ["turn any way"]
    if len(slides) > 1:
        slides = ["slide any way along the surface" if len(slides) == 2 else "slide any way"]
    return " and ".join([*slides, *said])


def _axis(motion: Array) -> str:
    turn, shift = motion[:3], motion[3:]
    # Where nothing moves, from the overlap's middle: an axis within the thing is its own, whatever its radius.
    behind = float(np.cross(turn, shift)[2] / (turn @ turn))
    way = _way(turn, "")
    if not way:
        return "the line of sight"
    return f"{'its own' if behind > INSIDE else 'an'} axis {way}"


def _way(direction: Array, away: str) -> str:
    """Return a direction as one sees it in the picture, ``away`` for one that leads out of it."""
    x, y, z = direction / np.linalg.norm(direction)
    if abs(z) > max(abs(x), abs(y)):
        return away
    angle = float(np.degrees(np.arctan2(-y, x)))
    angle = angle - 180.0 if angle > 90.0 else angle + 180.0 if angle <= -90.0 else angle
    if abs(angle) < LEVEL_DEG:
        return "left-right"
    if abs(angle) > 90.0 - LEVEL_DEG:
        return "up-down"
    return "from lower left to upper right" if angle > 0.0 else "from upper left to lower right"
