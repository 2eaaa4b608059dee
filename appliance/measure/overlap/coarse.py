"""Coarse poses of two scans relative to each other, from common keypoints or from shape.

Keypoints: three matched descriptors give a pose (M. Fischler, R. Bolles 1981). Shape: a coarse ICP from many starts
over translations and rolls at once; most end where little fits. These are guesses: fine registration and its judge
decide.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from appliance.measure.light.rotation import rotation_matrix
from appliance.measure.light.volume import WorkingVolume
from appliance.measure.overlap.features import Features
from appliance.measure.overlap.fine import PreparedScan
from appliance.measure.overlap.patches import Array
from appliance.measure.overlap.rigid import Rigid

RATIO = 0.85
"""Largest distance to the best match, over that to the second best (Lowe 2004)."""
NEAR_MM = 0.8
"""Largest distance between the points of matched features at a pose that they support."""
TRIPLES = 1_500
SETS_PER_GUESS = 10
"""Largest number of inlier sets that are examined per guess."""
MIN_SIDE_MM = 8.0
"""Least side of a triangle of features: smaller ones determine no rotation."""
ENOUGH_INLIERS = 10
"""Fewest features that agree on a pose: three always do, and some more by chance."""
DISTINCT_MM = 4.0
"""Poses that move the middle of the volume, or points 80 mm off it, by less are the same guess."""

SOURCES = 260
"""Number of patches in each start of the search by shape."""
FEWEST_SOURCES = 50
SHIFTS_MM = (-110.0, -55.0, 0.0, 55.0, 110.0)
"""Translations of the starts for scans of the standard housing."""
ROLLS_DEG = (0.0, 30.0, -30.0, 60.0, -60.0, 90.0, -90.0, 120.0, -120.0, 150.0, -150.0, 180.0)
ITERATIONS = 16
WIDE_MM, NARROW_MM = 35.0, 1.5
"""Largest distance of corresponding patches in the first and in the last iteration."""
LEAST_SHARE = 0.25
"""Least share of patches that must lie on the other scan."""


@dataclass(frozen=True, slots=True, eq=False)
class Guess:
    """A coarse pose of B in A's frame."""

    pose: Rigid
    support: float
    """Number of features that agree, or share of patches that fit."""
    by_features: bool


def guess_by_features(a: Features, b: Features, count_limit: int = 3, seed: int = 0) -> list[Guess]:
    """Return at most ``count_limit`` distinct poses on which enough features agree, the best first."""
    pairs = matches(a.descriptors, b.descriptors)
    if len(pairs) < ENOUGH_INLIERS:
        return []
    p, q = a.points_mm[pairs[:, 0]], b.points_mm[pairs[:, 1]]
    rng = np.random.default_rng(seed)
    triple = rng.integers(0, len(pairs), (TRIPLES, 3))
    sides_p = np.linalg.norm(p[triple] - p[triple[:, [1, 2, 0]]], axis=-1)
    sides_q = np.linalg.norm(q[triple] - q[triple[:, [1, 2, 0]]], axis=-1)
    # A rigid transform preserves the triangle: this removes most wrong triples.
    is_congruent = (np.abs(sides_p - sides_q) < 2.0 * NEAR_MM).all(1) & (sides_p.min(1) > MIN_SIDE_MM)
    triple = triple[is_congruent]
    if not len(triple):
        return []
    rotation, shift = _kabsch(p[triple], q[triple])
    off = np.einsum("kij,nj->kni", rotation, q) + shift[:, None] - p
    inliers = (off * off).sum(-1) < (2.0 * NEAR_MM) ** 2
    guesses: list[Guess] = []
    support = inliers.sum(1)
    left = np.argsort(-support, kind="stable")
    for _ in range(SETS_PER_GUESS * count_limit):
        if not len(left) or support[left[0]] < ENOUGH_INLIERS or len(guesses) == count_limit:
            break
        mine, pose = inliers[left[0]], Rigid(rotation[left[0]], shift[left[0]])
        # Triples of mostly the same features give the same pose, and would delay those of others.
        left = left[np.count_nonzero(inliers[left] & mine, axis=1) < 0.5 * support[left]]
        for _ in range(3):
            if np.count_nonzero(mine) < 4:
                break
            r, s = _kabsch(p[mine][None], q[mine][None])
            pose = Rigid(r[0], s[0])
            mine = ((pose.of(q) - p) ** 2).sum(-1) < NEAR_MM**2
        # Several features at one place count once.
        count = len(np.unique(np.round(p[mine] / 3.0), axis=0))
        if count >= ENOUGH_INLIERS and all(not same(pose, guess.pose) for guess in guesses):
            guesses.append(Guess(pose, float(count), True))
    return sorted(guesses, key=lambda guess: -guess.support)


