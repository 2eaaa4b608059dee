"""Figures of the verdict on motion: counts with their limits, and ROC curves, from one row for each scene."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from bench.result import Measurement
from bench.verdict.binomial import rate, tally
from bench.verdict.motion_cases import KINDS

HARMFUL, HARMLESS, LOST = 0.10, 0.05, 0.10
"""Limits of the added noise, as a fraction, and share of lost points that is harmful as well."""
REFUSED_PERCENT, COMPENSATED_MOST = 99.0, 1.2
"""Share of harmful scans that must be rejected, and limit of the error of compensated scans over that at rest."""
GROUPS = {"untextured": ("none",), "slight": ("slight",), "textured": ("strong", "checker")}
DISTURBANCES = ("flicker", "waves", "specks", "turbid", "dark", "period 16", "period 32", "period 64", "small")
Row = Mapping[str, Any]
Rows = Sequence[Row]


def harmful(row: Row) -> bool:
    """Return True if the motion adds over 10 % to the noise."""
    return row["added_percent"] is not None and row["added_percent"] > 100.0 * HARMFUL


def harmless(row: Row) -> bool:
    """Return True if the motion adds under 5 % to the noise."""
    return row["added_percent"] is not None and row["added_percent"] < 100.0 * HARMLESS


def keeps_points(row: Row) -> bool:
    """Return True if nine tenths of the points are left."""
    return bool(row["lost_percent"] < 100.0 * LOST)


def refused(row: Row, take: str = "moving") -> bool:
    """Return True if the verdict rejects the recording ``take``."""
    return row[take]["passed"] is False


def compensated(row: Row) -> bool:
    """Return True if the scan was rejected and then shown compensated."""
    return bool(row.get("compensated"))


def figures(rows: Rows, cpu_ms: float) -> list[Measurement]:
    """Return the figures with their targets; compensated scans are counted separately."""
    judged = [row for row in rows if row["at_rest"]["passed"] is not None]
    alarms = sum(refused(row, "at_rest") for row in judged)
    measured = [tally("motion: at rest and refused", alarms, len(judged), at_most=0.0, key="motion_false_alarms")]
    hands = [row for row in rows if row["kind"] != "fish"]
    fish = [row for row in rows if row["kind"] == "fish"]
    gross = [row for row in hands if harmful(row) and row["added_percent"] > 20.0]
    calm = [row for row in hands if harmless(row)]
    targets: list[tuple[str, Rows, float | None, float | None]] = [
        ("adding over 10 %", [row for row in hands if harmful(row)], REFUSED_PERCENT, None),
        ("adding over 20 %", gross, None, None),
        ("adding under 5 %", calm, None, 0.0),
        ("adding under 5 %, nine tenths kept", [row for row in calm if keeps_points(row)], None, 0.0),
        ("fish adding over 10 %", [row for row in fish if harmful(row)], None, None),
        ("fish adding under 5 %", [row for row in fish if harmless(row)], None, None),
    ]
    for what, mine, at_least, at_most in targets:
        mine = [row for row in mine if row["moving"]["passed"] is not None]
        stopped = [row for row in mine if refused(row)]
        name = f"motion: refused, of those {what}"
        measured.append(rate(name, len(stopped), len(mine), at_most=at_most, at_least=at_least))
        if stopped:
            shown = f"motion: shown compensated, of those refused {what}"
            measured.append(tally(shown, sum(map(compensated, stopped)), len(stopped)))
    undone = [row for row in hands if compensated(row)]
    over_rest = [row["compensated_over_rest"] for row in undone if row["compensated_over_rest"] is not None]
    beyond = sum(value > COMPENSATED_MOST for value in over_rest)
    measured.append(
        tally(
            f"motion: shown compensated and erring over {COMPENSATED_MOST:g} times as at rest",
            beyond,
            len(over_rest),
            at_most=0.0,
        )
    )
    left = [row for row in hands if harmful(row)]
    unjudged = sum(row["moving"]["passed"] is None for row in left)
    measured.append(tally("motion: adding over 10 %, too few points left to be judged", unjudged, len(left)))
    ratio = ratios(hands)
    measured.append(
        Measurement(
            f"motion: predicted over true addition near the limit ({len(ratio)})",
            float(np.median(ratio)) if ratio else math.nan,
            "",
            why=None if ratio else "none between 3 and 30 %",
            spread=_tenths(ratio),
        )
    )
    measured.append(
        Measurement("motion: CPU of a verdict on 2 x 24 frames of 1600 x 1200", cpu_ms, "ms", at_most=60.0)
    )  # fmt: skip
    return measured


def ratios(rows: Rows) -> list[float]:
    """Return predicted over true added noise, where the true one is 3 to 30 %."""
    return [
        (0.1 + (row["moving"]["added_percent"] or 0.0)) / (0.1 + row["added_percent"])
        for row in rows
        if row["added_percent"] is not None and 3.0 < row["added_percent"] < 30.0
    ]


def _tenths(values: Sequence[float]) -> tuple[float, float] | None:
    if not values:
        return None
    low, high = np.percentile(values, (10.0, 90.0))
    return float(low), float(high)


def roc(positive: Sequence[float], negative: Sequence[float]) -> tuple[list[float], list[float], float]:
    """Return the shares of negatives and positives above every threshold, and the area under that curve."""
    if not positive or not negative:
        return [], [], float("nan")
    p, n = np.asarray(positive), np.asarray(negative)
    limits = np.unique(np.concatenate([p, n, [np.inf, -np.inf]]))[::-1]
    false = [float(np.mean(n >= limit)) for limit in limits]
    true = [float(np.mean(p >= limit)) for limit in limits]
    return false, true, float(np.trapezoid(true, false))


def roc_table(rows: Rows) -> dict[str, dict[str, Any]]:
    """Return ROC curves of the judged scans for each group of textures with each kind of motion, and each disturbance.

    JSON-ready: ``harm`` (over 10 % against at rest and below 5 %, by the predicted addition) and ``seen`` (moving
    against at rest, by the largest score).
    """
    table = {
        f"{group} {kind}": _curves([row for row in rows if row["texture"] in textures and row["kind"] == kind], rows)
        for group, textures in GROUPS.items()
        for kind in KINDS
    }
    for name in DISTURBANCES:
        mine = [row for row in rows if name in row["classes"]]
        table[name] = _curves(mine, mine)
    return table


def _curves(mine: Rows, at_rest: Rows) -> dict[str, Any]:
    mine = [row for row in mine if row["moving"]["passed"] is not None]
    at_rest = [row for row in at_rest if row["at_rest"]["passed"] is not None]
    rest_added = [row["at_rest"]["added_percent"] or 0.0 for row in at_rest]
    bad = [row["moving"]["added_percent"] or 0.0 for row in mine if harmful(row)]
    good = [row["moving"]["added_percent"] or 0.0 for row in mine if harmless(row) and keeps_points(row)]
    curves = {
        "harm": (*roc(bad, good + rest_added), len(bad)),
        "seen": (
            *roc([row["moving"]["score"] or 0.0 for row in mine], [row["at_rest"]["score"] or 0.0 for row in at_rest]),
            len(mine),
        ),
    }
    return {
        name: {
            "false": [round(x, 4) for x in f],
            "true": [round(x, 4) for x in t],
            "area": None if np.isnan(a) else round(a, 4),
            "positives": n,
        }
        for name, (f, t, a, n) in curves.items()
    }
