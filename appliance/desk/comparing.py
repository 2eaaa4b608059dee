"""Comparison of measured points with a nominal surface: registration by shape, then deviations."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from appliance.base import Progress, one_line, refuse_wrong_fields
from appliance.desk.export.content import CAMERA_FRAME, Metadata
from appliance.desk.export.files import write_surface
from appliance.desk.object_errors import errors_of, with_sigma_after_registration
from appliance.desk.object_report import report_of
from appliance.desk.object_store import StoredObject
from appliance.desk.objects import metadata_of_object, surface_of
from appliance.desk.organised import organised_scan
from appliance.desk.registration.joint import JointErrors
from appliance.desk.registration.reference import (
    FITS_MM,
    FreeDirection,
    OrientedPoints,
    ReferencePlaces,
    SurfaceRegistration,
    register_to_reference,
)
from appliance.desk.report.content import Report, ReportNominal
from appliance.desk.report.page import write_report
from appliance.desk.surface.deviation import LIMIT_MM, Deviation, NominalTree, deviations, spread_over
from appliance.desk.surface.fusion import FusedCloud, PlacedScan, fuse
from appliance.desk.surface.nominal import Nominal, nominal_of_mesh, read_nominal
from appliance.desk.surface.object_mesh import VOXEL_MM, mesh_of_surface
from appliance.measure import Rigid, rotation_matrix, rotation_vector
from appliance.store import ScanOptions, SourceScan

PAGE = ".html"
SURE = 2.0
"""Number of standard deviations above which a deviation is significant."""
DOUBTFUL_PERCENT = 10.0
"""Share of points whose deviation may be bending of the object above which a warning says so: by chance some 5 % are
beyond two standard deviations."""
_MOST_SHOWN = 3


@refuse_wrong_fields
@dataclass(frozen=True, slots=True, eq=False)
class NominalSurface:
    """A surface with which others are compared."""

    name: str
    triangles: Nominal
    sigma_mm: NDArray[np.float32] | None = None
    """(v,) of its vertices, if it was measured itself; ``None``: it is exact."""

    __repr__ = one_line


@dataclass(frozen=True, slots=True, eq=False)
class Comparison:
    """Points that were registered to a nominal surface, with their deviations from it."""

    surface: FusedCloud
    """Points in their own frame; sigma and its shares are those after the registration."""
    laid: SurfaceRegistration
    nominal: str
    origin_mm: NDArray[np.float64]
    """(3,): origin of ``in_nominal_frame`` in the nominal surface's frame; (0, 0, 0) unless the surface lies far from its
    frame's origin."""
    deviation: Deviation
    """Deviation of each point, positive outside; its sigma includes that of the point, of its scan's pose, of the
    object's bending, of the registration, and of a measured nominal surface."""
    warnings: tuple[str, ...]

    __repr__ = one_line

    @property
    def in_nominal_frame(self) -> FusedCloud:
        """The points in the nominal surface's frame, less ``origin_mm``, with the sigma of their deviations."""
        pose = _translate(self.laid.pose, -self.origin_mm)
        return replace(
            self.surface,
            points_mm=pose.of(self.surface.points_mm.astype(np.float64)).astype(np.float32),
            normals=(self.surface.normals @ pose.rotation.T).astype(np.float32),
            sigma_mm=self.deviation.sigma_mm,
        )


def compare(
    surface: FusedCloud,
    nominal: NominalSurface,
    limit_mm: float = LIMIT_MM,
    start: Rigid | None = None,
    errors: JointErrors | None = None,
) -> Comparison:
    """Register ``surface`` to ``nominal`` by shape alone and return the deviation of each point.

    ``limit_mm``: points farther off are counted and have no deviation. ``start``: its pose within some millimetres;
    ``None``: it is searched. ``errors``: those of the object of which it is the surface (``errors_of``): each point's sigma
    then includes its scan's pose and the object's bending, as far as the registration does not remove them. Raises
    SurfaceMatchError if most of it fits no place.
    """
    tree = NominalTree.of(nominal.triangles)
    laid = register_to_reference(
        OrientedPoints(
            surface.points_mm.astype(np.float64),
            surface.normals.astype(np.float64),
            surface.beside_mm.astype(np.float64),
        ),
        NominalReference(tree, nominal.sigma_mm),
        None if start is None else _translate(start, -nominal.triangles.origin_mm),
    )
    points = laid.pose.of(surface.points_mm.astype(np.float64))
    normals = surface.normals.astype(np.float64) @ laid.pose.rotation.T
    deviation = deviations(points, surface.sigma_mm, tree, normals, limit_mm)
    surface = with_sigma_after_registration(surface, errors, np.isfinite(deviation.deviation_mm))
    variance = surface.sigma_mm.astype(np.float64) ** 2 + laid.sigma_at(points, normals) ** 2
    if nominal.sigma_mm is not None:
        variance += _sigma_on(nominal.sigma_mm, nominal.triangles, deviation.face) ** 2
    deviation = deviation.with_sigma(np.sqrt(variance).astype(np.float32))
    pose, *elsewhere = (
        _translate(other_pose, nominal.triangles.origin_mm) for other_pose in (laid.pose, *laid.elsewhere)
    )
    laid = replace(laid, pose=pose, elsewhere=tuple(elsewhere))
    warnings = (*_warnings(laid), *_beside(deviation), *_bent(surface, deviation))
    return Comparison(surface, laid, nominal.name, nominal.triangles.origin_mm, deviation, warnings)


