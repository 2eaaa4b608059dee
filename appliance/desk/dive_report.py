"""Content of the page about a dive: each scan with its verdicts, its warnings, and its image."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from appliance import __version__
from appliance.base import Progress
from appliance.desk.report.content import Report, ReportScan, ReportVerdict, when
from appliance.desk.report.still import picture_of_scan
from appliance.measure import CAUSES_NAME as CAUSES
from appliance.measure import GRADE_NAME as GRADE
from appliance.measure import Grade
from appliance.store import ScanEntry, ScanError, ScanRecord, StoredScan

_SHOWN_DIGITS = 12
_VERDICTS: Mapping[Grade, ReportVerdict] = {
    Grade.GOOD: ReportVerdict.GOOD,
    Grade.USABLE: ReportVerdict.DOUBTFUL,
    Grade.BAD: ReportVerdict.REFUSED,
}
"""Verdict of the report for each grade."""


def report_of_dive(root: Path, entries: Sequence[ScanEntry], progress: Progress) -> Report:
    """Return the page's content for scans under a storage root, in their order.

    A scan that cannot be read is on the page, with its fault.
    """
    # One at a time: a cloud is freed before the next is read.
    scans = []
    for number, entry in enumerate(entries):
        progress(f"scan {entry.scan_id}", number / max(len(entries), 1))
        scans.append(_scan(entry))
    records = [entry.manifest.record for entry in entries if entry.manifest is not None]
    dates = sorted(record.wall_time for record in records if record.wall_time is not None)
    points = sum(scan.points or 0 for scan in scans)
    return Report(
        title=_title(root.absolute().name),
        subtitle=f"{len(entries)} scans, {points / 1e6:.1f} million points",
        about={
            "Recorded": " to ".join(dict.fromkeys((when(dates[0]), when(dates[-1]))))
            if dates
            else "at an unknown time",
            "Calibration": _distinct(record.calibration_hash for record in records) or "none",
            "Refractive index of the water": _distinct(
                f"{index:.5f}" for record in records if (index := record.water.get("index")) is not None
            )
            or "–",
            "Objects": _distinct(f"{record.object}" for record in records if record.object is not None) or "none",
            "Software": f"Kingfisher {__version__}; recorded by {_distinct(record.software_version for record in records) or '–'}",
        },
        scans=scans,
        warnings=_warnings(entries, scans),
    )


def _when(record: ScanRecord) -> str | None:
    if record.wall_time is None:
        return None
    return when(record.wall_time) + ("" if record.clock_trusted else " (clock not set)")


def _distinct(values: Iterable[str | None]) -> str:
    """Return the distinct ``values``, shortened, in the order of appearance."""
    return ", ".join(dict.fromkeys(value[:_SHOWN_DIGITS] for value in values if value is not None))


def _scan(entry: ScanEntry) -> ReportScan:
    name = entry.scan_id if entry.label.name is None else f"{entry.scan_id} {entry.label.name}"
    if entry.manifest is None:
        return ReportScan(name, ReportVerdict.REFUSED, "damaged", warnings=entry.problems)
    record = entry.manifest.record
    failed = {
        verdict.name: f"{verdict.name}: {verdict.text}" if verdict.text else verdict.name
        for verdict in record.verdicts
        if verdict.passed is False
    }
    # Grade and causes only rank the faults that other verdicts state in full.
    details = [text for name, text in failed.items() if name not in {GRADE, CAUSES}]
    failures = details or list(failed.values())
    ungraded = ReportVerdict.DOUBTFUL if failures else ReportVerdict.GOOD
    belongs = [] if record.object is None else [f"object {record.object}"]
    count = record.cloud.get("points")
    report_scan = ReportScan(
        name=name,
        verdict=_VERDICTS[record.grade] if record.grade is not None else ungraded,
        grade=record.grade,
        reason="; ".join([*belongs, *(["motion corrected"] if record.compensated else [])]),
        recorded=_when(record),
        points=None if count is None else round(count),
        sigma_mm=record.cloud.get("noise_mm"),
        ray_gap_mm=record.gap_mm,
        warnings=(*failures, *entry.problems, *((entry.label.note,) if entry.label.note else ())),
    )
    if entry.problems:
        return replace(report_scan, verdict=ReportVerdict.REFUSED, grade=None)
    try:
        cloud = StoredScan.load(entry.folder).cloud()
    except ScanError as error:
        return replace(
            report_scan, verdict=ReportVerdict.REFUSED, grade=None, warnings=(*report_scan.warnings, str(error))
        )
    if cloud is None or not len(cloud.points_mm):
        # Its frames are complete: its points can be made again.
        return replace(
            report_scan,
            verdict=ReportVerdict.REFUSED,
            grade=None,
            warnings=(*report_scan.warnings, "raw frames only: kingfisher cloud"),
        )
    return replace(
        report_scan,
        points=len(cloud.points_mm),
        distance_mm=float(np.median(cloud.points_mm[:, 2])),
        sigma_mm=float(np.median(cloud.sigma_mm)),
        ray_gap_mm=None if record.compensated else float(np.median(np.abs(cloud.ray_gap_mm))),
        picture_png=picture_of_scan(cloud.points_mm, cloud.intensity),
    )


def _title(name: str) -> str:
    return name.capitalize() if name.lower().startswith("dive") else f"Dive {name}"


def _warnings(entries: Sequence[ScanEntry], scans: Sequence[ReportScan]) -> list[str]:
    warnings = []
    without = [scan.name for scan in scans if scan.verdict is ReportVerdict.REFUSED and scan.grade is None]
    for names, fault_text in (
        (without, "without usable points"),
        ([scan.name for scan in scans if scan.grade is Grade.BAD], "are bad"),
        ([scan.name for scan in scans if scan.grade is Grade.USABLE], "are usable, not good"),
    ):
        if names:
            warnings.append(f"{len(names)} of {len(scans)} scans {fault_text}: {', '.join(names)}")
    # Scans without points have no calibration; None does not count as a second one.
    used = {entry.manifest.record.calibration_hash for entry in entries if entry.manifest is not None} - {None}
    if len(used) > 1:
        warnings.append(f"{len(used)} calibrations: points of scans with different calibrations do not coincide")
    return warnings
