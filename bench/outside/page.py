"""Write the tables of ``docs/outside.md``: chosen figures of each part, and how each part was measured."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from types import MappingProxyType

from bench.outside.picture import draw_scene
from bench.outside.record import Content, read
from bench.verdict.binomial import percent

SCENE = 10_001, 3
"""Seed and number of the scene that is shown."""
BEGIN, END = "<!-- figures: ./dev bench outside --write-docs -->", "<!-- end of figures -->"
HEAD = ("| part | figure | target | measured |", "|---|---|---|---:|")
MADE_HEAD = ("| part | seed | count | day |", "|---|---:|---:|---|")
FIGURES = MappingProxyType(
    {
        "scenes": (
            "accepted",
            "completeness, median of accepted",
            "outliers over 1 mm in accepted scans",
            "error over sigma, median of accepted",
            "of these above 1.5 and nothing said",
            "false alarms of light",
            "false alarms of the calibration's health",
        ),
        "sample": ("soft scenes: false alarms of light",),
        "milk": ("completeness in milk, backscatter", "completeness in milk, all at rest"),
        "rigs": (
            "all, 4 recordings: E_Lb of the worst of",
            "all, 10 recordings: E_Lb of the worst of",
            "all, 10 recordings: E_Lb of the worst in a case",
        ),
        "health": ("knocks of 0.02° found",),
        "motion": (
            "motion: at rest and refused",
            "motion: refused, of those adding over 10 %",
            "motion: refused, of those adding under 5 %",
        ),
        "identity": (
            "identity: found, where visible, still",
            "identity: seen and rightly named",
        ),
        "compensation": ("named, shown: error over that at rest, largest",),
        "causes": ("first reason is a true one",),
    }
)
"""How the names of the figures begin that the page shows of each part; the measurement's file has all figures."""


def write_page(data: Path, page: Path, pictures: Path) -> None:
    """Write the figures of ``data`` into the page, and draw the picture.

    Rows of parts that ``data`` lacks stay. Of several seeds of a part the smallest seed is shown. Raises ValueError,
    and changes nothing, for a page without marks.
    """
    head, above, remainder = page.read_text(encoding="utf-8").partition(BEGIN)
    inside, below, tail = remainder.partition(END)
    if not above or not below:
        raise ValueError(f"{page}: no place for the figures; needed are the lines {BEGIN!r} and {END!r}")
    figures, settings = _rows(inside, HEAD), _rows(inside, MADE_HEAD)
    for name, seeds in read(data)["parts"].items():
        seed = min(seeds, key=int)
        figures[name] = [
            f"| {name} | {figure['name'].removeprefix(f'{name}: ')} | {_target(figure)} | {_now(figure)} |"
            for figure in seeds[seed]["measured"]
            if figure["name"].startswith(FIGURES[name])
        ]
        settings[name] = [f"| {name} | {seed} | {seeds[seed]['count']} | {seeds[seed]['measured_on']} |"]
    lines = [head + BEGIN, "", *HEAD, *_ordered(figures), "", *MADE_HEAD, *_ordered(settings), "", END + tail]
    page.write_text("\n".join(lines), encoding="utf-8")
    draw_scene(pictures / "outside-scene.png", *SCENE)


def _rows(inside: str, head: Sequence[str]) -> dict[str, list[str]]:
    """Return the rows below the table head ``head``, by their part."""
    rows: dict[str, list[str]] = {}
    for line in inside.partition("\n".join(head) + "\n")[2].splitlines():
        if not line.startswith("|"):
            break
        rows.setdefault(line.split("|")[1].strip(), []).append(line)
    return rows


def _ordered(rows: dict[str, list[str]]) -> list[str]:
    return [line for name in FIGURES for line in rows.get(name, [])]


def _now(figure: Content) -> str:
    """Return the cell of a figure: with the digits that show a missed limit, or the reason for its absence."""
    if figure["value"] is None:
        return f"— ({figure['why']})" if figure["why"] else "—"
    value, bounds = float(figure["value"]), (figure["at_least"], figure["at_most"])
    share = figure.get("share")
    text = percent(share[0] / share[1]) if share and figure["unit"].startswith("%") else _short(value)
    for digits in range(4, 12):
        if figure["kept"] or float(text) not in bounds:
            break
        text = f"{value:.{digits}g}"
    return f"{text} {figure['unit']}".rstrip() + ("" if figure["kept"] else " **missed**")


def _target(figure: Content) -> str:
    low, high = figure["at_least"], figure["at_most"]
    if low is not None and high is not None:
        return f"{low:g} to {high:g}"
    if low is not None:
        return f"≥ {low:g}"
    return "" if high is None else f"≤ {high:g}"


def _short(value: float) -> str:
    return f"{value:.0f}" if abs(value) >= 100.0 else f"{value:.3g}"
