"""Objects at the desk: clouds of their scans, scan poses, and one surface of them."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from appliance import __version__
from appliance.base import Progress, part_of, silent
from appliance.calibrate import HealthFile, OverlapNews, add_overlap_news
from appliance.desk import object_store as objects
from appliance.desk.export.content import OBJECT_FRAME, Metadata
from appliance.desk.object_errors import errors_of, pack, with_sigma_in_frame
from appliance.desk.object_store import (
    CloudFacts,
    ComparedScans,
    MemberScan,
    ObjectError,
    Places,
    ScanPlace,
    StoredObject,
)
from appliance.desk.organised import OrganisedScan, organised_scan
from appliance.desk.registration.bow import bow_score, prior_covariance, remove_depth_error, spread_mm
from appliance.desk.registration.graph import Edge, ScanPoses
from appliance.desk.registration.joint import JointErrors, joint_errors
from appliance.desk.registration.solve import ComparedPair, Solved, middle_of, solve
from appliance.desk.surface.fusion import POSE_SIGMA_MM, FusedCloud, PlacedScan, fuse
from appliance.measure import Calibration, OrganisedCloud, ReadyScan, matrix3, ready
from appliance.store import FRAME_FILES, ChosenCalibration, ScanError, ScanOptions, SourceScan, StoredScan, hold_lock

CLEAR_FACTOR = 4.0
"""Variance factor above which the pairs contradict each other by more than their sigmas."""


@dataclass(frozen=True, slots=True, eq=False)
class MemberCloud:
    """A scan of an object with its cloud, calibration and verdicts."""

    scan: MemberScan
    cloud: OrganisedCloud
    calibration: Calibration
    water_index: float
    verdicts: tuple[str, ...]
    """Faults of the scan, in words."""
    recorded: str | None
    """Wall time of the capture."""


def member_of(root: Path, folder: Path) -> MemberScan:
    """Return a stored scan as a member of an object. Raises ScanError."""
    manifest = StoredScan.manifest_of(folder)
    sums = tuple(manifest.files[name].sha256 for name in FRAME_FILES if name in manifest.files)
    absolute = folder.absolute()
    inside = absolute.is_relative_to(root.absolute())
    return MemberScan(manifest.scan_id, str(absolute.relative_to(root.absolute()) if inside else absolute), sums)


def add_to_object(root: Path, name: str, named: Sequence[Path], new_only: Sequence[Path]) -> StoredObject:
    """Add scans, by their folders, to an object, which is created if needed. Return it, durable.

    All ``named`` scans are added, and of ``new_only`` those that it has not. Raises ObjectError for a named scan that it has
    already, ScanError for damaged frames, StorageError.
    """
    for folder in (*named, *new_only):
        StoredScan.refuse_damage(folder)
    first, further = (tuple(member_of(root, path) for path in folders) for folders in (named, new_only))

    def more(now: StoredObject | None) -> StoredObject:
        stored = StoredObject(name) if now is None else now
        frames_of_object = {scan.frames_sha256 for scan in (*stored.scans, *first)}
        return objects.with_scans(
            stored, (*first, *(scan for scan in further if scan.frames_sha256 not in frames_of_object))
        )

    more(
        objects.read_object(root, name) if objects.object_exists(root, name) else None
    )  # a refused scan leaves no folder behind
    return objects.update_object(root, name, more)


def clouds_of(
    root: Path, stored_object: StoredObject, options: ScanOptions, progress: Progress
) -> Iterator[MemberCloud]:
    """Yield every scan's cloud, from the object's folder or made again from the frames and kept there.

    One cloud is held at a time. Raises ScanError for a scan that is gone, was replaced, or has no points; CalibrationError.
    """
    count = len(stored_object.scans)
    for number, member in enumerate(stored_object.scans):
        progress(f"points of scan {member.name}, {number + 1} of {count}", number / max(count, 1))
        yield _cloud_of(root, stored_object.name, member, options)


def _cloud_of(root: Path, name: str, member: MemberScan, options: ScanOptions) -> MemberCloud:
    folder = root / member.folder
    now = member_of(root, folder)
    if now.frames_sha256 != member.frames_sha256:
        raise ScanError(f"{folder}: has other frames than when it was added to object '{name}'; make the object again")
    source = SourceScan.open(folder, options)
    chosen = source.calibration_for(options)
    calibration = chosen.calibration
    index = source.scan.water(calibration).index
    key = hashlib.sha256(repr((member.frames_sha256, calibration.hash, index, __version__)).encode()).hexdigest()
    arrays = objects.load_cloud(root, name, member.name, key)
    if arrays is None:
        arrays = _make_arrays(source, chosen)
        objects.save_cloud(root, name, member.name, key, arrays)
    cloud = OrganisedCloud(
        arrays["points_mm"], arrays["sigma_mm"], arrays["modulation_dn"], arrays["ray_gap_mm"], arrays["grey"]
    )
    verdicts = tuple(str(verdict) for verdict in arrays["verdicts"].tolist())
    return MemberCloud(member, cloud, calibration, index, verdicts, source.scan.manifest.record.wall_time)


def _make_arrays(source: SourceScan, chosen: ChosenCalibration) -> dict[str, NDArray[Any]]:
    points = organised_scan(source, chosen, silent)
    verdicts = np.array([f"{fault.code.value}: {fault.detail}" for fault in points.faults], dtype=np.str_)
    cloud = points.cloud
    return {
        "points_mm": cloud.points_mm,
        "sigma_mm": cloud.sigma_mm,
        "modulation_dn": cloud.modulation_dn,
        "ray_gap_mm": cloud.ray_gap_mm,
        "grey": cloud.grey,
        "verdicts": verdicts,
    }


def ready_scan(made: OrganisedScan, calibration: Calibration) -> ReadyScan:
    """Prepare a scan's points for ``register`` and ``solve``; ``calibration`` is that of the points."""
    return ready(made.cloud, calibration.rig.left, made.water.index, light_of(calibration), calibration.rig.volume)


