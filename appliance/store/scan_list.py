"""A metrologist's list of scans: which scan shows which artefact, and its certificate's numbers.

It is read before any module that computes is loaded, so that a wrong word in it is reported at once.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from appliance.base import Within, parse_toml, read_text
from appliance.measure import LENGTHS, REFERENCE_MM, Artefact, Symbol

MOST_BYTES = 1_000_000
LENGTH_MM, REFERENCE_RANGE_MM = (1.0, 2000.0), (10.0, 5000.0)
SD_MM, RADIUS_MM, LIMIT_MM = (1e-5, 1.0), (1.0, 100.0), (1e-4, 10.0)
_TOP_KEYS = {"operator", "reference_mm", "scan", "limits"}
LIMITS = {f"{symbol.value.lower()}_mm": symbol for symbol in Symbol}
"""Keys of ``[limits]``: the maximum permissible error of each quantity."""


class ListError(Exception):
    """Error of a list of scans that cannot be used.

    The text has the key, its value, the allowed range and the remedy.
    """


@dataclass(frozen=True, slots=True)
class ListedScan:
    """One scan of the list, and the artefact that it shows."""

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
    """Maximum permissible errors; a missing quantity has no limit."""

    @classmethod
    def read(cls, path: Path) -> ScanList:
        """Read a list, TOML or (by its name) JSON: ``docs/evaluation.md``. Raises ListError."""
        try:
            text = read_text(path, MOST_BYTES)
            content = json.loads(text) if path.suffix == ".json" else parse_toml(text)
        except OSError as error:
            raise ListError(f"LIST {path}: cannot be read ({error.strerror}); give the list of scans") from error
        except (ValueError, RecursionError) as error:
            raise ListError(f"LIST {path}: not readable ({error}); see docs/evaluation.md") from error
        if not isinstance(content, dict):
            raise ListError(f"LIST {path}: is a {type(content).__name__}; allowed is a table; see docs/evaluation.md")
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
        return cls(
            tuple(_entry(path, k, table) for k, table in enumerate(tables)),
            _text(path, content, "operator"),
            _number(path, "reference_mm", reference, REFERENCE_RANGE_MM),
            {LIMITS[key]: _number(path, f"limits.{key}", value, LIMIT_MM) for key, value in limits.items()},
        )

    def refuse_repeats(self, path: Path, folders: Sequence[Path]) -> None:
        """Raise ListError for an artefact that appears twice in one scan's folder: it would count twice.

        ``path``: the list, for the message; ``folders``: those of the scans.
        """
        first_by_artefact: dict[tuple[Path, Artefact], int] = {}
        for k, (entry, folder) in enumerate(zip(self.entries, folders, strict=True)):
            first = first_by_artefact.setdefault((folder.resolve(), entry.artefact), k)
            if first != k:
                raise ListError(
                    f"LIST {path}: scan[{k}] ({entry.scan!r:.60}) is scan[{first}] "
                    f"({self.entries[first].scan!r:.60}) again, with the same artefact "
                    f"{entry.artefact.value}; remove one of them"
                )


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
    ball_limits = (
        {"length_sd_mm": SD_MM, "radius_mm": RADIUS_MM, "radius_sd_mm": SD_MM} if artefact is Artefact.BALL_BAR else {}
    )
    _known(path, table, {"scan", "artefact", "serial", *lengths, *ball_limits}, f"{where}.")
    scan = table.get("scan")
    if not isinstance(scan, str) or not scan:
        raise ListError(f"LIST {path}: {where}.scan is {scan!r}; allowed is a text: the scan's number or its folder")
    lengths_mm = {
        name: _number(path, f"{where}.{key}", table[key], LENGTH_MM) for key, name in lengths.items() if key in table
    }
    if lengths and not lengths_mm:
        raise ListError(
            f"LIST {path}: {where} has no calibrated length; give {' or '.join(lengths)} of its certificate"
        )
    ball_values = {
        key: _number(path, f"{where}.{key}", table[key], allowed)
        for key, allowed in ball_limits.items()
        if key in table
    }
    return ListedScan(scan, artefact, lengths_mm, _text(path, table, "serial"), **ball_values)


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
    within = Within(*allowed)
    if not within.takes(value):
        raise ListError(f"LIST {path}: {key} is {value!r:.60}; allowed are numbers {within.allowed}; correct it")
    return float(value)
