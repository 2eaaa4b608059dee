"""Owns an evaluation from list to report: which scan shows what, each reconstructed, its artefact measured."""

from __future__ import annotations

import json
import math
import tomllib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from appliance import __version__
from appliance.calibration.file import Calibration
from appliance.evaluation.acceptance import Certificate, Symbol
from appliance.evaluation.flatness import REFERENCE_MM
from appliance.evaluation.report import Evaluation, Item
from appliance.evaluation.result import LENGTHS, Artefact, evaluate
from appliance.instrument import settings_of_scan
from appliance.offline.origin import SourceScan
from appliance.offline.reprocess import refuse_empty, reprocess
from appliance.reconstruct.quality import QualityLimits
from appliance.storage import scan as stored

MOST_BYTES = 1_000_000
LENGTH_MM, REFERENCE_RANGE_MM = (1.0, 2000.0), (10.0, 5000.0)
JUDGING_GAP_MM = 20.0
"""The instrument masks points whose rays pass at more than 0.25 mm. A wrong calibration would so hide its own worst points,
many more than the 0.3 % that may be removed; here every calibration is judged by the same points."""
SD_MM, RADIUS_MM, LIMIT_MM = (1e-5, 1.0), (1.0, 100.0), (1e-4, 10.0)
_TOP_KEYS = {"operator", "reference_mm", "scan", "limits"}
LIMITS = {f"{symbol.value.lower()}_mm": symbol for symbol in Symbol}
"""Keys of ``[limits]``: the largest permissible error of each quantity."""


class ListError(Exception):
    """The list of scans cannot be used; the text names the key, its value, what is allowed and the remedy."""


@dataclass(frozen=True, slots=True)
class ListedScan:
    """One scan of the list, and what it shows."""

    scan: str
    """The scan's number or its folder, as written."""
    artefact: Artefact
    calibrated_mm: Mapping[str, float]
    serial: str | None
    """Serial number of the artefact; its certificate states the lengths."""
    length_sd_mm: float | None = None
    """Standard uncertainty of a ball bar's length in mm by the certificate."""
    radius_mm: float | None = None
    """Radius of a ball bar's balls in mm by the certificate."""
    radius_sd_mm: float | None = None
    """Standard uncertainty of that radius in mm."""


@dataclass(frozen=True, slots=True)
class ScanList:
    """A list of scans as the metrologist wrote it down."""

    entries: tuple[ListedScan, ...]
    operator: str | None
    reference_mm: float
    limits_mm: Mapping[Symbol, float] = field(default_factory=dict)
    """Largest permissible errors; what is not there is not limited."""


def read_list(path: Path) -> ScanList:
    """Read a list, TOML or (by its name) JSON: ``docs/evaluation.md``. Raises ListError."""
    try:
        data = path.read_bytes()
    except OSError as error:
        raise ListError(f"LIST {path}: cannot be read ({error.strerror}); give the list of scans") from error
    if len(data) > MOST_BYTES:
        raise ListError(f"LIST {path}: {len(data)} bytes; allowed are {MOST_BYTES}; give the list of scans")
    try:
        content = json.loads(data) if path.suffix == ".json" else tomllib.loads(data.decode())
    except (ValueError, RecursionError) as error:
        raise ListError(f"LIST {path}: not readable ({error}); see docs/evaluation.md") from error
    if not isinstance(content, dict):
        raise ListError(f"LIST {path}: a table was expected, not {type(content).__name__}; see docs/evaluation.md")
    # A misspelt key would be a certificate that is silently not used.
    _known(path, content, _TOP_KEYS)
    tables = content.get("scan")
    if not isinstance(tables, list) or not tables or not all(isinstance(table, dict) for table in tables):
        raise ListError(f"LIST {path}: no scan in it; give at least one [[scan]]")
    reference = content.get("reference_mm", REFERENCE_MM)
    limits = content.get("limits", {})
    if not isinstance(limits, dict):
        raise ListError(f"LIST {path}: limits is no table; give [limits] with {', '.join(LIMITS)}")
    _known(path, limits, set(LIMITS), "limits.")
    return ScanList(
        tuple(_entry(path, k, table) for k, table in enumerate(tables)),
        _text(path, content, "operator"),
        _number(path, "reference_mm", reference, REFERENCE_RANGE_MM),
        {LIMITS[key]: _number(path, f"limits.{key}", value, LIMIT_MM) for key, value in limits.items()},
    )


