"""Generator of the table in ``docs/outside-world.md`` that compares simulated backscatter with photons."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

BEGIN, END = "<!-- veil: ./dev bench veil --write-docs -->", "<!-- end of veil -->"
PERIODS_PX = (16.0, 32.0, 64.0)


@dataclass(frozen=True, slots=True)
class RayBackscatter:
    """Backscatter along one ray through one water, by photons and by the simulator."""

    per_m: float
    index: float
    """Refractive index of the particles over that of the water."""
    pixel: tuple[int, int]
    """Column and row."""
    more: float
    """All light of the photons over light that was scattered once."""
    more_error: float
    over: float
    """All light of the simulator over that of the photons."""
    photons: tuple[tuple[float, ...], tuple[float, ...]]
    """Remaining contrast of fringes in rows for each of ``PERIODS_PX``: of single scattering, and of all light."""
    simulated: tuple[tuple[float, ...], tuple[float, ...]]
    """Remaining contrast in the simulator, in the same order."""
    errors: tuple[float, ...]
    """Standard errors of the photons' contrasts of all light."""


def table(rows: Sequence[RayBackscatter]) -> list[str]:
    """Return the table as lines of Markdown."""
    head = ["water", "ray (of 400 × 300)", "all light, simulator over photons"]
    head += [f"contrast kept of {period:g} px: photons; simulator" for period in PERIODS_PX]
    lines = [f"| {' | '.join(head)} |", "|" + "---|" * len(head)]
    for row in rows:
        cells = [f"{row.per_m:g} /m, n {row.index:g}", "{}, {}".format(*row.pixel), f"{row.over:.2f}"]
        cells += [
            f"{photon_contrast:.2f}; {simulated_contrast:.2f}"
            for photon_contrast, simulated_contrast in zip(row.photons[1], row.simulated[1], strict=True)
        ]
        lines.append(f"| {' | '.join(cells)} |")
    return lines


def errors(rows: Sequence[RayBackscatter]) -> str:
    """Return the sentence on the standard errors of the photons, water by water."""
    sentences = []
    for per_m in sorted({row.per_m for row in rows}):
        mine = [row for row in rows if row.per_m == per_m]
        bright = 100.0 * max(row.more_error / row.more for row in mine)
        sentences.append(
            f"{bright:.1g} % of brightness and {max(max(row.errors) for row in mine):.1g} of contrast at {per_m:g} /m"
        )
    return f"The photons' standard errors are at most {', '.join(sentences)}. Nothing was fitted to them."


def write_page(rows: Sequence[RayBackscatter], page: Path) -> None:
    """Write the table between the page's marks. Raises ValueError, and changes nothing, for a page without marks."""
    head, above, remainder = page.read_text(encoding="utf-8").partition(BEGIN)
    _, below, tail = remainder.partition(END)
    if not above or not below:
        raise ValueError(f"{page}: no place for the table; needed are the lines {BEGIN!r} and {END!r}")
    lines = [head + BEGIN, "", *table(rows), "", errors(rows), "", END + tail]
    page.write_text("\n".join(lines), encoding="utf-8")