def matches(a: NDArray[np.float32], b: NDArray[np.float32]) -> NDArray[np.int64]:
    """Return index pairs (n, 2) of mutual best matches of descriptors (…, 128) that pass the ratio test.

    The distance to the best match must be less than ``RATIO`` times that to the second best.
    """
    if len(a) < 3 or len(b) < 3:
        return np.empty((0, 2), np.int64)
    alike = a @ b.T
    two = np.argpartition(-alike, 1, axis=1)[:, :2]
    of_two = np.take_along_axis(alike, two, axis=1)
    first = two[np.arange(len(two)), of_two.argmax(1)]
    # Unit vectors: squared distance = 2 − 2 cosine.
    distance = np.sqrt(np.maximum(2.0 - 2.0 * np.sort(of_two, axis=1)[:, ::-1], 0.0))
    good = distance[:, 0] < RATIO * distance[:, 1]
    mutual = alike.argmax(0)[first] == np.arange(len(first))
    rows = np.flatnonzero(good & mutual)
    return np.stack([rows, first[rows]], axis=1)


def in_common(a: Features, b: Features, pose: Rigid) -> Array:
    """Return the points (n, 3), in A's frame, of the features that two scans share at ``pose``."""
    pairs = matches(a.descriptors, b.descriptors)
    # Descriptors alone also match by chance and where texture repeats, so the points must agree with the pose.
    points = a.points_mm[pairs[:, 0]]
    off = pose.of(b.points_mm[pairs[:, 1]]) - points
    return np.asarray(points[(off**2).sum(axis=1) < NEAR_MM**2])


def turn_error_mm(points_mm: Array, reach_mm: float) -> float:
    """Return the displacement, ``reach_mm`` off points (n, 3), by the uncertain rotation about their line.

    It is one standard deviation. Points that also extend across the line determine that rotation.
    """
    centred = points_mm - points_mm.mean(axis=0)
    extent_mm = float(np.linalg.svd(centred, compute_uv=False)[1])
    return 0.5 * NEAR_MM * reach_mm / max(extent_mm, 1e-9)


def _kabsch(p: Array, q: Array) -> tuple[Array, Array]:
    """Return rotations (k, 3, 3) and translations (k, 3) that map points q (k, n, 3) to p (Kabsch 1976)."""
    pm, qm = p.mean(axis=1), q.mean(axis=1)
    u, _, vt = np.linalg.svd(np.swapaxes(q - qm[:, None], 1, 2) @ (p - pm[:, None]))
    sign = np.sign(np.linalg.det(u) * np.linalg.det(vt))
    fix = np.ones((len(p), 3))
    fix[:, 2] = sign
    rotation = np.swapaxes(vt, 1, 2) @ (fix[:, :, None] * np.swapaxes(u, 1, 2))
    return rotation, pm - np.einsum("kij,kj->ki", rotation, qm)


def same(first: Rigid, second: Rigid, within_mm: float = DISTINCT_MM, depth_mm: float = 540.0) -> bool:
    """Return whether two poses of B put points around the middle of the volume at the same place."""
    around = np.array([[0.0, 0.0, depth_mm], [80.0, 0.0, depth_mm], [0.0, 80.0, depth_mm], [-80.0, -80.0, depth_mm]])
    return bool(np.linalg.norm(first.of(around) - second.of(around), axis=1).max() < within_mm)


