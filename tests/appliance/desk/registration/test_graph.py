"""Many scans from their pairs: loops close, a wrong pair is found, and what may bend the object is said."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from appliance.desk.registration.graph import Edge, place
from appliance.desk.registration.solve import ComparedPair, _most_useful, _omissions, edges_of
from appliance.measure.calibration.depth_error import DEPTH_ERROR_TERMS
from appliance.measure.light.rotation import rotation_matrix
from appliance.measure.overlap.fine import DepthErrorEquations, Fit
from appliance.measure.overlap.pair import PairRefusal, RegisteredPair
from appliance.measure.overlap.rigid import Rigid

STEP_MM = 60.0
MIDDLE_MM = np.array([30.0, 0.0, 500.0])
NO_NEWS = DepthErrorEquations(
    np.zeros((6, DEPTH_ERROR_TERMS)), np.zeros((DEPTH_ERROR_TERMS, DEPTH_ERROR_TERMS)), np.zeros(DEPTH_ERROR_TERMS)
)


def true_pose(k: int) -> Rigid:
    return Rigid(
        rotation_matrix(np.array([0.0, 0.02 * k, 0.05 * np.sin(k)])), np.array([STEP_MM * k, 3.0 * np.cos(k), 0.5 * k])
    )


def edge(
    i: int,
    j: int,
    sigma_mm: float = 0.02,
    off_mm: tuple[float, float, float] = (0.0, 0.0, 0.0),
    seed: int | None = None,
) -> Edge:
    pose = true_pose(j).then(true_pose(i).inverse)
    if seed is not None:
        small = np.random.default_rng(seed).normal(size=6) * sigma_mm / np.sqrt(6.0)
        turn = rotation_matrix(small[3:] / 60.0)
        # About the overlap's middle, which the stated covariance speaks of.
        pose = Rigid(turn @ pose.rotation, turn @ (pose.translation_mm - MIDDLE_MM) + MIDDLE_MM + small[:3])
    pose = Rigid(pose.rotation, pose.translation_mm + np.array(off_mm))
    fit = Fit(
        pose=pose, middle_mm=MIDDLE_MM, lever_mm=60.0, stiffness=np.eye(6),
        covariance=np.eye(6) * sigma_mm**2 / 6.0, significance=np.full(6, 100.0),
        directions=np.eye(6), patches=5000, overlap=0.6,
        rms_mm=0.02, outliers=0.0, missing=0.0, front=0.0, texture_correlation=0.9, texture_share=0.2,
        depth_error=NO_NEWS,
    )  # fmt: skip
    return Edge(i, j, fit)


def middles(count: int) -> dict[int, np.ndarray[tuple[int, ...], np.dtype[np.float64]]]:
    return {k: np.array([0.0, 0.0, 500.0]) for k in range(count)}


def off_mm(placed: Rigid, k: int) -> float:
    at, first = np.array([0.0, 0.0, 500.0]), true_pose(0)
    return float(np.linalg.norm(placed.of(at) - true_pose(k).then(first.inverse).of(at)))


def test_exact_pairs_give_exact_places_in_the_frame_of_the_first_scan() -> None:
    placed = place(6, [edge(k, k + 1) for k in range(5)] + [edge(0, 2), edge(5, 3), edge(1, 4)], middles(6))
    assert {k: off_mm(pose, k) < 1e-5 for k, pose in placed.poses.items()} == dict.fromkeys(range(6), True)
    assert (placed.unchecked, placed.wrong) == ((), ())


def test_a_wrong_pair_is_found_by_the_loops_and_taken_out() -> None:
    good = [edge(k, k + 1, seed=k) for k in range(7)] + [edge(k, k + 2, seed=20 + k) for k in range(6)]
    wrong = edge(1, 5, off_mm=(0.0, 8.0, 0.0))
    placed = place(8, [*good, wrong], middles(8))
    assert placed.wrong == (wrong,)
    assert all(off_mm(pose, k) < 0.15 for k, pose in placed.poses.items())


@pytest.mark.parametrize(
    ("sigma_mm", "off_mm", "wrong"),
    [
        # Of a certain pair: by the place, a quarter of a millimetre.
        (0.02, 0.22, False),
        (0.02, 0.32, True),
        # Of an uncertain one: by its variance, 45 times that in all.
        (0.2, 0.46, False),
        (0.2, 0.70, True),
    ],
)
def test_a_pair_is_wrong_beyond_chance_and_what_calibrations_leave(sigma_mm: float, off_mm: float, wrong: bool) -> None:
    firm = [edge(k, j, sigma_mm=0.001) for k in range(5) for j in range(k + 1, 6) if (k, j) != (1, 4)]
    placed = place(6, [*firm, edge(1, 4, sigma_mm, off_mm=(0.0, off_mm, 0.0))], middles(6))
    assert bool(placed.wrong) is wrong


def test_a_pair_that_no_loop_checks_is_kept_and_named() -> None:
    bridge = edge(3, 4, off_mm=(0.0, 8.0, 0.0))
    rings = [edge(i, j) for i, j in ((0, 1), (1, 2), (2, 3), (0, 3), (4, 5), (5, 6), (4, 6))]
    placed = place(7, [*rings, bridge], middles(7))
    assert placed.wrong == ()
    assert placed.unchecked == (bridge,)


def test_of_neighbours_by_place_three_of_each_scan_are_compared_the_farthest_in_time_first() -> None:
    here = Rigid(np.eye(3), np.zeros(3))
    kept = _most_useful([(0, k, here) for k in range(1, 6)] + [(k, 6, here) for k in (2, 4, 5)])
    assert list(kept) == [(0, 5), (0, 4), (2, 6), (0, 3), (4, 6), (5, 6)]
    assert all(pose is here for pose in kept.values())


def test_each_scan_without_a_place_has_the_reason_that_helps_most() -> None:
    def refused(first: int, second: int, why: PairRefusal) -> ComparedPair:
        return ComparedPair(first, second, RegisteredPair(None, why, f"{first} and {second}"))

    def accepted(edge_of: Edge) -> ComparedPair:
        return ComparedPair(edge_of.first, edge_of.second, RegisteredPair(edge_of.fit, None, ""))

    compared = [
        *(accepted(edge(i, j)) for i, j in ((0, 1), (1, 2), (0, 2), (3, 4))),
        refused(2, 5, PairRefusal.SLIDES), refused(5, 6, PairRefusal.TOO_LITTLE), refused(2, 6, PairRefusal.NOTHING_IN_COMMON),
        refused(0, 7, PairRefusal.NOTHING_IN_COMMON),
    ]  # fmt: skip
    assert [(one.first, one.second) for one in edges_of(compared)] == [(0, 1), (1, 2), (0, 2), (3, 4)]
    placed = place(8, edges_of(compared), middles(8))
    left = _omissions(8, placed, compared)
    assert {scan: (one.why, one.beside) for scan, one in left.items()} == {
        3: ("it overlaps only scans without a pose", None),
        4: ("it overlaps only scans without a pose", None),
        5: ("5 and 6", 6),
        6: ("5 and 6", 5),
        7: ("it overlaps no other scan", None),
    }
    contradicting = replace(placed, wrong=(edge(3, 4),))
    assert _omissions(8, contradicting, compared)[4].why == "its scan pairs contradict the loops of the others"
