"""Owns what the page about a dive says: each scan as it was judged, its warnings, and its cloud as a picture."""

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
"""Signs of the grades."""


def report_of_dive(root: Path, entries: Sequence[ScanEntry], progress: Progress) -> Report:
    """Return the page's content for scans under a storage root, in their order.

    A scan that cannot be read is on the page, with its problem.
    """
    # One at a time: a cloud is let go before the next is read.
    scans = []
    for number, entry in enumerate(entries):
        progress(f"scan {entry.scan_id}", number / max(len(entries), 1))
        scans.append(_scan(entry))
    records = [entry.manifest.record for entry in entries if entry.manifest is not None]
    dates = sorted(one.wall_time for one in records if one.wall_time is not None)
    points = sum(one.points or 0 for one in scans)
    return Report(
        title=_title(root.absolute().name),
        subtitle=f"{len(entries)} scans, {points / 1e6:.1f} million points",
        about={
            "Recorded": " to ".join(dict.fromkeys((when(dates[0]), when(dates[-1]))))
            if dates
            else "at an unknown time",
            "Calibration": _each(one.calibration_hash for one in records) or "none",
            "Refractive index of the water": _each(
                f"{index:.5f}" for one in records if (index := one.water.get("index")) is not None
            )
            or "–",
            "Objects": _each(f"{one.object}" for one in records if one.object is not None) or "none",
            "Software": f"Kingfisher {__version__}; recorded by {_each(one.software_version for one in records) or '–'}",
        },
        scans=scans,
        warnings=_warnings(entries, scans),
    )


def _when(record: ScanRecord) -> str | None:
    if record.wall_time is None:
        return None
    return when(record.wall_time) + ("" if record.clock_trusted else " (clock not set)")


def _each(values: Iterable[str | None]) -> str:
    """Return what occurs among ``values``, each once and shortened, in the order of appearance."""
    return ", ".join(dict.fromkeys(one[:_SHOWN_DIGITS] for one in values if one is not None))


def _scan(entry: ScanEntry) -> ReportScan:
    name = entry.scan_id if entry.label.name is None else f"{entry.scan_id} {entry.label.name}"
    if entry.manifest is None:
        return ReportScan(name, ReportVerdict.REFUSED, "damaged", warnings=entry.problems)
    record = entry.manifest.record
    failed = {
        one.name: f"{one.name}: {one.text}" if one.text else one.name for one in record.verdicts if one.passed is False
    }
    # The causes rank what other verdicts say in full.
    others = [text for name, text in failed.items() if name not in {GRADE, CAUSES}]
    told = others or list(failed.values())
    ungraded = ReportVerdict.DOUBTFUL if told else ReportVerdict.GOOD
    belongs = [] if record.object is None else [f"object {record.object}"]
    count = record.cloud.get("points")
    found = ReportScan(
        name=name,
        verdict=_VERDICTS[record.grade] if record.grade is not None else ungraded,
        grade=record.grade,
        reason="; ".join([*belongs, *(["motion corrected"] if record.compensated else [])]),
        recorded=_when(record),
        points=None if count is None else round(count),
        sigma_mm=record.cloud.get("noise_mm"),
        ray_gap_mm=record.gap_mm,
        warnings=(*told, *entry.problems, *((entry.label.note,) if entry.label.note else ())),
    )
    if entry.problems:
        return replace(found, verdict=ReportVerdict.REFUSED, grade=None)
    try:
        cloud = StoredScan.load(entry.folder).cloud()
    except ScanError as error:
        return replace(found, verdict=ReportVerdict.REFUSED, grade=None, warnings=(*found.warnings, str(error)))
    if cloud is None or not len(cloud.points_mm):
        # Its frames are whole: its points can be made again.
        return replace(
            found,
            verdict=ReportVerdict.REFUSED,
            grade=None,
            warnings=(*found.warnings, "raw frames only: kingfisher cloud"),
        )
    return replace(
        found,
        points=len(cloud.points_mm),
        distance_mm=float(np.median(cloud.points_mm[:, 2])),
        sigma_mm=float(np.median(cloud.sigma_mm)),
        ray_gap_mm=None if record.compensated else float(np.median(np.abs(cloud.ray_gap_mm))),
        picture_png=picture_of_scan(cloud.points_mm, cloud.intensity),
    )


def _title(name: str) -> str:
    return name.capitalize() if name.lower().startswith("dive") else f"Dive {name}"


def _warnings(entries: Sequence[ScanEntry], scans: Sequence[ReportScan]) -> list[str]:
    said = []
    without = [one.name for one in scans if one.verdict is ReportVerdict.REFUSED and one.grade is None]
    for names, words in (
        (without, "without points that can be used"),
        ([one.name for one in scans if one.grade is Grade.BAD], "are bad"),
        ([one.name for one in scans if one.grade is Grade.USABLE], "are usable, not good"),
    ):
        if names:
            said.append(f"{len(names)} of {len(scans)} scans {words}: {', '.join(names)}")
    # Scans without points have no calibration, which is no second one.
    used = {entry.manifest.record.calibration_hash for entry in entries if entry.manifest is not None} - {None}
    if len(used) > 1:
        said.append(f"{len(used)} calibrations: points of different ones do not lie on each other")
    return said
