"""Generator of tables and picture of ``docs/accuracy.md`` from the files of runs."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from bench.document import short
from bench.metrology.table import PAPER, SAME_AS, JsonRow, summary
from bench.picture import Bar, Panel, draw

BEGIN, END = "<!-- figures: ./dev bench metrology --write-docs -->", "<!-- end of figures -->"
SETS = ("nominal", "realistic", "hard", "paper")
TARGETS: Mapping[tuple[str, str, str], float] = {
    ("realistic", "ba_spline_4", "E_Lb"): 0.05,
    ("realistic", "ba_spline_4", "E_Lp"): 0.10,
    ("realistic", "ba_spline_4", "E_F_sys"): 0.07,
    ("realistic", "ba_spline_10", "E_Lb"): 0.02,
    ("realistic", "ba_spline_10", "E_Lp"): 0.05,
    ("realistic", "salt_updated", "E_Lb"): 0.03,
    ("realistic", "ba_spline_4", "noise_mm"): 0.03,
}
"""What the median over the rigs of a set should keep, by set, rung and quantity."""
ROWS = {
    "pm_mapped": "`paper`, PM",
    "rm": "`paper`, RM",
    "rmd": "`paper`, RMD",
    "ba_ports": "`ports`",
    "ba_spline_4": "**`spline`**",
    "ba_spline_10": "**`spline`**",
    "salt_updated": "`spline`, salt water, index updated",
    "salt_not_updated": "`spline`, salt water, index not updated",
}
"""Rungs in the page's tables, by the names of the product's methods; the picture and the files have all."""
TABLE_SETS, TABLE_KEYS = ("realistic", "hard"), ("E_Lb", "E_Lp", "E_F_sys")
TITLES = {
    "E_Lb": "E_Lb %",
    "E_Lp": "E_Lp %",
    "E_F": "E_F %",
    "E_F_sys": "E_F,sys %",
    "noise_mm": "noise mm",
}


def collected(folder: Path) -> dict[str, dict[str, Any]]:
    """Return the runs of each set, with several files ``metrology-SET*.json`` of a set as one; missing sets are left
    out.

    Raises ValueError where files of a set were made differently or contain the same rig.
    """
    runs: dict[str, dict[str, Any]] = {}
    for name in SETS:
        for path in sorted(folder.glob(f"metrology-{name}*.json")):
            run = json.loads(path.read_text(encoding="utf-8"))
            combined = runs.setdefault(name, {**run, "rows": []})
            if any(run[key] != combined[key] for key in ("set", "resolution", "unseen")):
                raise ValueError(f"{path}: made otherwise than the other files of set {name}; measure or remove one")
            repeated = {(row["rung"], row["seed"]) for row in combined["rows"]} & {
                (row["rung"], row["seed"]) for row in run["rows"]
            }
            if repeated:
                raise ValueError(f"{path}: rig {min(repeated)[1]} of set {name} is in two files; remove one")
            combined["rows"] += run["rows"]
    return runs


def write_accuracy(folder: Path, document: Path, picture: Path) -> None:
    """Replace the text between the marks of ``document``, and draw ``picture``.

    Raises OSError, and ValueError for a document without marks or for runs that do not fit together.
    """
    text = document.read_text(encoding="utf-8")
    if BEGIN not in text or END not in text:
        raise ValueError(f"{document} has no marks {BEGIN} and {END}")
    runs = collected(folder)
    if not runs:
        raise ValueError(f"no metrology-*.json in {folder}; run ./dev bench metrology first")
    parts = [table(run) for name, run in runs.items() if name in TABLE_SETS]
    if "paper" in runs:
        parts.append(beside_the_paper(runs["paper"]["rows"]))
    before, after = text.split(BEGIN)[0], text.split(END)[1]
    document.write_text(before + BEGIN + "\n\n" + "\n\n".join(parts) + "\n\n" + END + after, encoding="utf-8")
    draw(picture, panels(runs))


def table(run: Mapping[str, Any]) -> str:
    """Return a table with the median (and worst) of a set's rigs, a line per rung."""
    rows: Sequence[JsonRow] = run["rows"]
    unseen = run["unseen"]
    seeds = sorted({row["seed"] for row in rows})
    lines = [
        (
            f"**Set {run['set']}**: {len(seeds)} {'rigs' if len(seeds) > 1 else 'rig'} "
            f"(seed {', '.join(str(seed) for seed in seeds)}), "
            f"{run['resolution'].replace('x', ' × ')}; per rig {unseen['bars']} unseen bars, {unseen['planes']} planes, "
            f"{unseen['frustums']} frustums. Median over the rigs (worst rig)."
        ),
        "",
        "| | scans | " + " | ".join(TITLES[key] for key in TABLE_KEYS) + " |",
        "|---|---:|" + "---:|" * len(TABLE_KEYS),
    ]
    summed = summary(rows)
    for rung in (rung for rung in ROWS if rung in summed):
        values = summed[rung]
        cells = [_cell(values[key], TARGETS.get((run["set"], rung, key))) for key in TABLE_KEYS]
        name = ROWS[rung] + (f" ({values['missing']} artefacts not found)" if values["missing"] else "")
        lines.append(f"| {name} | {values['recordings']} | {' | '.join(cells)} |")
    return "\n".join(lines)


def beside_the_paper(rows: Sequence[JsonRow]) -> str:
    """Return the table of the paper's Table 2 beside the same rungs here."""
    summed = summary(rows)
    keys = ("E_Lb", "E_Lp", "E_F", "noise_mm")
    lines = [
        "**Beside the paper's Table 2** (its instrument's largest errors; ours: median over the paper-like rigs, worst rig)",
        "",
        "| | " + " | ".join(f"{TITLES[key]}: paper | ours" for key in keys) + " |",
        "|---|" + "---:|" * (2 * len(keys)),
    ]
    for name, theirs in PAPER.items():
        ours = summed.get(SAME_AS[name])
        cells = [f"{theirs[key]:g} | {_cell(ours[key] if ours else None, None)}" for key in keys]
        lines.append(f"| {name} | {' | '.join(cells)} |")
    return "\n".join(lines)


def panels(runs: Mapping[str, Mapping[str, Any]]) -> list[Panel]:
    """Return the length errors of ball bars per set: bars to the median, whiskers from the best to the worst rig."""
    panels_of_sets = []
    for name, run in runs.items():
        values: dict[str, list[float]] = {}
        for row in run["rows"]:
            if row["E_Lb"] is not None:
                values.setdefault(row["rung"], []).append(row["E_Lb"])
        medians = summary(run["rows"])
        bars = [
            Bar(rung, medians[rung]["E_Lb"]["median"], (min(each), max(each)), TARGETS.get((name, rung, "E_Lb")))
            for rung, each in values.items()
        ]
        panels_of_sets.append(Panel(f"E_Lb in percent, set {name}", bars))
    return panels_of_sets


def _cell(value: Mapping[str, float] | None, target: float | None) -> str:
    if value is None:
        return "—"
    verdict = "" if target is None else f" ≤ {short(target)}{'' if value['median'] <= target else ' **missed**'}"
    return f"{_digits(value['median'])} ({_digits(value['worst'])}){verdict}"


def _digits(value: float) -> str:
    return f"{value:.3f}" if value < 0.9995 else f"{value:.2f}"