def run_evaluation(
    listed: ScanList,
    sources: Sequence[SourceScan],
    chosen: Calibration,
    progress: Callable[[str, float], None],
) -> Evaluation:
    """Reconstruct and measure every scan of the list; ``sources`` are they, in its order, with whole raw frames.

    Raises ScanError, also for a scan that the calibration leaves no points of.
    """
    items = []
    for k, (entry, source) in enumerate(zip(listed.entries, sources, strict=True)):
        at, scan = k / len(sources), source.scan

        def step(what: str, at: float = at, name: str = scan.folder.name) -> None:
            progress(f"{name}: {what}", at)

        settings = settings_of_scan(scan.manifest.record, source.rig)
        reprocessed = reprocess(scan, chosen, settings, step, QualityLimits(max_gap_mm=JUDGING_GAP_MM))
        # An artefact that was not found is a result; a calibration that does not fit the scan measures nothing.
        if reprocessed.empty is not None and reprocessed.empty.by_calibration:
            refuse_empty(scan.folder, reprocessed.empty)
        cloud, water = reprocessed.cloud, reprocessed.water
        step(f"looking for the {entry.artefact.value}")
        certificate = Certificate(entry.length_sd_mm, entry.radius_mm, entry.radius_sd_mm)
        result = evaluate(
            cloud, entry.artefact, entry.calibrated_mm, listed.reference_mm, certificate, listed.limits_mm
        )
        record = scan.manifest.record
        provenance = {
            "recorded": record.wall_time,
            "clock_trusted": record.clock_trusted,
            "artefact_serial": entry.serial,
            "points": cloud.summary.points,
            "coverage_percent": cloud.summary.coverage_percent,
            "ray_gap_mm": cloud.summary.gap_mm,
            "water": {"temperature_c": water.temperature_c, "salinity_psu": water.salinity_psu, "index": water.index},
            "temperatures_c": dict(record.temperatures_c),
            "period_px": record.sequence.period_px,
            "warnings": [f"{fault.code.value}: {fault.detail}" for fault in reprocessed.faults],
            "recorded_by_version": record.software_version,
            "recorded_with_rig": record.rig_hash,
            "recorded_with_calibration": record.calibration_hash,
            # Which frames were measured can be proved later, wherever the folder has gone.
            "sha256": {name: scan.manifest.files[name].sha256 for name in stored.RAW_FILES},
        }
        items.append(Item(scan.manifest.scan_id, result, provenance))
    about = {
        "operator": listed.operator,
        "rig_serial": chosen.rig_serial,
        "calibration": chosen.hash,
        "calibration_method": chosen.method,
        "calibration_made_at": chosen.made_at,
        "software_version": __version__,
    }
    return Evaluation(about, listed.reference_mm, chosen.rig.left.width_px, tuple(items))


def _entry(path: Path, k: int, table: dict[str, Any]) -> ListedScan:
    where = f"scan[{k}]"
    names = ", ".join(a.value for a in Artefact)
    try:
        artefact = Artefact(table.get("artefact"))
    except ValueError as error:
        raise ListError(
            f"LIST {path}: {where}.artefact is {table.get('artefact')!r}; allowed are {names}; correct it"
        ) from error
    lengths = {f"{name}_mm": name for name in LENGTHS[artefact]}
    of_balls = (
        {"length_sd_mm": SD_MM, "radius_mm": RADIUS_MM, "radius_sd_mm": SD_MM} if artefact is Artefact.BALL_BAR else {}
    )
    _known(path, table, {"scan", "artefact", "serial", *lengths, *of_balls}, f"{where}.")
    scan = table.get("scan")
    if not isinstance(scan, str) or not scan:
        raise ListError(f"LIST {path}: {where}.scan is {scan!r}; allowed is a text: the scan's number or its folder")
    given = {
        name: _number(path, f"{where}.{key}", table[key], LENGTH_MM) for key, name in lengths.items() if key in table
    }
    if lengths and not given:
        raise ListError(
            f"LIST {path}: {where} has no calibrated length; give {' or '.join(lengths)} of its certificate"
        )
    balls = {
        key: _number(path, f"{where}.{key}", table[key], allowed) for key, allowed in of_balls.items() if key in table
    }
    return ListedScan(scan, artefact, given, _text(path, table, "serial"), **balls)


def _known(path: Path, table: dict[str, Any], allowed: set[str], where: str = "") -> None:
    for key in table:
        if key not in allowed:
            raise ListError(f"LIST {path}: {where}{key} is unknown; allowed are {', '.join(sorted(allowed))}")


def _text(path: Path, table: dict[str, Any], key: str) -> str | None:
    value = table.get(key)
    if value is not None and not isinstance(value, str):
        raise ListError(f"LIST {path}: {key} is {value!r}; allowed is a text; put it in quotes")
    return value


def _number(path: Path, key: str, value: object, allowed: tuple[float, float]) -> float:
    low, high = allowed
    # TOML has true, inf and nan; Python counts true among the integers.
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        raise ListError(f"LIST {path}: {key} is {value!r}; allowed are numbers {low:g}..{high:g}; correct it")
    if not low <= value <= high:
        raise ListError(f"LIST {path}: {key} is {value:g}; allowed are {low:g}..{high:g}; correct it")
    return float(value)
