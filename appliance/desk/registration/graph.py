"""Pose graph: scan poses and covariances from scan pairs, closed loops, and wrong pairs.

Every pair gives the pose of one scan in another's frame, with a covariance. All poses are adjusted at once by least
squares (Gauss-Newton on small motions), together with the depth error that all scans share (``bow``). A pair that
contradicts its loops is removed and named. Pairs that no loop checks are named, too.

Symbols: T_i  rigid transform from scan i's frame into the object's (that of the first scan);  ξ = (ω rad, τ mm)  a small motion of T_i,
         in the object's frame;  δ  discrepancy of a pair, a rotation (mm at its lever) and a shift;  W  its weight, 1/mm²
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from appliance.desk.registration.bow import PRIOR_MM2, Array
from appliance.measure import DEPTH_ERROR_TERMS, Fit, Rigid, rotation_matrix, rotation_vector

FLOOR_MM = 0.015
"""Standard deviation that is added to every pair: the error that calibrations leave between places of the image."""
ROUNDS = 25
WRONG = 45.0
"""Squared discrepancy of a pair over its variance above which it is wrong; χ² with 6 degrees of freedom exceeds 39 in
one case of a million."""
WRONG_MM = 0.25
"""Least discrepancy of a wrong pair: less is due to calibrations, and is in the variance factor."""
_IDENTITY = Rigid(np.eye(3), np.zeros(3))


@dataclass(frozen=True, slots=True, eq=False)
class Edge:
    """An accepted scan pair: scan ``second`` lies in the frame of ``first`` by ``fit``."""

    first: int
    second: int
    fit: Fit


@dataclass(frozen=True, slots=True, eq=False)
class ScanPoses:
    """Poses of scans in one frame, with their covariances."""

    poses: Mapping[int, Rigid]
    """Transform from each scan's frame into the object's, without scans that no pair connects to the others."""
    covariance: Mapping[int, Array]
    """(6, 6) of ω and τ of each pose, rad and mm, about the middle of the scan, relative to the first scan; shared error
    included."""
    wrong: tuple[Edge, ...]
    """Pairs that contradict their loops and were removed."""
    unchecked: tuple[Edge, ...]
    """Pairs that are in no loop: only their own judge has checked them."""
    used: tuple[Edge, ...]
    discrepancy_mm: Mapping[tuple[int, int], float]
    """RMS displacement between each pair's own pose and the poses of its scans."""
    variance_factor: float
    """Mean squared discrepancy over its variance; above 1 the covariances are scaled by it."""
    bow_mm: Array
    """(k,): coefficients of the shared depth error (``calibration.depth_error``)."""
    bow_covariance: Array
    """(k, k)."""
    bending_mm: Mapping[int, float]
    """Standard deviation of each scan's middle by the shared error alone, which may bend the object."""
    bending_unaided_mm: Mapping[int, float]
    """The same with the prior of the shared error."""
    joint_covariance: Array
    """(6 n, 6 n) of the poses of all n scans in ascending order, rotations about the object's origin (rad) and shifts
    (mm); without the shared error."""
    follow: Array
    """(6 n, k): derivatives of these poses by the coefficients of the shared error, rad and mm per mm."""


def place(
    count: int,
    edges: Sequence[Edge],
    middles_mm: Mapping[int, Array],
    with_bow: bool = True,
    prior_mm2: Array = PRIOR_MM2,
) -> ScanPoses:
    """Place ``count`` scans by ``edges``.

    ``middles_mm``: the middle (3,) of each scan's points in its own frame. ``with_bow``: the shared depth error is
    estimated, too; else it is taken for zero, and its full prior is in the budget. ``prior_mm2``: that prior, the
    covariance (k, k) of its coefficients. The largest set of connected scans is placed, in the frame of its first
    scan.
    """
    remaining = list(edges)
    wrong: list[Edge] = []
    while True:
        members = _largest(count, remaining)
        inside = [edge for edge in remaining if edge.first in members]
        solution = _solve(members, inside, with_bow, prior_mm2)
        worst = _worst(solution, members, inside, with_bow, prior_mm2)
        if worst is None:
            break
        wrong.append(worst)
        remaining = [edge for edge in remaining if edge is not worst]
    return _result(solution, members, inside, tuple(wrong), middles_mm, prior_mm2, with_bow)


