"""Owns the table of ``docs/outside-world.md`` that compares the simulator's veil with photons: written from what was measured, never by hand."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

BEGIN, END = "<!-- veil: ./dev bench veil --write-docs -->", "<!-- end of veil -->"
PERIODS_PX = (16.0, 32.0, 64.0)


@dataclass(frozen=True, slots=True)
class Checked:
    """One ray through one water: what photons bring along it, and what the simulator draws there."""

    per_m: float
    index: float
    """Of the particles, over the water's."""
    pixel: tuple[int, int]
    """Column and row."""
    more: float
    """All light of the photons over that which was scattered once."""
    more_error: float
    over: float
    """All light of the simulator over the photons'."""
    photons: tuple[tuple[float, ...], tuple[float, ...]]
    """Contrast kept of fringes in rows of each of ``PERIODS_PX``: of single scattering, and of all light."""
    simulated: tuple[tuple[float, ...], tuple[float, ...]]
    """The same of the simulator."""
    errors: tuple[float, ...]
    """Standard errors of the photons' contrasts of all light."""


def table(rows: Sequence[Checked]) -> list[str]:
    """Return lines of Markdown."""
    head = ["water", "ray (of 400 × 300)", "all light, simulator over photons"]
    head += [f"contrast kept of {period:g} px: photons; simulator" for period in PERIODS_PX]
    lines = [f"| {' | '.join(head)} |", "|" + "---|" * len(head)]
    for row in rows:
        cells = [f"{row.per_m:g} /m, n {row.index:g}", "{}, {}".format(*row.pixel), f"{row.over:.2f}"]
        cells += [f"{one:.2f}; {other:.2f}" for one, other in zip(row.photons[1], row.simulated[1], strict=True)]
        lines.append(f"| {' | '.join(cells)} |")
    return lines


def errors(rows: Sequence[Checked]) -> str:
    """Return the sentence on how certain the photons are, water by water."""
    said = []
    for per_m in sorted({row.per_m for row in rows}):
        mine = [row for row in rows if row.per_m == per_m]
        bright = 100.0 * max(row.more_error / row.more for row in mine)
        said.append(
            f"{bright:.1g} % of brightness and {max(max(row.errors) for row in mine):.1g} of contrast at {per_m:g} /m"
        )
    return f"The photons' standard errors are at most {', '.join(said)}. Nothing was fitted to them."


def write_page(rows: Sequence[Checked], page: Path) -> None:
    """Write the table between the page's marks. Raises ValueError for a page without marks; it is left as it was."""
    head, above, rest = page.read_text(encoding="utf-8").partition(BEGIN)
    _, below, tail = rest.partition(END)
    if not above or not below:
        raise ValueError(f"{page}: no place for the table; needed are the lines {BEGIN!r} and {END!r}")
    lines = [head + BEGIN, "", *table(rows), "", errors(rows), "", END + tail]
    page.write_text("\n".join(lines), encoding="utf-8")
