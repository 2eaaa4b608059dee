"""Owns the answer to "how did the hand move": the most likely smooth motion, from what the sine frames say against others."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Protocol

import cv2
import numpy as np
from numpy.typing import NDArray

from appliance.calibration.file import Calibration
from appliance.compensation.eyes import see
from appliance.compensation.hand import LEVER_MM, SHIFT, TURN, displacement_covariance_mm2
from appliance.compensation.projector import FittedProjector, fit_projector
from appliance.compensation.residuals import (
    FRAMES,
    GAINS,
    MOTIONS,
    PARAMETERS,
    SMOOTH,
    SMOOTH_TERMS,
    TEXTURE,
    X_STEPS,
    Y_STEPS,
    Samples,
    accumulate,
)
from appliance.optics.model import HousedCamera
from appliance.optics.water import Water
from appliance.patterns.sequence import Direction, PatternSequence
from appliance.reconstruct.decode import CameraDecoder, Mask
from appliance.reconstruct.noise import StereoNoise
from appliance.reconstruct.pipeline import SIDES

Array = NDArray[np.float64]

WORKING_WIDTH_PX = 800
SAMPLES = 5_000
FIT_POINTS = 1_200
GAIN_SD = 0.03
GAIN_MEAN_SD = 1e-5
SMOOTH_SD = 0.1
LEAST_SCALE_DN = 0.15
START_SCALE_DN = 5.0
CONVERGED_MM = 2e-4
NEARLY_CONVERGED_MM = 0.05
MAX_VARIANCE = 25.0
GOOD_ERROR = 1.25
"""Against a scan at rest; beyond, the scan is better repeated."""
NEARLY_EQUAL = 1.05
"""Where only albedo edges suffer, the ripple of most points says nothing."""
NEGLIGIBLE_RIPPLE, NEGLIGIBLE_PX = 0.3, 0.7
RIPPLE_OF_CONTRADICTION = 0.5
"""Steps that are wrong by ε each make a phase ripple of ε/2 · cos 2φ and a contradiction of ε (sin φ − cos φ) of the
modulation; noise of σ makes a phase noise of σ/√2 of it. So the ripple in units of noise is half the contradiction in
units of σ, both as root mean squares."""


@dataclass(frozen=True, slots=True)
class Level:
    """One stage from coarse to fine. Blurs are sigmas in px of pictures of ``WORKING_WIDTH_PX``, whose fringes are about
    13 px long."""

    steps_blur_px: float
    """Of the pictures in which phase steps are compared: less than the fringes, more than their second harmonic."""
    texture_blur_px: float
    """Of those in which textures are: as much as they may be apart."""
    kinds: tuple[int, ...]
    iterations: int


LEVELS = (
    Level(5.0, 8.0, (X_STEPS,), 5),
    Level(5.0, 8.0, (X_STEPS, TEXTURE), 4),
    Level(5.0, 5.0, (X_STEPS, Y_STEPS, TEXTURE), 4),
    Level(3.0, 3.0, (X_STEPS, Y_STEPS, TEXTURE), 8),
)


class Scanned(Protocol):
    """A whole sequence of both cameras. Mappings are keyed ``left`` and ``right``."""

    @property
    def sequence(self) -> PatternSequence: ...
    @property
    def frames(self) -> Mapping[str, NDArray[np.uint8]]: ...
    @property
    def decoded(self) -> Mapping[str, CameraDecoder]: ...
    @property
    def noise(self) -> StereoNoise: ...
    @property
    def frame_s(self) -> float: ...


@dataclass(frozen=True, slots=True)
class MotionEstimate:
    """How the scene moved before the instrument, against the reference time; left camera frame."""

    frames: tuple[int, ...]
    """The 8 sine frames: x, then y."""
    motion_mm: Array
    """(8, 6) mm: shift of the middle of the volume, and turn as mm at ``LEVER_MM`` from it."""
    covariance_mm2: Array
    """(48, 48) of ``motion_mm``, row by row."""
    gains: Array
    """(8,): by how much each frame is brighter than its block."""
    centre_mm: Array
    """(3,): the middle of the volume."""
    reference_s: float
    """The time of which the cloud will be: middle of the x-sines, from frame 0 on."""
    projector: FittedProjector
    ripple_before: float
    """Ripple of the points that motion makes when nothing is done, in units of their noise; from the frames alone."""
    ripple_after: float
    """What remains of it with this motion."""
    texture_px: float
    """Median way of the picture from the first to the last x-sine, in px of the left camera."""
    noise_factor: float
    """Noise of the new phases against that of steps of 90°. Large where the hand moved along with the fringes: a point
    then saw nearly the same phase in all steps."""
    converged: bool

    @property
    def moved(self) -> bool:
        """By enough to show in the points."""
        return self.ripple_before > NEGLIGIBLE_RIPPLE or self.texture_px > NEGLIGIBLE_PX

    @property
    def error_before(self) -> float:
        """Expected error of the points against that of a scan at rest, when nothing is done."""
        return math.hypot(1.0, self.ripple_before)

    @property
    def error_after(self) -> float:
        """The same of the compensated points."""
        return math.hypot(self.noise_factor, self.ripple_after)

    @property
    def helps(self) -> bool:
        """What moved, and the compensated scan is as good as one at rest: worth its time, and to be shown."""
        good = self.error_after <= min(GOOD_ERROR, NEARLY_EQUAL * self.error_before)
        return self.moved and self.converged and good


def estimate(
    scanned: Scanned, calibration: Calibration, water: Water, points_mm: NDArray[np.floating], pixel: NDArray[np.uint32]
) -> MotionEstimate:
    """From a scan, its cloud's points (n, 3) in the left camera frame and their left pixels (n,) flat.

    Raises ValueError where too few points were found.
    """
    index, rig, sequence = water.index, calibration.rig, scanned.sequence
    left = scanned.decoded["left"]
    finite = np.isfinite(left.p_px.ravel()[pixel]) & np.isfinite(left.q_px.ravel()[pixel])
    points, pixel = points_mm[finite].astype(np.float64), pixel[finite]
    chosen = _spread(len(points), FIT_POINTS)
    pattern_px = np.stack([left.p_px.ravel()[pixel[chosen]], left.q_px.ravel()[pixel[chosen]]], -1).astype(np.float64)
    projector = fit_projector(rig, index, points[chosen], pattern_px, (sequence.width_px, sequence.height_px))
    chosen = _spread(len(points), SAMPLES)
    centre = rig.volume_centre_mm(index)
    binning = max(1, rig.left.width_px // WORKING_WIDTH_PX)
    samples = {
        side: _samples(camera, projector.eye, index, points[chosen], centre, sequence.period_px, binning)
        for side, camera in (("left", rig.left), ("right", rig.right))
    }
    sines = (*sequence.axis(Direction.X).sine, *sequence.axis(Direction.Y).sine)
    times_s = scanned.frame_s * np.asarray(sines)
    reference_s = float(np.mean(times_s[:4]))
    working = {side: _working(scanned.frames[side], sines, binning) for side in samples}
    scale = math.sqrt(rig.left.width_px / binning / WORKING_WIDTH_PX)
    solver = _Solver(samples, _prior(times_s, reference_s))
    step_mm = math.inf
    for level in LEVELS:
        solver.look_at(working, level.steps_blur_px * scale, level.texture_blur_px * scale)
        for _ in range(level.iterations):
            step_mm = solver.step(level.kinds)
            if step_mm < CONVERGED_MM:
                break
    grey_dn = float(np.mean([noise_dn(scanned, side) for side in SIDES]))
    averaged_px = 2.0 * math.sqrt(math.pi) * LEVELS[-1].steps_blur_px * scale * binning
    after = solver.contradiction(solver.values, grey_dn / averaged_px)
    noise_factor, covariance = solver.noise_factor(), solver.covariance()
    before = solver.contradiction(np.zeros(PARAMETERS), grey_dn / averaged_px)
    noise = grey_dn / float(np.mean([_modulation_dn(scanned, side) for side in SIDES]))
    return MotionEstimate(
        frames=sines,
        motion_mm=solver.values[:MOTIONS].reshape(FRAMES, 6).copy(),
        covariance_mm2=covariance,
        gains=solver.values[GAINS : GAINS + FRAMES].copy(),
        centre_mm=centre,
        reference_s=reference_s,
        projector=projector,
        ripple_before=RIPPLE_OF_CONTRADICTION * before / noise,
        ripple_after=RIPPLE_OF_CONTRADICTION * after / noise,
        texture_px=binning * _way_px(samples["left"], solver.values),
        noise_factor=noise_factor,
        converged=step_mm < NEARLY_CONVERGED_MM,
    )


def _blurred(pictures: list[NDArray[np.float32]], blur_px: float) -> NDArray[np.float32]:
    return np.asarray(np.stack([cv2.GaussianBlur(picture, (0, 0), blur_px) for picture in pictures]), np.float32)


class _Solver:
    """Gauss-Newton with robust weights on the samples of both cameras."""

    def __init__(self, samples: Mapping[str, Samples], prior: Array) -> None:
        self.values = np.zeros(PARAMETERS)
        self._samples, self._prior = samples, prior
        self._pictures: tuple[dict[str, NDArray[np.float32]], ...] = ()
        self._blurs_px = (0.0, 0.0)
        self._scale_dn = np.full(3, START_SCALE_DN)
        self._matrix = prior
        self._vector = np.zeros(PARAMETERS)
        self._variance = np.ones((1, 2))

    def look_at(
        self, working: Mapping[str, list[NDArray[np.float32]]], steps_blur_px: float, texture_blur_px: float
    ) -> None:
        """From now on at pictures of these blurs."""
        known = dict(zip(self._blurs_px, self._pictures, strict=False))
        self._blurs_px = (steps_blur_px, texture_blur_px)
        for blur_px in self._blurs_px:
            if blur_px not in known:
                known[blur_px] = {side: _blurred(pictures, blur_px) for side, pictures in working.items()}
        self._pictures = (known[steps_blur_px], known[texture_blur_px])

    def step(self, kinds: tuple[int, ...]) -> float:
        """One step on residuals of these kinds; its largest part in mm."""
        residual_dn, _ = self._accumulate(self.values, kinds)
        self._scale_dn = np.maximum(1.4826 * np.nanmedian(np.abs(residual_dn), axis=0), LEAST_SCALE_DN)
        step = -np.linalg.solve(self._matrix, self._vector + self._prior @ self.values)
        self.values += step
        return float(np.abs(step[:MOTIONS]).max())

    def contradiction(self, values: Array, noise_dn: float) -> float:
        """Robust standard deviation of what contradicts in the x-sines beyond the noise of the pictures that are looked
        at, as a share of the modulation."""
        residual_dn, modulation_dn = self._accumulate(values, (X_STEPS,))
        modulation_dn = np.maximum(modulation_dn[:, 0], noise_dn)
        share = 1.4826 * float(np.nanmedian(np.abs(residual_dn[:, X_STEPS]) / modulation_dn))
        floor = noise_dn * float(np.nanmedian(1.0 / modulation_dn))
        return math.sqrt(max(share**2 - floor**2, 0.0))

    def noise_factor(self) -> float:
        """Root mean square noise of the x-sines' phases, as last looked at, against steps of 90°."""
        known = self._variance[np.isfinite(self._variance[:, 0]), 0]
        return math.sqrt(float(np.mean(np.minimum(known, MAX_VARIANCE)))) if known.size else math.inf

    def covariance(self) -> Array:
        """Of the motion."""
        return np.asarray(np.linalg.inv(self._matrix)[:MOTIONS, :MOTIONS])

    def _accumulate(self, values: Array, kinds: tuple[int, ...]) -> tuple[Array, Array]:
        matrix, vector = np.zeros((PARAMETERS, PARAMETERS)), np.zeros(PARAMETERS)
        residuals, modulations, variances = [], [], []
        for number, side in enumerate(SIDES):
            n = len(self._samples[side].uv_px)
            residual_dn, modulation_dn = np.full((n, 3), np.nan), np.full((n, 2), np.nan)
            other_dn, variance, unused = np.full((n, 3), np.nan), np.full((n, 2), np.nan), np.full((n, 2), np.nan)
            for pictures, mine, written, doubt in (
                (self._pictures[0], (X_STEPS, Y_STEPS), residual_dn, variance),
                (self._pictures[1], (TEXTURE,), other_dn, unused),
            ):
                wanted = sum(1 << kind for kind in kinds if kind in mine)
                accumulate(
 self._samples[side], pictures[side], values, number, self._scale_dn, wanted, matrix, vector, written,
 modulation_dn, doubt,
)  # fmt: skip
            residual_dn[:, TEXTURE] = other_dn[:, TEXTURE]
            residuals.append(residual_dn)
            modulations.append(modulation_dn)
            variances.append(variance)
        # The kernel fills each pair once, in either order.
        self._matrix = matrix + matrix.T - np.diag(np.diag(matrix)) + self._prior
        self._vector = vector
        self._variance = np.concatenate(variances)
        both = np.concatenate(residuals)
        if not np.isfinite(both).any():
            raise ValueError("no sample stays in the pictures; the instrument moved too far")
        return both, np.concatenate(modulations)


