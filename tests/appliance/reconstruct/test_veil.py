"""Backscatter that keeps the pattern's rows: its phasor is added to the object's, and taken out again where the two directions tell it.

Frames are sums of phasors, written down here: a plane before the cameras of the drawing, and light of the water on each ray's way to it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from appliance.calibration.health import HealthTrend, judge
from appliance.calibration.patches import PatchGaps
from appliance.optics.model import HousedCamera
from appliance.patterns.sequence import Direction, Kind, Pattern, build_sequence
from appliance.reconstruct.pipeline import Pipeline
from appliance.reconstruct.table import Cloud
from tests.support.synthetic import WATER, calibration, plane_points, projector

SEQUENCE = build_sequence(16)
CALIBRATION = calibration()
SIDES = {"left": CALIBRATION.rig.left, "right": CALIBRATION.rig.right}
OWN_DN = 40.0
COARSE = 10
"""The water's light is added up on every tenth pixel and spread between: it is smooth."""
NOISE_DN, KEPT = 0.7, 0.3
Array = NDArray[np.float64]


def plane() -> tuple[Array, float]:
    normal = np.array([-0.12, 0.15, 1.0])
    normal /= np.linalg.norm(normal)
    return normal, float(normal @ CALIBRATION.rig.volume_centre_mm(WATER.index))


