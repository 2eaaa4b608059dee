"""Owns the answer to "how did the hand move": the most likely smooth motion, from what the sine frames say against others."""

from __future__ import annotations

import math
from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from appliance.calibration.file import Calibration
from appliance.compensation.course import Course, follow_stripes, hands_course
from appliance.compensation.eyes import see
from appliance.compensation.hand import LEVER_MM
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
from appliance.reconstruct.decode.decoder import Mask
from appliance.reconstruct.images import ScanImages
from appliance.scan.sides import SIDES, of_side

Array = NDArray[np.float64]

WORKING_WIDTH_PX = 800
SAMPLES = 5_000
FIT_POINTS = 1_200
AROUND = 4
"""So many Gray images before the x-sines and after them."""
GAIN_SD = 0.03
GAIN_MEAN_SD = 1e-5
SMOOTH_SD = 0.1
LEAST_SCALE_DN = 0.15
START_SCALE_DN = 5.0
CONVERGED_MM = 2e-4
ENOUGH_MM = 0.02
"""Of a step, before the last level."""
NEARLY_CONVERGED_MM = 0.05
MAX_VARIANCE = 25.0
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
    shrunk: int
    """The pictures are looked at this many times smaller: what is blurred needs no more pixels."""
    every: int
    """Of the samples."""


LEVELS = (
    Level(5.0, 8.0, (X_STEPS,), 5, 2, 4),
    Level(5.0, 8.0, (X_STEPS, TEXTURE), 4, 2, 4),
    Level(5.0, 5.0, (X_STEPS, Y_STEPS, TEXTURE), 4, 2, 2),
    Level(3.0, 3.0, (X_STEPS, Y_STEPS, TEXTURE), 5, 1, 3),
    Level(3.0, 3.0, (X_STEPS, Y_STEPS, TEXTURE), 4, 1, 1),
)


@dataclass(frozen=True, slots=True)
class MotionEstimate:
    """How the scene moved before the instrument, against the reference time; left camera frame."""

    frames: tuple[int, ...]
    """The 8 sine frames: x, then y."""
    course_mm: Array
    """(n, 6) mm of all frames."""
    motion_mm: Array
    """(8, 6) mm: shift of the middle of the volume, and turn as mm at ``LEVER_MM`` from it."""
    covariance_mm2: Array
    """(48, 48) of ``motion_mm``, row by row."""
    gray_place_mm: float
    """Uncertainty (σ) of the place sideways in the Gray images around the x-sines, which tell the paint."""
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
    step_deg: float
    """Median advance of a point's phase from one x-sine to the next: 90 at rest, 0 where it moved along with the fringes."""
    noise_factor: float
    """Noise of phases against that of steps of 90° where points are followed all the way. Large where the hand moved along
    with the fringes: a point then saw nearly the same phase in all steps."""
    converged: bool

    @property
    def moved(self) -> bool:
        """By enough to show in the points."""
        return self.ripple_before > NEGLIGIBLE_RIPPLE or self.texture_px > NEGLIGIBLE_PX

    @property
    def error_before(self) -> float:
        """Expected error of the points against that of a scan at rest, when nothing is done."""
        return math.hypot(1.0, self.ripple_before)