@dataclass(frozen=True, slots=True, eq=False)
class StoredComparison:
    """A comparison of stored points, with their metadata and their object."""

    comparison: Comparison
    metadata: Metadata
    stored: StoredObject | None
    """The object of the points; ``None``: they are of one scan."""

    def write(self, out: Path, tolerance_mm: float | None) -> None:
        """Write points or a page, by the suffix. Raises ExportError, StorageError, MissingLibraryError."""
        _write(out, self.comparison, self.metadata, tolerance_mm, self.stored)

    def figures(self, tolerance_mm: float | None) -> Mapping[str, Any]:
        """Return the comparison in numbers, JSON-ready; lengths in mm."""
        return _figures(self.comparison, tolerance_mm)


def compare_stored(
    root: Path,
    subject: Path | StoredObject,
    nominal: Path | StoredObject,
    options: ScanOptions,
    progress: Progress,
    *,
    spacing_mm: float,
    limit_mm: float,
    start: Sequence[float] | None,
) -> StoredComparison:
    """Compare a scan, or the surface of a solved object, with a CAD model or another object.

    ``subject`` is the folder of a scan or an object, ``nominal`` the file of a model or an object. ``start``: pose of
    ``subject``, x, y, z in mm and the rotation as axis times angle in degrees. Raises ScanError, CalibrationError,
    NominalError, ObjectError, SurfaceMatchError, MissingLibraryError.
    """
    reference, errors, stored = _nominal_surface(root, nominal, options, progress, spacing_mm), None, None
    if isinstance(subject, StoredObject):
        surface, metadata = surface_of(root, subject, options, progress, spacing_mm), metadata_of_object(subject)
        errors, stored = errors_of(subject), subject
    else:
        surface, metadata = _surface_of_scan(subject, options, progress, spacing_mm)
    progress(f"registering with {reference.name}")
    begin = None if start is None else Rigid(rotation_matrix(np.radians(start[3:])), np.array(start[:3]))
    return StoredComparison(compare(surface, reference, limit_mm, begin, errors), metadata, stored)


def _surface_of_scan(
    folder: Path, options: ScanOptions, progress: Progress, spacing_mm: float
) -> tuple[FusedCloud, Metadata]:
    progress(f"comparing checksums of {folder.name}")
    source = SourceScan.open(folder, options, whole=True)
    points = organised_scan(source, source.calibration_for(options), progress)
    # A single scan has no pose relative to others.
    placed = PlacedScan(points.cloud, np.eye(3), np.zeros(3), pose_sigma_mm=0.0)
    return fuse([placed], spacing_mm), Metadata(f"scan {source.scan.manifest.scan_id}", CAMERA_FRAME)


def _nominal_surface(
    root: Path, nominal: Path | StoredObject, options: ScanOptions, progress: Progress, spacing_mm: float
) -> NominalSurface:
    if isinstance(nominal, Path):
        return NominalSurface(nominal.name, read_nominal(nominal))
    # The registration removes the common motion from the errors of the reference object.
    surface = with_sigma_after_registration(
        surface_of(root, nominal, options, progress, spacing_mm), errors_of(nominal)
    )
    mesh = mesh_of_surface(surface, max(VOXEL_MM, 2.0 * spacing_mm))
    return NominalSurface(f"object {nominal.name}", nominal_of_mesh(mesh), mesh.sigma_mm)


