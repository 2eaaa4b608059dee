"""Owns the answer to "how did the hand move": the most likely smooth motion, from what the frames say against every
other.

Robust Gauss-Newton goes from coarse to fine (``STAGES``). It begins with the x-sines alone, in blurred pictures: they
tell velocity and acceleration well enough that the extrapolation finds the other images up to 15 mm away, so that no
optical flow is needed. Then the Gray images make one Gaussian of the motion of all frames (``stripes``), which is the
prior of what follows: the texture, ever sharper. Pictures are never looked at finer than 3 px: there
the second harmonic of the fringes, which four steps of 90° do not see, would speak.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from appliance.measure.calibration.file import Calibration
from appliance.measure.decode.decoder import Mask
from appliance.measure.light.model import HousedCamera
from appliance.measure.light.noise import MAD_TO_SIGMA
from appliance.measure.light.patterns import Direction, PatternSequence
from appliance.measure.light.sides import SIDES, of_side
from appliance.measure.light.water import Water
from appliance.measure.motion.displacement import linearise
from appliance.measure.motion.prior import LEVER_MM, Trajectory, trajectory_prior_precision
from appliance.measure.motion.projector import FittedProjector, fit_projector
from appliance.measure.motion.residuals import (
    FRAMES,
    GAINS,
    MOTIONS,
    PARAMETERS,
    SMOOTH_GAIN,
    SMOOTH_TERMS,
    TEXTURE,
    X_STEPS,
    Samples,
    accumulate,
)
from appliance.measure.motion.stripes import Information, trajectory_from_stripes
from appliance.measure.scan_images import ScanImages

Array = NDArray[np.float64]

WORKING_WIDTH_PX = 800
"""Width of the pictures that are looked at, roughly: the camera's, shrunk by a whole number."""
SAMPLES = 5_000
FIT_POINTS = 1_200
"""Points that the projector is fitted to."""
GAIN_SD = 0.03
"""Prior of a frame's gain, as a share."""
GAIN_MEAN_SD = 1e-5
"""Prior of the mean gain of a block: brighter pictures would disagree louder, and no otherwise."""
SMOOTH_SD = 0.1
"""Prior of each coefficient of the smooth gain."""
LEAST_SCALE_DN, START_SCALE_DN = 0.15, 5.0
"""Robust scale of residuals: the least one that is believed, and the first one."""
CONVERGED_MM = 2e-4
"""A step in the last stage that ends it."""
ENOUGH_MM = 0.02
"""A step that ends a stage before the last."""
NEARLY_CONVERGED_MM = 0.05
"""A last step below which the estimate counts as converged."""
MAX_VARIANCE = 25.0
"""A sample's phase variance, over that by steps of 90°, counts up to here."""
NEGLIGIBLE_RIPPLE, NEGLIGIBLE_PX = 0.3, 0.7
"""Ripple in units of noise, and way of the texture, that do not show in the points."""
RIPPLE_OF_CONTRADICTION = 0.5
"""Rising steps that are wrong by ε each make a phase ripple of ε/2 · cos 2φ and a contradiction of ε (sin φ − cos φ) of the
modulation; noise of σ makes a phase noise of σ/√2 of it. So the ripple in units of noise is half the contradiction in
units of σ, both as root mean squares."""


@dataclass(frozen=True, slots=True)
class SearchStage:
    """One stage of the search, from coarse to fine.

    Blurs are sigmas in px of pictures of ``WORKING_WIDTH_PX``, whose fringes are about 13 px long.
    """

    steps_blur_px: float
    """Blur of the pictures in which phase steps are compared: less than the fringes, more than their second harmonic.
    """
    texture_blur_px: float
    """Blur of those in which textures are: as much as they may be apart."""
    kinds: tuple[int, ...]
    """Kinds of residuals that count."""
    iterations: int
    shrunk: int
    """The pictures are looked at this many times smaller: what is blurred needs no more pixels."""
    every: int
    """Every so many samples are looked at."""


