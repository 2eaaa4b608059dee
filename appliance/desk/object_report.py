"""Content of the page about an object: its scan poses, scan pairs, uncertainty budget and warnings."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from appliance import __version__
from appliance.base import Progress
from appliance.desk.object_errors import length_between
from appliance.desk.object_store import ComparedScans, Places, ScanPlace, StoredObject
from appliance.desk.objects import surface_of
from appliance.desk.report.content import Report, ReportBudget, ReportPair, ReportScan, ReportTerm, ReportVerdict, when
from appliance.desk.surface.fusion import FusedCloud
from appliance.measure import rotation_vector
from appliance.store import ScanOptions

SHOWN_DIGITS = 12
_UNCHECKED = "not checked: in no loop of scan pairs; add a scan that overlaps both"


def report_of(stored_object: StoredObject, surface: FusedCloud) -> Report:
    """Return the page's content for a solved object and its fused surface.

    Raises ValueError for an object that is not solved.
    """
    places = stored_object.places
    if places is None:
        raise ValueError(f"object '{stored_object.name}' is not solved; solve it first")
    return Report(
        title=stored_object.name,
        subtitle=f"{len(places.places)} of {len(stored_object.scans)} scans placed",
        about={
            "Calibration": ", ".join(calibration[:SHOWN_DIGITS] for calibration in places.calibrations),
            "Refractive index of the water": f"{places.water_index[0]:.5f}",
            "Software": f"Kingfisher {__version__}",
            "Frame": f"left camera of scan {next(iter(places.places), '-')}, mm",
        },
        scans=[_scan(scan.name, places) for scan in stored_object.scans],
        pairs=[_pair(pair) for pair in places.pairs],
        budget=_budget(stored_object, places),
        surface=surface,
        warnings=places.warnings,
    )


def report_of_object(
    root: Path, solved: StoredObject, options: ScanOptions, progress: Progress, spacing_mm: float
) -> Report:
    """Return the page's content for a solved object, with its surface, a point about every ``spacing_mm``.

    Raises ScanError, CalibrationError.
    """
    return report_of(solved, surface_of(root, solved, options, progress, spacing_mm))


def _scan(name: str, places: Places) -> ReportScan:
    warnings = tuple(warning.partition(": ")[2] for warning in places.warnings if warning.startswith(f"scan {name}: "))
    cloud, place = places.clouds.get(name), places.places.get(name)
    report_scan = ReportScan(name, ReportVerdict.REFUSED, places.left_out.get(name, ""), warnings=warnings)
    if cloud is not None:
        report_scan = replace(
            report_scan,
            recorded=None if cloud.recorded is None else when(cloud.recorded),
            points=cloud.points,
            distance_mm=cloud.distance_mm,
            sigma_mm=cloud.sigma_mm,
            ray_gap_mm=cloud.ray_gap_mm,
        )
    if place is None:
        return report_scan
    rotation_deg = np.degrees(rotation_vector(np.array(place.rotation)))
    return replace(
        report_scan,
        verdict=ReportVerdict.DOUBTFUL if warnings else ReportVerdict.GOOD,
        reason="",
        position_mm=place.translation_mm,
        rotation_deg=(float(rotation_deg[0]), float(rotation_deg[1]), float(rotation_deg[2])),
        pose_sigma_mm=place.sigma_mm,
    )


def _pair(pair: ComparedScans) -> ReportPair:
    checked = ReportVerdict.UNCHECKED if pair.discrepancy_mm is None else ReportVerdict.GOOD
    verdict = checked if pair.used else ReportVerdict.REFUSED
    return ReportPair(
        first=pair.first,
        second=pair.second,
        verdict=verdict,
        reason=_UNCHECKED if verdict is ReportVerdict.UNCHECKED else "" if pair.used else pair.text,
        overlap_percent=pair.overlap_percent,
        matches=pair.matches,
        residual_mm=pair.discrepancy_mm,
        sigma_mm=pair.sigma_mm,
        sigma_deg=pair.sigma_deg,
    )


def _budget(stored_object: StoredObject, places: Places) -> ReportBudget | None:
    """Return the uncertainty of the distance between the middles of the first scan and the farthest one.

    ``None`` for one scan.
    """
    if len(places.places) < 2:
        return None
    names = list(places.places)
    first = places.places[names[0]]
    name = max(names, key=lambda candidate: _distance_mm(first, places.places[candidate]))
    farthest = places.places[name]
    length = length_between(stored_object, names[0], first.middle_mm, name, farthest.middle_mm)
    terms = (
        ReportTerm(
            "scan poses", length.places_mm, "scan pairs along the graph: robust residuals of the overlaps, by cells"
        ),
        ReportTerm(
            "shared depth error of all scans",
            length.bending_mm,
            "its uncertainty after the estimate from the overlaps"
            if places.shared_error_removed
            else "its uncertainty from the calibration",
        ),
    )
    return ReportBudget(
        over_mm=length.length_mm,
        terms=terms,
        combined_mm=length.sigma_mm,
        statement=f"Distance from the centre of scan {names[0]} to the centre of scan {name}. Bending may displace scan {name} by {farthest.bending_mm:.3f} mm "
        f"sideways ({farthest.bending_aided_mm:.3f} mm with --with-estimate). Scale and the noise of single points are "
        "not included: see the calibration's evaluation.",
    )


def _distance_mm(first: ScanPlace, place: ScanPlace) -> float:
    return float(np.linalg.norm(np.subtract(place.middle_mm, first.middle_mm)))
