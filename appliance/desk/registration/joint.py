"""Joint errors of all scan poses of an object, and the uncertainty of points and lengths by them.

A point of scan s that is at x in the object's frame has the error

    τ + ω × x + R ρ φ c      with  (ω, τ) = r − F c

r are the errors of the pose by its pairs, F the derivatives of the poses by the depth error that all scans share, if it
is not estimated, and R ρ φ c the effect of that error on the point in its own scan
(``measure/calibration/depth_error.py``): c are its coefficients, φ its shapes, ρ the direction of the ray, R the
rotation of the pose. r of all scans are one vector and c is the same everywhere, so that errors of neighbours cancel in
a length and those along a row add up.

Both covariances are kept as roots: L with L L' the covariance.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from appliance.base import one_line
from appliance.desk.registration.bow import Array
from appliance.desk.registration.graph import ScanPoses
from appliance.measure import STANDARD, Rigid, WorkingVolume, along_ray, shapes

_BLOCK = 20_000
"""Number of points that are processed at once: their shapes take some megabytes."""
_MIN_SINGULAR_VALUE = 0.01
"""Singular value, over the largest, below which a surface does not hold a motion: noise of its normals makes as much."""


@dataclass(frozen=True, slots=True, eq=False)
class LengthSigma:
    """Standard deviation of the distance between two points, by its sources.

    That of the points in their own scans is not included.
    """

    length_mm: float
    places_mm: float
    """Contribution of the poses, as the pairs determine them."""
    bending_mm: float
    """Contribution of the depth error that all scans share: in the poses, and in the two points."""

    @property
    def sigma_mm(self) -> float:
        """The standard deviation by both contributions."""
        return float(np.hypot(self.places_mm, self.bending_mm))


@dataclass(frozen=True, slots=True, eq=False)
class JointErrors:
    """Joint errors of all scan poses of an object, in its frame.

    Scans are numbered in the order of ``poses``.
    """

    poses: tuple[Rigid, ...]
    """Transforms from each scan's frame into the object's, n of them."""
    own_root: Array
    """(6 n, r): root of the covariance of r, rad and mm, of rotations about the object's origin and shifts, scan by
    scan."""
    follow: Array
    """(6 n, k): F, per mm of each coefficient."""
    shared_root: Array
    """(k, q): root of the covariance of c, mm²."""
    volume: WorkingVolume = STANDARD

    __repr__ = one_line

    def sigma_along(
        self, points_mm: NDArray[np.floating], directions: NDArray[np.floating], scan: NDArray[np.integer]
    ) -> tuple[Array, Array]:
        """Return standard deviations (n,), mm, of points along unit vectors, by poses and by the depth error.

        ``points_mm`` (n, 3) in the object's frame, ``directions`` (n, 3), ``scan`` (n,): the scan of each point.
        """
        places, bending = np.zeros(len(points_mm)), np.zeros(len(points_mm))
        for number in np.unique(scan).tolist():
            rows = np.flatnonzero(scan == number)
            root = self.own_root[6 * number : 6 * number + 6]
            covariance = root @ root.T
            for start in range(0, len(rows), _BLOCK):
                batch = rows[start : start + _BLOCK]
                x, n = points_mm[batch].astype(np.float64), directions[batch].astype(np.float64)
                a = _motion_along(x, n)
                places[batch] = np.sqrt(np.maximum(((a @ covariance) * a).sum(axis=1), 0.0))
                bending[batch] = np.linalg.norm(self._by_shared(x, n, a, number) @ self.shared_root, axis=1)
        return places, bending

    def of_length(self, first: int, at_first_mm: Array, second: int, at_second_mm: Array) -> LengthSigma:
        """Return the standard deviation of the distance between points of scans ``first`` and ``second``.

        The points are (3,) in the object's frame.
        """
        x, y = np.asarray(at_first_mm, np.float64), np.asarray(at_second_mm, np.float64)
        length = float(np.linalg.norm(y - x))
        u = ((y - x) / max(length, 1e-9))[None]
        a, b = _motion_along(x[None], u), _motion_along(y[None], u)
        # Both ends have common errors: subtract before squaring.
        places = b @ self._own(second) - a @ self._own(first)
        shared = self._by_shared(y[None], u, b, second) - self._by_shared(x[None], u, a, first)
        return LengthSigma(length, float(np.linalg.norm(places)), float(np.linalg.norm(shared @ self.shared_root)))

    def settled(
        self, points_mm: NDArray[np.floating], normals: NDArray[np.floating], scan: NDArray[np.integer]
    ) -> JointErrors:
        """Return the errors that remain once the surface of the object is registered to a reference.

        A common motion of all scans is removed. ``points_mm`` and ``normals`` (n, 3), ``scan`` (n,): some thousand points over
        the surface, in the object's frame.
        """
        # Without points there is no registration: the errors stay.
        if not len(points_mm):
            return self
        x, n = np.asarray(points_mm, np.float64), np.asarray(normals, np.float64)
        a = _motion_along(x, n)
        by_pairs, shared = np.empty((len(x), self.own_root.shape[1])), np.empty((len(x), len(self.shared_root)))
        for number in np.unique(scan).tolist():
            rows = scan == number
            by_pairs[rows] = a[rows] @ self._own(number)
            shared[rows] = self._by_shared(x[rows], n[rows], a[rows], number)
        # About the middle and with rotations in mm at their lever, so that the six columns are of one size.
        middle = x.mean(axis=0)
        lever = max(float(np.sqrt(((x - middle) ** 2).sum(axis=1).mean())), 1.0)
        centred = np.concatenate([np.cross(x - middle, n) / lever, n], axis=1)
        to_origin = np.zeros((6, 6))
        to_origin[:3, :3] = np.eye(3) / lever
        to_origin[3:, :3] = _cross(middle) / lever
        to_origin[3:, 3:] = np.eye(3)
        motion = (
            to_origin
            @ np.linalg.lstsq(centred, np.concatenate([by_pairs, shared], axis=1), rcond=_MIN_SINGULAR_VALUE)[0]
        )
        motions = np.tile(motion, (len(self.poses), 1))
        r = self.own_root.shape[1]
        return replace(self, own_root=self.own_root - motions[:, :r], follow=self.follow + motions[:, r:])

    def _own(self, scan: int) -> Array:
        return self.own_root[6 * scan : 6 * scan + 6]

    def _by_shared(self, x: Array, directions: Array, motion: Array, scan: int) -> Array:
        """Return (n, k): displacement along ``directions`` by each coefficient, per mm."""
        pose = self.poses[scan]
        # The shapes belong to the scan's own view.
        scan_points = pose.inverse.of(x)
        ray = (directions * (along_ray(scan_points) @ pose.rotation.T)).sum(axis=1)
        return np.asarray(
            ray[:, None] * shapes(scan_points, self.volume) - motion @ self.follow[6 * scan : 6 * scan + 6]
        )


def joint_errors(placed: ScanPoses, volume: WorkingVolume = STANDARD) -> JointErrors:
    """Return the joint errors of placed scans, in ascending order of their indices."""
    members = sorted(placed.poses)
    return JointErrors(
        poses=tuple(placed.poses[k] for k in members),
        own_root=_root(placed.joint_covariance),
        follow=placed.follow,
        shared_root=_root(placed.bow_covariance),
        volume=volume,
    )


def _motion_along(x: Array, directions: Array) -> Array:
    """Return (n, 6): displacement of points along ``directions`` by a rotation (rad) and a shift."""
    return np.concatenate([np.cross(x, directions), directions], axis=1)


def _cross(vector: Array) -> Array:
    """Return the matrix (3, 3) with M ω = vector × ω: the shift of the origin by a rotation about a point."""
    x, y, z = vector
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])


def _root(covariance: Array) -> Array:
    value, vector = np.linalg.eigh(covariance) if covariance.size else (np.zeros(0), covariance)
    return np.asarray(vector * np.sqrt(np.maximum(value, 0.0)))