STAGES = (
    SearchStage(5.0, 8.0, (X_STEPS,), 5, 2, 4),
    SearchStage(5.0, 8.0, (X_STEPS, TEXTURE), 4, 2, 4),
    SearchStage(5.0, 5.0, (X_STEPS, TEXTURE), 4, 2, 2),
    SearchStage(3.0, 3.0, (X_STEPS, TEXTURE), 5, 1, 3),
    SearchStage(3.0, 3.0, (X_STEPS, TEXTURE), 4, 1, 1),
)


@dataclass(frozen=True, slots=True)
class MotionEstimate:
    """The motion of the scene before the instrument, against the reference time; left camera frame."""

    frames: tuple[int, ...]
    """The 8 sine frames: x, then y."""
    trajectory_mm: Array
    """(n, 6) mm: the displacements of all frames."""
    motion_mm: Array
    """(8, 6) mm: those of the sine frames; shift of the middle of the volume, and turn as mm at ``LEVER_MM`` from it.
    """
    gains: Array
    """(8,): by how much each frame is brighter than its block."""
    centre_mm: Array
    """(3,): the middle of the volume."""
    reference_s: float
    """The time to which the cloud will belong: middle of the x-sines, from frame 0 on."""
    projector: FittedProjector
    ripple_before: float
    """Ripple of the points that motion makes when nothing is done, in units of their noise: what of the x-sines'
    contradiction this motion explains. From the frames alone."""
    ripple_after: float
    """Ripple that remains with this motion: a light that is no pure sine makes one at rest, too."""
    texture_px: float
    """Median way of the picture from the first to the last x-sine, in px of the left camera."""
    step_deg: float
    """Median advance of a point's phase from one step to the next: 90 at rest, 0 where it moved along with the fringes."""
    noise_factor: float
    """Noise of phases against that of steps of 90° where points are followed all the way.

    Large where the hand moved along with the fringes: a point then saw nearly the same phase in all steps.
    """
    converged: bool

    @property
    def moved(self) -> bool:
        """The scene moved by enough to show in the points."""
        return self.ripple_before > NEGLIGIBLE_RIPPLE or self.texture_px > NEGLIGIBLE_PX

    @property
    def error_before(self) -> float:
        """Expected error of the points when nothing is done, in units of that of a scan at rest."""
        return math.hypot(1.0, self.ripple_before)