@dataclass(frozen=True, slots=True, eq=False)
class NominalReference:
    """A nominal surface as a reference for registration."""

    tree: NominalTree
    sigma_mm: NDArray[np.float32] | None = None

    def spread(self, count: int) -> OrientedPoints:
        """Return ``count`` places spread evenly over the surface."""
        places, face = spread_over(self.tree.nominal, count)
        return OrientedPoints(places, self.tree.nominal.face_normals[face], self._sigma(face))

    def nearest(self, points_mm: NDArray[np.float64], limit_mm: float) -> ReferencePlaces:
        """Return the nearest place to each of the points (n, 3), at any distance."""
        nearest_places = self.tree.nearest(points_mm)
        distance_mm = np.where(nearest_places.beside, np.inf, np.abs(nearest_places.signed_mm))
        return ReferencePlaces(
            distance_mm,
            nearest_places.place_mm,
            self.tree.nominal.face_normals[nearest_places.face],
            self._sigma(nearest_places.face),
        )

    def _sigma(self, face: NDArray[np.int64]) -> NDArray[np.float64]:
        if self.sigma_mm is None:
            return np.zeros(len(face))
        return _sigma_on(self.sigma_mm, self.tree.nominal, face)


def _sigma_on(sigma_mm: NDArray[np.float32], nominal: Nominal, face: NDArray[np.int64]) -> NDArray[np.float64]:
    """Return the sigma (n,) of the triangles ``face`` (n,).

    The triangle -1 takes that of the last one, since it has no deviation.
    """
    return np.asarray(sigma_mm[nominal.faces[face]].mean(axis=1), np.float64)


def _translate(pose: Rigid, by_mm: NDArray[np.float64]) -> Rigid:
    return Rigid(pose.rotation, pose.translation_mm + by_mm)


def _beside(deviation: Deviation) -> tuple[str, ...]:
    """Return a warning where points lie beside an open border."""
    if not deviation.summary.beside:
        return ()
    return (f"{deviation.summary.beside} points lie beside an open border of the CAD model: they are not compared",)


def _bent(surface: FusedCloud, deviation: Deviation) -> tuple[str, ...]:
    """Return a warning where deviations may be explained by the object's bending alone."""
    if surface.shares is None:
        return ()
    bending, size_mm = surface.shares.bending_mm.astype(np.float64), np.abs(deviation.deviation_mm.astype(np.float64))
    has_deviation = np.isfinite(size_mm)
    # Deviations that noise, pose and registration explain do not count.
    without = np.sqrt(np.maximum(deviation.sigma_mm.astype(np.float64) ** 2 - bending**2, 0.0))
    doubtful = has_deviation & (size_mm > SURE * without) & (size_mm <= SURE * deviation.sigma_mm)
    share = 100.0 * float(np.count_nonzero(doubtful)) / max(int(np.count_nonzero(has_deviation)), 1)
    if share < DOUBTFUL_PERCENT:
        return ()
    max_bend_mm = SURE * float(bending[has_deviation].max())
    warning = (
        f"{share:.0f} % of the deviations are within the object's depth error (± {max_bend_mm:.3f} mm at most, two "
        "standard deviations, "
        "after registration): they may be errors of the calibration"
    )
    return (warning,)


def _warnings(laid: SurfaceRegistration) -> tuple[str, ...]:
    warnings = [_free_words(laid, direction) for direction in laid.free]
    if laid.elsewhere:
        poses = "; ".join(_pose_words(pose, laid.pose) for pose in laid.elsewhere[:_MOST_SHOWN])
        warnings.append(
            f"it fits equally well in {len(laid.elsewhere)} or more other poses: object or parts of it are "
            f"symmetric. To choose a pose: {poses}"
        )
    return tuple(warnings)


def _free_words(laid: SurfaceRegistration, direction: FreeDirection) -> str:
    """Return a warning about a direction that the shape does not hold, in the nominal surface's frame."""
    motion = (
        f"can turn about {_vector(direction.direction[:3])}"
        if direction.is_rotation
        else f"can slide along {_vector(direction.direction[3:])}"
    )
    unit = "°" if direction.is_rotation else " mm"
    # Both ends are given along the direction as it is written.
    sense = 1 if _upright(direction.direction[:3] if direction.is_rotation else direction.direction[3:]) else -1
    ends = [sense * end + 0.0 for end in direction.ends][::sense]
    rms = [laid.rms_mm, *list(direction.rms_mm)[::sense]]
    beyond_percent = [100.0 * (1.0 - share) for share in [laid.fitting, *list(direction.fitting)[::sense]]]
    return (
        f"{motion}: its shape does not determine its pose between {ends[0]:+.3g} and {ends[1]:+.3g}{unit} from "
        "here. RMS there: "
        f"{rms[0]:.3f} mm here, {rms[1]:.3f} and {rms[2]:.3f} mm at the ends; {beyond_percent[0]:.1f} %, {beyond_percent[1]:.1f} % and {beyond_percent[2]:.1f} % of the points lie beyond "
        f"{FITS_MM:g} mm. Give its pose with --start; here is {_start_words(laid.pose)}"
    )


