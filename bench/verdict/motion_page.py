"""Generator of table, curves and pictures of ``docs/motion.md`` from measured values."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from bench.verdict.binomial import count_text
from bench.verdict.motion_figures import Rows, compensated, harmful, harmless, keeps_points, ratios, refused, roc_table
from bench.verdict.motion_pictures import draw_roc, draw_scatter

BEGIN, END = "<!-- table: ./dev bench verdict --write-docs -->", "<!-- end of table -->"


def write_page(content: Mapping[str, Any], docs: Path) -> None:
    """Write the page from a measurement's file with the part ``motion``.

    Raises OSError, and ValueError for a page without marks.
    """
    page, data = docs / "motion.md", content["parts"]["motion"]["data"]
    text = page.read_text(encoding="utf-8")
    if BEGIN not in text or END not in text:
        raise ValueError(f"{page} has no marks {BEGIN} and {END}")
    before, after = text.split(BEGIN)[0], text.split(END)[1]
    lines = table(data["scans"], data["cpu_ms"], content["version"])
    page.write_text(before + BEGIN + "\n" + "\n".join(lines) + "\n" + END + after, encoding="utf-8")
    draw_scatter(docs / "pictures" / "motion-harm.png", data["scans"])
    draw_roc(docs / "pictures" / "motion-roc.png", data["scans"])
    (docs / "motion-roc.json").write_text(json.dumps(roc_table(data["scans"])) + "\n", encoding="utf-8")


def table(rows: Rows, cpu_ms: float, version: str | None) -> list[str]:
    """Return the table as lines of Markdown."""
    hands = [row for row in rows if row["kind"] != "fish"]
    judged_at_rest = [row for row in rows if row["at_rest"]["passed"] is not None]
    judged = [row for row in hands if row["moving"]["passed"] is not None]
    largest = max(row["at_rest"]["added_percent"] for row in judged_at_rest)

    def share(mine: Rows) -> str:
        return count_text(sum(map(refused, mine)), len(mine))

    bad, good = [row for row in judged if harmful(row)], [row for row in judged if harmless(row)]
    ratio = ratios(judged)
    alarms = count_text(sum(refused(row, "at_rest") for row in judged_at_rest), len(judged_at_rest))
    near = "none" if not ratio else "{:.2f}, {:.2f} to {:.2f}".format(*np.percentile(ratio, (50, 10, 90)))
    gone = [100.0 - row["lost_percent"] for row in hands if harmful(row) and row["moving"]["passed"] is None]

    def undone(mine: Rows) -> str:
        stopped = [row for row in mine if refused(row)]
        return count_text(sum(map(compensated, stopped)), len(stopped))

    with_points = [row for row in good if keeps_points(row)]
    lines = [
        (
            f"{len(rows)} scenes, each at rest and moving; {len(rows) - len(judged_at_rest)} too dark or milky to be "
            "judged. In brackets 95 % limits."
        ),
        "",
        "| | measured | of these shown compensated | target |",
        "|---|---|---|---|",
        f"| at rest and refused | {alarms}; largest predicted addition {largest:.1f} % | – | 0 |",
        f"| refused, of those whose hands add over 10 % | {share(bad)} | {undone(bad)} | 99 % |",
        f"| harmful, but not judged: they keep {min(gone, default=0.0):.0f} to {max(gone, default=0.0):.0f} % of their points | {len(gone)} | – | – |",
        f"| refused, of those that add under 5 % | {share(good)} | {undone(good)} | 0 |",
        f"| the same, that keep 90 % of the points | {share(with_points)} | {undone(with_points)} | 0 |",
        f"| predicted over true addition between 3 and 30 %: median, first and ninth tenth ({len(ratio)}) | {near} | – | – |",
        f"| CPU for 2 × 24 frames of 1600 × 1200 | {cpu_ms:.0f} ms | – | 60 ms |",
        "",
        f"*Figures of {version}.*",
        "",
    ]
    for what, mine in (
        ("Harmful and kept", [row for row in bad if not refused(row)]),
        ("Harmless and refused", [row for row in good if refused(row)]),
        ("At rest and refused", [row for row in judged_at_rest if refused(row, "at_rest")]),
    ):
        for row in mine:
            lines.append(
                f"- {what}: {row['kind']} {row['speed_mm_s']:.1f} mm/s, {row['texture']} {row['object']} ({', '.join(row['classes'][1:])}): "
                f"adds {row['added_percent'] or 0.0:.1f} %, predicted {row['moving']['added_percent'] or 0.0:.1f} %, "
                f"loses {row['lost_percent']:.0f} % of the points."
            )
    return lines