def _largest(count: int, edges: Sequence[Edge]) -> list[int]:
    """Return the members of the largest connected set, ascending; the first one of equal sets."""
    label = list(range(count))

    def root(k: int) -> int:
        while label[k] != k:
            k = label[k]
        return k

    for edge in edges:
        first, second = root(edge.first), root(edge.second)
        label[max(first, second)] = min(first, second)
    groups: dict[int, list[int]] = {}
    for k in range(count):
        groups.setdefault(root(k), []).append(k)
    return max(groups.values(), key=len, default=[])


@dataclass(frozen=True, slots=True, eq=False)
class _Solution:
    poses: dict[int, Rigid]
    bow: Array
    hessian: Array
    """Second derivatives by ξ of all members but the first, then by the coefficients."""
    squared: Array
    """(edges,): squared discrepancy over variance."""
    freedom: int


def _weight(fit: Fit) -> Array:
    return np.asarray(np.linalg.inv(fit.covariance + FLOOR_MM**2 / 6.0 * np.eye(6)))


def _solve(members: Sequence[int], edges: Sequence[Edge], with_bow: bool, prior_mm2: Array) -> _Solution:
    poses = _initial_poses(members, edges)
    column = {scan: 6 * k for k, scan in enumerate(members[1:])}
    size, m = 6 * max(len(members) - 1, 0), DEPTH_ERROR_TERMS
    bow = np.zeros(m)
    prior = np.linalg.inv(prior_mm2)
    weights = [_weight(edge.fit) for edge in edges]
    for _ in range(ROUNDS):
        H, g = np.zeros((size + m, size + m)), np.zeros(size + m)
        H[size:, size:] += prior
        g[size:] += prior @ bow
        squared = np.zeros(len(edges))
        for k, (edge, W) in enumerate(zip(edges, weights, strict=True)):
            delta = _discrepancy(poses, edge) + edge.fit.depth_error.response @ bow
            squared[k] = delta @ W @ delta
            blocks = [
                (column[scan], sign * _jacobian(poses, edge))
                for scan, sign in ((edge.first, -1.0), (edge.second, 1.0))
                if scan in column
            ]
            blocks.append((size, edge.fit.depth_error.response))
            for row, A in blocks:
                g[row : row + A.shape[1]] += A.T @ W @ delta
                for first_column, B in blocks:
                    H[row : row + A.shape[1], first_column : first_column + B.shape[1]] += A.T @ W @ B
            H[size:, size:] += edge.fit.depth_error.information
            g[size:] += edge.fit.depth_error.gradient + edge.fit.depth_error.information @ bow
        step = np.zeros(size + m)
        n = size + m if with_bow else size
        if n:
            step[:n] = -np.linalg.solve(H[:n, :n], g[:n])
        for scan, first_row in column.items():
            poses[scan] = _apply_motion(poses[scan], step[first_row : first_row + 6])
        bow = bow + step[size:]
        if np.abs(step).max(initial=0.0) < 1e-7:
            break
    return _Solution(poses, bow, H, squared, 6 * len(edges) - size)


def _initial_poses(members: Sequence[int], edges: Sequence[Edge]) -> dict[int, Rigid]:
    """Return initial poses along the most certain pairs."""
    poses = {members[0]: _IDENTITY} if members else {}
    ordered = sorted(edges, key=lambda edge: edge.fit.sigma_mm)
    while len(poses) < len(members):
        for edge in ordered:
            if edge.first in poses and edge.second not in poses:
                poses[edge.second] = edge.fit.pose.then(poses[edge.first])
                break
            if edge.second in poses and edge.first not in poses:
                poses[edge.first] = edge.fit.pose.inverse.then(poses[edge.second])
                break
    return poses


def _discrepancy(poses: Mapping[int, Rigid], edge: Edge) -> Array:
    """Return δ (6,): the displacement of ``second`` between the poses and the pair, in the first's frame."""
    fit = edge.fit
    placed = poses[edge.second].then(poses[edge.first].inverse)
    difference = fit.pose.inverse.then(placed)
    return np.concatenate(
        [fit.lever_mm * rotation_vector(difference.rotation), difference.of(fit.middle_mm) - fit.middle_mm]
    )


def _jacobian(poses: Mapping[int, Rigid], edge: Edge) -> Array:
    """Return ∂δ/∂ξ (6, 6) of the second scan; that of the first is its negative."""
    fit, to_first = edge.fit, poses[edge.first].rotation.T
    middle = poses[edge.first].of(fit.middle_mm)
    # A small motion moves the middle p by τ + ω × p.
    cross = np.array([[0.0, middle[2], -middle[1]], [-middle[2], 0.0, middle[0]], [middle[1], -middle[0], 0.0]])
    J = np.zeros((6, 6))
    J[:3, :3] = fit.lever_mm * to_first
    J[3:, :3] = to_first @ cross
    J[3:, 3:] = to_first
    return J


