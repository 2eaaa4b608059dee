"""Owns how the errors of all places of an object hang together: what they make of a point, and of a length between two
scans.

A point of scan s that is at x in the object's frame is off by

    τ + ω × x + R ρ φ c      with  (ω, τ) = r − F c

r are the errors that the pairs leave in the place, F how the places follow the depth error that all scans share, when
nothing tells of it, and R ρ φ c what that error does to the point in its own scan
(``measure/calibration/depth_error.py``): c are its coefficients, φ its shapes, ρ the way along the ray, R the place's
rotation. r of all scans are one vector and c is the same everywhere, so that errors of neighbours cancel in a length
and those along a row add up.

Both covariances are kept as roots: L with L L' the covariance.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from appliance.base import one_line
from appliance.desk.registration.bow import Array
from appliance.desk.registration.graph import Placed
from appliance.measure import STANDARD, Rigid, WorkingVolume, along_ray, shapes

_BLOCK = 20_000
"""Points that are worked on at once: their shapes take some megabytes."""
_LEAST_HELD = 0.01
"""Singular value, over the largest, below which a surface does not hold a motion: noise in its normals is as much."""


@dataclass(frozen=True, slots=True, eq=False)
class LengthSigma:
    """Standard deviation of the distance between two points, by its sources; that of the points in their own scans is
    not in it."""

    length_mm: float
    places_mm: float
    """Share of the places, as the pairs leave them."""
    bending_mm: float
    """Share of the depth error that all scans have in common: in the places, and in the two points."""

    @property
    def sigma_mm(self) -> float:
        """Both together."""
        return float(np.hypot(self.places_mm, self.bending_mm))


@dataclass(frozen=True, slots=True, eq=False)
class JointErrors:
    """Errors of all places of an object, in its frame; scans are numbered from 0 in the order of ``poses``."""

    poses: tuple[Rigid, ...]
    """Motion from each scan's frame into the object's, n of them."""
    own_root: Array
    """(6 n, r): root of the covariance of r, rad and mm, of turns about the object's origin and shifts of each scan in
    turn."""
    follow: Array
    """(6 n, k): F, per mm of each coefficient."""
    shared_root: Array
    """(k, q): root of the covariance of c, mm²."""
    volume: WorkingVolume = STANDARD

    __repr__ = one_line

    def sigma_along(
        self, points_mm: NDArray[np.floating], directions: NDArray[np.floating], scan: NDArray[np.integer]
    ) -> tuple[Array, Array]:
        """Return the standard deviations (n,), mm, of points along unit vectors: by the places, and by the shared depth
        error.

        ``points_mm`` (n, 3) in the object's frame, ``directions`` (n, 3), ``scan`` (n,): the scan that each is a point
        of.
        """
        places, bending = np.zeros(len(points_mm)), np.zeros(len(points_mm))
        for of in np.unique(scan).tolist():
            rows = np.flatnonzero(scan == of)
            own = self.own_root[6 * of : 6 * of + 6]
            covariance = own @ own.T
            for start in range(0, len(rows), _BLOCK):
                at = rows[start : start + _BLOCK]
                x, n = points_mm[at].astype(np.float64), directions[at].astype(np.float64)
                a = _motion_along(x, n)
                places[at] = np.sqrt(np.maximum(((a @ covariance) * a).sum(axis=1), 0.0))
                bending[at] = np.linalg.norm(self._by_shared(x, n, a, of) @ self.shared_root, axis=1)
        return places, bending

    def of_length(self, first: int, at_first_mm: Array, second: int, at_second_mm: Array) -> LengthSigma:
        """Return the standard deviation of the distance between two points (3,) in the object's frame, one of scan
        ``first`` and one of ``second``."""
        x, y = np.asarray(at_first_mm, np.float64), np.asarray(at_second_mm, np.float64)
        length = float(np.linalg.norm(y - x))
        u = ((y - x) / max(length, 1e-9))[None]
        a, b = _motion_along(x[None], u), _motion_along(y[None], u)
        # The same errors are in both ends: they are subtracted before they are squared.
        places = b @ self._own(second) - a @ self._own(first)
        shared = self._by_shared(y[None], u, b, second) - self._by_shared(x[None], u, a, first)
        return LengthSigma(length, float(np.linalg.norm(places)), float(np.linalg.norm(shared @ self.shared_root)))

    def settled(
        self, points_mm: NDArray[np.floating], normals: NDArray[np.floating], scan: NDArray[np.integer]
    ) -> JointErrors:
        """Return the same errors once the object lies on something by its surface: what one motion of all of it takes
        away is gone.

        ``points_mm`` and ``normals`` (n, 3), ``scan`` (n,): some thousand points over the surface, in the object's
        frame.
        """
        # Nothing to lie on anything by: the errors stay what they are.
        if not len(points_mm):
            return self
        x, n = np.asarray(points_mm, np.float64), np.asarray(normals, np.float64)
        a = _motion_along(x, n)
        own, shared = np.empty((len(x), self.own_root.shape[1])), np.empty((len(x), len(self.shared_root)))
        for of in np.unique(scan).tolist():
            at = scan == of
            own[at] = a[at] @ self._own(of)
            shared[at] = self._by_shared(x[at], n[at], a[at], of)
        # About the middle and with turns in mm at their lever, so that the six columns are alike.
        middle = x.mean(axis=0)
        lever = max(float(np.sqrt(((x - middle) ** 2).sum(axis=1).mean())), 1.0)
        centred = np.concatenate([np.cross(x - middle, n) / lever, n], axis=1)
        back = np.zeros((6, 6))
        back[:3, :3] = np.eye(3) / lever
        back[3:, :3] = _cross(middle) / lever
        back[3:, 3:] = np.eye(3)
        motion = back @ np.linalg.lstsq(centred, np.concatenate([own, shared], axis=1), rcond=_LEAST_HELD)[0]
        every = np.tile(motion, (len(self.poses), 1))
        r = self.own_root.shape[1]
        return replace(self, own_root=self.own_root - every[:, :r], follow=self.follow + every[:, r:])

    def _own(self, scan: int) -> Array:
        return self.own_root[6 * scan : 6 * scan + 6]

    def _by_shared(self, x: Array, directions: Array, motion: Array, scan: int) -> Array:
        """Return (n, k): displacement along ``directions`` per mm of each coefficient, by the place and in the scan
        itself."""
        pose = self.poses[scan]
        # The shapes are those of the scan's own view, whatever its place.
        own = pose.inverse.of(x)
        ray = (directions * (along_ray(own) @ pose.rotation.T)).sum(axis=1)
        return np.asarray(ray[:, None] * shapes(own, self.volume) - motion @ self.follow[6 * scan : 6 * scan + 6])


def joint_errors(placed: Placed, volume: WorkingVolume = STANDARD) -> JointErrors:
    """Return the errors of scans that were placed, in ascending order of their numbers."""
    members = sorted(placed.poses)
    return JointErrors(
        poses=tuple(placed.poses[k] for k in members),
        own_root=_root(placed.joint_covariance),
        follow=placed.follow,
        shared_root=_root(placed.bow_covariance),
        volume=volume,
    )


def _motion_along(x: Array, directions: Array) -> Array:
    """Return (n, 6): displacement of points along ``directions`` by a turn about the origin (rad) and a shift."""
    return np.concatenate([np.cross(x, directions), directions], axis=1)


def _cross(of: Array) -> Array:
    """Return the matrix (3, 3) with M ω = of × ω: the shift about the origin that goes with a turn about ``of``."""
    x, y, z = of
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])


def _root(covariance: Array) -> Array:
    value, vector = np.linalg.eigh(covariance) if covariance.size else (np.zeros(0), covariance)
    return np.asarray(vector * np.sqrt(np.maximum(value, 0.0)))
