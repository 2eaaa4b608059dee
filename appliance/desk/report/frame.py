"""Owns a page around what is on it: the document, its head, its tiles and its tables. All text is escaped here, but cells of tables."""

from __future__ import annotations

import html
from collections.abc import Iterable, Mapping

from appliance.desk.report.style import STYLE


def document(title: str, policy: str, parts: Iterable[str], scripts: str = "") -> str:
    """Return the whole page as HTML. ``policy``: what a browser may fetch or run."""
    return (
        f'<!doctype html>\n<html lang="en"><head><meta charset="utf-8"><meta http-equiv="Content-Security-Policy" content="{policy}">'
        f'<meta name="viewport" content="width=device-width, initial-scale=1"><title>{html.escape(title)}</title><style>{STYLE}</style></head>\n'
        f"<body><main>{''.join(parts)}</main>\n{scripts}</body></html>\n"
    )


def head(title: str, subtitle: str, about: Mapping[str, str]) -> str:
    """Return the head of a page, with what it is ``about`` by name."""
    facts = "".join(
        f"<div><dt>{html.escape(name)}</dt><dd>{html.escape(text)}</dd></div>" for name, text in about.items()
    )
    said = f"<p>{html.escape(subtitle)}</p>" if subtitle else ""
    return f"<header><h1>{html.escape(title)}</h1>{said}<dl>{facts}</dl></header>"


def tiles(figures: Iterable[tuple[str, str, str]]) -> str:
    """Return the figures that stand large: a name, a value, and small words below."""
    each = "".join(
        f'<div class="tile"><span>{html.escape(name)}</span><b>{html.escape(value)}</b><small>{html.escape(more)}</small></div>'
        for name, value, more in figures
    )
    return f'<section class="tiles">{each}</section>'


def table(columns: Iterable[str], rows: Iterable[Iterable[str]], kind: str = "") -> str:
    """Return a table; ``rows`` are of cells that are HTML."""
    body = "".join("<tr>" + "".join(f"<td>{cell}</td>" for cell in row) + "</tr>" for row in rows)
    names = "".join(f"<th>{name}</th>" for name in columns)
    return f'<div class="wide"><table class="{kind}"><thead><tr>{names}</tr></thead><tbody>{body}</tbody></table></div>'
