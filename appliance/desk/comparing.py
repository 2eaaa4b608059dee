"""Owns the comparison of measured points with a nominal surface: aligned to it by their shape, then how far each lies
from it."""

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
    FreeWay,
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
"""Standard deviations beyond which a deviation is one."""
DOUBTFUL_PERCENT = 10.0
"""Share of points whose deviation may be the object's bending from which on that is said: some of 5 % are beyond two
standard deviations by chance."""
_MOST_SHOWN = 3


@refuse_wrong_fields
@dataclass(frozen=True, slots=True, eq=False)
class NominalSurface:
    """A surface that others are compared with."""

    name: str
    triangles: Nominal
    sigma_mm: NDArray[np.float32] | None = None
    """(v,) of its vertices, where it was measured itself; ``None``: it is exact."""

    __repr__ = one_line


@dataclass(frozen=True, slots=True, eq=False)
class Comparison:
    """Points that were aligned to a nominal surface, with how far they lie from it."""

    surface: FusedCloud
    """Points in their own frame; sigma and its shares as they are once it lies on the nominal surface."""
    laid: SurfaceRegistration
    nominal: str
    origin_mm: NDArray[np.float64]
    """(3,): place in the nominal surface's frame that ``in_nominal_frame`` is about; (0, 0, 0) unless it lies far from
    its frame's origin."""
    deviation: Deviation
    """One for each point, positive outside; its sigma has everything in it: the point's, its scan's place, what may
    bend the object, how it is laid onto the nominal surface, and a measured nominal surface's own."""
    warnings: tuple[str, ...]

    __repr__ = one_line

    @property
    def in_nominal_frame(self) -> FusedCloud:
        """The points in the nominal surface's frame, less ``origin_mm``, with the sigma of their deviations."""
        pose = _moved(self.laid.pose, -self.origin_mm)
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
    """Lay ``surface`` onto ``nominal`` by shape alone and return how far each point lies from it.

    ``limit_mm``: points farther off are counted and have no deviation. ``start``: where it lies within some
    millimetres; ``None``: it is searched for. ``errors``: those of the object that it is the surface of
    (``errors_of``): each point's sigma then has those of its scan's place and of the object's bending, as far as laying
    it onto ``nominal`` does not take them away. Raises SurfaceMatchError where most of it fits nowhere.
    """
    tree = NominalTree.of(nominal.triangles)
    laid = register_to_reference(
        OrientedPoints(
            surface.points_mm.astype(np.float64),
            surface.normals.astype(np.float64),
            surface.beside_mm.astype(np.float64),
        ),
        NominalReference(tree, nominal.sigma_mm),
        None if start is None else _moved(start, -nominal.triangles.origin_mm),
    )
    points = laid.pose.of(surface.points_mm.astype(np.float64))
    normals = surface.normals.astype(np.float64) @ laid.pose.rotation.T
    deviation = deviations(points, surface.sigma_mm, tree, normals, limit_mm)
    surface = with_sigma_after_registration(surface, errors, np.isfinite(deviation.deviation_mm))
    variance = surface.sigma_mm.astype(np.float64) ** 2 + laid.sigma_at(points, normals) ** 2
    if nominal.sigma_mm is not None:
        variance += _sigma_on(nominal.sigma_mm, nominal.triangles, deviation.face) ** 2
    deviation = deviation.with_sigma(np.sqrt(variance).astype(np.float32))
    pose, *elsewhere = (_moved(one, nominal.triangles.origin_mm) for one in (laid.pose, *laid.elsewhere))
    laid = replace(laid, pose=pose, elsewhere=tuple(elsewhere))
    warnings = (*_warnings(laid), *_beside(deviation), *_bent(surface, deviation))
    return Comparison(surface, laid, nominal.name, nominal.triangles.origin_mm, deviation, warnings)


