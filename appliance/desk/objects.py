"""Owns an object at the desk: its scans' clouds, made again from the frames; where they lie; and one surface of them."""

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
"""Variance factor from which on the pairs contradict each other by more than they state."""


@dataclass(frozen=True, slots=True, eq=False)
class MemberCloud:
    """A scan of an object with its cloud and what that was made with."""

    scan: MemberScan
    cloud: OrganisedCloud
    calibration: Calibration
    water_index: float
    verdicts: tuple[str, ...]
    """Faults that were held against the scan, in words."""
    recorded: str | None
    """Wall time of the recording."""


def member_of(root: Path, folder: Path) -> MemberScan:
    """Return a stored scan as a member of an object. Raises ScanError."""
    manifest = StoredScan.manifest_of(folder)
    sums = tuple(manifest.files[name].sha256 for name in FRAME_FILES if name in manifest.files)
    whole = folder.absolute()
    inside = whole.is_relative_to(root.absolute())
    return MemberScan(manifest.scan_id, str(whole.relative_to(root.absolute()) if inside else whole), sums)


def add_to_object(root: Path, name: str, named: Sequence[Path], taken: Sequence[Path]) -> StoredObject:
    """Add scans, by their folders, to an object, which is made where there is none: those ``named``, and of those
    ``taken`` the ones that it has not. Return it, durable.

    Raises ObjectError for a scan that it has already, ScanError for one whose frames are damaged, StorageError.
    """
    for folder in (*named, *taken):
        StoredScan.refuse_damage(folder)
    first, others = (tuple(member_of(root, one) for one in folders) for folders in (named, taken))

    def more(now: StoredObject | None) -> StoredObject:
        begun = StoredObject(name) if now is None else now
        have = {one.frames_sha256 for one in (*begun.scans, *first)}
        return objects.with_scans(begun, (*first, *(one for one in others if one.frames_sha256 not in have)))

    more(
        objects.read_object(root, name) if objects.object_exists(root, name) else None
    )  # a refused scan leaves no folder behind
    return objects.update_object(root, name, more)


def clouds_of(root: Path, stored_object: StoredObject, wish: ScanOptions, progress: Progress) -> Iterator[MemberCloud]:
    """Yield every scan's cloud, from the object's folder or made again from the frames and kept there; one is held at a
    time.

    Raises ScanError for a scan that is gone, has become another one, or has no points; CalibrationError.
    """
    count = len(stored_object.scans)
    for number, member in enumerate(stored_object.scans):
        progress(f"points of scan {member.name}, {number + 1} of {count}", number / max(count, 1))
        yield _cloud_of(root, stored_object.name, member, wish)


def _cloud_of(root: Path, name: str, member: MemberScan, wish: ScanOptions) -> MemberCloud:
    folder = root / member.folder
    now = member_of(root, folder)
    if now.frames_sha256 != member.frames_sha256:
        raise ScanError(
            f"{folder}: holds other frames than when it was added to object '{name}'; make the object again"
        )
    source = SourceScan.open(folder, wish)
    chosen = source.calibration_for(wish)
    calibration = chosen.calibration
    index = source.scan.water(calibration).index
    key = hashlib.sha256(repr((member.frames_sha256, calibration.hash, index, __version__)).encode()).hexdigest()
    kept = objects.load_cloud(root, name, member.name, key)
    if kept is None:
        kept = _make_arrays(source, chosen)
        objects.save_cloud(root, name, member.name, key, kept)
    cloud = OrganisedCloud(kept["points_mm"], kept["sigma_mm"], kept["modulation_dn"], kept["ray_gap_mm"], kept["grey"])
    verdicts = tuple(str(one) for one in kept["verdicts"].tolist())
    return MemberCloud(member, cloud, calibration, index, verdicts, source.scan.manifest.record.wall_time)


def _make_arrays(source: SourceScan, chosen: ChosenCalibration) -> dict[str, NDArray[Any]]:
    made = organised_scan(source, chosen, silent)
    verdicts = np.array([f"{fault.code.value}: {fault.detail}" for fault in made.faults], dtype=np.str_)
    cloud = made.cloud
    return {
        "points_mm": cloud.points_mm,
        "sigma_mm": cloud.sigma_mm,
        "modulation_dn": cloud.modulation_dn,
        "ray_gap_mm": cloud.ray_gap_mm,
        "grey": cloud.grey,
        "verdicts": verdicts,
    }


