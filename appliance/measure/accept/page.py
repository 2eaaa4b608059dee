"""Owns how the page of a report looks: plain HTML with its pictures in it, so that one file is all there is to keep."""

from __future__ import annotations

import base64
import html
from collections.abc import Mapping, Sequence
from typing import Any

_STYLE = (
    "body{font:15px/1.45 sans-serif;max-width:60em;margin:2em auto;padding:0 1em;color:#222}"
    "table{border-collapse:collapse;margin:.6em 0}td,th{border:1px solid #bbb;padding:.2em .6em;text-align:left}"
    "img,svg{max-width:100%;border:1px solid #bbb}figure{display:inline-block;margin:.4em}figcaption{font-size:.85em}"
    ".no{color:#a00;font-weight:bold}"
)
PAGE_END = "</html>\n"


def page_head(title: str) -> str:
    """Return the page down to its title."""
    text = html.escape(title)
    return (
        f'<!doctype html><html lang="en"><meta charset="utf-8"><title>{text}</title><style>{_STYLE}</style>\n'
        f"<h1>{text}</h1>"
    )


def figure(caption: str, png: bytes) -> str:
    """Return a picture with what it shows."""
    text = html.escape(caption)
    # As data within the page: a report that is mailed or archived takes its pictures along.
    source = base64.b64encode(png).decode()
    return f'<figure><img alt="{text}" src="data:image/png;base64,{source}"><figcaption>{text}</figcaption></figure>'


def drawing(caption: str, svg: str) -> str:
    """Return a drawing, a whole ``svg`` element, with what it shows."""
    return f"<figure>{svg}<figcaption>{html.escape(caption)}</figcaption></figure>"


def table(values: Mapping[str, Any]) -> str:
    """Return a table of names and values."""
    body = "".join(f"<tr><th>{html.escape(str(k))}</th><td>{_cell(v)}</td></tr>" for k, v in values.items())
    return f"<table>{body}</table>"


def rows(content: Sequence[Mapping[str, Any]]) -> str:
    """Return a table with one row each (at least one), all with the keys of the first."""
    head = "".join(f"<th>{html.escape(key)}</th>" for key in content[0])
    body = "".join("<tr>" + "".join(f"<td>{_cell(v)}</td>" for v in row.values()) + "</tr>" for row in content)
    return f"<table><tr>{head}</tr>{body}</table>"


def _cell(value: Any) -> str:
    if value is None:
        return "–"
    if isinstance(value, float):
        return f"{value:.4g}" if abs(value) < 10 else f"{value:.4f}"
    if isinstance(value, Mapping):
        return "; ".join(f"{html.escape(str(k))} {_cell(v)}" for k, v in value.items()) or "–"
    return html.escape(str(value))