def guess_by_shape(a: PreparedScan, b: PreparedScan, near: Rigid | None = None, count_limit: int = 6) -> list[Guess]:
    """Return at most ``count_limit`` distinct poses of B on A that fit by shape, the best first.

    ``a`` and ``b`` have coarse patches of some 4 mm. ``near``: an approximate pose of B, such as that of the scan
    before; ``None``: any pose within ``SHIFTS_MM`` of the same view.
    """
    pa, pb = a.patches, b.patches
    if min(np.count_nonzero(pa.valid), np.count_nonzero(pb.valid)) < FEWEST_SOURCES:
        return []
    source = _spread_over_normals(pb.normal.reshape(-1, 3), np.flatnonzero(pb.valid))
    c, n = pb.centre_mm.reshape(-1, 3)[source], pb.normal.reshape(-1, 3)[source]
    middle_a = np.median(pa.centre_mm[pa.valid], axis=0)
    middle_b = np.median(c, axis=0)
    rotation, shift = _starts(middle_a, middle_b, near, pa.projection.volume)
    limits_mm = np.geomspace(WIDE_MM, NARROW_MM, ITERATIONS)
    share = np.zeros(len(rotation))
    for step, limit_mm in enumerate(limits_mm):
        if step in (5, 9):
            # Only the better starts go on.
            best = np.argsort(-share)[: max(len(share) // (3 if step == 5 else 2), 4 * count_limit)]
            rotation, shift, share = rotation[best], shift[best], share[best]
        rotation, shift, share = _iterate(pa.centre_mm, pa.normal, pa.cells, c, n, rotation, shift, limit_mm)
    guesses: list[Guess] = []
    for k in np.argsort(-share, kind="stable"):
        pose = Rigid(rotation[k], shift[k])
        if share[k] < LEAST_SHARE or len(guesses) == count_limit:
            break
        if all(not same(pose, guess.pose) for guess in guesses):
            guesses.append(Guess(pose, float(share[k]), False))
    return guesses


def _spread_over_normals(normal: Array, valid: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return ``SOURCES`` of the ``valid`` patches, evenly over the normals (Rusinkiewicz 2001)."""
    bins = np.round(normal[valid][:, :2] / 0.2).astype(int)
    _, label, count = np.unique(bins, axis=0, return_inverse=True, return_counts=True)
    rng = np.random.default_rng(3)
    weight = 1.0 / np.sqrt(count[label.ravel()])
    chosen = rng.choice(len(valid), min(SOURCES, len(valid)), replace=False, p=weight / weight.sum())
    return np.asarray(valid[np.sort(chosen)])


def _starts(middle_a: Array, middle_b: Array, near: Rigid | None, volume: WorkingVolume) -> tuple[Array, Array]:
    if near is not None:
        rolls: tuple[float, ...] = (0.0, 12.0, -12.0)
        shifts: tuple[float, ...] = (-30.0, 0.0, 30.0)
        base, to = near.rotation, near.of(middle_b)
    else:
        rolls, base, to = ROLLS_DEG, np.eye(3), middle_a
        shifts = tuple(volume.scaled(shift) for shift in SHIFTS_MM)
    rotations, translations = [], []
    for roll in rolls:
        start_rotation = rotation_matrix(np.array([0.0, 0.0, np.radians(roll)])) @ base
        for x in shifts:
            for y in shifts:
                rotations.append(start_rotation)
                translations.append(to + np.array([x, y, 0.0]) - start_rotation @ middle_b)
    return np.array(rotations), np.array(translations)


def _iterate(
    centre: Array,
    normal: Array,
    cells: Callable[[Array], Array],
    c: Array,
    n: Array,
    rotation: Array,
    shift: Array,
    max_distance_mm: float,
) -> tuple[Array, Array, Array]:
    """Move every start (k) one ICP step; return the poses and the share of patches that fit."""
    x = np.einsum("kij,nj->kni", rotation, c) + shift[:, None]
    m = np.einsum("kij,nj->kni", rotation, n)
    with np.errstate(invalid="ignore"):
        cell = np.rint(cells(x))
        gh, gw = normal.shape[:2]
        inside = (cell[..., 0] >= 0) & (cell[..., 1] >= 0) & (cell[..., 0] < gw) & (cell[..., 1] < gh)
    i, j = np.where(inside, cell[..., 0], 0).astype(int), np.where(inside, cell[..., 1], 0).astype(int)
    plane = normal[j, i]
    off = (plane * (x - centre[j, i])).sum(-1)
    with np.errstate(invalid="ignore"):
        fits = inside & (np.abs(off) < max_distance_mm) & ((plane * m).sum(-1) > 0.5)
    w = np.where(fits, 1.0 / (1.0 + (off / (0.3 * max_distance_mm)) ** 2), 0.0)
    off, plane = np.where(fits, off, 0.0), np.where(fits[..., None], plane, 0.0)
    total = np.maximum(w.sum(1), 1e-9)
    middle = (w[..., None] * x).sum(1) / total[:, None]
    lever = 70.0
    J = np.concatenate([np.cross(x - middle[:, None], plane) / lever, plane], axis=-1)
    A = np.einsum("kn,kni,knj->kij", w, J, J) + (0.02 * total[:, None, None] + 1e-6) * np.eye(6)
    g = np.einsum("kn,kni,kn->ki", w, J, off)
    step = -np.linalg.solve(A, g[..., None])[..., 0]
    size = np.linalg.norm(step, axis=1)
    step *= np.minimum(1.0, 25.0 / np.maximum(size, 1e-9))[:, None]
    angle = step[:, :3] / lever
    increment = np.array([rotation_matrix(rotation_rad) for rotation_rad in angle])
    return (
        increment @ rotation,
        np.einsum("kij,kj->ki", increment, shift - middle) + middle + step[:, 3:],
        # The share is of all patches: those that leave the view count as not fitting.
        w.sum(1) / len(c),
    )