class WaterBefore:
    """The water on each ray's way to the plane, lit with inverse squares and 2 /m, on every tenth pixel."""

    def __init__(self, camera: HousedCamera, shown: HousedCamera) -> None:
        h, w = camera.height_px, camera.width_px
        v, u = np.mgrid[0:h:COARSE, 0:w:COARSE].astype(float)
        origin, direction = camera.rays(np.stack([u, v], -1), WATER.index)
        normal, offset = plane()
        length = (offset - origin @ normal) / (direction @ normal)
        along = np.append(np.linspace(0.02, 0.98, 49), 1.0)
        nodes = origin[..., None, :] + (length[..., None] * along)[..., None] * direction[..., None, :]
        pq = shown.project(nodes, WATER.index)
        far = np.linalg.norm(nodes - np.asarray(shown.translation_mm), axis=-1)
        lit = (pq[..., 0] > 0.0) & (pq[..., 0] < SEQUENCE.width_px)
        self._weight = np.where(lit, np.exp(-0.002 * (far + length[..., None] * along)) / far**2, 0.0)[..., :-1]
        self._pq, self._ends = np.nan_to_num(pq[..., :-1, :]), np.nan_to_num(pq[..., -1:, 1])
        self._at = np.mgrid[:h, :w].astype(np.float32) / COARSE

    def share(self, pattern: Pattern) -> Array:
        """(h, w): of its light, that a pattern lets through."""
        level = pattern.codes(None).astype(float) / 255.0
        at = self._pq[..., 0 if pattern.direction is Direction.X else 1]
        shown = np.interp(at, np.arange(level.size), level)
        share = self._spread((self._weight * shown).sum(-1) / np.maximum(self._weight.sum(-1), 1e-300))
        # Of stripes along the rows light that was scattered often keeps a third.
        return share if pattern.direction is Direction.X else 0.5 + KEPT * (share - 0.5)

    def rows(self) -> NDArray[np.complex128]:
        """(h, w): sum of e^{2πi q/P}, of length 1, against the plane's own: so it is smooth enough to be spread between."""
        turned = (self._weight * np.exp(2j * math.pi / SEQUENCE.period_px * (self._pq[..., 1] - self._ends))).sum(-1)
        turned /= np.maximum(np.abs(turned), 1e-300)
        return np.asarray(self._spread(turned.real) + 1j * self._spread(turned.imag))

    def _spread(self, coarse: Array) -> Array:
        return np.asarray(
            cv2.remap(coarse, self._at[1], self._at[0], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        )


@dataclass(frozen=True)
class Scan:
    cloud: Cloud
    gaps: PatchGaps
    off_px: dict[str, Array]
    """Decoded row less true one, (n,)."""
    moved_px: dict[str, Array]
    """What the veil does to the rows where it is left in, (h, w)."""


def scanned(of_object: float, backscatter: float, seed: int = 10_001) -> Scan:
    """Scan the plane with a veil of ``of_object`` of its fringes and ``backscatter`` of its light."""
    rng = np.random.default_rng(seed)
    shown = projector(CALIBRATION)
    true, moved = {}, {}
    with Pipeline(CALIBRATION, WATER, SEQUENCE) as pipeline:
        for side, camera in SIDES.items():
            points = plane_points(camera, *plane())
            pq = shown.project(points, WATER.index)
            inside = np.all((pq > 1.0) & (pq < [SEQUENCE.width_px - 2.0, SEQUENCE.height_px - 2.0]), axis=-1)
            true[side] = np.where(inside, pq[..., 1], np.nan)
            phase = np.exp(2j * math.pi / SEQUENCE.period_px * (np.nan_to_num(pq[..., 1]) + 0.5))
            water = WaterBefore(camera, shown)
            veil = of_object * OWN_DN * water.rows() * phase
            own = np.where(inside, OWN_DN, 0.0)
            moved[side] = np.angle(1.0 + of_object * water.rows()) * SEQUENCE.period_px / (2.0 * math.pi)
            light = 2.0 * backscatter * OWN_DN
            frames = []
            for pattern in SEQUENCE.patterns:
                at = pq[..., 0 if pattern.direction is Direction.X else 1]
                match pattern.kind:
                    case Kind.BRIGHT:
                        image = 2.0 * own + light
                    case Kind.DARK:
                        image = np.zeros_like(own)
                    case Kind.GRAY:
                        lit = pattern.codes(None) > 0
                        place = np.clip(np.nan_to_num(np.rint(at)), 0, lit.size - 1).astype(int)
                        image = 2.0 * own * lit[place] + water.share(pattern) * light
                    case Kind.SINE:
                        turn = np.exp(
                            1j * (2.0 * math.pi / SEQUENCE.period_px * (at + 0.5) + 0.5 * math.pi * pattern.index)
                        )
                        image = own * (1.0 + np.nan_to_num(turn.real)) + 0.5 * light
                        if pattern.direction is Direction.Y:
                            image += (veil * np.exp(0.5j * math.pi * pattern.index)).real
                frames.append(np.clip(np.rint(10.0 + image + rng.normal(0.0, NOISE_DN, own.shape)), 0, 255))
            stack = np.stack(frames).astype(np.uint8)
            for k in range(len(SEQUENCE)):
                pipeline.push(side, stack, k)
        pipeline.coarse()
        cloud = pipeline.full()
        off = {side: (pipeline.decoded(side).q_px.astype(np.float64) - true[side]).ravel() for side in SIDES}
    assert cloud.gaps is not None
    return Scan(cloud, cloud.gaps, {side: one[np.isfinite(one)] for side, one in off.items()}, moved)


@pytest.fixture(scope="module")
def clear() -> Scan:
    return scanned(0.0, 0.0)


@pytest.fixture(scope="module")
def milk() -> Scan:
    return scanned(0.35, 1.5)


def rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2)))


def test_a_third_of_the_objects_fringes_is_taken_out_of_the_rows(clear: Scan, milk: Scan) -> None:
    for side in SIDES:
        noise_px = rms(clear.off_px[side])
        assert rms(milk.moved_px[side]) > 0.25, "left in, it counts"
        assert rms(milk.off_px[side]) < math.hypot(noise_px, 0.3 * rms(milk.moved_px[side]))
    assert len(milk.cloud.pixel) > 0.98 * len(clear.cloud.pixel)


def test_gaps_in_milk_are_those_of_clear_water_within_what_is_not_known(milk: Scan) -> None:
    assert milk.gaps.doubts_um is not None
    assert milk.gaps.shape_um is not None
    doubt = np.sqrt(np.sum(milk.gaps.doubts_um**2, axis=1) + milk.gaps.shape_um**2)
    assert rms(milk.gaps.gap_um / doubt) < 1.0
    _, said = judge(HealthTrend(), milk.gaps)
    assert said.point is None
    assert "backscatter" in said.text


def test_clear_water_is_not_asked(clear: Scan) -> None:
    assert clear.gaps.veil_um is None
