"""Registration of two scans: the pose with its covariance, or a refusal in words.

A small residual is no proof, since a pair that slides fits as well as one that is fixed. The judge asks four other
questions: is every direction determined (``Fit.significance``), do the surfaces contradict each other, does the texture
correlate, and does no other pose fit as well?

register, ready, ready_with   the pose of one scan in the frame of another, and the preparation of a scan for it
refusal_of                    the judgement of one fit
repeats_of                    the shifts by which a texture repeats: a printed grid also fits one square farther
freedom                       undetermined directions in words
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

import numpy as np
from numpy.typing import NDArray

from appliance.base import one_line
from appliance.measure.light.model import HousedCamera
from appliance.measure.light.volume import STANDARD, WorkingVolume
from appliance.measure.overlap.albedo import Texture, patch_pitch_mm, texture_of
from appliance.measure.overlap.coarse import Guess, guess_by_features, guess_by_shape, in_common, same
from appliance.measure.overlap.equations import Resistance
from appliance.measure.overlap.features import Features, features_of
from appliance.measure.overlap.fine import Fit, PreparedScan, refine, self_resistance
from appliance.measure.overlap.patches import Array, Patches, Projection, coarser, patches_of, projection_of
from appliance.measure.overlap.rigid import Rigid
from appliance.measure.points.organised import OrganisedCloud

ALIKE = 0.55
"""Least autocorrelation of a texture that repeats."""
NEAR_MM = 4.0
"""Largest shift at which every texture correlates with itself."""
MOST = 6
"""Largest number of shifts."""
LEAST_COMMON = 0.3
"""Least share of the patches that overlap at a shift."""


def repeats_of(patches: Patches, texture: Texture) -> list[Array]:
    """Return the shifts (3,), mm, by which the texture repeats; the highest correlation first.

    They are in the scan's frame. They come from the masked autocorrelation over the grid of patches (D. Padfield 2012),
    which is nearly metric at the usual distances of a dive.
    """
    value = texture.value
    finite = np.isfinite(value)
    if np.count_nonzero(finite) < 200:
        return []
    correlation, common = _autocorrelation(np.where(finite, value, 0.0), finite)
    h, w = value.shape
    pitch = patch_pitch_mm(patches)
    dv, du = np.mgrid[-h + 1 : h, -w + 1 : w]
    far = np.hypot(dv, du) * pitch > NEAR_MM
    # A shift and its opposite have the same correlation.
    half = (dv > 0) | ((dv == 0) & (du > 0))
    candidate = far & half & (common > LEAST_COMMON * np.count_nonzero(finite)) & (correlation > ALIKE)
    candidate &= _is_peak(correlation)
    peaks = np.argwhere(candidate)
    order = np.argsort(-correlation[candidate])[:MOST]
    shifts = []
    for v, u in peaks[order]:
        shift = _shift_mm(patches.centre_mm, int(dv[v, u]), int(du[v, u]))
        if shift is not None:
            shifts += [shift, -shift]
    return shifts


def _autocorrelation(value: Array, valid: NDArray[np.bool_]) -> tuple[Array, Array]:
    """Return Pearson's autocorrelation and the number of values in it at each shift; zero shift is central."""
    h, w = value.shape
    size = (2 * h - 1, 2 * w - 1)

    def correlate(a: Array, b: Array) -> Array:
        spectrum = np.fft.rfft2(a, size) * np.conj(np.fft.rfft2(b, size))
        full = np.fft.irfft2(spectrum, size)
        return np.roll(full, (h - 1, w - 1), axis=(0, 1))

    mask = valid.astype(np.float64)
    n = np.maximum(np.round(correlate(mask, mask)), 1.0)
    first, second = correlate(value, mask), correlate(mask, value)
    square = value * value
    product = correlate(value, value) - first * second / n
    spread = (correlate(square, mask) - first**2 / n) * (correlate(mask, square) - second**2 / n)
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
    ends = centre[max(dv, 0) : h + min(dv, 0), max(du, 0) : w + min(du, 0)]
    starts = centre[max(-dv, 0) : h + min(-dv, 0), max(-du, 0) : w + min(-du, 0)]
    step = (ends - starts).reshape(-1, 3)
    step = step[np.isfinite(step[:, 0])]
    return np.median(step, axis=0) if len(step) else None