def estimate(
    scanned: ScanImages,
    calibration: Calibration,
    water: Water,
    points_mm: NDArray[np.floating],
    pixel: NDArray[np.uint32],
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
    pattern_of = see(projector.eye, index, points[chosen]).px
    samples = {
        side: _samples(camera, projector.eye, index, points[chosen], centre, sequence.period_px, binning)
        for side, camera in (("left", rig.left), ("right", rig.right))
    }
    sines = (*sequence.axis(Direction.X).sine, *sequence.axis(Direction.Y).sine)
    times_s = scanned.frame_s * np.asarray(sines)
    reference_s = float(np.mean(times_s[:4]))
    working = {side: _working(scanned.frames[side], sines, binning) for side in samples}
    scale = math.sqrt(rig.left.width_px / binning / WORKING_WIDTH_PX)
    with ThreadPoolExecutor(len(SIDES), "kf-motion") as pool:
        solver = _Solver(samples, _prior(times_s, reference_s), pool)
        hands = hands_course(scanned.frame_s * np.arange(len(sequence), dtype=np.float64), reference_s)
        course = Course(np.zeros(len(hands)), np.asarray(np.linalg.inv(hands), np.float64))
        step_mm = math.inf
        for level in LEVELS:
            if level is LEVELS[1]:
                course = follow_stripes(
                    sequence, scanned.frames, samples, pattern_of, hands, (sines, *solver.information()), pool
                )
                solver.expect(*course.at(sines))
            solver.look_at(working, level, scale)
            for _ in range(level.iterations):
                step_mm = solver.step(level.kinds)
                if step_mm < (CONVERGED_MM if level is LEVELS[-1] else ENOUGH_MM):
                    break
        grey_dn = float(np.mean([noise_dn(scanned, side) for side in SIDES]))
        averaged_px = 2.0 * math.sqrt(math.pi) * LEVELS[-1].steps_blur_px * scale * binning
        after = solver.contradiction(solver.values, grey_dn / averaged_px)
        noise_factor, covariance = solver.noise_factor(), solver.covariance()
        before = solver.contradiction(np.zeros(PARAMETERS), grey_dn / averaged_px)
    noise = grey_dn / float(np.mean([_modulation_dn(scanned, side) for side in SIDES]))
    return MotionEstimate(
        frames=sines,
        course_mm=course.given(sines, solver.values[:MOTIONS].reshape(FRAMES, 6)),
        motion_mm=solver.values[:MOTIONS].reshape(FRAMES, 6).copy(),
        covariance_mm2=covariance,
        gray_place_mm=course.shift_sd_mm(sines, covariance, _around(sequence)),
        gains=solver.values[GAINS : GAINS + FRAMES].copy(),
        centre_mm=centre,
        reference_s=reference_s,
        projector=projector,
        ripple_before=RIPPLE_OF_CONTRADICTION * before / noise,
        ripple_after=RIPPLE_OF_CONTRADICTION * after / noise,
        texture_px=binning * _way_px(samples["left"], solver.values),
        step_deg=_step_deg(samples["left"], solver.values),
        noise_factor=noise_factor,
        converged=step_mm < NEARLY_CONVERGED_MM,
    )


def _around(sequence: PatternSequence) -> tuple[int, ...]:
    """The Gray images next to the x-sines."""
    first, last = sequence.axis(Direction.X).sine[0], sequence.axis(Direction.X).sine[-1]
    gray = (*sequence.axis(Direction.X).gray, *sequence.axis(Direction.Y).gray)
    return tuple(k for k in gray if first - k in range(1, AROUND + 1) or k - last in range(1, AROUND + 1))


def _blurred(pictures: list[NDArray[np.float32]], blur_px: float, shrunk: int) -> NDArray[np.float32]:
    return np.stack([cv2.GaussianBlur(_shrunk(picture, shrunk), (0, 0), blur_px / shrunk) for picture in pictures])


def _shrunk(picture: NDArray[np.float32], times: int) -> NDArray[np.float32]:
    height, width = picture.shape
    size = (width // times, height // times)
    return np.asarray(cv2.resize(picture, size, interpolation=cv2.INTER_AREA) if times > 1 else picture, np.float32)


class _Asked(NamedTuple):
    """What one camera's samples say."""

    matrix: Array
    vector: Array
    residual_dn: Array
    modulation_dn: Array
    variance: Array


class _Solver:
    """Gauss-Newton with robust weights on the samples of both cameras, each in its own thread of ``pool``."""

    def __init__(self, samples: Mapping[str, Samples], prior: Array, pool: ThreadPoolExecutor) -> None:
        self._pool = pool
        self.values = np.zeros(PARAMETERS)
        self._all, self._samples, self._prior = samples, samples, prior
        self._known: dict[float, Mapping[str, NDArray[np.float32]]] = {}
        self._steps_blur_px = self._texture_blur_px = 0.0
        self._scale_dn = np.full(3, START_SCALE_DN)
        self._matrix = prior
        self._vector = np.zeros(PARAMETERS)
        self._variance = np.ones((1, 2))
        self._mean = np.zeros(PARAMETERS)

    def information(self) -> tuple[Array, Array]:
        """Of the motion, from what was last asked alone: matrix (48, 48) and vector of its normal equations."""
        own = self._matrix - self._prior
        vector = own @ self._asked_at - self._vector
        m, g = slice(0, MOTIONS), slice(MOTIONS, PARAMETERS)
        cross = own[m, g] @ np.linalg.inv(own[g, g] + self._prior[g, g])
        return own[m, m] - cross @ own[g, m], vector[m] - cross @ vector[g]

    def expect(self, mean_mm: Array, covariance_mm2: Array) -> None:
        """From now on the motion is expected so, and looked for from where what is known of it says."""
        told, vector = self.information()
        precision = np.linalg.inv(covariance_mm2)
        self._prior = self._prior.copy()
        self._prior[:MOTIONS, :MOTIONS] = precision
        self._mean[:MOTIONS] = mean_mm
        self.values[:MOTIONS] = np.linalg.solve(precision + told, precision @ mean_mm + vector)

    def look_at(self, working: Mapping[str, list[NDArray[np.float32]]], level: Level, scale: float) -> None:
        """From now on at a level's pictures, its blurs times ``scale``."""
        self._steps_blur_px, self._texture_blur_px = level.steps_blur_px * scale, level.texture_blur_px * scale
        self._samples = {side: _some(samples, level) for side, samples in self._all.items()}
        blurs_px = (self._steps_blur_px, self._texture_blur_px)
        known = {blur_px: pictures for blur_px, pictures in self._known.items() if blur_px in blurs_px}
        for blur_px in blurs_px:
            if blur_px not in known:
                blurred = self._pool.map(lambda side: _blurred(working[side], blur_px, level.shrunk), SIDES)  # noqa: B023
                known[blur_px] = dict(zip(SIDES, blurred, strict=True))
        self._known = known

    def step(self, kinds: tuple[int, ...]) -> float:
        """One step on residuals of these kinds; in mm the largest part of it among the x-sines, which make the depth."""
        residual_dn, _ = self._accumulate(self.values, kinds)
        for kind in range(3):
            known = residual_dn[np.isfinite(residual_dn[:, kind]), kind]
            if known.size:
                self._scale_dn[kind] = max(1.4826 * float(np.median(np.abs(known))), LEAST_SCALE_DN)
        step = -np.linalg.solve(self._matrix, self._vector + self._prior @ (self.values - self._mean))
        self.values += step
        return float(np.abs(step[: MOTIONS // 2]).max())

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

    def _looks(self, kinds: tuple[int, ...]) -> list[tuple[float, tuple[int, ...]]]:
        """Which pictures are looked at for what; phase steps last, for what they say of modulation stays."""
        if self._steps_blur_px == self._texture_blur_px or TEXTURE not in kinds:
            return [(self._steps_blur_px, kinds)]
        steps = tuple(kind for kind in kinds if kind != TEXTURE)
        return [(self._texture_blur_px, (TEXTURE,)), (self._steps_blur_px, steps)]

    def _accumulate(self, values: Array, kinds: tuple[int, ...]) -> tuple[Array, Array]:
        asked = list(self._pool.map(lambda side: self._ask(side, values, kinds), SIDES))
        self._asked_at = values.copy()
        matrix = np.sum([one.matrix for one in asked], axis=0)
        self._vector = np.sum([one.vector for one in asked], axis=0)
        # The kernel fills each pair once, in either order.
        self._matrix = matrix + matrix.T - np.diag(np.diag(matrix)) + self._prior
        self._variance = np.concatenate([one.variance for one in asked])
        both = np.concatenate([one.residual_dn for one in asked])
        if not np.isfinite(both).any():
            raise ValueError("no sample stays in the pictures; the instrument moved too far")
        return both, np.concatenate([one.modulation_dn for one in asked])

    def _ask(self, side: str, values: Array, kinds: tuple[int, ...]) -> _Asked:
        samples = self._samples[side]
        n = len(samples.uv_px)
        asked = _Asked(
            np.zeros((PARAMETERS, PARAMETERS)), np.zeros(PARAMETERS), np.full((n, 3), np.nan), np.full((n, 2), np.nan),
            np.full((n, 2), np.nan),
        )  # fmt: skip
        for blur_px, looked_for in self._looks(kinds):
            accumulate(
                samples, self._known[blur_px][side], values, SIDES.index(side), self._scale_dn,
                sum(1 << kind for kind in looked_for), *asked,
            )  # fmt: skip
        return asked


def _way_px(samples: Samples, values: Array) -> float:
    """Median way between the first and the last x-sine, in px of the pictures that are looked at."""
    moved = values[18:24] - values[0:6]
    d = moved[:3] + np.cross(moved[3:], samples.lever)
    way = np.einsum("nij,nj->ni", samples.jacobian, d)
    return float(np.nanmedian(np.linalg.norm(way, axis=1)))


def _step_deg(samples: Samples, values: Array) -> float:
    moved = values[18:24] - values[0:6]
    d = moved[:3] + np.cross(moved[3:], samples.lever)
    advance = np.einsum("nj,nj->n", samples.phase_per_mm[:, 0], d)
    return 90.0 + math.degrees(float(np.nanmedian(advance))) / 3.0


def noise_dn(scanned: ScanImages, side: str) -> float:
    """Of the grey values of one camera, at the object's mean light."""
    decoder, camera = scanned.decoded[side], of_side(scanned.noise, side)
    lit = decoder.gray_threshold[::4, ::4][decoder.mask[::4, ::4] == Mask.VALID]
    return math.sqrt(camera.variance_dn2(float(np.median(lit)) if lit.size else 0.0))


def _modulation_dn(scanned: ScanImages, side: str) -> float:
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
    prior[:MOTIONS, :MOTIONS] = hands_course(times_s, reference_s)
    for block in (np.arange(GAINS, GAINS + 4), np.arange(GAINS + 4, GAINS + FRAMES)):
        prior[block, block] = 1.0 / GAIN_SD**2
        # Only their differences mean anything: brighter pictures would have louder disagreements, no others.
        prior[np.ix_(block, block)] += 1.0 / GAIN_MEAN_SD**2
    smooth = np.arange(SMOOTH, SMOOTH + 2 * SMOOTH_TERMS)
    prior[smooth, smooth] = 1.0 / SMOOTH_SD**2
    return prior


def _working(frames: NDArray[np.uint8], sines: tuple[int, ...], binning: int) -> list[NDArray[np.float32]]:
    return [_shrunk(frames[k].astype(np.float32), binning) for k in sines]


def _some(samples: Samples, level: Level) -> Samples:
    """Those that a level looks at, in its pictures' pixels."""
    if level.every == level.shrunk == 1:
        return samples
    few = Samples(*(np.ascontiguousarray(values[:: level.every]) for values in samples))
    uv_px = (few.uv_px + 0.5) / level.shrunk - 0.5
    return few._replace(uv_px=uv_px, jacobian=few.jacobian / level.shrunk)