def light_of(calibration: Calibration) -> NDArray[np.float64]:
    """Return the place of the projector, (3,) mm in the left camera frame: between the two cameras."""
    return 0.5 * np.asarray(calibration.rig.right.translation_mm)


def solve_object(
    root: Path,
    stored_object: StoredObject,
    options: ScanOptions,
    progress: Progress,
    *,
    with_shared_error: bool = False,
) -> StoredObject:
    """Find the pose of every scan of an object, store them, and return the object as it is stored then.

    Scans that were added meanwhile stay, without a pose. ``with_shared_error``: the depth error that all scans share is
    estimated from their overlaps, and removed. Raises ObjectError for fewer than two scans, and if the object was made again
    meanwhile, or solved with more scans; ScanError, CalibrationError, StorageError.
    """
    if len(stored_object.scans) < 2:
        raise ObjectError(
            f"object '{stored_object.name}' has {len(stored_object.scans)} scans; at least 2 are needed: kingfisher "
            "object add"
        )
    scans: list[ReadyScan] = []
    clouds: list[tuple[str, str, float, tuple[str, ...]]] = []
    calibrations_used: list[Calibration] = []
    facts: dict[str, CloudFacts] = {}
    for member in clouds_of(root, stored_object, options, part_of(progress, 0.0, 0.5)):
        scans.append(
            ready(
                member.cloud,
                member.calibration.rig.left,
                member.water_index,
                light_of(member.calibration),
                member.calibration.rig.volume,
            )
        )
        calibrations_used.append(member.calibration)
        facts[member.scan.name] = _facts(member)
        clouds.append((member.scan.name, member.calibration.hash, member.water_index, member.verdicts))
    # Scans of several calibrations share no error that one of them states.
    calibrations = {calibration.hash: calibration.depth_error_mm2 for calibration in calibrations_used}
    depth_error_mm2 = next(iter(calibrations.values())) if len(calibrations) == 1 else None
    stated = None if depth_error_mm2 is None else np.array(depth_error_mm2)
    solved = solve(scans, part_of(progress, 0.5, 1.0), with_shared_error, stated)
    # Use the first calibration's volume: the difference between several is in no budget, and a warning says so.
    joint = joint_errors(solved.placed, calibrations_used[0].rig.volume)
    places = _places(solved, scans, clouds, with_shared_error, prior_covariance(stated), joint, facts)
    answer = replace(stored_object, places=places)
    return objects.update_object(root, answer.name, lambda now: objects.merge_places(now, answer))


def _facts(member: MemberCloud) -> CloudFacts:
    cloud = member.cloud
    gap = np.abs(cloud.ray_gap_mm[np.isfinite(cloud.ray_gap_mm)])
    return CloudFacts(
        points=int(cloud.mask.sum()),
        distance_mm=float(np.median(cloud.points_mm[..., 2][cloud.mask])),
        sigma_mm=float(np.median(cloud.sigma_mm[cloud.mask])),
        ray_gap_mm=float(np.median(gap)) if len(gap) else None,
        recorded=member.recorded,
    )