@dataclass(frozen=True, slots=True, eq=False)
class StoredComparison:
    """A comparison of what is stored, and what was compared."""

    found: Comparison
    about: Metadata
    stored: StoredObject | None
    """The object that the points are of; ``None``: they are of one scan."""

    def write(self, out: Path, tolerance_mm: float | None) -> None:
        """Write points or a page, by the suffix. Raises ExportError, StorageError, MissingLibraryError."""
        _write(out, self.found, self.about, tolerance_mm, self.stored)

    def figures(self, tolerance_mm: float | None) -> Mapping[str, Any]:
        """Return the comparison in numbers, JSON-ready; lengths in mm."""
        return _figures(self.found, tolerance_mm)


def compare_stored(
    root: Path,
    what: Path | StoredObject,
    nominal: Path | StoredObject,
    wish: ScanOptions,
    progress: Progress,
    *,
    spacing_mm: float,
    limit_mm: float,
    start: Sequence[float] | None,
) -> StoredComparison:
    """Compare a scan (its folder), or the surface of a solved object, with a CAD model (its file) or another object.

    ``start``: where it lies, x, y, z in mm and the turn as axis times angle in degrees. Raises ScanError,
    CalibrationError, NominalError, ObjectError, SurfaceMatchError, MissingLibraryError.
    """
    reference, errors, stored = _nominal_surface(root, nominal, wish, progress, spacing_mm), None, None
    if isinstance(what, StoredObject):
        surface, about = surface_of(root, what, wish, progress, spacing_mm), metadata_of_object(what)
        errors, stored = errors_of(what), what
    else:
        surface, about = _surface_of_scan(what, wish, progress, spacing_mm)
    progress(f"laying it onto {reference.name}")
    begin = None if start is None else Rigid(rotation_matrix(np.radians(start[3:])), np.array(start[:3]))
    return StoredComparison(compare(surface, reference, limit_mm, begin, errors), about, stored)


def _surface_of_scan(
    folder: Path, wish: ScanOptions, progress: Progress, spacing_mm: float
) -> tuple[FusedCloud, Metadata]:
    progress(f"comparing checksums of {folder.name}")
    source = SourceScan.open(folder, wish, whole=True)
    made = organised_scan(source, source.calibration_for(wish), progress)
    # One scan has no other to be placed beside.
    placed = PlacedScan(made.cloud, np.eye(3), np.zeros(3), pose_sigma_mm=0.0)
    return fuse([placed], spacing_mm), Metadata(f"scan {source.scan.manifest.scan_id}", CAMERA_FRAME)


def _nominal_surface(
    root: Path, nominal: Path | StoredObject, wish: ScanOptions, progress: Progress, spacing_mm: float
) -> NominalSurface:
    if isinstance(nominal, Path):
        return NominalSurface(nominal.name, read_nominal(nominal))
    # What the two are laid onto each other by, no error of the other's frame is left in.
    surface = with_sigma_after_registration(surface_of(root, nominal, wish, progress, spacing_mm), errors_of(nominal))
    mesh = mesh_of_surface(surface, max(VOXEL_MM, 2.0 * spacing_mm))
    return NominalSurface(f"object {nominal.name}", nominal_of_mesh(mesh), mesh.sigma_mm)


@dataclass(frozen=True, slots=True, eq=False)
class NominalReference:
    """A nominal surface as something that measured points are laid onto."""

    tree: NominalTree
    sigma_mm: NDArray[np.float32] | None = None

    def spread(self, count: int) -> OrientedPoints:
        """Return ``count`` places spread evenly over it."""
        places, face = spread_over(self.tree.nominal, count)
        return OrientedPoints(places, self.tree.nominal.face_normals[face], self._sigma(face))

    def nearest(self, points_mm: NDArray[np.float64], limit_mm: float) -> ReferencePlaces:
        """Return the nearest place to each of the points (n, 3), whatever its distance."""
        on = self.tree.nearest(points_mm)
        apart = np.where(on.beside, np.inf, np.abs(on.signed_mm))
        return ReferencePlaces(apart, on.place_mm, self.tree.nominal.face_normals[on.face], self._sigma(on.face))

    def _sigma(self, face: NDArray[np.int64]) -> NDArray[np.float64]:
        if self.sigma_mm is None:
            return np.zeros(len(face))
        return _sigma_on(self.sigma_mm, self.tree.nominal, face)