HELD = 5.0
"""Least stiffness of the softest direction, in standard deviations of its stiffness by noise alone."""
MAX_SIGMA_MM = 0.4
"""Largest stated RMS displacement of a pose that is used."""
LEAST_OVERLAP = 0.08
MAX_OUTLIERS, MAX_FRONT = 0.05, 0.02
"""Largest shares of outliers, and of patches in front of the other surface."""
LEAST_ALIKE = 0.6
"""Least correlation of texture where texture determines the pose; half of it where shape does."""
LEAST_ALIKE_REPEATING = 0.82
"""The same for texture that repeats: a board of markers still correlates by up to 0.78 some squares farther."""
AS_GOOD, AS_ALIKE = 0.04, 0.06
"""Largest differences of contradictions and of texture correlation between the best pose and one that is as good."""
SLIDES_ROUGHLY = 3.0
"""Least significance, by planes alone, of a pose of the search by shape that does not slide."""
MOST_SLIDING = 4
"""Number of sliding poses that are refined: a bar has two orientations, and each slides about its axis."""
TURNS = 0.4
"""Least share of rotation in a free direction, of length 1, that is called a turn: a pipe of 0.2 m radius has that."""
INSIDE = 0.15
"""Least depth behind the surface, in levers, of an axis that is called the object's own."""
LEVEL_DEG = 22.5
UNEVEN = "bring a structured part (a flange, a weld, an edge) into both views, or stick on marks"
COARSE = 3
"""Patches per side that are joined for the search by shape."""


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
    """A scan that is prepared for registration."""

    fine: PreparedScan
    coarse: PreparedScan
    features: Features
    repeats: tuple[Array, ...]
    resistance: Resistance
    """Resistance of the scan's whole shape to a displacement."""

    @property
    def holds(self) -> bool:
        """True if the shape alone determines every direction.

        Otherwise no pair with this scan is registered by shape.
        """
        return bool(self.resistance.significance.min() >= HELD)

    def common_keypoints(self, second: ReadyScan, pose: Rigid) -> int:
        """Return the number of keypoints that this scan shares with ``second`` at ``pose``."""
        return len(in_common(self.features, second.features, pose))

    __repr__ = one_line


@dataclass(frozen=True, slots=True, eq=False)
class RegisteredPair:
    """The result of registering two scans."""

    fit: Fit | None
    """The best pose; ``None``: there is none. Of a refused pair neither pose nor overlap can be relied on."""
    refusal: PairRefusal | None
    text: str
    """The result in words: how certain the pose is, or the refusal and its remedy."""

    __repr__ = one_line

    @property
    def accepted(self) -> bool:
        """True if the pose may be used."""
        return self.refusal is None


def ready(
    cloud: OrganisedCloud,
    camera: HousedCamera,
    water_index: float,
    light_mm: Array,
    volume: WorkingVolume = STANDARD,
) -> ReadyScan:
    """Prepare a scan for registration.

    ``light_mm``: position of the projector's light in the left camera's frame.
    """
    return ready_with(cloud, projection_of(camera, water_index, volume), light_mm)


def ready_with(cloud: OrganisedCloud, projection: Projection, light_mm: Array) -> ReadyScan:
    """Prepare a scan with a projection that was fitted before."""
    patches = patches_of(cloud, projection)
    fine = PreparedScan(patches, texture_of(patches, light_mm))
    joined = coarser(patches, COARSE)
    unknown = np.full(joined.sigma_mm.shape, np.nan)
    coarse = PreparedScan(joined, Texture(unknown, np.full((*unknown.shape, 3), np.nan), unknown))
    return ReadyScan(fine, coarse, features_of(cloud), tuple(repeats_of(patches, fine.texture)), self_resistance(fine))


