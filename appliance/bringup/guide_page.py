"""Owns the page about a guided bring-up: everything that whoever helps from afar would ask for, in one file."""

from __future__ import annotations

import html
from collections.abc import Mapping

from appliance.bringup.guide import STEPS, GuideStep
from appliance.bringup.guide_state import GuideState, StepRecord
from appliance.bringup.page import findings_table
from appliance.evaluation.page import PAGE_END, figure, page_head, rows, table

PAGE = "bringup.html"
_STYLE = (
    "<style>.good{color:#06602a;font-weight:bold}.yet{color:#777}"
    "pre{background:#f5f5f2;border:1px solid #bbb;padding:.8em;overflow-x:auto;font-size:.85em}"
    "td{vertical-align:top}body{max-width:74em}h2{margin-top:1.8em;border-bottom:1px solid #bbb}"
    ".next{border-left:4px solid #a00;padding:.2em 1em;background:#fbf3f2}.next.done{border-color:#06602a;background:#f1f7f2}</style>"
)


def guide_page(state: GuideState, rig_text: str, pictures: Mapping[str, bytes]) -> str:
    """Return the page as HTML. ``pictures`` are PNG by the name that the state has; one that is missing is left out."""
    parts = [page_head("Kingfisher: from a box of parts to the first plane"), _STYLE, _next(state), _summary(state)]
    for number, step in enumerate(STEPS, 1):
        record = state.steps.get(step.name)
        if record is not None:
            parts.append(_step(number, step, record, pictures))
    # Last, since it is long and only wanted where the findings leave something open.
    for title, lines in state.about.items():
        parts.append(f"<h2>{html.escape(title)}</h2><pre>{html.escape(chr(10).join(lines) or 'nothing')}</pre>")
    parts.append(
        f"<h2>The rig file</h2><p>{html.escape(state.rig_file)}, sha256 {html.escape(state.rig_sha256)}</p>"
        f"<pre>{html.escape(rig_text)}</pre>"
    )
    return "".join(parts) + PAGE_END


def side_by_side(name: str, columns: Mapping[str, Mapping[str, str]]) -> tuple[Mapping[str, object], ...]:
    """Return the rows of a table with one column for each of ``columns``, and every key that one of them has under ``name``."""
    keys = dict.fromkeys(key for column in columns.values() for key in column)
    return tuple({name: key, **{title: column.get(key) for title, column in columns.items()}} for key in keys)


def _next(state: GuideState) -> str:
    """Return what is to be done now, in words: whoever opens the page wants that first."""
    for step in STEPS:
        record = state.steps.get(step.name)
        if record is None:
            return f'<p class="next">Next: <b>{step.name}</b>, {html.escape(step.title.lower())}.</p>'
        if not record.good:
            wrong = "".join(
                f"<li><b>{html.escape(one.name)}</b>: {html.escape(one.said)}. Do: {html.escape(one.remedy)}.</li>"
                for one in record.findings
                if not one.ok
            )
            return f'<div class="next"><p>Stopped at <b>{step.name}</b>, {html.escape(step.title.lower())}:</p><ul>{wrong}</ul></div>'
    return '<p class="next done">All twelve steps are good. Next: calibrate (docs/calibration.md).</p>'


def _summary(state: GuideState) -> str:
    lines = []
    for number, step in enumerate(STEPS, 1):
        record = state.steps.get(step.name)
        lines.append(
            {
                "": number,
                "step": step.name,
                "what": step.title,
                "is": "not yet" if record is None else "good" if record.good else "WRONG",
                "when": None if record is None else record.when,
                "took": None if record is None else f"{record.duration_s:.0f} s",
            }
        )
    # Marked after the cells were escaped: the words are ours.
    table_html = rows(lines)
    for step in STEPS:
        if step.name in state.steps:
            table_html = table_html.replace(f"<td>{step.name}</td>", f'<td><a href="#{step.name}">{step.name}</a></td>')
    return (
        table_html.replace("<td>WRONG</td>", '<td class="no">WRONG</td>')
        .replace("<td>good</td>", '<td class="good">good</td>')
        .replace("<td>not yet</td>", '<td class="yet">not yet</td>')
    )


def _step(number: int, step: GuideStep, record: StepRecord, pictures: Mapping[str, bytes]) -> str:
    word = '<span class="good">good</span>' if record.good else '<span class="no">WRONG</span>'
    parts = [f'<h2 id="{step.name}">{number}. {html.escape(step.title)} ({step.name}): {word}</h2>']
    if record.findings:
        parts.append(findings_table(record.findings))
        # Sentences round their numbers; whoever helps wants all digits.
        numbers = [
            {"number": f"{one.name}: {name}", "value": value}
            for one in record.findings
            for name, value in one.numbers.items()
        ]
        if numbers:
            parts.append(f"<details><summary>all numbers</summary>{rows(numbers)}</details>")
    if record.written:
        parts.append("<h3>Written into the rig file</h3>" + table(record.written))
    for title, content in record.tables.items():
        if content:
            parts.append(f"<details open><summary>{html.escape(title)}</summary>{rows(content)}</details>")
    parts += [figure(caption, pictures[name]) for name, caption in record.pictures.items() if name in pictures]
    return "".join(parts)
