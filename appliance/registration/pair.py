"""Owns whether two scans lie to each other as found: accepted with a covariance, or refused in words.

The residual does not tell: a pair that slides fits as well as one that holds. What is asked instead: does something hold every direction
(``Fit.held``), do surfaces contradict each other, is the paint alike, and does no other pose fit as well.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

import numpy as np

from appliance.one_line import one_line
from appliance.optics.model import HousedCamera
from appliance.optics.volume import STANDARD, WorkingVolume
from appliance.reconstruct.organised import OrganisedCloud
from appliance.registration.albedo import Paint, paint_of
from appliance.registration.coarse import Guess, guess_by_features, guess_by_shape, same
from appliance.registration.features import Features, features_of
from appliance.registration.fine import Fit, Prepared, refine
from appliance.registration.patches import Array, Projection, coarser, patches_of, projection_of
from appliance.registration.repeats import repeats_of
from appliance.registration.rigid import Rigid

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
"""The same where paint that repeats holds the pose: some squares farther it is still alike by up to 0.78 (a board of markers)."""
AS_GOOD, AS_ALIKE = 0.04, 0.06
"""A pose whose share of contradictions is larger, and whose paint is less alike, by less than these is as good as the best one."""
SLIDES_ROUGHLY = 3.0
"""Poses that the search by shape found and that planes hold less than this slide: others like them stand for one family, and for few."""
MOST_SLIDING = 4
"""Sliding poses that are tried: a bar may lie either way round, and each way slides about its axis."""
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

    __repr__ = one_line


@dataclass(frozen=True, slots=True, eq=False)
class RegisteredPair:
    """Two scans that were compared, and what came of it."""

    fit: Fit | None
    """The best pose, also of a refused pair; ``None``: there is none."""
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
    """Prepare a scan for registration. ``light_mm``: where the projector's light comes from, in the left camera's frame."""
    return ready_with(cloud, projection_of(camera, water_index, volume), light_mm)


def ready_with(cloud: OrganisedCloud, projection: Projection, light_mm: Array) -> ReadyScan:
    """Prepare a scan with a projection that was fitted before."""
    patches = patches_of(cloud, projection)
    fine = Prepared(patches, paint_of(patches, light_mm))
    joined = coarser(patches, COARSE)
    nothing = np.full(joined.sigma_mm.shape, np.nan)
    coarse = Prepared(joined, Paint(nothing, np.full((*nothing.shape, 3), np.nan), nothing))
    return ReadyScan(fine, coarse, features_of(cloud), tuple(repeats_of(patches, fine.paint)))


def register(a: ReadyScan, b: ReadyScan, near: Rigid | None = None) -> RegisteredPair:
    """Find the pose of B in A's frame. ``near``: where it is thought to be, for instance by a graph of other pairs."""
    fits = [] if near is None else _fits(a, b, [Guess(near, 0.0, False)])
    if not any(_plausible(fit) for fit in fits):
        fits += _fits(a, b, guess_by_features(a.features, b.features))
    # Paint that repeats has features that repeat: they may have led to one place of several, all of which the shape knows.
    repeats = bool(a.repeats or b.repeats)
    by_shape = _fits_by_shape(a, b) if repeats or not any(_plausible(fit) for fit in fits) else []
    fits += by_shape
    if not fits:
        return RegisteredPair(None, PairRefusal.NOTHING_IN_COMMON, _words(PairRefusal.NOTHING_IN_COMMON, None))
    # Of those that may be believed the one that least contradicts; where there is none, the reason of the best of the others.
    fits = sorted(fits, key=lambda fit: (not _plausible(fit), _contradiction(fit)))
    best = fits[0]
    refusal = _refused(best)
    if refusal is None:
        others = fits[1:] + _repeated(a, b, best)
        # A thing too small to be searched by shape (a ball bar) is the same turned half about, and so is a grid on it.
        unlike = (best.alike or 0.0) < LEAST_ALIKE_REPEATING
        doubtful = repeats and best.paint_share > 0.5 and (unlike or not by_shape)
        if doubtful or any(_as_good(other, best, repeats=repeats and best.paint_share > 0.5) for other in others):
            refusal = PairRefusal.AMBIGUOUS
    return RegisteredPair(best, refusal, _words(refusal, best))


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
    # Where there is no paint to decide, or paint that repeats, a place that slides explains what is seen as well as one that is held.
    slides = (best.alike is None or repeats) and _refused(other) is PairRefusal.SLIDES
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
    """Return fits one repeat of the paint away from the best one; none where shape holds it, which would contradict them."""
    if best.paint_share < 0.5:
        return []
    guesses = [Guess(Rigid(best.pose.rotation, best.pose.translation_mm + shift), 0.0, False) for shift in a.repeats]
    return [fit for fit in _fits(a, b, guesses) if not same(fit.pose, best.pose, 1.0)]


def _plausible(fit: Fit) -> bool:
    return _refused(fit) is None


def _refused(fit: Fit) -> PairRefusal | None:
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


def _words(refusal: PairRefusal | None, fit: Fit | None) -> str:
    if fit is None or refusal is PairRefusal.NOTHING_IN_COMMON:
        return "no pose was found: nothing in common; scan in between, or with more overlap"
    share = f"{100.0 * fit.overlap:.0f} % in common"
    if refusal is None:
        return f"{share}; placed within {1000.0 * fit.sigma_mm:.0f} µm"
    if refusal is PairRefusal.SLIDES or refusal is PairRefusal.UNCERTAIN:
        return f"{share}; {softest(fit)} without resistance: have something uneven in both views (a flange, a weld, an edge), or stick on marks"
    if refusal is PairRefusal.AMBIGUOUS:
        return f"{share}; it fits as well elsewhere, since shape or paint repeats: have something that is there once in both views"
    if refusal is PairRefusal.TOO_LITTLE:
        return f"only {share}: scan again with half of the view in common"
    return (
        f"{share}, but surfaces contradict each other: one of the scans may have moved, or they show different places"
    )


def softest(fit: Fit) -> str:
    """Return in words how the pair gives way most easily, as seen by A's camera."""
    soft = fit.directions[:, 0]
    turn, shift = soft[:3], soft[3:]
    names = ("sideways", "up and down", "to and from the instrument")
    if np.linalg.norm(shift) >= np.linalg.norm(turn):
        k = int(np.argmax(np.abs(shift)))
        if k < 2:
            angle = float(np.degrees(np.arctan2(-shift[1], shift[0])))
            angle = angle - 180.0 if angle > 90.0 else angle + 180.0 if angle <= -90.0 else angle
            return f"slides along {angle:.0f}° to the image's rows"
        return f"slides {names[k]}"
    k = int(np.argmax(np.abs(turn)))
    about = ("the image's rows", "the image's columns", "the viewing direction")[k]
    return f"turns about {about}"
