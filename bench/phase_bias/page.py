"""Generator of the table in ``docs/phase-bias.md`` from measured values."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

BEGIN, END = "<!-- figures: ./dev bench phase_bias --write-docs -->", "<!-- end of figures -->"
TABLE, TITLE = "distances", "As the instrument is, 16 px"
COLUMNS = ("ripple of depth, µm", "rms, µm", "rms in sigmas")
"""Of the page's table; the other tables are printed and kept as JSON."""


def write_page(measured: Path, page: Path) -> None:
    """Replace the text between the marks. Raises OSError, and ValueError for a page without marks."""
    rows: list[dict[str, Any]] = json.loads(measured.read_text(encoding="utf-8"))["rows"]
    text = page.read_text(encoding="utf-8")
    if BEGIN not in text or END not in text:
        raise ValueError(f"{page} has no marks {BEGIN} and {END}")
    lines = [f"| {TITLE} | {' | '.join(COLUMNS)} |", "|---|" + "---:|" * len(COLUMNS)]
    lines += [
        f"| {row['name']} | {' | '.join(short(row['values'][c]) for c in COLUMNS)} |"
        for row in rows
        if row["table"] == TABLE
    ]
    before, after = text.split(BEGIN)[0], text.split(END)[1]
    page.write_text(before + BEGIN + "\n\n" + "\n".join(lines) + "\n\n" + END + after, encoding="utf-8")


def short(value: float) -> str:
    """Return as many digits as a comparison needs."""
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