def _way_px(samples: Samples, values: Array) -> float:
    """Median way between the first and the last x-sine, in px of the pictures that are looked at."""
    moved = values[18:24] - values[0:6]
    d = moved[:3] + np.cross(moved[3:], samples.lever)
    way = np.einsum("nij,nj->ni", samples.jacobian, d)
    return float(np.nanmedian(np.linalg.norm(way, axis=1)))


def noise_dn(scanned: Scanned, side: str) -> float:
    """Of the grey values of one camera, at the object's mean light."""
    decoder, camera = scanned.decoded[side], scanned.noise.left if side == "left" else scanned.noise.right
    lit = decoder.middle[::4, ::4][decoder.mask[::4, ::4] == Mask.VALID]
    return math.sqrt(camera.variance_dn2(float(np.median(lit)) if lit.size else 0.0))


def _modulation_dn(scanned: Scanned, side: str) -> float:
    decoder = scanned.decoded[side]
    lit = decoder.modulation_half_dn[::4, ::4][decoder.mask[::4, ::4] == Mask.VALID]
    return max(0.5 * float(np.median(lit)), 1.0) if lit.size else 1.0


def _spread(n: int, wanted: int) -> NDArray[np.intp]:
    return np.unique(np.linspace(0, n - 1, min(n, wanted)).astype(np.intp))