def register(a: ReadyScan, b: ReadyScan, near: Rigid | None = None) -> RegisteredPair:
    """Find the pose of B in A's frame; ``near``: an approximate pose, such as that of other pairs."""
    fits = [] if near is None else _fits(a, b, [Guess(near, 0.0, False)])
    if not any(_plausible(fit) for fit in fits):
        fits += _fits(a, b, guess_by_features(a.features, b.features))
    # Repeating texture has repeating features, which may give one pose of several; the search by shape finds all.
    repeats = bool(a.repeats or b.repeats)
    by_shape = []
    # For a shape that slides, the search would return arbitrary poses along the slide.
    if repeats if any(_plausible(fit) for fit in fits) else a.holds and b.holds:
        by_shape = _fits_by_shape(a, b)
    fits += by_shape
    if not fits:
        sliding = PairRefusal.AMBIGUOUS if repeats else PairRefusal.SLIDES
        reason = PairRefusal.NOTHING_IN_COMMON if a.holds and b.holds else sliding
        return RegisteredPair(None, reason, _words(reason, None, a, b))
    # The plausible fit with the fewest contradictions; if none is plausible, the best fit gives the refusal.
    fits = sorted(fits, key=lambda fit: (not _plausible(fit), _contradiction(fit)))
    best = fits[0]
    refusal = refusal_of(best)
    if refusal is None:
        rivals = fits[1:] + _repeated(a, b, best)
        # An object too small for the search by shape (a ball bar) looks the same after half a turn; so does its grid.
        unlike = (best.texture_correlation or 0.0) < LEAST_ALIKE_REPEATING
        doubtful = repeats and best.texture_share > 0.5 and (unlike or not by_shape)
        if doubtful or any(_as_good(rival, best, repeats=repeats and best.texture_share > 0.5) for rival in rivals):
            refusal = PairRefusal.AMBIGUOUS
    return RegisteredPair(best, refusal, _words(refusal, best, a, b))


def _fits(a: ReadyScan, b: ReadyScan, guesses: list[Guess]) -> list[Fit]:
    """Refine guesses and return the distinct fits."""
    fits: list[Fit] = []
    for guess in guesses:
        fit = refine(a.fine, b.fine, guess.pose, max_distance_mm=2.0)
        if fit is not None and all(not same(fit.pose, known_fit.pose, 1.0) for known_fit in fits):
            fits.append(fit)
    return fits


def _fits_by_shape(a: ReadyScan, b: ReadyScan) -> list[Fit]:
    """Search by shape and refine the guesses."""
    chosen: list[Guess] = []
    sliding = 0
    for guess in guess_by_shape(a.coarse, b.coarse):
        # Planes alone first, at 4 mm, since texture converges only from nearby.
        rough = refine(a.coarse, b.coarse, guess.pose, max_distance_mm=4.0, with_texture=False)
        if rough is None or rough.outliers > 0.3:
            continue
        if rough.significance.min() < SLIDES_ROUGHLY:
            if sliding == MOST_SLIDING:
                continue
            sliding += 1
        chosen.append(Guess(rough.pose, guess.support, False))
    return _fits(a, b, chosen)


def _contradiction(fit: Fit) -> float:
    """Return the evidence against a fit: outliers, patches in front or missing, and difference of texture."""
    unlike = 0.0 if fit.texture_correlation is None else 0.3 * (1.0 - fit.texture_correlation)
    return fit.outliers + 2.0 * fit.front + fit.missing + unlike - 0.1 * min(fit.overlap, 1.0)


def _as_good(rival: Fit, best: Fit, *, repeats: bool) -> bool:
    # Without texture, or with repeating texture, a sliding pose explains the scans as well as a determined one.
    slides = (best.texture_correlation is None or repeats) and refusal_of(rival) is PairRefusal.SLIDES
    if not (_plausible(rival) or slides) or rival.overlap < 0.5 * best.overlap:
        return False
    if same(rival.pose, best.pose, 1.0 + 5.0 * best.sigma_mm):
        return False
    less_alike = (
        best.texture_correlation is not None
        and rival.texture_correlation is not None
        and rival.texture_correlation < best.texture_correlation - AS_ALIKE
    )
    # Repeating texture also correlates at wrong poses, so it does not decide against a sliding pose.
    if less_alike and not slides:
        return False
    return rival.outliers + rival.front + rival.missing < best.outliers + best.front + best.missing + AS_GOOD


def _repeated(a: ReadyScan, b: ReadyScan, best: Fit) -> list[Fit]:
    """Return the fits one texture repeat away from ``best``; none if shape determines it."""
    if best.texture_share < 0.5:
        return []
    guesses = [Guess(Rigid(best.pose.rotation, best.pose.translation_mm + shift), 0.0, False) for shift in a.repeats]
    return [fit for fit in _fits(a, b, guesses) if not same(fit.pose, best.pose, 1.0)]


