"""Pages of reports: one HTML file with its pictures in it, for screen and paper."""

from __future__ import annotations

import base64
import html
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

_STYLE = """
:root { --ink: #1c2733; --muted: #5b6b7b; --line: #d5dde5; --soft: #f4f7f9; --deep: #0b3c5d; }
* { box-sizing: border-box; }
html { -webkit-print-color-adjust: exact; print-color-adjust: exact; }
body { margin: 0; color: var(--ink); background: #fff; font: 15px/1.5 "Inter", "Segoe UI", "Helvetica Neue", Arial, sans-serif; }
main { max-width: 1120px; margin: 0 auto; padding: 0 28px 48px; }
header { margin: 0 -28px 26px; padding: 34px 28px 24px; color: #fff; background: linear-gradient(120deg, #0b3c5d, #11698e); }
header h1 { margin: 0; font-size: 30px; line-height: 1.2; font-weight: 650; letter-spacing: -.01em; }
header p { margin: 6px 0 0; font-size: 16px; opacity: .9; }
header dl { display: grid; grid-template-columns: repeat(auto-fill, minmax(210px, 1fr)); gap: 10px 26px; margin: 22px 0 0; }
header dt { font-size: 11px; letter-spacing: .07em; text-transform: uppercase; opacity: .75; }
header dd { margin: 1px 0 0; overflow-wrap: anywhere; }
h2 { margin: 38px 0 12px; font-size: 19px; font-weight: 650; color: var(--deep); }
section p { max-width: 76ch; }
.tiles { display: grid; grid-template-columns: repeat(auto-fill, minmax(220px, 1fr)); gap: 14px; }
.tile { padding: 14px 18px; border: 1px solid var(--line); border-radius: 10px; background: var(--soft); }
.tile span, .tile small { display: block; color: var(--muted); font-size: 13px; }
.tile b { display: block; font-size: 25px; font-weight: 650; line-height: 1.3; font-variant-numeric: tabular-nums; }
.warnings { margin-top: 22px; padding: 2px 20px 8px; border-left: 4px solid #b26a00; border-radius: 6px; background: #fdf5e8; }
.warnings h2 { margin: 12px 0 4px; font-size: 16px; color: #7a4a00; }
.warnings ul { margin: 4px 0; padding-left: 20px; }
figure { margin: 0; }
.shown { display: inline-block; margin: 6px; vertical-align: top; max-width: 100%; }
.shown img, .shown svg { max-width: 100%; border: 1px solid var(--line); border-radius: 8px; }
.no { color: #8c1d18; font-weight: 600; }
.good { color: #0f5c3a; font-weight: 600; }
.yet { color: var(--muted); }
.next { border-left: 4px solid #b3261e; padding: .2em 1em; background: #fbf3f2; }
.next.done { border-color: #0f5c3a; background: #f1f7f2; }
pre { background: var(--soft); border: 1px solid var(--line); padding: .8em; overflow-x: auto; font-size: 13px; }
figcaption, .note, small { color: var(--muted); font-size: 13px; }
#turned { display: none; height: 620px; border: 1px solid var(--line); border-radius: 10px; background: linear-gradient(#fff, #eef3f6); overflow: hidden; }
.turning #turned { display: block; }
.turning .paper { display: none; }
.paper svg { display: block; width: 100%; height: auto; border: 1px solid var(--line); border-radius: 10px; }
.looks { display: none; gap: 6px; margin-bottom: 10px; }
.turning .looks { display: flex; }
.look { padding: 6px 15px; border: 1px solid var(--line); border-radius: 99px; background: #fff; color: var(--ink); font: inherit; font-size: 14px; cursor: pointer; }
.look[aria-pressed="true"] { border-color: var(--deep); background: var(--deep); color: #fff; }
.bar { display: block; width: 100%; max-width: 620px; height: auto; margin-top: 12px; }
.beside { display: grid; grid-template-columns: minmax(0, 3fr) minmax(0, 2fr); gap: 30px; align-items: start; }
.chart { display: block; width: 100%; height: auto; }
.net { max-width: 760px; margin: 0 auto 10px; }
.pictures { display: grid; grid-template-columns: repeat(auto-fill, minmax(240px, 1fr)); gap: 14px; }
.pictures img { display: block; width: 100%; height: auto; border: 1px solid var(--line); border-radius: 8px; }
.wide { overflow-x: auto; }
table { width: 100%; border-collapse: collapse; font-size: 13.5px; font-variant-numeric: tabular-nums; }
th { text-align: left; font-weight: 600; }
thead th { padding: 7px 10px; color: var(--muted); font-size: 12px; border-bottom: 2px solid var(--line); white-space: nowrap; }
td, tbody th, tfoot th { padding: 7px 8px; border-bottom: 1px solid var(--line); vertical-align: top; }
tbody tr:nth-child(even) { background: var(--soft); }
tfoot th { border-top: 2px solid var(--ink); border-bottom: 0; }
.figures th { font-weight: 400; color: var(--muted); }
.figures td { text-align: right; font-weight: 600; white-space: nowrap; }
.scans td:nth-child(-n+9), .pairs td:nth-child(-n+7) { white-space: nowrap; }
.vector span { display: inline-block; min-width: 4.2em; text-align: right; }
.chip { display: inline-block; padding: 1px 10px; border-radius: 99px; font-size: 12.5px; font-weight: 600; white-space: nowrap; }
.chip.good { color: #0f5c3a; background: #ddf3e7; }
.chip.doubtful, .chip.unchecked { color: #7a4a00; background: #fdeccd; }
.chip.refused { color: #8c1d18; background: #fbdfdc; }
.reading p { color: var(--muted); font-size: 13.5px; max-width: none; }
@media (max-width: 760px) { .beside { grid-template-columns: 1fr; } }
@page { size: A4; margin: 14mm 12mm 16mm; }
@media print {
  body { font-size: 10pt; }
  main { max-width: none; padding: 0; }
  header { margin: 0 0 14pt; padding: 14pt 16pt; border-radius: 6pt; }
  header h1 { font-size: 19pt; }
  h2 { margin: 16pt 0 6pt; font-size: 13pt; break-after: avoid; }
  .looks, .screen, #turned, .turning #turned, .turning .looks { display: none; }
  .paper, .turning .paper { display: block; }
  .colouring { display: none; }
  .colouring[data-colouring="0"] { display: block !important; }
  .tiles { grid-template-columns: repeat(4, 1fr); gap: 8pt; }
  .beside { grid-template-columns: minmax(0, 3fr) minmax(0, 2fr); gap: 14pt; }
  .paper svg { width: 92%; margin: 0 auto; }
  section p { break-after: avoid; }
  small, .chip { font-size: 7pt; }
  .chip { padding: 0 5pt; }
  .tile { padding: 6pt 9pt; }
  .tile b { font-size: 14pt; }
  .pictures { grid-template-columns: repeat(3, 1fr); gap: 8pt; }
  .wide { overflow: visible; }
  table { font-size: 7.6pt; }
  thead { display: table-header-group; }
  thead th { font-size: 7pt; white-space: normal; }
  td, tbody th, tfoot th { padding: 3pt 4pt; }
  .scans td:nth-child(n+10), .pairs td:nth-child(n+8) { white-space: normal; }
  .vector span { display: block; }
  tr, figure, .tile, .warnings, .beside, .view, tfoot { break-inside: avoid; }
}
"""
"""Style sheet of every page. It uses fonts of the reader's computer: a page brings none and loads none."""
NOTHING_RUNS = "default-src 'none'; img-src data:; style-src 'unsafe-inline'"
"""Content security policy of a page without scripts."""