def _upright(direction: NDArray[np.float64]) -> bool:
    return bool(direction[np.abs(direction).argmax()] >= 0.0)


def _vector(direction: NDArray[np.float64]) -> str:
    unit = direction / max(float(np.linalg.norm(direction)), 1e-12)
    # A direction and its opposite are one.
    unit = unit if _upright(unit) else -unit
    return "(" + ", ".join(f"{component:z.2f}" for component in unit) + ")"


def _start_words(pose: Rigid) -> str:
    """Return the option that gives this pose."""
    turn_deg = np.degrees(rotation_vector(pose.rotation))
    return "--start " + ",".join(f"{number:z.3f}" for number in (*pose.translation_mm, *turn_deg))


def _pose_words(pose: Rigid, best: Rigid) -> str:
    rotation = rotation_vector(best.inverse.then(pose).rotation)
    angle = float(np.degrees(np.linalg.norm(rotation)))
    if angle < 1.0:
        difference = f"{np.linalg.norm(pose.translation_mm - best.translation_mm):.1f} mm beside"
    else:
        difference = f"turned by {angle:.0f}° about {_vector(rotation)}"
    return f"{_start_words(pose)} ({difference})"


def _write(
    path: Path, comparison: Comparison, metadata: Metadata, tolerance_mm: float | None, stored: StoredObject | None
) -> None:
    """Write a comparison: points with deviations (.ply .e57 .las), or a page (.html).

    Points are in the nominal surface's frame. ``stored``: the object of the points, for the page's scans. Raises
    ExportError, StorageError, MissingLibraryError.
    """
    if path.suffix.lower() == PAGE:
        write_report(path, _report(comparison, metadata, tolerance_mm, stored))
        return
    in_frame = replace(metadata, frame=f"frame of {comparison.nominal}", notes=(*metadata.notes, *comparison.warnings))
    write_surface(path, comparison.in_nominal_frame, in_frame, comparison.deviation.deviation_mm, comparison.origin_mm)


def _report(
    comparison: Comparison, metadata: Metadata, tolerance_mm: float | None, stored: StoredObject | None
) -> Report:
    nominal = ReportNominal(comparison.nominal, comparison.deviation, tolerance_mm)
    report = (
        Report(metadata.title) if stored is None or stored.places is None else report_of(stored, comparison.surface)
    )
    return replace(
        report,
        title=f"{metadata.title} against {comparison.nominal}",
        about={
            **report.about,
            "Compared with": comparison.nominal,
            "Registration": f"standard deviation {1000.0 * comparison.laid.scatter_mm:.0f} µm",
        },
        surface=comparison.surface,
        nominal=nominal,
        warnings=(*comparison.warnings, *report.warnings),
    )


def _figures(comparison: Comparison, tolerance_mm: float | None) -> Mapping[str, Any]:
    """Return a comparison in numbers, JSON-ready; lengths in mm."""
    summary, laid = comparison.deviation.summary, comparison.laid
    near = np.abs(comparison.deviation.deviation_mm)
    return {
        "nominal": comparison.nominal,
        "points": summary.points,
        "beyond_limit": summary.beyond,
        "beside_border": summary.beside,
        "limit_mm": summary.limit_mm,
        "mean_mm": summary.mean_mm,
        "sd_mm": summary.sd_mm,
        "rms_mm": summary.rms_mm,
        "least_mm": summary.least_mm,
        "most_mm": summary.most_mm,
        "sigma_mm": _median(comparison.deviation.sigma_mm),
        "bending_mm": None if comparison.surface.shares is None else _median(comparison.surface.shares.bending_mm),
        "percentiles_mm": {f"{percent:g}": value for percent, value in summary.percentiles_mm},
        "within_2_sigma_percent": summary.within_2_sigma_percent,
        "tolerance_mm": tolerance_mm,
        # A point beyond the limit has no deviation and is out of every tolerance.
        "out_of_tolerance_percent": None
        if tolerance_mm is None
        else 100.0 * (1.0 - float((near <= tolerance_mm).mean())),
        "rotation": laid.pose.rotation.tolist(),
        "translation_mm": laid.pose.translation_mm.tolist(),
        "scatter_mm": laid.scatter_mm,
        "fitting_percent": 100.0 * laid.fitting,
        "warnings": list(comparison.warnings),
    }


def _median(values: NDArray[np.float32]) -> float | None:
    return float(np.median(values)) if len(values) else None