def _plausible(fit: Fit) -> bool:
    return refusal_of(fit) is None


def refusal_of(fit: Fit) -> PairRefusal | None:
    """Return the reason to refuse a fit, regardless of other poses; ``None``: no reason."""
    if fit.overlap < LEAST_OVERLAP:
        return PairRefusal.TOO_LITTLE
    if fit.outliers > MAX_OUTLIERS:
        return PairRefusal.CONTRADICTS
    by_texture = fit.texture_share > 0.5
    # First, since another pose along the slide could remove all further contradictions.
    if fit.significance.min() < HELD:
        return PairRefusal.SLIDES
    if fit.front > MAX_FRONT:
        return PairRefusal.CONTRADICTS
    if fit.texture_correlation is None:
        if by_texture:
            return PairRefusal.SLIDES
    elif fit.texture_correlation < (LEAST_ALIKE if by_texture else 0.5 * LEAST_ALIKE):
        return PairRefusal.CONTRADICTS
    return PairRefusal.UNCERTAIN if fit.sigma_mm > MAX_SIGMA_MM else None


def _words(refusal: PairRefusal | None, fit: Fit | None, a: ReadyScan, b: ReadyScan) -> str:
    if refusal is PairRefusal.NOTHING_IN_COMMON:
        return "no pose was found: no overlap; scan in between, or with more overlap"
    if refusal is PairRefusal.AMBIGUOUS:
        return "several poses fit, since shape or texture repeats: bring a unique part into both views"
    if fit is None:
        slides = b if a.holds else a
        loose = freedom(slides.resistance.directions, slides.resistance.significance)
        return (
            f"no common keypoints, and by shape alone the {'second' if a.holds else 'first'} can {loose}: scan "
            f"in between, {UNEVEN}"
        )
    if refusal is None:
        return f"{100.0 * fit.overlap:.0f} % in common; placed within {1000.0 * fit.sigma_mm:.0f} µm"
    if refusal is PairRefusal.SLIDES or refusal is PairRefusal.UNCERTAIN:
        if fit.texture_correlation is not None and fit.texture_correlation >= LEAST_ALIKE:
            remedy = "too few common keypoints determine the pose: scan again with more overlap, or stick on marks"
        elif a.holds and b.holds:
            remedy = "what determines the pose is not in both views: scan in between"
        else:
            remedy = UNEVEN
        return f"the second can {freedom(fit.directions, fit.significance)} on the first: {remedy}"
    if refusal is PairRefusal.TOO_LITTLE:
        return "too little overlap: scan again with half of the view in common"
    return "surfaces contradict each other: one of the scans may have moved, or they show different places"


def freedom(directions: Array, significance: Array) -> str:
    """Return in words how a scan can move, as seen by the camera whose frame ``directions`` (6, 6) are in.

    It can move along the directions whose ``significance`` (6,) is too small; along the least significant if none is.
    """
    loose = significance < HELD if (significance < HELD).any() else significance == significance.min()
    soft = directions[:, loose]
    # Any combination of free directions is free: combine them so that those with the least rotation come last.
    _, turning, mixing = np.linalg.svd(soft[:3])
    motions = mixing @ soft.T
    turn_count = np.count_nonzero(turning > TURNS)
    turns = [f"turn about {_axis(motion)}" for motion in motions[:turn_count]]
    slides = [f"slide {_way(motion[3:], 'to and from the instrument')}" for motion in motions[turn_count:]]
    if len(turns) == 3:
        turns = ["turn any way"]
    if len(slides) > 1:
        slides = ["slide any way along the surface" if len(slides) == 2 else "slide any way"]
    return " and ".join([*slides, *turns])


def _axis(motion: Array) -> str:
    rotation, shift = motion[:3], motion[3:]
    # Depth of the axis behind the overlap's middle: an axis within the object is its own, regardless of its radius.
    behind = float(np.cross(rotation, shift)[2] / (rotation @ rotation))
    direction_words = _way(rotation, "")
    if not direction_words:
        return "the line of sight"
    return f"{'its own' if behind > INSIDE else 'an'} axis {direction_words}"


def _way(direction: Array, away: str) -> str:
    """Return a direction in the image in words, ``away`` for one that leads out of it."""
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
