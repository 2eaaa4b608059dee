"""Generator of the table and the curve of ``docs/compensation.md`` from measured values."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from bench.verdict.calibrations import KINDS
from bench.verdict.compensation_curve import draw_curve

END = "<!-- end of table -->"
Rows = Sequence[Mapping[str, Any]]


MARK = "<!-- compensation_full: ./dev bench verdict --write-docs -->"


def write_page(content: Mapping[str, Any], docs: Path) -> None:
    """Write the table and the curve of the parts that a measurement's file has.

    Raises OSError, and ValueError for a page without the table's marks.
    """
    page, parts = docs / "compensation.md", content["parts"]
    if "compensation_full" in parts:
        rows = [*table(parts["compensation_full"]["data"]["rows"]), "", f"*Figures of {content['version']}.*"]
        page.write_text(_put(page.read_text(encoding="utf-8"), MARK, rows), encoding="utf-8")
    if "compensation_speed" in parts:
        draw_curve(docs / "pictures" / "compensation-speed.png", parts["compensation_speed"]["data"]["rows"])


def table(rows: Rows) -> list[str]:
    """Return lines of Markdown: a row for each scan that was solved with a calibrated rig."""
    lines = [
        "| scan | paint | at rest, mm | as decoded, over at rest | compensated, over at rest | in own σ |",
        "|---|---|---|---|---|---|",
    ]
    for row in rows:
        if row["calibration"] != KINDS[-1]:
            continue
        after = f"{row['after']:.2f} ({row['completeness_after']:.0f})" if row["used"] else f"not used: {row['why']}"
        sigmas = "–" if row["in_sigmas"] is None else f"{row['in_sigmas']:.2f} ({row['in_sigmas_at_rest']:.2f})"
        lines.append(
            f"| {row['name']} | {row['texture']} | {row['at_rest_mm']:.4f} ({row['completeness_at_rest']:.0f}) "
            f"| {row['before']:.2f} ({row['completeness_before']:.0f}) | {after} | {sigmas} |"
        )
    return lines


def _put(text: str, mark: str, lines: Sequence[str]) -> str:
    if mark not in text:
        raise ValueError(f"docs/compensation.md has no mark {mark}")
    before, after = text.split(mark, 1)
    if END not in after:
        raise ValueError(f"docs/compensation.md: nothing ends the table after {mark}")
    return before + mark + "\n" + "\n".join(lines) + "\n" + END + after.split(END, 1)[1]