def _apply_motion(pose: Rigid, motion: Array) -> Rigid:
    rotation = rotation_matrix(motion[:3])
    return Rigid(rotation @ pose.rotation, rotation @ pose.translation_mm + motion[3:])


def _worst(
    solution: _Solution, members: Sequence[int], edges: Sequence[Edge], with_bow: bool, prior_mm2: Array
) -> Edge | None:
    """Return the pair without which the others agree best, if they contradict each other beyond chance."""
    bridges = {id(edge) for edge in _bridges(members, edges)}
    suspects = [
        k
        for k in np.argsort(-solution.squared)
        if solution.squared[k] > WRONG
        and id(edges[k]) not in bridges
        and np.linalg.norm(_discrepancy(solution.poses, edges[k])) > WRONG_MM
    ][:4]
    best: tuple[float, Edge] | None = None
    for k in suspects:
        without = [edge for number, edge in enumerate(edges) if number != k]
        squared = float(_solve(members, without, with_bow, prior_mm2).squared.sum())
        if best is None or squared < best[0]:
            best = (squared, edges[k])
    return None if best is None else best[1]


def _bridges(members: Sequence[int], edges: Sequence[Edge]) -> list[Edge]:
    """Return the edges that are in no loop."""
    bridges = []
    for edge in edges:
        remaining = [candidate for candidate in edges if candidate is not edge]
        if len(_largest(max(members) + 1, remaining)) < len(members):
            bridges.append(edge)
    return bridges


def _result(
    solution: _Solution,
    members: Sequence[int],
    edges: Sequence[Edge],
    wrong: tuple[Edge, ...],
    middles_mm: Mapping[int, Array],
    prior_mm2: Array,
    with_bow: bool,
) -> ScanPoses:
    m = DEPTH_ERROR_TERMS
    size = len(solution.hessian) - m
    factor = float(solution.squared.sum()) / solution.freedom if solution.freedom > 0 else 1.0
    scale = max(factor, 1.0)
    joint = np.asarray(np.linalg.inv(solution.hessian), np.float64)
    # Without an estimate the shared error has its prior covariance.
    bow_covariance = joint[size:, size:] if with_bow else prior_mm2
    # Derivatives of the poses by the coefficients, from the responses of the pairs.
    follow = (
        -np.linalg.solve(solution.hessian[:size, :size], solution.hessian[:size, size:]) if size else np.zeros((0, m))
    )
    unshared = np.linalg.inv(solution.hessian[:size, :size]) * scale if size else np.zeros((0, 0))
    covariance: dict[int, Array] = {members[0]: np.zeros((6, 6))} if members else {}
    bending, unaided = dict.fromkeys(members[:1], 0.0), dict.fromkeys(members[:1], 0.0)
    for k, scan in enumerate(members[1:]):
        rows = slice(6 * k, 6 * k + 6)
        # Refer the covariance to the middle of the scan.
        p = solution.poses[scan].of(middles_mm[scan])
        to_middle = np.eye(6)
        to_middle[3:, :3] = np.array([[0.0, p[2], -p[1]], [-p[2], 0.0, p[0]], [p[1], -p[0], 0.0]])
        by_bow = to_middle @ follow[rows]
        covariance[scan] = to_middle @ unshared[rows, rows] @ to_middle.T + by_bow @ bow_covariance @ by_bow.T
        bending[scan] = float(np.sqrt(np.trace(by_bow[3:] @ bow_covariance @ by_bow[3:].T)))
        unaided[scan] = float(np.sqrt(np.trace(by_bow[3:] @ prior_mm2 @ by_bow[3:].T)))
    return ScanPoses(
        poses=solution.poses,
        covariance=covariance,
        wrong=wrong,
        unchecked=tuple(_bridges(members, edges)),
        used=tuple(edges),
        discrepancy_mm={
            (edge.first, edge.second): float(
                np.linalg.norm(_discrepancy(solution.poses, edge) + edge.fit.depth_error.response @ solution.bow)
            )
            for edge in edges
        },
        variance_factor=factor,
        bow_mm=solution.bow,
        bow_covariance=bow_covariance,
        bending_mm=bending,
        bending_unaided_mm=unaided,
        # The first scan is the frame: its pose has no error.
        joint_covariance=np.pad(unshared, ((6 * bool(members), 0), (6 * bool(members), 0))),
        follow=np.pad(follow, ((6 * bool(members), 0), (0, 0))),
    )
