"""Uncertainty of a stored object: its joint errors, the sigma of its surface, and that of a length."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from appliance.desk.object_store import JointPlaces, ObjectError, PackedMatrix, StoredObject
from appliance.desk.registration.joint import JointErrors, LengthSigma
from appliance.desk.surface.fusion import FusedCloud, with_places
from appliance.measure import STANDARD, Rigid, WorkingVolume

_MAX_POINTS = 12_000
"""Largest number of points of a surface that determine the common motion of its registration."""


def pack(errors: JointErrors, scans: Sequence[str]) -> JointPlaces:
    """Return joint errors in their stored form; ``scans`` are the names of theirs, in their order."""
    return JointPlaces(
        scans=tuple(scans),
        own_root=PackedMatrix.of(errors.own_root),
        follow=PackedMatrix.of(errors.follow),
        shared_root=PackedMatrix.of(errors.shared_root),
        working_mm=errors.volume.working_mm,
    )


def errors_of(stored_object: StoredObject) -> JointErrors:
    """Return the joint errors of an object's poses, scans in the order of ``places``.

    Raises ObjectError for an object that is not solved, or damaged.
    """
    places = stored_object.places
    if places is None:
        raise ObjectError(
            f"object '{stored_object.name}' is not solved: kingfisher object solve '{stored_object.name}'"
        )
    stored = places.joint
    if stored.scans != tuple(places.places):
        raise ObjectError(
            f"object '{stored_object.name}': its errors and its scan poses are of different scans; solve it again"
        )
    # Only the working distance scales the shapes; the ends of the range follow in proportion.
    scale = stored.working_mm / STANDARD.working_mm
    return JointErrors(
        poses=tuple(
            Rigid(np.array(place.rotation), np.array(place.translation_mm)) for place in places.places.values()
        ),
        own_root=stored.own_root.array(),
        follow=stored.follow.array(),
        shared_root=stored.shared_root.array(),
        volume=WorkingVolume(scale * STANDARD.nearest_mm, stored.working_mm, scale * STANDARD.farthest_mm),
    )


def length_between(
    stored_object: StoredObject, first: str, at_first_mm: Sequence[float], second: str, at_second_mm: Sequence[float]
) -> LengthSigma:
    """Return the distance between points of scans ``first`` and ``second``, with its standard deviation.

    The points are in the object's frame. Raises ObjectError for scans without a pose, and for an object that is not solved.
    """
    errors = errors_of(stored_object)
    names = [] if stored_object.places is None else list(stored_object.places.places)
    for name in (first, second):
        if name not in names:
            raise ObjectError(
                f"object '{stored_object.name}': scan {name} has no place; those with one are {', '.join(names)}"
            )
    return errors.of_length(names.index(first), np.array(at_first_mm), names.index(second), np.array(at_second_mm))


def with_sigma_in_frame(cloud: FusedCloud, errors: JointErrors) -> FusedCloud:
    """Return an object's fused surface with sigma in the object's frame.

    The surface is unchanged if its points name no scan.
    """
    if cloud.first_scan is None:
        return cloud
    return with_places(cloud, *errors.sigma_along(cloud.points_mm, cloud.normals, cloud.first_scan))


def with_sigma_after_registration(
    cloud: FusedCloud, errors: JointErrors | None, on_reference: NDArray[np.bool_] | None = None
) -> FusedCloud:
    """Return the surface with the sigma that remains once it is registered to a reference by its shape.

    ``on_it`` (n,): points that lie on the reference, all by default.
    """
    if errors is None or cloud.first_scan is None:
        return cloud
    # Points beside the reference do not determine the registration.
    rows = np.arange(len(cloud.grey)) if on_reference is None else np.flatnonzero(on_reference)
    rows = rows[:: max(1, len(rows) // _MAX_POINTS)]
    return with_sigma_in_frame(
        cloud, errors.settled(cloud.points_mm[rows], cloud.normals[rows], cloud.first_scan[rows])
    )