def estimate(
    images: ScanImages,
    calibration: Calibration,
    water: Water,
    points_mm: NDArray[np.floating],
    pixel: NDArray[np.uint32],
) -> MotionEstimate:
    """Estimate the motion of a scan from its images and a sample of its cloud.

    ``points_mm`` (n, 3) are given in the left camera frame, ``pixel`` (n,) are their left pixels as flat indices.
    Raises ValueError where too few points were found, or none of them stays in the pictures.
    """
    index, rig, sequence = water.index, calibration.rig, images.sequence
    left = images.decoded["left"]
    finite = np.isfinite(left.p_px.ravel()[pixel]) & np.isfinite(left.q_px.ravel()[pixel])
    points, pixel = points_mm[finite].astype(np.float64), pixel[finite]
    chosen = _spread(len(points), FIT_POINTS)
    pattern_px = np.stack([left.p_px.ravel()[pixel[chosen]], left.q_px.ravel()[pixel[chosen]]], -1).astype(np.float64)
    projector = fit_projector(rig, index, points[chosen], pattern_px, (sequence.width_px, sequence.height_px))
    chosen = _spread(len(points), SAMPLES)
    centre = rig.volume_centre_mm(index)
    binning = max(1, rig.left.width_px // WORKING_WIDTH_PX)
    pattern_px = linearise(projector.camera, index, points[chosen]).px
    samples = {
        side: _samples(camera, projector.camera, index, points[chosen], centre, sequence.period_px, binning)
        for side, camera in (("left", rig.left), ("right", rig.right))
    }
    sines = (*sequence.axis(Direction.X).sine, *sequence.axis(Direction.Y).sine)
    times_s = images.frame_s * np.asarray(sines)
    reference_s = float(np.mean(times_s[:4]))
    working = {side: _working(images.frames[side], sines, binning) for side in samples}
    scale = math.sqrt(rig.left.width_px / binning / WORKING_WIDTH_PX)
    with ThreadPoolExecutor(len(SIDES), "kf-motion") as pool:
        solver = _Solver(samples, _prior(times_s, reference_s), pool)
        prior = trajectory_prior_precision(images.frame_s * np.arange(len(sequence), dtype=np.float64), reference_s)
        trajectory = Trajectory(np.zeros(len(prior)), np.asarray(np.linalg.inv(prior), np.float64))
        step_mm = math.inf
        for stage in STAGES:
            if stage is STAGES[1]:
                seen = Information(sines, *solver.information())
                trajectory = trajectory_from_stripes(sequence, images.frames, samples, pattern_px, prior, seen, pool)
                solver.expect(*trajectory.marginal(sines))
            solver.look_at(working, stage, scale)
            for _ in range(stage.iterations):
                step_mm = solver.step(stage.kinds)
                if step_mm < (CONVERGED_MM if stage is STAGES[-1] else ENOUGH_MM):
                    break
        grey_dn = float(np.mean([noise_dn(images, side) for side in SIDES]))
        # Blurring leaves 1 / (2 √π σ) of the noise of a grey value.
        averaged_px = 2.0 * math.sqrt(math.pi) * STAGES[-1].steps_blur_px * scale * binning
        after = solver.contradiction(solver.values, grey_dn / averaged_px)
        noise_factor = solver.noise_factor()
        # What the frames' brightness explains is no motion's doing: the gains stay, the motion is taken away.
        still = solver.values.copy()
        still[:MOTIONS] = 0.0
        before = math.sqrt(max(solver.contradiction(still, grey_dn / averaged_px) ** 2 - after**2, 0.0))
    noise = grey_dn / float(np.mean([_modulation_dn(images, side) for side in SIDES]))
    return MotionEstimate(
        frames=sines,
        trajectory_mm=trajectory.conditional_mm(sines, solver.values[:MOTIONS].reshape(FRAMES, 6)),
        motion_mm=solver.values[:MOTIONS].reshape(FRAMES, 6).copy(),
        gains=solver.values[GAINS : GAINS + FRAMES].copy(),
        centre_mm=centre,
        reference_s=reference_s,
        projector=projector,
        ripple_before=RIPPLE_OF_CONTRADICTION * before / noise,
        ripple_after=RIPPLE_OF_CONTRADICTION * after / noise,
        texture_px=binning * _way_px(samples["left"], solver.values, sequence),
        step_deg=_step_deg(samples["left"], solver.values),
        noise_factor=noise_factor,
        converged=step_mm < NEARLY_CONVERGED_MM,
    )


def _blurred(pictures: list[NDArray[np.float32]], blur_px: float, shrunk: int) -> NDArray[np.float32]:
    """Return the pictures (n, h, w), shrunk, and blurred by ``blur_px`` (σ, px before they are shrunk)."""
    return np.stack([cv2.GaussianBlur(_shrunk(picture, shrunk), (0, 0), blur_px / shrunk) for picture in pictures])


def _shrunk(picture: NDArray[np.float32], times: int) -> NDArray[np.float32]:
    """Return the picture (h, w) at 1 / ``times`` of its size, each pixel the mean of those that it replaces."""
    height, width = picture.shape
    size = (width // times, height // times)
    return np.asarray(cv2.resize(picture, size, interpolation=cv2.INTER_AREA) if times > 1 else picture, np.float32)


class _Equations(NamedTuple):
    """The normal equations of one camera's n samples: outputs of ``accumulate``, P parameters."""

    matrix: Array
    """(P, P), the lower triangle."""
    vector: Array
    """(P,)."""
    residual_dn: Array
    """(n, 2)."""
    modulation_dn: Array
    """(n,)."""
    variance: Array
    """(n,)."""


class _Solver:
    """Gauss-Newton with robust weights on the samples of both cameras, each in its own thread of ``pool``."""

    def __init__(self, samples: Mapping[str, Samples], prior: Array, pool: ThreadPoolExecutor) -> None:
        self._pool = pool
        self.values = np.zeros(PARAMETERS)
        self._all, self._samples, self._prior = samples, samples, prior
        self._known: dict[float, Mapping[str, NDArray[np.float32]]] = {}
        self._steps_blur_px = self._texture_blur_px = 0.0
        self._scale_dn = np.full(2, START_SCALE_DN)
        self._matrix = prior
        self._vector = np.zeros(PARAMETERS)
        self._variance = np.ones(1)
        self._mean = np.zeros(PARAMETERS)

    def information(self) -> tuple[Array, Array]:
        """Return the normal equations of the motion alone, by the residuals of the last step: matrix (48, 48), vector
        (48,)."""
        own = self._matrix - self._prior
        vector = own @ self._linearised_at - self._vector
        # Gains are eliminated (Schur complement), their prior included.
        m, g = slice(0, MOTIONS), slice(MOTIONS, PARAMETERS)
        cross = own[m, g] @ np.linalg.inv(own[g, g] + self._prior[g, g])
        return own[m, m] - cross @ own[g, m], vector[m] - cross @ vector[g]

    def expect(self, mean_mm: Array, covariance_mm2: Array) -> None:
        """Replace the prior of the motion by the Gaussian ``mean_mm`` (48,), ``covariance_mm2`` (48, 48).

        The search goes on where that and what the samples said agree best.
        """
        matrix, vector = self.information()
        precision = np.linalg.inv(covariance_mm2)
        self._prior = self._prior.copy()
        self._prior[:MOTIONS, :MOTIONS] = precision
        self._mean[:MOTIONS] = mean_mm
        self.values[:MOTIONS] = np.linalg.solve(precision + matrix, precision @ mean_mm + vector)

    def look_at(self, working: Mapping[str, list[NDArray[np.float32]]], stage: SearchStage, scale: float) -> None:
        """Look at the pictures and samples of ``stage`` from now on; its blurs are multiplied by ``scale``."""
        self._steps_blur_px, self._texture_blur_px = stage.steps_blur_px * scale, stage.texture_blur_px * scale
        self._samples = {side: _some(samples, stage) for side, samples in self._all.items()}
        blurs_px = (self._steps_blur_px, self._texture_blur_px)
        known = {blur_px: pictures for blur_px, pictures in self._known.items() if blur_px in blurs_px}
        for blur_px in blurs_px:
            if blur_px not in known:
                blurred = self._pool.map(lambda side: _blurred(working[side], blur_px, stage.shrunk), SIDES)  # noqa: B023
                known[blur_px] = dict(zip(SIDES, blurred, strict=True))
        self._known = known

    def step(self, kinds: tuple[int, ...]) -> float:
        """Take one step on residuals of these kinds; return its largest part among the x-sines, which make the depth,
        in mm."""
        residual_dn, _ = self._accumulate(self.values, kinds)
        for kind in (X_STEPS, TEXTURE):
            known = residual_dn[np.isfinite(residual_dn[:, kind]), kind]
            if known.size:
                self._scale_dn[kind] = max(MAD_TO_SIGMA * float(np.median(np.abs(known))), LEAST_SCALE_DN)
        step = -np.linalg.solve(self._matrix, self._vector + self._prior @ (self.values - self._mean))
        self.values += step
        return float(np.abs(step[: MOTIONS // 2]).max())

    def contradiction(self, values: Array, noise_dn: float) -> float:
        """Return the robust standard deviation of the x-sines' contradiction at ``values``, as a share of the
        modulation.

        The noise of the pictures that are looked at, ``noise_dn``, is taken out.
        """
        residual_dn, modulation_dn = self._accumulate(values, (X_STEPS,))
        modulation_dn = np.maximum(modulation_dn, noise_dn)
        share = MAD_TO_SIGMA * float(np.nanmedian(np.abs(residual_dn[:, X_STEPS]) / modulation_dn))
        floor = noise_dn * float(np.nanmedian(1.0 / modulation_dn))
        return math.sqrt(max(share**2 - floor**2, 0.0))

    def noise_factor(self) -> float:
        """Return the root mean square noise of the x-sines' phases at the last step, over that by steps of 90°."""
        known = self._variance[np.isfinite(self._variance)]
        return math.sqrt(float(np.mean(np.minimum(known, MAX_VARIANCE)))) if known.size else math.inf

    def _looks(self, kinds: tuple[int, ...]) -> list[tuple[float, tuple[int, ...]]]:
        """Return the blurs to look at and the kinds of residuals each serves.

        Phase steps come last, for what they say of the modulation is what remains.
        """
        if self._steps_blur_px == self._texture_blur_px or TEXTURE not in kinds:
            return [(self._steps_blur_px, kinds)]
        steps = tuple(kind for kind in kinds if kind != TEXTURE)
        return [(self._texture_blur_px, (TEXTURE,)), (self._steps_blur_px, steps)]

    def _accumulate(self, values: Array, kinds: tuple[int, ...]) -> tuple[Array, Array]:
        """Set up the normal equations at ``values``; return residuals (n, 2) and modulations (n,) of both cameras.

        Raises ValueError where no sample stays in the pictures.
        """
        sides = list(self._pool.map(lambda side: self._equations(side, values, kinds), SIDES))
        self._linearised_at = values.copy()
        matrix = np.sum([one.matrix for one in sides], axis=0)
        self._vector = np.sum([one.vector for one in sides], axis=0)
        # The kernel fills each pair once, in either order.
        self._matrix = matrix + matrix.T - np.diag(np.diag(matrix)) + self._prior
        self._variance = np.concatenate([one.variance for one in sides])
        both = np.concatenate([one.residual_dn for one in sides])
        if not np.isfinite(both).any():
            raise ValueError("no sample stays within the images; the instrument moved too far")
        return both, np.concatenate([one.modulation_dn for one in sides])

    def _equations(self, side: str, values: Array, kinds: tuple[int, ...]) -> _Equations:
        samples = self._samples[side]
        n = len(samples.uv_px)
        made = _Equations(
            np.zeros((PARAMETERS, PARAMETERS)),
            np.zeros(PARAMETERS),
            np.full((n, 2), np.nan),
            np.full(n, np.nan),
            np.full(n, np.nan),
        )
        for blur_px, some in self._looks(kinds):
            accumulate(
                samples,
                self._known[blur_px][side],
                values,
                SIDES.index(side),
                self._scale_dn,
                sum(1 << kind for kind in some),
                *made,
            )
        return made


def _way_px(samples: Samples, values: Array, sequence: PatternSequence) -> float:
    """Return the median way of the samples from the first x-sine to the last, in px of the pictures that are looked at."""
    moved_mm, sine = _displaced_mm(samples, values), sequence.axis(Direction.X).sine
    way = np.einsum("nij,nj->ni", samples.jacobian, moved_mm[np.argmax(sine)] - moved_mm[np.argmin(sine)])
    return float(np.nanmedian(np.linalg.norm(way, axis=1)))


def _step_deg(samples: Samples, values: Array) -> float:
    """Return the median advance of the samples' phase from one step to the next, in degrees; 90 at rest."""
    moved_mm = _displaced_mm(samples, values)
    advance = np.einsum("nj,nj->n", samples.phase_per_mm[:, 0], moved_mm[3] - moved_mm[0])
    return 90.0 + math.degrees(float(np.nanmedian(advance))) / 3.0


def _displaced_mm(samples: Samples, values: Array) -> Array:
    """Return the displacements (4, n, 3) of the samples in the x-sines of 0° to 270°: shift + turn × lever."""
    moved = values[:24].reshape(4, 1, 6)
    return np.asarray(moved[..., :3] + np.cross(moved[..., 3:], samples.lever))


def noise_dn(images: ScanImages, side: str) -> float:
    """Return the noise (σ) of one camera's grey values at the median light on the object; that of black where there is
    none."""
    decoder, camera = images.decoded[side], of_side(images.noise, side)
    valid = decoder.gray_threshold[::4, ::4][decoder.mask[::4, ::4] == Mask.VALID]
    return math.sqrt(camera.variance_dn2(float(np.median(valid)) if valid.size else 0.0))


def _modulation_dn(images: ScanImages, side: str) -> float:
    """Return the median modulation of what one camera decoded, at least 1."""
    decoder = images.decoded[side]
    valid = decoder.modulation_half_dn[::4, ::4][decoder.mask[::4, ::4] == Mask.VALID]
    return max(0.5 * float(np.median(valid)), 1.0) if valid.size else 1.0


def _spread(n: int, wanted: int) -> NDArray[np.intp]:
    """Return at most ``wanted`` of the numbers 0 … n − 1, evenly spread."""
    return np.unique(np.linspace(0, n - 1, min(n, wanted)).astype(np.intp))


def _samples(
    camera: HousedCamera,
    projector: HousedCamera,
    index: float,
    points_mm: Array,
    centre_mm: Array,
    period_px: int,
    binning: int,
) -> Samples:
    """Linearise camera and projector at points (n, 3); px are those of pictures shrunk ``binning`` times."""
    seen, shown = linearise(camera, index, points_mm), linearise(projector, index, points_mm)
    size = np.array([camera.width_px, camera.height_px])
    x, y = ((seen.px + 0.5) / size * 2.0 - 1.0).T
    return Samples(
        (seen.px + 0.5) / binning - 0.5,
        seen.jacobian / binning,
        seen.inverse_depth_gradient,
        shown.jacobian * (2.0 * np.pi / period_px),
        shown.inverse_depth_gradient,
        (points_mm - centre_mm) / LEVER_MM,
        np.ascontiguousarray(np.stack([np.ones_like(x), x, y, x * x, x * y, y * y], -1)),
    )


def _prior(times_s: Array, reference_s: float) -> Array:
    """Return the precision (PARAMETERS, PARAMETERS) of all parameters before anything was seen."""
    prior = np.zeros((PARAMETERS, PARAMETERS))
    prior[:MOTIONS, :MOTIONS] = trajectory_prior_precision(times_s, reference_s)
    for block in (np.arange(GAINS, GAINS + 4), np.arange(GAINS + 4, GAINS + FRAMES)):
        prior[block, block] = 1.0 / GAIN_SD**2
        # Only their differences mean anything: brighter pictures would have louder disagreements, no others.
        prior[np.ix_(block, block)] += 1.0 / GAIN_MEAN_SD**2
    smooth = np.arange(SMOOTH_GAIN, SMOOTH_GAIN + 2 * SMOOTH_TERMS)
    prior[smooth, smooth] = 1.0 / SMOOTH_SD**2
    return prior


def _working(frames: NDArray[np.uint8], sines: tuple[int, ...], binning: int) -> list[NDArray[np.float32]]:
    """Return the sine frames of one side as pictures shrunk ``binning`` times."""
    return [_shrunk(frames[k].astype(np.float32), binning) for k in sines]


def _some(samples: Samples, stage: SearchStage) -> Samples:
    """Return the samples that a stage looks at, in px of its pictures."""
    if stage.every == stage.shrunk == 1:
        return samples
    few = Samples(*(np.ascontiguousarray(values[:: stage.every]) for values in samples))
    uv_px = (few.uv_px + 0.5) / stage.shrunk - 0.5
    return few._replace(uv_px=uv_px, jacobian=few.jacobian / stage.shrunk)
