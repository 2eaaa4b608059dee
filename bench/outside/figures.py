"""Figures over the rows of scans: completeness, outliers, error over sigma, false alarms."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from appliance.measure.fault import FaultCode
from bench.outside.kept import Row
from bench.result import Measurement
from bench.verdict.binomial import tally

HONEST = 1.5
"""Ratio of errors to expected errors above which a scan needs a verdict with the cause."""
MEDIAN_LEAST, MEDIAN_MOST = 0.9, 1.1
MOST_PPM = 100.0
FALSE_ALARMS = {
    "identity": FaultCode.PATTERN_WRONG,
    "light": FaultCode.LIGHT_FLICKERS,
    "window": FaultCode.WINDOW,
}
"""Faults that no drawn scene has: each frame shows the pattern it should, light is steady, windows are clean."""
CALIBRATION = "the calibration's health"
"""Name of the false alarm of calibration health, over the scans of one instrument with a true calibration."""
SOFT = "soft scenes"


def is_soft(row: Row) -> bool:
    """Return True if the scene's object is not rigid."""
    return "soft" in row["families"]


def of_scenes(rows: Sequence[Row]) -> list[Measurement]:
    """Return the figures of random scenes with their limits; soft ones are counted separately and have none."""
    rigid, soft = [row for row in rows if not is_soft(row)], [row for row in rows if is_soft(row)]
    accepted = [row for row in rigid if row["accepted"]]
    measured = [
        Measurement("scenes that are rigid", len(rigid), ""),
        tally("accepted", len(accepted), len(rigid)),
        Measurement("completeness, median of accepted", median(rows_of(accepted, "complete_percent")), "%"),
        Measurement("completeness, median of all", median(rows_of(rigid, "complete_percent")), "%"),
        Measurement("outliers over 1 mm in accepted scans", ppm(accepted), "ppm", at_most=MOST_PPM),
        Measurement("outliers over 1 mm in all scans", ppm(rigid), "ppm"),
        Measurement(
            "error over sigma, median of accepted", median(rows_of(accepted, "error_over_sigma")), "",
            at_most=MEDIAN_MOST, at_least=MEDIAN_LEAST,
        ),
        tally("of these above 1.5 and nothing said", len(unsaid(accepted)), len(accepted), at_most=0.0),
        Measurement("noise, median of accepted", median(rows_of(accepted, "rms_um")), "µm"),
    ]  # fmt: skip
    measured += false_alarms(rigid)
    if soft:
        accepted_soft = [row for row in soft if row["accepted"]]
        measured += [
            Measurement(SOFT, len(soft), ""),
            tally("soft scenes that are accepted", len(accepted_soft), len(soft)),
            Measurement("outliers over 1 mm in these", ppm(accepted_soft), "ppm"),
            Measurement("error over sigma in these, median", median(rows_of(accepted_soft, "error_over_sigma")), ""),
            *false_alarms(soft, f"{SOFT}: "),
        ]
    return measured


def false_alarms(rows: Sequence[Row], prefix: str = "") -> list[Measurement]:
    """Return how many of these scans raise a fault that no drawn scene has; names begin with ``prefix``."""
    return [
        tally(
            f"{prefix}false alarms of {name}", sum(code.value in row["faults"] for row in rows), len(rows), at_most=0.0
        )
        for name, code in FALSE_ALARMS.items()
    ]


def of_families(rows: Mapping[str, Sequence[Row]], few: int) -> list[dict[str, Any]]:
    """Return one row of figures for each name, all on the same ``few`` scenes."""
    return [
        summary(name, [row for row in family_rows if row["number"] < few and not is_soft(row)])
        for name, family_rows in rows.items()
    ]


def summary(name: str, rows: Sequence[Row]) -> dict[str, Any]:
    """Return the figures of one table's row, ready for JSON."""
    accepted = [row for row in rows if row["accepted"]]
    ratios = rows_of(rows, "error_over_sigma")
    return {
        "name": name,
        "scenes": len(rows),
        "accepted": len(accepted),
        "complete_percent": known(median(rows_of(rows, "complete_percent"))),
        "outliers_ppm": known(ppm(accepted)),
        "outliers_all_ppm": known(ppm(rows)),
        "error_over_sigma": known(median(ratios)),
        "error_over_sigma_most": max(ratios, default=None),
        "unsaid": len(unsaid(accepted)),
        "rms_um": known(median(rows_of(rows, "rms_um"))),
        "faults": dict(Counter(code for row in rows for code in row["faults"])),
    }


def unsaid(rows: Sequence[Row]) -> list[Row]:
    """Return the scans with errors beyond ``HONEST`` times the expected ones and no fault."""
    return [row for row in rows if (row["error_over_sigma"] or 0.0) > HONEST and not row["faults"]]


def rows_of(rows: Sequence[Row], key: str) -> list[float]:
    """Return a figure of all rows that have it."""
    return [float(row[key]) for row in rows if row[key] is not None]


def ppm(rows: Sequence[Row]) -> float:
    """Return the share of points that are more than a millimetre off, of all points of all rows; NaN without points."""
    points = sum(row["points"] for row in rows)
    return 1e6 * sum(row["outliers"] for row in rows) / points if points else math.nan


def median(values: Sequence[float]) -> float:
    """Return the median, NaN without values."""
    return float(np.median(values)) if len(values) else math.nan


def known(value: float) -> float | None:
    """Return the value, ``None`` for NaN, as JSON wants it."""
    return None if math.isnan(value) else value