def ready_scan(made: OrganisedScan, calibration: Calibration) -> ReadyScan:
    """Prepare a scan's points for ``register`` and ``solve``; ``calibration``: the one that they were made with."""
    return ready(made.cloud, calibration.rig.left, made.water.index, light_of(calibration), calibration.rig.volume)


def light_of(calibration: Calibration) -> NDArray[np.float64]:
    """Return where the projector's light comes from, (3,) mm in the left camera's frame: from between the two cameras."""
    return 0.5 * np.asarray(calibration.rig.right.translation_mm)


def solve_object(
    root: Path, stored_object: StoredObject, wish: ScanOptions, progress: Progress, *, with_shared_error: bool = False
) -> StoredObject:
    """Find where every scan of an object lies, write it down, and return the object as it is stored then; what was added
    meanwhile stays, without a place.

    ``with_shared_error``: the depth error that all scans share is estimated from their overlaps, and taken out. Raises
    ObjectError for fewer than two scans, and where the object was made again meanwhile, or solved with more scans;
    ScanError, CalibrationError, StorageError.
    """
    if len(stored_object.scans) < 2:
        raise ObjectError(
            f"object '{stored_object.name}' has {len(stored_object.scans)} scans; at least 2 are needed: kingfisher "
            "object add"
        )
    scans: list[ReadyScan] = []
    clouds: list[tuple[str, str, float, tuple[str, ...]]] = []
    used: list[Calibration] = []
    facts: dict[str, CloudFacts] = {}
    for member in clouds_of(root, stored_object, wish, part_of(progress, 0.0, 0.5)):
        scans.append(
            ready(
                member.cloud,
                member.calibration.rig.left,
                member.water_index,
                light_of(member.calibration),
                member.calibration.rig.volume,
            )
        )
        used.append(member.calibration)
        facts[member.scan.name] = _facts(member)
        clouds.append((member.scan.name, member.calibration.hash, member.water_index, member.verdicts))
    # Scans of several calibrations share no error that one of them states.
    calibrations = {one.hash: one.depth_error_mm2 for one in used}
    known = next(iter(calibrations.values())) if len(calibrations) == 1 else None
    stated = None if known is None else np.array(known)
    solved = solve(scans, part_of(progress, 0.5, 1.0), with_shared_error, stated)
    # Of several calibrations the first's volume: what they differ by is in no budget, and said.
    joint = joint_errors(solved.placed, used[0].rig.volume)
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
    named = [one[0] for one in clouds]
    aided = solved.aided
    calibrations = tuple(dict.fromkeys(one[1] for one in clouds))
    places = {named[k]: _place(placed, aided, k, middle_of(scans[k])) for k in sorted(placed.poses)}
    return Places(
        calibrations=calibrations,
        water_index=tuple(one[2] for one in clouds),
        places=places,
        pairs=tuple(_pair(one, placed, named) for one in solved.compared),
        left_out={
            named[k]: one.why if one.beside is None else f"with scan {named[one.beside]}: {one.why}"
            for k, one in solved.left_out.items()
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
        # A pair that only one of both graphs finds wrong may leave a scan in one and out of the other.
        bending_aided_mm=aided.bending_mm.get(k, placed.bending_unaided_mm[k]),
    )


def _pair(one: ComparedPair, placed: ScanPoses, named: Sequence[str]) -> ComparedScans:
    def among(edges: Sequence[Edge]) -> bool:
        return any((edge.first, edge.second) == (one.first, one.second) for edge in edges)

    wrong = among(placed.wrong)
    # Of a pose that nothing holds, or that is wrong, neither the overlap is known nor how certain it is.
    fit = one.pair.fit if one.pair.accepted and not wrong else None
    return ComparedScans(
        first=named[one.first],
        second=named[one.second],
        accepted=one.pair.accepted,
        used=among(placed.used),
        text="contradicts the loops it is in: taken out" if wrong else one.pair.text,
        overlap_percent=None if fit is None else 100.0 * fit.overlap,
        sigma_mm=None if fit is None else fit.sigma_mm,
        # The places follow a pair that nothing else ties: that they agree with it is no news.
        discrepancy_mm=None if among(placed.unchecked) else placed.discrepancy_mm.get((one.first, one.second)),
        sigma_deg=None if fit is None else fit.sigma_deg,
        matches=None if fit is None else one.matches,
    )


def _warnings(
    solved: Solved, clouds: Sequence[tuple[str, str, float, tuple[str, ...]]], calibrations: Sequence[str]
) -> tuple[str, ...]:
    found = []
    if len(calibrations) > 1:
        found.append(
            f"{len(calibrations)} calibrations: what they differ by is in no budget; choose one for all with "
            "--calibration FILE"
        )
    if solved.placed.unchecked:
        pairs = ", ".join(f"{clouds[edge.first][0]}-{clouds[edge.second][0]}" for edge in solved.placed.unchecked)
        found.append(f"in no loop, so that nothing checks them: {pairs}; a scan across them would")
    if solved.placed.variance_factor > CLEAR_FACTOR:
        found.append(
            f"the pairs contradict each other by {np.sqrt(solved.placed.variance_factor):.1f} times what they state: "
            "check the calibration"
        )
    found += [f"scan {name}: {verdict}" for name, _, _, verdicts in clouds for verdict in verdicts]
    return tuple(found)


def placed_scans(
    root: Path, stored_object: StoredObject, wish: ScanOptions, progress: Progress
) -> Iterator[PlacedScan]:
    """Yield the scans that have a place, each with how certain it is beside its neighbours; the shared depth error is
    taken out of their points where the places say so.

    Raises ObjectError for an object that is not solved; ScanError, CalibrationError.
    """
    places = stored_object.places
    if places is None:
        raise ObjectError(
            f"object '{stored_object.name}' is not solved: kingfisher object solve '{stored_object.name}'"
        )
    kept = replace(stored_object, scans=tuple(one for one in stored_object.scans if one.name in places.places))
    shared = np.array(places.shared_error_mm)
    for member in clouds_of(root, kept, wish, progress):
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
    """Return the standard deviation of a scan's place relative to those it overlaps, mm: what decides where two skins
    are one."""
    mine = [pair.sigma_mm for pair in places.pairs if pair.used and scan in (pair.first, pair.second) and pair.sigma_mm]
    return max(POSE_SIGMA_MM, float(np.median(mine))) if mine else POSE_SIGMA_MM


def surface_of(
    root: Path, stored_object: StoredObject, wish: ScanOptions, progress: Progress, spacing_mm: float
) -> FusedCloud:
    """Return one surface of all scans that have a place, a point about every ``spacing_mm``, with sigma in the object's
    frame.

    Raises ObjectError for an object that is not solved; ScanError, CalibrationError.
    """
    errors = errors_of(stored_object)
    return with_sigma_in_frame(fuse(placed_scans(root, stored_object, wish, progress), spacing_mm), errors)


def tell_health(root: Path, solved: StoredObject) -> None:
    """Write what an object's overlaps tell of its calibration beside what its scans told; the instrument reads it at its
    next start. Raises StorageError, also where a service holds ``root``."""
    told = _overlap_news(solved)
    if told is None:
        return
    calibration_hash, news = told
    # The running service keeps the trend in memory and would write it over this.
    with hold_lock(root):
        file = HealthFile(root, calibration_hash)
        file.write(add_overlap_news(file.read(), news))


def _overlap_news(stored_object: StoredObject) -> tuple[str, OverlapNews] | None:
    """Return the hash of the calibration that an object's scans share and what their overlaps tell of it; ``None``:
    nothing."""
    places = stored_object.places
    if places is None or places.shared_error_score is None or len(places.calibrations) != 1:
        return None
    found = np.array(places.shared_error_mm)
    return places.calibrations[0], OverlapNews(
        object=stored_object.name,
        scans=len(places.places),
        bend_um=1000.0 * spread_mm(np.outer(found, found)),
        sigma_um=1000.0 * places.shared_error_aided_mm,
        score=places.shared_error_score,
    )


def metadata_of_object(stored_object: StoredObject) -> Metadata:
    """Return what a file of the object says of it."""
    places = stored_object.places
    if places is None:
        return Metadata(stored_object.name, OBJECT_FRAME)
    widest = max(places.places.values(), key=lambda one: one.sigma_mm, default=None)
    notes = [
        f"{len(places.places)} scans in the frame of {next(iter(places.places), '-')}",
        f"calibration {', '.join(one[:12] for one in places.calibrations)}; water index {places.water_index[0]:.5f}",
    ]
    if widest is not None:
        notes.append(
            f"farthest scan placed within {widest.sigma_mm:.3f} mm (one standard deviation), {widest.bending_mm:.3f} "
            "mm of that by bending"
        )
    notes += [f"without {name}: {why}" for name, why in places.left_out.items()]
    return Metadata(stored_object.name, OBJECT_FRAME, (*notes, *places.warnings))