def _places(
    solved: Solved,
    scans: Sequence[ReadyScan],
    clouds: Sequence[tuple[str, str, float, tuple[str, ...]]],
    with_shared_error: bool,
    known_mm2: NDArray[np.float64],
    joint: JointErrors,
    facts: Mapping[str, CloudFacts],
) -> Places:
    placed = solved.placed
    names = [entry[0] for entry in clouds]
    aided = solved.aided
    calibrations = tuple(dict.fromkeys(entry[1] for entry in clouds))
    places = {names[k]: _place(placed, aided, k, middle_of(scans[k])) for k in sorted(placed.poses)}
    return Places(
        calibrations=calibrations,
        water_index=tuple(entry[2] for entry in clouds),
        places=places,
        pairs=tuple(_pair(pair, placed, names) for pair in solved.compared),
        left_out={
            names[k]: omission.why if omission.beside is None else f"with scan {names[omission.beside]}: {omission.why}"
            for k, omission in solved.left_out.items()
        },
        warnings=_warnings(solved, clouds, calibrations),
        shared_error_mm=tuple(aided.bow_mm.tolist()),
        shared_error_spread_mm=spread_mm(placed.bow_covariance),
        shared_error_aided_mm=spread_mm(aided.bow_covariance),
        shared_error_removed=with_shared_error,
        variance_factor=placed.variance_factor,
        shared_error_score=bow_score(aided.bow_mm, known_mm2, aided.bow_covariance),
        joint=pack(joint, list(places)),
        clouds=facts,
    )


def _place(placed: ScanPoses, aided: ScanPoses, k: int, middle_mm: NDArray[np.float64]) -> ScanPlace:
    pose, covariance = placed.poses[k], placed.covariance[k]
    x, y, z = pose.translation_mm.tolist()
    across, down, away = pose.of(middle_mm).tolist()
    return ScanPlace(
        rotation=matrix3(pose.rotation),
        translation_mm=(x, y, z),
        middle_mm=(across, down, away),
        sigma_mm=float(np.sqrt(np.trace(covariance[3:, 3:]))),
        covariance=tuple(tuple(row) for row in covariance.tolist()),
        bending_mm=placed.bending_mm[k],
        bending_unaided_mm=placed.bending_unaided_mm[k],
        # A pair that is wrong in only one of both graphs may leave out a scan in that graph alone.
        bending_aided_mm=aided.bending_mm.get(k, placed.bending_unaided_mm[k]),
    )


def _pair(result: ComparedPair, placed: ScanPoses, names: Sequence[str]) -> ComparedScans:
    def among(edges: Sequence[Edge]) -> bool:
        return any((edge.first, edge.second) == (result.first, result.second) for edge in edges)

    wrong = among(placed.wrong)
    # An undetermined or wrong pose gives neither overlap nor sigma.
    fit = result.pair.fit if result.pair.accepted and not wrong else None
    return ComparedScans(
        first=names[result.first],
        second=names[result.second],
        accepted=result.pair.accepted,
        used=among(placed.used),
        text="contradicts its loops; excluded" if wrong else result.pair.text,
        overlap_percent=None if fit is None else 100.0 * fit.overlap,
        sigma_mm=None if fit is None else fit.sigma_mm,
        # The poses follow a pair that is in no loop: agreement with it is no check.
        discrepancy_mm=None if among(placed.unchecked) else placed.discrepancy_mm.get((result.first, result.second)),
        sigma_deg=None if fit is None else fit.sigma_deg,
        matches=None if fit is None else result.matches,
    )


def _warnings(
    solved: Solved, clouds: Sequence[tuple[str, str, float, tuple[str, ...]]], calibrations: Sequence[str]
) -> tuple[str, ...]:
    warnings = []
    if len(calibrations) > 1:
        warnings.append(
            f"{len(calibrations)} calibrations: their differences are in no uncertainty; choose one for all scans "
            "with --calibration FILE"
        )
    if solved.placed.unchecked:
        pairs = ", ".join(f"{clouds[edge.first][0]}-{clouds[edge.second][0]}" for edge in solved.placed.unchecked)
        warnings.append(f"scan pairs in no loop, and so not checked: {pairs}; add a scan that overlaps both")
    if solved.placed.variance_factor > CLEAR_FACTOR:
        warnings.append(
            f"the scan pairs contradict each other by {np.sqrt(solved.placed.variance_factor):.1f} times their "
            "stated uncertainties: check the calibration"
        )
    warnings += [f"scan {name}: {verdict}" for name, _, _, verdicts in clouds for verdict in verdicts]
    return tuple(warnings)