def _sigma_on(sigma_mm: NDArray[np.float32], nominal: Nominal, face: NDArray[np.int64]) -> NDArray[np.float64]:
    """Return the sigma (n,) of the triangles ``face`` (n,); of none, -1, that of the last: it has no deviation either."""
    return np.asarray(sigma_mm[nominal.faces[face]].mean(axis=1), np.float64)


def _moved(pose: Rigid, by_mm: NDArray[np.float64]) -> Rigid:
    return Rigid(pose.rotation, pose.translation_mm + by_mm)


def _beside(deviation: Deviation) -> tuple[str, ...]:
    """Return a warning where points lie beside an open border."""
    if not deviation.summary.beside:
        return ()
    return (
        f"{deviation.summary.beside} points lie beside an open border of the CAD model: it has nothing there to compare them with",
    )


def _bent(surface: FusedCloud, deviation: Deviation) -> tuple[str, ...]:
    """Return a warning where deviations beyond a point's other uncertainty may be the object's bending and nothing
    else."""
    if surface.shares is None:
        return ()
    bending, off = surface.shares.bending_mm.astype(np.float64), np.abs(deviation.deviation_mm.astype(np.float64))
    there = np.isfinite(off)
    # Whose deviation noise, place and laying on explain is no case for the bending.
    without = np.sqrt(np.maximum(deviation.sigma_mm.astype(np.float64) ** 2 - bending**2, 0.0))
    doubtful = there & (off > SURE * without) & (off <= SURE * deviation.sigma_mm)
    share = 100.0 * float(np.count_nonzero(doubtful)) / max(int(np.count_nonzero(there)), 1)
    if share < DOUBTFUL_PERCENT:
        return ()
    most_mm = SURE * float(bending[there].max())
    said = (
        f"{share:.0f} % of the deviations are within what may bend the object (± {most_mm:.3f} mm at most, two standard deviations, once it "
        "is laid on): they do not tell the thing from the calibration's own error"
    )
    return (said,)


def _warnings(laid: SurfaceRegistration) -> tuple[str, ...]:
    found = [_free_words(laid, one) for one in laid.free]
    if laid.elsewhere:
        poses = "; ".join(_pose_words(one, laid.pose) for one in laid.elsewhere[:_MOST_SHOWN])
        found.append(
            f"it fits as well in {len(laid.elsewhere)} or more other places: the thing is symmetric, or its repeated parts are. To choose one: {poses}"
        )
    return tuple(found)


def _free_words(laid: SurfaceRegistration, way: FreeWay) -> str:
    """Return what is known of a direction that the shape does not hold, in the nominal surface's frame."""
    motion = (
        f"can turn about {_vector(way.direction[:3])}" if way.turns else f"can slide along {_vector(way.direction[3:])}"
    )
    unit = "°" if way.turns else " mm"
    # Both are told along the direction as it is written.
    sense = 1 if _upright(way.direction[:3] if way.turns else way.direction[3:]) else -1
    ends = [sense * one + 0.0 for one in way.ends][::sense]
    rms = [laid.rms_mm, *list(way.rms_mm)[::sense]]
    lost = [100.0 * (1.0 - one) for one in [laid.fitting, *list(way.fitting)[::sense]]]
    return (
        f"{motion}: its shape does not hold it between {ends[0]:+.3g} and {ends[1]:+.3g}{unit} from here. Tried there: RMS "
        f"{rms[0]:.3f} mm here, {rms[1]:.3f} and {rms[2]:.3f} mm at the ends; {lost[0]:.1f} %, {lost[1]:.1f} % and {lost[2]:.1f} % of the points lie beyond "
        f"{FITS_MM:g} mm. Say where it belongs with --start; here is {_start_words(laid.pose)}"
    )


