"""Generator of tables and curve of ``docs/compensation.md`` from measured values."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from bench.verdict.compensation_curve import draw_curve

END = "<!-- end of table -->"
Rows = Sequence[Mapping[str, Any]]


def begin(name: str) -> str:
    """The mark above the table ``name`` (a part's name, with the seed where there are several)."""
    return f"<!-- {name}: ./dev bench verdict --write-docs -->"


def write_page(content: Mapping[str, Any], docs: Path) -> None:
    """Of a measurement's file: a table for each part that it has, of the file's seed.

    Raises OSError, and ValueError for a page without the part's marks.
    """
    page, parts = docs / "compensation.md", content["parts"]
    text = page.read_text(encoding="utf-8")
    seed = content["seed"]
    if "compensation" in parts:
        data = parts["compensation"]["data"]
        text = _put(text, begin(f"compensation, seed {seed}"), table(data["named"]))
        text = _put(text, begin(f"drawn, seed {seed}"), summary(data["drawn"])) if len(data["drawn"]) > 2 else text
    if "compensation_full" in parts:
        text = _put(text, begin("compensation_full"), table(parts["compensation_full"]["data"]["rows"]))
    if "compensation_hard" in parts:
        text = _put(text, begin("compensation_hard"), table(parts["compensation_hard"]["data"]["rows"]))
    if "compensation_speed" in parts:
        draw_curve(docs / "pictures" / "compensation-speed.png", parts["compensation_speed"]["data"]["rows"])
    page.write_text(text, encoding="utf-8")


def table(rows: Rows) -> list[str]:
    """Lines of Markdown: a row for each scan, exact and calibrated rig side by side."""
    lines = [
        "| scan | paint | rig | at rest, mm | as decoded, over at rest | compensated, over at rest | in own sigmas (at rest) | CPU, s |",
        "|---|---|---|---|---|---|---|---|",
    ]
    for row in rows:
        after = f"{row['after']:.2f} ({row['completeness_after']:.0f})" if row["used"] else f"not used: {row['why']}"
        sigmas = "–" if row["in_sigmas"] is None else f"{row['in_sigmas']:.2f} ({row['in_sigmas_at_rest']:.2f})"
        lines.append(
            f"| {row['name']} | {row['texture']} | {row['calibration']} | {row['at_rest_mm']:.4f} ({row['completeness_at_rest']:.0f}) "
            f"| {row['before']:.2f} ({row['completeness_before']:.0f}) | {after} | {sigmas} | {row['cpu_s']:.1f} |"
        )
    return lines


def summary(rows: Rows) -> list[str]:
    """Return the summary of random scans: how many were shown compensated, and their gain."""
    used = sorted((row for row in rows if row["used"]), key=lambda row: -float(row["after"] / row["before"]))
    left = [row for row in rows if not row["used"] and row["moved"]]
    still = [row for row in rows if not row["moved"]]
    touched = sum(bool(row["used"]) for row in still)
    lines = [
        f"{len(rows)} judgements; {len(used)} shown compensated, {len(left)} moved ones left as they are, {len(still)} at rest, {touched} of them touched.",
        "Those shown, least gain first:",
        "",
        "| scan | paint | rig | as decoded, over at rest | compensated |",
        "|---|---|---|---|---|",
    ]
    lines += [
        f"| {row['name']} | {row['texture']} | {row['calibration']} | {row['before']:.2f} ({row['completeness_before']:.0f}) "
        f"| {row['after']:.2f} ({row['completeness_after']:.0f}) |"
        for row in used
    ]
    return lines


def _put(text: str, mark: str, lines: Sequence[str]) -> str:
    if mark not in text:
        raise ValueError(f"docs/compensation.md has no mark {mark}")
    before, after = text.split(mark, 1)
    if END not in after:
        raise ValueError(f"docs/compensation.md: nothing ends the table after {mark}")
    return before + mark + "\n" + "\n".join(lines) + "\n" + END + after.split(END, 1)[1]
