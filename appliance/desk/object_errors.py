"""Owns how certain a stored object is as a whole: its joint errors as they are kept, the sigma of its surface, and that
of a length on it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from appliance.desk.object_store import JointPlaces, ObjectError, PackedMatrix, StoredObject
from appliance.desk.registration.joint import JointErrors, LengthSigma
from appliance.desk.surface.fusion import FusedCloud, with_places
from appliance.measure import STANDARD, Rigid, WorkingVolume

_MAX_POINTS = 12_000
"""Points of a surface that say which motion it would be laid onto something by."""


def pack(errors: JointErrors, scans: Sequence[str]) -> JointPlaces:
    """Return joint errors as an object keeps them; ``scans``: the names of theirs, in their order."""
    return JointPlaces(
        scans=tuple(scans),
        own_root=PackedMatrix.of(errors.own_root),
        follow=PackedMatrix.of(errors.follow),
        shared_root=PackedMatrix.of(errors.shared_root),
        working_mm=errors.volume.working_mm,
    )


def errors_of(stored_object: StoredObject) -> JointErrors:
    """Return the joint errors of an object's places, scans in the order of ``places``.

    Raises ObjectError for an object that is not solved, or damaged.
    """
    places = stored_object.places
    if places is None:
        raise ObjectError(
            f"object '{stored_object.name}' is not solved: kingfisher object solve '{stored_object.name}'"
        )
    kept = places.joint
    if kept.scans != tuple(places.places):
        raise ObjectError(
            f"object '{stored_object.name}': its errors are of other scans than its places; solve it again"
        )
    # Only the working distance scales the shapes; the rest of the range is made up in proportion.
    scale = kept.working_mm / STANDARD.working_mm
    return JointErrors(
        poses=tuple(Rigid(np.array(one.rotation), np.array(one.translation_mm)) for one in places.places.values()),
        own_root=kept.own_root.array(),
        follow=kept.follow.array(),
        shared_root=kept.shared_root.array(),
        volume=WorkingVolume(scale * STANDARD.nearest_mm, kept.working_mm, scale * STANDARD.farthest_mm),
    )


def length_between(
    stored_object: StoredObject, first: str, at_first_mm: Sequence[float], second: str, at_second_mm: Sequence[float]
) -> LengthSigma:
    """Return the distance between two points in the object's frame, one of scan ``first`` and one of ``second``, with
    its standard deviation.

    Raises ObjectError for scans that have no place, and for an object that is not solved.
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
    """Return an object's fused surface with sigma in the object's frame; as it is where its points name no scan."""
    if cloud.first_scan is None:
        return cloud
    return with_places(cloud, *errors.sigma_along(cloud.points_mm, cloud.normals, cloud.first_scan))


def with_sigma_after_registration(
    cloud: FusedCloud, errors: JointErrors | None, on_it: NDArray[np.bool_] | None = None
) -> FusedCloud:
    """Return the surface with the sigma that is left once it lies on something by its shape; ``on_it`` (n,): points
    that lie there, all by default."""
    if errors is None or cloud.first_scan is None:
        return cloud
    # What lies beside it has no say in how it is laid on.
    rows = np.arange(len(cloud.grey)) if on_it is None else np.flatnonzero(on_it)
    rows = rows[:: max(1, len(rows) // _MAX_POINTS)]
    return with_sigma_in_frame(
        cloud, errors.settled(cloud.points_mm[rows], cloud.normals[rows], cloud.first_scan[rows])
    )
