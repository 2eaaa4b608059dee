"""The veil that is found at single points is the one that is there, and as unsure as a projector that stands elsewhere makes it."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from appliance.optics.model import HousedCamera
from appliance.patterns.sequence import Direction, Kind
from appliance.reconstruct.quality import CloudSummary
from appliance.reconstruct.table import Cloud
from appliance.reconstruct.veil import VeilFringes, find_veil
from tests.appliance.reconstruct.test_veil import CALIBRATION, OWN_DN, SEQUENCE, SIDES, WaterBefore, plane
from tests.support.synthetic import WATER, plane_points, projector

Array = NDArray[np.float64]
TURN = 2.0 * math.pi / SEQUENCE.period_px
STRONG = 0.35


@dataclass(frozen=True)
class Case:
    found: VeilFringes
    true_um: Array
    """(n,): gaps that the veil makes at the places of ``found``."""


def scanned(shown: HousedCamera, every: int = 97, dark_px: int = 0) -> Case:
    """Fringes, stripes and the water's light before a plane, without noise; ``every``: of so many left pixels one is a point;
    ``dark_px``: so many columns of the left camera show nothing."""
    frames, maps, moved, points = {}, {}, {}, {}
    for side, camera in SIDES.items():
        points[side] = plane_points(camera, *plane())
        pq = shown.project(points[side], WATER.index)
        inside = np.all((pq > 1.0) & (pq < [SEQUENCE.width_px - 2.0, SEQUENCE.height_px - 2.0]), axis=-1)
        water = WaterBefore(camera, shown)
        veil = STRONG * water.rows()
        moved[side] = np.angle(1.0 + veil) / TURN
        images = np.zeros((len(SEQUENCE), *inside.shape))
        light = 3.0 * OWN_DN
        for k, pattern in enumerate(SEQUENCE.patterns):
            at = pq[..., 0 if pattern.direction is Direction.X else 1]
            if pattern.kind is Kind.BRIGHT:
                images[k] = 2.0 * OWN_DN + light
            elif pattern.kind is Kind.GRAY:
                lit = pattern.codes(None) > 0
                place = np.clip(np.nan_to_num(np.rint(at)), 0, lit.size - 1).astype(int)
                images[k] = 2.0 * OWN_DN * lit[place] + water.share(pattern) * light
            elif pattern.kind is Kind.SINE:
                turned = np.exp(1j * (TURN * (at + 0.5) + 0.5 * math.pi * pattern.index))
                both = turned * (1.0 + veil) if pattern.direction is Direction.Y else turned
                images[k] = OWN_DN * (1.0 + both.real) + 0.5 * light
        frames[side] = np.clip(np.rint(np.nan_to_num(images)), 0, 255).astype(np.uint8)
        p, q = np.where(inside, pq[..., 0], np.nan), np.where(inside, pq[..., 1] + moved[side], np.nan)
        maps[side] = p.astype(np.float32), q.astype(np.float32)
    frames["left"][:, :, :dark_px] = 4
    pixel = np.flatnonzero(np.isfinite(maps["left"][0]))[::every]
    at = points["left"].reshape(-1, 3)[pixel]
    n = len(pixel)
    cloud = Cloud(
        at.astype(np.float32), np.zeros(n, np.uint8), np.zeros(n, np.float32), np.zeros(n, np.float32), np.zeros(n, np.float32),
        pixel.astype(np.uint32), CloudSummary(n, 80.0, 530.0, 0.02, 0.001),
    )  # fmt: skip
    found = find_veil(SEQUENCE, frames, maps, cloud, CALIBRATION.rig, WATER.index)
    assert found is not None
    u, v = found.gaps.left_px.astype(int).T
    places = points["left"][v, u]
    right = CALIBRATION.rig.right.project(places, WATER.index).astype(np.float32)
    there = cv2.remap(moved["right"].astype(np.float32), right[None, :, 0], right[None, :, 1], cv2.INTER_LINEAR)[0]
    # How far across the rows one row lies from the next, at each place.
    down = np.asarray(shown.rotation)[:, 1]
    row = [shown.project(places + 0.5 * sign * down, WATER.index)[:, 1] for sign in (1.0, -1.0)]
    true_um = 1000.0 / (row[0] - row[1]) * (there.astype(np.float64) - moved["left"][v, u])
    return Case(found, true_um)


def rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2)))


@pytest.fixture(scope="module")
def drawn() -> Case:
    return scanned(projector(CALIBRATION))


def test_strength_and_gaps_of_a_veil_are_those_that_are_there(drawn: Case) -> None:
    for veil in drawn.found.sides.values():
        assert veil.of_object == pytest.approx(STRONG, rel=0.06)
    assert drawn.found.removable
    wrong_um = rms(drawn.found.gaps.gap_um - drawn.true_um)
    assert rms(drawn.true_um) > 80.0, "a veil that makes no gaps proves nothing"
    assert wrong_um < 0.65 * rms(drawn.true_um)
    assert 0.3 * drawn.found.doubt_um < wrong_um < drawn.found.doubt_um


def test_a_projector_that_stands_elsewhere_makes_gaps_wrong_by_no_more_than_is_said() -> None:
    """By one standard deviation of its mount, across the rows and along its axis."""
    shown = projector(CALIBRATION)
    at = np.asarray(shown.translation_mm) + np.asarray(shown.rotation) @ np.array([0.0, 0.7, 2.5])
    other = scanned(replace(shown, translation_mm=(float(at[0]), float(at[1]), float(at[2]))))
    assert rms(other.found.gaps.gap_um - other.true_um) < 1.5 * other.found.doubt_um


def test_points_without_fringes_in_one_camera_say_nothing_of_the_veil(drawn: Case) -> None:
    found = scanned(projector(CALIBRATION), dark_px=150).found
    assert drawn.found.gaps.left_px[:, 0].min() < 150.0 <= found.gaps.left_px[:, 0].min()
    for veil in found.sides.values():
        assert veil.of_object == pytest.approx(STRONG, rel=0.06)


def test_a_projector_that_may_be_nearer_leaves_no_doubt_half_way_down(drawn: Case) -> None:
    """Light that leaves along its axis does so from any place on it; one that stands higher moves rows everywhere."""
    gaps = drawn.found.gaps
    half_way = np.abs(gaps.left_px[:, 1] - 150.0) < 20.0
    edges = np.abs(gaps.left_px[:, 1] - 150.0) > 120.0
    _, across, along = gaps.doubts_um.T
    assert rms(along[half_way]) < 0.3 * rms(along[edges])
    assert rms(across[half_way]) > 0.8 * rms(across[edges])