def placed_scans(
    root: Path, stored_object: StoredObject, options: ScanOptions, progress: Progress
) -> Iterator[PlacedScan]:
    """Yield the scans that have a pose, each with its standard deviation beside its neighbours.

    The shared depth error is removed from their points if the stored poses say so. Raises ObjectError for an object that is
    not solved; ScanError, CalibrationError.
    """
    places = stored_object.places
    if places is None:
        raise ObjectError(
            f"object '{stored_object.name}' is not solved: kingfisher object solve '{stored_object.name}'"
        )
    with_place = replace(stored_object, scans=tuple(scan for scan in stored_object.scans if scan.name in places.places))
    shared = np.array(places.shared_error_mm)
    for member in clouds_of(root, with_place, options, progress):
        place, cloud = places.places[member.scan.name], member.cloud
        if places.shared_error_removed:
            points = remove_depth_error(
                cloud.points_mm.astype(np.float64), shared, member.calibration.rig.volume
            ).astype(np.float32)
            cloud = replace(cloud, points_mm=points)
        yield PlacedScan(
            cloud,
            np.array(place.rotation),
            np.array(place.translation_mm),
            _beside_others(places, member.scan.name),
            member.scan.name,
            np.array(place.covariance),
            np.array(place.middle_mm),
        )


def _beside_others(places: Places, scan: str) -> float:
    """Return the standard deviation of a scan's pose relative to overlapping scans, mm, for the fusion."""
    sigmas_mm = [
        pair.sigma_mm for pair in places.pairs if pair.used and scan in (pair.first, pair.second) and pair.sigma_mm
    ]
    return max(POSE_SIGMA_MM, float(np.median(sigmas_mm))) if sigmas_mm else POSE_SIGMA_MM


def surface_of(
    root: Path, stored_object: StoredObject, options: ScanOptions, progress: Progress, spacing_mm: float
) -> FusedCloud:
    """Return one surface of all placed scans, with sigma in the object's frame.

    It has a point about every ``spacing_mm``. Raises ObjectError for an object that is not solved; ScanError,
    CalibrationError.
    """
    errors = errors_of(stored_object)
    return with_sigma_in_frame(fuse(placed_scans(root, stored_object, options, progress), spacing_mm), errors)


def tell_health(root: Path, solved: StoredObject) -> None:
    """Store the shared error that an object's overlaps show with the health of its calibration.

    The instrument reads it at its next start. Raises StorageError, also where a service holds ``root``.
    """
    calibration_news = _overlap_news(solved)
    if calibration_news is None:
        return
    calibration_hash, news = calibration_news
    # A running service keeps the trend in memory and would overwrite this.
    with hold_lock(root):
        file = HealthFile(root, calibration_hash)
        file.write(add_overlap_news(file.read(), news))


def _overlap_news(stored_object: StoredObject) -> tuple[str, OverlapNews] | None:
    """Return the hash of the calibration of an object's scans, and the shared error by their overlaps.

    ``None`` if they show none.
    """
    places = stored_object.places
    if places is None or places.shared_error_score is None or len(places.calibrations) != 1:
        return None
    shared_mm = np.array(places.shared_error_mm)
    return places.calibrations[0], OverlapNews(
        object=stored_object.name,
        scans=len(places.places),
        bend_um=1000.0 * spread_mm(np.outer(shared_mm, shared_mm)),
        sigma_um=1000.0 * places.shared_error_aided_mm,
        score=places.shared_error_score,
    )


def metadata_of_object(stored_object: StoredObject) -> Metadata:
    """Return the metadata of an object for a file."""
    places = stored_object.places
    if places is None:
        return Metadata(stored_object.name, OBJECT_FRAME)
    widest = max(places.places.values(), key=lambda place: place.sigma_mm, default=None)
    notes = [
        f"{len(places.places)} scans in the frame of {next(iter(places.places), '-')}",
        f"calibration {', '.join(calibration[:12] for calibration in places.calibrations)}; water index {places.water_index[0]:.5f}",
    ]
    if widest is not None:
        notes.append(
            f"farthest scan placed within {widest.sigma_mm:.3f} mm (one standard deviation), {widest.bending_mm:.3f} "
            "mm of that from the shared depth error"
        )
    notes += [f"without {name}: {reason}" for name, reason in places.left_out.items()]
    return Metadata(stored_object.name, OBJECT_FRAME, (*notes, *places.warnings))