def _samples(
    camera: HousedCamera, projector: HousedCamera, index: float, points_mm: Array, centre_mm: Array, period_px: int,
    binning: int,
) -> Samples:  # fmt: skip
    seen, lit = see(camera, index, points_mm), see(projector, index, points_mm)
    size = np.array([camera.width_px, camera.height_px])
    x, y = ((seen.px + 0.5) / size * 2.0 - 1.0).T
    return Samples(
        (seen.px + 0.5) / binning - 0.5,
        seen.jacobian / binning,
        seen.nearing,
        lit.jacobian * (2.0 * np.pi / period_px),
        lit.nearing,
        (points_mm - centre_mm) / LEVER_MM,
        np.ascontiguousarray(np.stack([np.ones_like(x), x, y, x * x, x * y, y * y], -1)),
    )


def _prior(times_s: Array, reference_s: float) -> Array:
    """Precision of all parameters before anything was seen."""
    prior = np.zeros((PARAMETERS, PARAMETERS))
    for hand, parts in ((SHIFT, (0, 1, 2)), (TURN, (3, 4, 5))):
        precision = np.linalg.inv(displacement_covariance_mm2(hand, times_s, reference_s))
        for part in parts:
            at = part + 6 * np.arange(FRAMES)
            prior[np.ix_(at, at)] = precision
    for block in (np.arange(GAINS, GAINS + 4), np.arange(GAINS + 4, GAINS + FRAMES)):
        prior[block, block] = 1.0 / GAIN_SD**2
        # Only their differences mean anything: brighter pictures would have louder disagreements, no others.
        prior[np.ix_(block, block)] += 1.0 / GAIN_MEAN_SD**2
    smooth = np.arange(SMOOTH, SMOOTH + 2 * SMOOTH_TERMS)
    prior[smooth, smooth] = 1.0 / SMOOTH_SD**2
    return prior


def _working(frames: NDArray[np.uint8], sines: tuple[int, ...], binning: int) -> list[NDArray[np.float32]]:
    size = (frames.shape[2] // binning, frames.shape[1] // binning)
    pictures = (frames[k].astype(np.float32) for k in sines)
    return [np.asarray(cv2.resize(p, size, interpolation=cv2.INTER_AREA) if binning > 1 else p) for p in pictures]
