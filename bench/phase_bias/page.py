"""Owns the tables of ``docs/phase-bias.md``: written from what was measured, never by hand."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

BEGIN, END = "<!-- figures: ./dev bench phase_bias --write-docs -->", "<!-- end of figures -->"
TITLES = {
    "response": "Harmonics of the fringes, in parts of the first; 64 px",
    "causes": "One cause at a time; no noise, no paint, 16 px",
    "periods": "As the instrument is, 500 mm",
    "distances": "As the instrument is, 16 px",
    "paint": "Paint; a straight response, 16 px",
    "artefacts": "Full images of a ball bar, a plane and a frustum, the true calibration, 16 px",
}


def write_page(measured: Path, page: Path) -> None:
    """Replace what lies between the marks. Raises OSError, and ValueError for a page without marks."""
    rows: list[dict[str, Any]] = json.loads(measured.read_text(encoding="utf-8"))["rows"]
    text = page.read_text(encoding="utf-8")
    if BEGIN not in text or END not in text:
        raise ValueError(f"{page} has no marks {BEGIN} and {END}")
    lines: list[str] = []
    for table, title in TITLES.items():
        mine = [row for row in rows if row["table"] == table]
        if not mine:
            continue
        columns = list(mine[0]["values"])
        lines += ["", f"| {title} | {' | '.join(columns)} |", "|---|" + "---:|" * len(columns)]
        lines += [f"| {row['name']} | {' | '.join(short(row['values'][c]) for c in columns)} |" for row in mine]
    before, after = text.split(BEGIN)[0], text.split(END)[1]
    page.write_text(before + BEGIN + "\n" + "\n".join(lines) + "\n\n" + END + after, encoding="utf-8")


def short(value: float) -> str:
    """Enough digits to compare, and no more."""
    size = abs(value)
    return (
        f"{value:.0f}"
        if size >= 100
        else f"{value:.1f}"
        if size >= 10
        else f"{value:.2f}"
        if size >= 0.1
        else f"{value:.4f}"
    )