def _upright(direction: NDArray[np.float64]) -> bool:
    return bool(direction[np.abs(direction).argmax()] >= 0.0)


def _vector(of: NDArray[np.float64]) -> str:
    unit = of / max(float(np.linalg.norm(of)), 1e-12)
    # A direction and its opposite are one.
    unit = unit if _upright(unit) else -unit
    return "(" + ", ".join(f"{one:z.2f}" for one in unit) + ")"


def _start_words(pose: Rigid) -> str:
    """Return the option that puts it there."""
    turn_deg = np.degrees(rotation_vector(pose.rotation))
    return "--start " + ",".join(f"{one:z.3f}" for one in (*pose.translation_mm, *turn_deg))


def _pose_words(other: Rigid, best: Rigid) -> str:
    turn = rotation_vector(best.inverse.then(other).rotation)
    angle = float(np.degrees(np.linalg.norm(turn)))
    if angle < 1.0:
        how = f"{np.linalg.norm(other.translation_mm - best.translation_mm):.1f} mm beside"
    else:
        how = f"turned by {angle:.0f}° about {_vector(turn)}"
    return f"{_start_words(other)} ({how})"


def _write(
    path: Path, found: Comparison, about: Metadata, tolerance_mm: float | None, stored: StoredObject | None
) -> None:
    """Write a comparison: points with their deviation (.ply .e57 .las) in the nominal surface's frame, or a page
    (.html).

    ``stored``: the object that the points are of, for the page's scans. Raises ExportError, StorageError,
    MissingLibraryError.
    """
    if path.suffix.lower() == PAGE:
        write_report(path, _report(found, about, tolerance_mm, stored))
        return
    in_frame = replace(about, frame=f"frame of {found.nominal}", notes=(*about.notes, *found.warnings))
    write_surface(path, found.in_nominal_frame, in_frame, found.deviation.deviation_mm, found.origin_mm)


def _report(found: Comparison, about: Metadata, tolerance_mm: float | None, stored: StoredObject | None) -> Report:
    nominal = ReportNominal(found.nominal, found.deviation, tolerance_mm)
    whole = Report(about.title) if stored is None or stored.places is None else report_of(stored, found.surface)
    return replace(
        whole,
        title=f"{about.title} against {found.nominal}",
        about={
            **whole.about,
            "Compared with": found.nominal,
            "Laid onto it": f"within {1000.0 * found.laid.scatter_mm:.0f} µm scatter",
        },
        surface=found.surface,
        nominal=nominal,
        warnings=(*found.warnings, *whole.warnings),
    )


def _figures(found: Comparison, tolerance_mm: float | None) -> Mapping[str, Any]:
    """Return a comparison in numbers, JSON-ready; lengths in mm."""
    summary, laid = found.deviation.summary, found.laid
    near = np.abs(found.deviation.deviation_mm)
    return {
        "nominal": found.nominal,
        "points": summary.points,
        "beyond_limit": summary.beyond,
        "beside_border": summary.beside,
        "limit_mm": summary.limit_mm,
        "mean_mm": summary.mean_mm,
        "sd_mm": summary.sd_mm,
        "rms_mm": summary.rms_mm,
        "least_mm": summary.least_mm,
        "most_mm": summary.most_mm,
        "sigma_mm": _median(found.deviation.sigma_mm),
        "bending_mm": None if found.surface.shares is None else _median(found.surface.shares.bending_mm),
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
        "warnings": list(found.warnings),
    }


def _median(values: NDArray[np.float32]) -> float | None:
    return float(np.median(values)) if len(values) else None
