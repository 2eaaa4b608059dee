"""Owns what the page about an object says: its places, pairs, budget and warnings as the report's values."""

from __future__ import annotations

import numpy as np

from appliance import __version__
from appliance.optics.rotation import rotation_vector
from appliance.report.content import Report, ReportBudget, ReportPair, ReportScan, ReportTerm, ReportVerdict
from appliance.storage.objects import ComparedScans, Places, ScanPlace, StoredObject
from appliance.surface.fusion import FusedCloud

SHOWN_DIGITS = 12


def report_of(stored_object: StoredObject, surface: FusedCloud) -> Report:
    """Return the page's content for a solved object and its fused surface. Raises ValueError for one that is not solved."""
    places = stored_object.places
    if places is None:
        raise ValueError(f"object '{stored_object.name}' is not solved; solve it before its report is made")
    return Report(
        title=stored_object.name,
        subtitle=f"{len(places.places)} of {len(stored_object.scans)} scans placed",
        about={
            "Calibration": ", ".join(one[:SHOWN_DIGITS] for one in places.calibrations),
            "Refractive index of the water": f"{places.water_index[0]:.5f}",
            "Software": f"Kingfisher {__version__}",
            "Frame": f"left camera of scan {next(iter(places.places), '-')}, mm",
        },
        scans=[_scan(one.name, places) for one in stored_object.scans],
        pairs=[_pair(one) for one in places.pairs],
        budget=_budget(places),
        surface=surface,
        warnings=places.warnings,
    )


def _scan(name: str, places: Places) -> ReportScan:
    warnings = tuple(one.partition(": ")[2] for one in places.warnings if one.startswith(f"scan {name}: "))
    place = places.places.get(name)
    if place is None:
        return ReportScan(name, ReportVerdict.REFUSED, places.left_out.get(name, ""), warnings=warnings)
    turn = np.degrees(rotation_vector(np.array(place.rotation)))
    return ReportScan(
        name=name,
        verdict=ReportVerdict.DOUBTFUL if warnings else ReportVerdict.GOOD,
        position_mm=place.translation_mm,
        rotation_deg=(float(turn[0]), float(turn[1]), float(turn[2])),
        pose_sigma_mm=place.sigma_mm,
        warnings=warnings,
    )


def _pair(pair: ComparedScans) -> ReportPair:
    verdict = ReportVerdict.GOOD if pair.used else ReportVerdict.REFUSED
    return ReportPair(
        first=pair.first,
        second=pair.second,
        verdict=verdict,
        reason="" if pair.used else pair.text,
        overlap_percent=pair.overlap_percent,
        residual_mm=pair.discrepancy_mm,
        sigma_mm=pair.sigma_mm,
    )


def _budget(places: Places) -> ReportBudget | None:
    """Return the uncertainty of the distance between the first scan's middle and that of the farthest one; ``None`` for one scan."""
    if len(places.places) < 2:
        return None
    first = next(iter(places.places.values()))
    farthest = max(places.places.values(), key=lambda place: _apart_mm(first, place))
    others = float(np.sqrt(max(farthest.sigma_mm**2 - farthest.bending_mm**2, 0.0)))
    terms = (
        ReportTerm("pairs of scans, along the graph", others, "residuals of the overlaps, robust by tiles"),
        ReportTerm(
            "depth error that all scans share",
            farthest.bending_mm,
            f"estimated from the overlaps; {farthest.bending_unaided_mm:.3f} mm without them"
            if places.shared_error_removed
            else f"what the calibration leaves open; {farthest.bending_aided_mm:.3f} mm if the overlaps' estimate were believed",
        ),
    )
    return ReportBudget(
        over_mm=_apart_mm(first, farthest),
        terms=terms,
        combined_mm=farthest.sigma_mm,
        statement="Scale and single points are the calibration's: see its evaluation.",
    )


def _apart_mm(first: ScanPlace, place: ScanPlace) -> float:
    return float(np.linalg.norm(np.subtract(place.middle_mm, first.middle_mm)))
