"""Rows of a metrology run as files and tables: per rung and rig, and median and worst over the rigs."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from bench.metrology.hidden import Row

KEYS = ("E_Lb", "E_Lp", "E_F", "E_F_sys", "noise_mm", "gap_mm")
"""Values that are combined over rigs; errors are in percent."""
PAPER: Mapping[str, Mapping[str, float]] = {
    "PM": {"E_Lb": 1.0, "E_Lp": 1.45, "E_F": 1.7, "noise_mm": 0.05},
    "RM": {"E_Lb": 0.4, "E_Lp": 0.6, "E_F": 0.65, "noise_mm": 0.04},
    "RMD": {"E_Lb": 0.35, "E_Lp": 0.35, "E_F": 0.4, "noise_mm": 0.03},
}
"""Table 2 of Bräuer-Burchardt et al. 2015, in water."""
SAME_AS = {"PM": "pm_mapped", "RM": "rm", "RMD": "rmd"}
"""Our rung for each model of the paper."""

JsonRow = dict[str, Any]


def as_json(row: Row) -> JsonRow:
    """Return a row, JSON-ready; values that could not be measured are null."""
    errors = row.errors
    values = (errors.e_lb, errors.e_lp, errors.e_f, errors.e_f_sys, errors.noise_mm, errors.gap_mm)
    return {
        "rung": row.rung,
        "seed": row.seed,
        **dict(zip(KEYS, values, strict=True)),
        "recordings": row.recordings,
        "seconds": round(row.seconds, 3),
        "missing": list(errors.missing),
    }


def summary(rows: Iterable[JsonRow]) -> dict[str, dict[str, Any]]:
    """Return median and worst over rigs per rung and key, the number of rigs, and of artefacts that were not found."""
    per_rung: dict[str, list[JsonRow]] = {}
    for row in rows:
        per_rung.setdefault(row["rung"], []).append(row)
    combined: dict[str, dict[str, Any]] = {}
    for rung, rung_rows in per_rung.items():
        combined[rung] = {"rigs": len(rung_rows), "missing": sum(len(row["missing"]) for row in rung_rows)}
        for key in (*KEYS, "seconds"):
            values = [row[key] for row in rung_rows if row[key] is not None]
            combined[rung][key] = {"median": float(np.median(values)), "worst": max(values)} if values else None
        combined[rung]["recordings"] = rung_rows[0]["recordings"]
    return combined


def write(path: Path, settings: Mapping[str, Any], rows: Sequence[JsonRow]) -> None:
    """Write the file of a run, as a whole or not at all."""
    content = {**settings, "rows": list(rows), "summary": summary(rows)}
    if settings["set"] == "paper":
        content["paper"] = {name: dict(values) for name, values in PAPER.items()}
    path.parent.mkdir(parents=True, exist_ok=True)
    part = path.with_suffix(".part")
    part.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")
    part.replace(path)


def text(settings: Mapping[str, Any], rows: Sequence[JsonRow]) -> str:
    """Return tables for a terminal."""
    lines = [f"{'rung':<20} {'seed':>5} {'E_Lb':>8} {'E_Lp':>8} {'E_F':>8} {'E_F,sys':>8} {'noise':>8} {'gap':>8}"]
    for row in rows:
        numbers = " ".join(_number(row[key]) for key in KEYS)
        missing = f"  {len(row['missing'])} not found" if row["missing"] else ""
        lines.append(f"{row['rung']:<20} {row['seed']:>5} {numbers} {row['seconds']:6.1f} s{missing}")
    lines += ["", f"{'median over rigs':<26} (worst)"]
    summed = summary(rows)
    for rung, values in summed.items():
        numbers = " ".join(
            " " * 17 if (v := values[key]) is None else f"{_number(v['median'])} ({v['worst']:6.4f})" for key in KEYS
        )
        lines.append(f"{rung:<20} {numbers}")
    if settings["set"] == "paper":
        lines += ["", "Table 2 of the paper, and ours (median, worst)"]
        for name, theirs in PAPER.items():
            ours = summed.get(SAME_AS[name], {})
            for key, value in theirs.items():
                mine = ours.get(key)
                value_text = "not measured" if mine is None else f"{mine['median']:.3f}  {mine['worst']:.3f}"
                lines.append(f"{name:<4} {key:<9} {value:5.2f}   {value_text}")
    return "\n".join(lines) + "\n"


def _number(value: float | None) -> str:
    return f"{'-':>8}" if value is None else f"{value:8.4f}"