class Html(str):
    """A text that is HTML already, for a cell of a table."""

    __slots__ = ()


class Page:
    """A page in the making, from its head on. All text is escaped here, unless it is ``Html``."""

    def __init__(self, title: str, subtitle: str = "", facts: Mapping[str, Any] | None = None) -> None:
        """Begin a page; ``facts``: facts by name, for the head."""
        terms = "".join(f"<div><dt>{_escaped(k)}</dt><dd>{_cell(v)}</dd></div>" for k, v in (facts or {}).items())
        below = f"<p>{_escaped(subtitle)}</p>" if subtitle else ""
        self._title = _escaped(title)
        self._parts = [f"<header><h1>{self._title}</h1>{below}<dl>{terms}</dl></header>"]

    def add(self, content: str) -> None:
        """Add HTML as it is."""
        self._parts.append(content)

    def heading(self, text: str, anchor: str = "") -> None:
        """Begin a section; ``anchor``: the name that links go to."""
        self.add(f'<h2 id="{_escaped(anchor)}">{_escaped(text)}</h2>' if anchor else f"<h2>{_escaped(text)}</h2>")

    def note(self, text: str) -> None:
        """Add a line of explanation."""
        self.add(f'<p class="note">{_escaped(text)}</p>')

    def problem(self, text: str) -> None:
        """Add a line about a fault, in red."""
        self.add(f'<p class="no">{_escaped(text)}</p>')

    def tiles(self, figures: Iterable[tuple[str, str, str]]) -> None:
        """Add figures in large type: name, value, and small text below."""
        each = "".join(
            f'<div class="tile"><span>{_escaped(name)}</span><b>{_escaped(value)}</b><small>{_escaped(more)}</small></div>'
            for name, value, more in figures
        )
        self.add(f'<section class="tiles">{each}</section>')

    def facts(self, values: Mapping[str, Any]) -> None:
        """Add a table of names and values."""
        body = "".join(f"<tr><th>{_escaped(k)}</th><td>{_cell(v)}</td></tr>" for k, v in values.items())
        self.add(f'<div class="wide"><table>{body}</table></div>')

    def rows(self, content: Sequence[Mapping[str, Any]], marks: Mapping[str, str] | None = None) -> None:
        """Add a table with one row each (at least one), all with the keys of the first.

        ``marks``: the CSS class of a cell by its text.
        """
        marked = marks or {}
        cells = ([(_cell(value), marked.get(str(value), "")) for value in row.values()] for row in content)
        self._table(map(_escaped, content[0]), cells, "")

    def table(self, columns: Iterable[str], cells: Iterable[Iterable[str]], kind: str = "") -> None:
        """Add a table of ``cells`` that are HTML, row by row."""
        self._table(map(_escaped, columns), ([(cell, "") for cell in row] for row in cells), kind)

    def _table(self, columns: Iterable[str], cells: Iterable[Iterable[tuple[str, str]]], kind: str) -> None:
        names = "".join(f"<th>{name}</th>" for name in columns)
        body = "".join("<tr>" + "".join(_td(*cell) for cell in row) + "</tr>" for row in cells)
        self.add(
            f'<div class="wide"><table class="{kind}"><thead><tr>{names}</tr></thead><tbody>{body}</tbody></table></div>'
        )

    def figure(self, caption: str, picture: bytes | str) -> None:
        """Add a picture, a PNG file or a complete ``svg`` element, with its caption."""
        text = _escaped(caption)
        if isinstance(picture, bytes):
            # Embedded, so that a report that is mailed or archived keeps its pictures.
            picture = f'<img alt="{text}" src="data:image/png;base64,{base64.b64encode(picture).decode()}">'
        self.add(f'<figure class="shown">{picture}<figcaption>{text}</figcaption></figure>')

    def as_html(self, policy: str = NOTHING_RUNS, scripts: str = "") -> str:
        """Return the complete page. ``policy``: its content security policy."""
        return (
            f'<!doctype html>\n<html lang="en"><head><meta charset="utf-8"><meta http-equiv="Content-Security-Policy" '
            f'content="{policy}"><meta name="viewport" content="width=device-width, initial-scale=1">'
            f"<title>{self._title}</title><style>{_STYLE}</style></head>\n"
            f"<body><main>{''.join(self._parts)}</main>\n{scripts}</body></html>\n"
        )


def _escaped(text: str) -> str:
    return html.escape(str(text))


def _td(cell: str, mark: str) -> str:
    return f'<td class="{mark}">{cell}</td>' if mark else f"<td>{cell}</td>"


def _cell(value: Any) -> str:
    if value is None:
        return "–"
    if isinstance(value, Html):
        return value
    if isinstance(value, float):
        return f"{value:.4g}" if abs(value) < 10 else f"{value:.4f}"
    if isinstance(value, Mapping):
        return "; ".join(f"{_escaped(str(k))} {_cell(v)}" for k, v in value.items()) or "–"
    return _escaped(str(value))
